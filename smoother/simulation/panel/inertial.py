"""What the IMUs on the panel and on the camera measure while the panel goes from pose to pose."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from ...array_types import FloatArray
from ...recording import ImuStream
from ...units import GRAVITY
from ..config import SensorErrors
from ..inertial import ideal_imu, measure
from ..path import band_noise, ramp
from .config import PanelSimulation

#: The earth's field in {W}, uT: 60 degrees below the horizon, x to the north.
FIELD_W = np.array([24.0, 0.0, -41.6])
_SWAY_HZ = (0.5, 3.0)
_SWAY_M_A_DEG = 0.005  # a hand that sways by a degree also moves by this


@dataclass(frozen=True)
class Held:
    """A body that is held in one pose after the other, and sways a little.

    Attributes
    ----------
    R_W : ndarray, shape (n, 3, 3)
        Orientation in each pose, body to world.
    p_W : ndarray, shape (n, 3), m
    hold_s, move_s : float, s
        Time in a pose, and from one to the next.
    sway_deg : float, deg
        Rms of the sway.
    seed : int
        Of the sway.
    """

    R_W: FloatArray
    p_W: FloatArray
    hold_s: float
    move_s: float
    sway_deg: float = 0.0
    seed: int = 0

    def middle_s(self) -> FloatArray:
        """Times (n,) in the middle of the holds."""
        return (np.arange(len(self.R_W)) + 0.5) * self.hold_s + np.arange(len(self.R_W)) * self.move_s

    @property
    def duration_s(self) -> float:
        """From the start of the first hold to the end of the last."""
        return len(self.R_W) * self.hold_s + (len(self.R_W) - 1) * self.move_s

    def imu_pose(self, t_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Orientation (N, 3, 3) and position (N, 3) m in {W}: minimum jerk between the poses."""
        poses = Rotation.from_matrix(self.R_W)
        step = (poses[:-1].inv() * poses[1:]).as_rotvec()
        R = np.tile(self.R_W[0], (len(t_s), 1, 1))
        p = np.tile(self.p_W[0], (len(t_s), 1))
        for i, begin in enumerate(self.middle_s()[:-1] + self.hold_s / 2):
            now = t_s >= begin
            share = ramp(t_s[now], begin, self.move_s)[:, None]
            R[now] = (poses[i] * Rotation.from_rotvec(share * step[i])).as_matrix()
            p[now] = self.p_W[i] + share * (self.p_W[i + 1] - self.p_W[i])
        if self.sway_deg > 0:
            sway = self.sway_deg * band_noise(t_s, *_SWAY_HZ, 6, np.random.default_rng(self.seed))
            R = R @ Rotation.from_rotvec(np.radians(sway[:, :3]) / np.sqrt(3)).as_matrix()
            p = p + _SWAY_M_A_DEG * sway[:, 3:]
        return R, p

    def joints(self, t_s: FloatArray) -> dict[str, FloatArray]:
        """No joints."""
        return {}


def imu_stream(
    name: str, body: Held, R_body_imu: FloatArray, config: PanelSimulation, rng: np.random.Generator
) -> ImuStream:
    """Samples of an IMU on a body, in the IMU's axes, over the whole session."""
    on_body = replace(body, R_W=body.R_W @ R_body_imu)
    ideal = ideal_imu(on_body, body.duration_s, config.imu_rate_hz, np.array([0, 0, -GRAVITY]))
    errors = SensorErrors.preset(
        "clean",
        imu_rate_hz=config.imu_rate_hz,
        accelerometer_noise=config.accelerometer_noise,
        gyroscope_noise=config.gyroscope_noise,
        accelerometer_bias=config.accelerometer_bias,
        gyroscope_bias=config.gyroscope_bias,
        imu_scale=config.imu_scale,
    )
    stream, _ = measure(ideal, errors, rng)
    mag = None
    if config.magnetometer:
        R, _ = on_body.imu_pose(ideal.t_s)
        mag = np.einsum("nji,j->ni", R, FIELD_W) + config.magnetometer_bias * rng.normal(size=3)
        mag = mag + config.magnetometer_noise * rng.normal(size=mag.shape)
    return ImuStream(name, stream.t_s, stream.acc, stream.gyro, mag)
