"""An IMU on the trunk: how it sits, and what it measures."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from ..array_types import FloatArray
from ..recording import ImuStream
from .config import ArmSimulation
from .inertial import ideal_imu, measure
from .trunk import TrunkTurn

#: Where it sits, on the breastbone, m in {T}.
BREASTBONE = np.array([0.0, -0.10, -0.12])
#: {T} of the simulation (x right, y up, z back) to the ISB's thorax (x forward, y up, z right).
R_ISB_T = np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])


@dataclass(frozen=True)
class TrunkImuMotion:
    """The trunk with its IMU: a `MotionModel` without joints.

    Attributes
    ----------
    R_K_T : ndarray, shape (3, 3)
        Axes of the upright trunk to the camera's.
    origin_K : ndarray, shape (3,), m
        Origin of {T} in {K}.
    turn : TrunkTurn
    axes : ndarray, shape (3, 3)
        Maps a vector from the IMU's axes {D} to {T}.
    """

    R_K_T: FloatArray
    origin_K: FloatArray
    turn: TrunkTurn
    axes: FloatArray

    @property
    def R_T_D(self) -> FloatArray:
        """From {D} to the thorax's axes as the ISB has them, (3, 3)."""
        return R_ISB_T @ self.axes

    def thorax(self, t_s: FloatArray) -> FloatArray:
        """The thorax's axes as the ISB has them, in {K}, (N, 3, 3)."""
        return self.R_K_T @ self.turn.at(t_s) @ R_ISB_T.T

    def imu_pose(self, t_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """See `MotionModel.imu_pose`."""
        place = self.turn.moved(np.tile(BREASTBONE, (len(t_s), 1)), t_s)
        return self.R_K_T @ self.turn.at(t_s) @ self.axes, place @ self.R_K_T.T + self.origin_K

    def joints(self, t_s: FloatArray) -> dict[str, FloatArray]:
        """No joints."""
        return {}


def draw_trunk_axes(rng: np.random.Generator) -> FloatArray:
    """How the IMU lies on the breastbone: turned as it comes, a little tilted, (3, 3) from {D} to {T}."""
    turn = Rotation.from_euler("z", rng.uniform(-180, 180), degrees=True)
    tilt = Rotation.from_rotvec(rng.normal(0, 12, 3), degrees=True)
    return np.asarray((tilt * turn).as_matrix())


def measure_trunk(
    motion: TrunkImuMotion,
    duration_s: float,
    gravity: FloatArray,
    config: ArmSimulation,
    rng: np.random.Generator,
) -> tuple[ImuStream, dict[str, Any]]:
    """The IMU's samples on its own clock, and what was drawn, by names that begin with `trunk_imu_`."""
    measured, drawn = measure(ideal_imu(motion, duration_s, config.imu_rate_hz, gravity), config, rng)
    parameters: dict[str, Any] = {f"trunk_imu_{name}": value for name, value in drawn.items()}
    stream = ImuStream("/imu/trunk", measured.t_s + config.trunk_clock_s, measured.acc, measured.gyro)
    return stream, parameters | {"trunk_clock_s": config.trunk_clock_s}
