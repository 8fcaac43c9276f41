"""One Gaussian process over positions, seen through two linear maps: positions and accelerations.

Feng (Glasgow thesis, 2014), chapter 4: positions at a high rate have the prior N(0, Sigma); the camera sees
some of them (K_p, 4.17), the accelerometer their second differences (K_a, 4.13, each belonging to the centre
of its three), and the joint covariance of all measurements is K Sigma K' plus their noise (4.21). K Sigma K'
is written out here as differences of the kernel, so frames and samples may be at any times, and the second
difference keeps its own step whatever the IMU's rate: a step of 1/1000 s would leave nothing but rounding.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..array_types import FloatArray

#: Step of the differences, s (theirs).
STEP_S = 1.0 / 90.0
SECOND = ((-1, 1.0), (0, -2.0), (1, 1.0))
FIRST = ((-0.5, -1.0), (0.5, 1.0))


@dataclass(frozen=True)
class Kernel:
    """Hyper-parameters: cov(p(t), p(t + d)) = variance exp(-rate d^2) (2.14), and the sensors' noise."""

    variance: float = 5.66e4 * 1e-6  # m^2: v0
    rate: float = 4.19  # w
    position_sigma: float = 0.008  # m and m/s^2
    acceleration_sigma: float = 0.100  # m and m/s^2

    def __call__(self, apart: FloatArray) -> FloatArray:
        """Covariance of positions at times `apart`, s, from each other."""
        return np.asarray(self.variance * np.exp(-self.rate * apart**2))


#: What was published (section 4.5.2): v0 = 5.66e4 mm^2, w = 4.19, 8 mm, 100 mm/s^2.
PUBLISHED = Kernel()


@dataclass(frozen=True)
class Measurements:
    """Positions and accelerations; their c columns share the times."""

    frame_t: FloatArray  # (f,) s
    position: FloatArray  # (f, c) m
    acc_t: FloatArray  # (n,) s
    acceleration: FloatArray  # (n, c) m/s^2

    def between(self, start_s: float, end_s: float) -> Measurements:
        """Those from one time to another, s, both included."""
        f = (self.frame_t >= start_s) & (self.frame_t <= end_s)
        a = (self.acc_t >= start_s) & (self.acc_t <= end_s)
        return Measurements(self.frame_t[f], self.position[f], self.acc_t[a], self.acceleration[a])

    @property
    def targets(self) -> FloatArray:
        """M_all (4.19), (f + n, c)."""
        return np.vstack([self.position, self.acceleration])


def mapped_covariance(
    kernel: Kernel,
    t: FloatArray,  # (n,) and (k,) s
    rows: tuple[tuple[float, float], ...],
    other: FloatArray,  # (n,) and (k,) s
    columns: tuple[tuple[float, float], ...],
) -> FloatArray:  # (n, k)
    """Covariance of two differences of positions."""
    apart = t[:, None] - other[None, :]
    total = np.zeros_like(apart)
    shifts: dict[float, float] = {}
    for i, a in rows:
        for j, b in columns:
            shifts[i - j] = shifts.get(i - j, 0.0) + a * b
    for shift, weight in shifts.items():
        total += weight * kernel(apart + shift * STEP_S)
    return total


VALUE = ((0, 1.0),)


def joint_covariance(kernel: Kernel, frame_t: FloatArray, acc_t: FloatArray) -> FloatArray:
    """K_all Sigma K_all' and the noise on its diagonal (4.21), (f + n, f + n)."""
    to_acc = STEP_S**-2
    pp = kernel(frame_t[:, None] - frame_t[None, :])
    pa = mapped_covariance(kernel, frame_t, VALUE, acc_t, SECOND) * to_acc
    aa = mapped_covariance(kernel, acc_t, SECOND, acc_t, SECOND) * to_acc**2
    C = np.block([[pp, pa], [pa.T, aa]])
    noise = np.repeat([kernel.position_sigma, kernel.acceleration_sigma], [len(frame_t), len(acc_t)])
    C[np.diag_indices_from(C)] += noise**2
    return C
