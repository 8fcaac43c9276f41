"""A second IMU, on the upper arm: how it sits, how soft tissue moves it, and what it measures."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.spatial.transform import Rotation

from ..array_types import FloatArray
from ..recording import ImuStream
from .body import BodyMeasures
from .config import ArmSimulation
from .inertial import ideal_imu, measure
from .motion import ArmMotion


@dataclass(frozen=True)
class UpperMount:
    """How the IMU sits on the upper arm; {U} as in `body`, its origin in the elbow.

    Attributes
    ----------
    in_upper_arm : ndarray, shape (3,), m
        The IMU in {U}: y is negative, {U} points from the shoulder to the elbow.
    axes : ndarray, shape (3, 3)
        Maps a vector from the IMU's axes {B} to {U}.
    side : str
        Whose {U} it is.
    """

    in_upper_arm: FloatArray
    axes: FloatArray
    side: str

    def levers(self, upper_arm_m: float) -> dict[str, FloatArray]:
        """Elbow and shoulder (3,) in {B}, m, for an IMU that sits as it was put on."""
        shoulder = np.array([0.0, -upper_arm_m, 0.0])
        return {
            "elbow": self.axes.T @ -self.in_upper_arm,
            "shoulder": self.axes.T @ (shoulder - self.in_upper_arm),
        }

    @property
    def R_U_B(self) -> FloatArray:
        """From {B} to axes with y towards the shoulder and z towards the lateral epicondyle, (3, 3)."""
        lateral = -1.0 if self.side == "left" else 1.0
        return np.asarray(np.diag([-lateral, -1.0, lateral]) @ self.axes)


def draw_upper_mount(measures: BodyMeasures, side: str, rng: np.random.Generator) -> UpperMount:
    """Somewhere in the middle of the upper arm's outer side, turned as it comes."""
    roll = Rotation.from_euler("y", rng.uniform(-60, 60), degrees=True)
    axes = roll * Rotation.from_euler("z", rng.uniform(-180, 180), degrees=True)
    tilt = Rotation.from_rotvec(rng.normal(0, 5, 3), degrees=True)
    along = -rng.uniform(0.35, 0.6) * measures.upper_arm
    off = roll.apply([0.0, 0.0, rng.uniform(0.040, 0.055)])
    return UpperMount(off + np.array([0.0, along, 0.0]), (axes * tilt).as_matrix(), side)


class UpperArmMotion:
    """The upper-arm IMU of an arm in motion; the tissue turns it about the bone's axis beneath it."""

    def __init__(self, arm: ArmMotion, mount: UpperMount, t_s: FloatArray, wobble: FloatArray) -> None:
        self.arm, self.mount = arm, mount
        self._wobble = make_interp_spline(t_s, wobble, k=5)

    def imu_pose(self, t_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """`R_K_B` (N, 3, 3) and the IMU's position (N, 3) m in {K}."""
        elbow, R_K_U = self.arm.upper_arm(t_s)
        tissue = Rotation.from_rotvec(self._wobble(t_s)).as_matrix()
        beneath = self.mount.in_upper_arm * [0.0, 1.0, 0.0]
        in_upper_arm = beneath + tissue @ (self.mount.in_upper_arm - beneath)
        position = elbow + np.einsum("nij,nj->ni", R_K_U, in_upper_arm)
        return R_K_U @ tissue @ self.mount.axes, position

    def joints(self, t_s: FloatArray) -> dict[str, FloatArray]:
        """Positions (N, 3) by joint, m in {K}."""
        return self.arm.joints(t_s)


def measure_upper_arm(
    motion: UpperArmMotion,
    duration_s: float,
    gravity: FloatArray,
    config: ArmSimulation,
    rng: np.random.Generator,
) -> tuple[ImuStream, dict[str, Any]]:
    """The IMU's samples on its own clock, and what was drawn, by names that begin with `upper_imu_`."""
    ideal = ideal_imu(motion, duration_s, config.imu_rate_hz, gravity)
    measured, drawn = measure(ideal, config, rng)
    t_s = config.upper_clock_s + (1.0 + 1e-6 * config.upper_clock_ppm) * measured.t_s
    name = f"/imu/upper_arm_{config.side}"
    parameters = {f"upper_imu_{name}": value for name, value in drawn.items()}
    parameters["upper_clock_s"] = config.upper_clock_s
    return replace(measured, name=name, t_s=t_s), parameters
