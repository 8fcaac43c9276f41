"""An analytic motion: a body that turns and accelerates, known in closed form at any time."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

from smoother.array_types import FloatArray
from smoother.recording import ImuStream

G = 9.81


def _harmonics(seed: int, size: int, amplitude: FloatArray, fastest_hz: float) -> FloatArray:
    """(3, size, 3) amplitude, angular frequency, phase of three sines for each of `size` quantities."""
    rng = np.random.default_rng(seed)
    a = amplitude[:, None] * rng.uniform(0.3, 1.0, (size, 3))
    return np.stack([a, 2 * np.pi * rng.uniform(0.2, fastest_hz, (size, 3)), rng.uniform(0, 6.28, (size, 3))])


@dataclass(frozen=True)
class Curve:
    """Euler angles (zyx) and position are sums of sines; everything else follows by differentiation.

    With `fastest_hz` 1.5 the body reaches about 6 rad/s and 8 m/s^2: a brisk arm.
    """

    seed: int = 0
    fastest_hz: float = 1.5
    down: FloatArray = field(default_factory=lambda: np.array([0.0, -1.0, 0.0]))
    turns_rad: tuple[float, float, float] = (0.5, 0.4, 0.5)  # About z, y and x

    def _sum(self, waves: FloatArray, t: FloatArray, order: int) -> FloatArray:
        a, w, phase = waves
        return (a * w**order * np.sin(w * t[:, None, None] + phase + 0.5 * np.pi * order)).sum(axis=-1)

    def _angles(self, t: FloatArray, order: int) -> FloatArray:
        waves = _harmonics(self.seed, 3, np.array(self.turns_rad), self.fastest_hz)
        return self._sum(waves, t, order)

    def _position(self, t: FloatArray, order: int) -> FloatArray:
        waves = _harmonics(self.seed + 1000, 3, np.array([0.12, 0.10, 0.06]), self.fastest_hz)
        return self._sum(waves, t, order) + (np.array([0.0, 0.0, 2.0]) if order == 0 else 0.0)

    def rotation(self, t: FloatArray) -> Rotation:
        return Rotation.from_euler("ZYX", self._angles(t, 0))

    def position(self, t: FloatArray) -> FloatArray:
        return self._position(t, 0)

    def velocity(self, t: FloatArray) -> FloatArray:
        return self._position(t, 1)

    def rate(self, t: FloatArray) -> FloatArray:
        """Angular velocity (N, 3) in the body's axes, by the kinematics of zyx Euler angles."""
        (_, b, c), (da, db, dc) = self._angles(t, 0).T, self._angles(t, 1).T
        return np.stack(
            [
                dc - da * np.sin(b),
                db * np.cos(c) + da * np.cos(b) * np.sin(c),
                da * np.cos(b) * np.cos(c) - db * np.sin(c),
            ],
            axis=1,
        )

    def force(self, t: FloatArray) -> FloatArray:
        """Specific force (N, 3) in the body's axes."""
        return self.rotation(t).inv().apply(self._position(t, 2) - G * self.down)

    def imu(self, rate_hz: float, duration_s: float) -> ImuStream:
        """Samples that are exact means over their intervals (Gauss-Legendre, 10 points: rounding only)."""
        t: FloatArray = (np.arange(int(duration_s * rate_hz), dtype=np.float64) + 0.5) / rate_hz
        x, w = np.polynomial.legendre.leggauss(10)
        fine = (t[:, None] + 0.5 * x / rate_hz).ravel()
        acc, gyro = (
            np.einsum("k,nki->ni", 0.5 * w, values(fine).reshape(len(t), 10, 3))
            for values in (self.force, self.rate)
        )
        return ImuStream("analytic", t, acc, gyro)


def angle_rad(a: FloatArray, b: FloatArray) -> FloatArray:
    """Angle (N,) between stacks of rotation matrices."""
    return np.asarray(Rotation.from_matrix(np.swapaxes(a, -1, -2) @ b).magnitude())
