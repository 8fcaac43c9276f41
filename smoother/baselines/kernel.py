"""One Gaussian process over positions, seen through two linear maps: positions and accelerations.

Feng (Glasgow thesis, 2014), chapter 4: positions at a high rate have the prior N(0, Sigma); the camera sees
some of them (K_p, 4.17), the accelerometer their second differences (K_a, 4.13, each belonging to the centre
of its three), and the joint covariance of all measurements is K Sigma K' plus their noise (4.21). K Sigma K'
is written out here as differences of the kernel, so frames and samples may lie at any times, and the second
difference keeps its own step whatever the IMU's rate: a step of 1/1000 s would leave nothing but rounding.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from ..recording import FloatArray

#: Step of the differences, s (theirs).
STEP_S = 1.0 / 90.0
_SECOND = ((-1, 1.0), (0, -2.0), (1, 1.0))
_FIRST = ((-0.5, -1.0), (0.5, 1.0))


@dataclass(frozen=True)
class Kernel:
    """Hyper-parameters: cov(p(t), p(t + d)) = variance exp(-rate d^2) (2.14), and the sensors' noise.

    Attributes
    ----------
    variance : float, m^2
        v0.
    rate : float, 1/s^2
        w.
    position_sigma, acceleration_sigma : float, m and m/s^2
    """

    variance: float = 5.66e4 * 1e-6
    rate: float = 4.19
    position_sigma: float = 0.008
    acceleration_sigma: float = 0.100

    def __call__(self, apart: FloatArray) -> FloatArray:
        """Covariance of positions so far apart in time, s."""
        return np.asarray(self.variance * np.exp(-self.rate * apart**2))


#: What was published (section 4.5.2): v0 = 5.66e4 mm^2, w = 4.19, 8 mm, 100 mm/s^2.
PUBLISHED = Kernel()


@dataclass(frozen=True)
class Measurements:
    """Positions and accelerations; their c columns share the times.

    Attributes
    ----------
    frame_t : ndarray, shape (f,), s
    position : ndarray, shape (f, c), m
    acc_t : ndarray, shape (n,), s
    acceleration : ndarray, shape (n, c), m/s^2
    """

    frame_t: FloatArray
    position: FloatArray
    acc_t: FloatArray
    acceleration: FloatArray

    def between(self, start_s: float, end_s: float) -> Measurements:
        """Those from one time to another, s, both included."""
        f = (self.frame_t >= start_s) & (self.frame_t <= end_s)
        a = (self.acc_t >= start_s) & (self.acc_t <= end_s)
        return Measurements(self.frame_t[f], self.position[f], self.acc_t[a], self.acceleration[a])

    @property
    def targets(self) -> FloatArray:
        """M_all (4.19), (f + n, c)."""
        return np.vstack([self.position, self.acceleration])


def _mapped(
    kernel: Kernel,
    t: FloatArray,
    rows: tuple[tuple[float, float], ...],
    other: FloatArray,
    columns: tuple[tuple[float, float], ...],
) -> FloatArray:
    """Covariance of two differences of positions: their weights at shifts in `STEP_S`s."""
    apart = t[:, None] - other[None, :]
    total = np.zeros_like(apart)
    shifts: dict[float, float] = {}
    for i, a in rows:
        for j, b in columns:
            shifts[i - j] = shifts.get(i - j, 0.0) + a * b
    for shift, weight in shifts.items():
        total += weight * kernel(apart + shift * STEP_S)
    return total


_VALUE = ((0, 1.0),)


def joint_covariance(kernel: Kernel, frame_t: FloatArray, acc_t: FloatArray) -> FloatArray:
    """K_all Sigma K_all' and the noise on its diagonal (4.21), (f + n, f + n)."""
    to_acc = STEP_S**-2
    pp = kernel(frame_t[:, None] - frame_t[None, :])
    pa = _mapped(kernel, frame_t, _VALUE, acc_t, _SECOND) * to_acc
    aa = _mapped(kernel, acc_t, _SECOND, acc_t, _SECOND) * to_acc**2
    C = np.block([[pp, pa], [pa.T, aa]])
    noise = np.repeat([kernel.position_sigma, kernel.acceleration_sigma], [len(frame_t), len(acc_t)])
    C[np.diag_indices_from(C)] += noise**2
    return C


class Posterior:
    """The positions given the measurements (4.24, with the covariance 4.23 belongs to).

    Rasmussen and Williams, Gaussian Processes for Machine Learning, 2006, algorithm 2.1.

    Parameters
    ----------
    kernel : Kernel
    data : Measurements
    """

    def __init__(self, kernel: Kernel, data: Measurements) -> None:
        self._kernel, self._data = kernel, data
        covariance = joint_covariance(kernel, data.frame_t, data.acc_t)
        self._factor = cho_factor(covariance, lower=True, check_finite=False)
        self._weights = cho_solve(self._factor, data.targets, check_finite=False)

    def position(self, at: FloatArray) -> FloatArray:
        """(k, c) m at times (k,)."""
        return np.asarray(_to_measurements(self._kernel, at, _VALUE, self._data) @ self._weights)

    def velocity(self, at: FloatArray) -> FloatArray:
        """(k, c) m/s at times (k,), the first difference about each (4.12)."""
        cross = _to_measurements(self._kernel, at, _FIRST, self._data) / STEP_S
        return np.asarray(cross @ self._weights)

    def variance(self, at: FloatArray) -> FloatArray:
        """(k,) m^2 of the positions, the same for all columns."""
        cross = _to_measurements(self._kernel, at, _VALUE, self._data)
        explained = np.einsum("ij,ji->i", cross, cho_solve(self._factor, cross.T, check_finite=False))
        return np.maximum(self._kernel.variance - explained, 0.0)


def _to_measurements(
    kernel: Kernel, at: FloatArray, rows: tuple[tuple[float, float], ...], data: Measurements
) -> FloatArray:
    return np.hstack(
        [
            _mapped(kernel, at, rows, data.frame_t, _VALUE),
            _mapped(kernel, at, rows, data.acc_t, _SECOND) * STEP_S**-2,
        ]
    )


def log_likelihood(kernel: Kernel, data: Measurements) -> float:
    """Log-density of the measurements under the prior (2.13), all columns together."""
    factor = cho_factor(joint_covariance(kernel, data.frame_t, data.acc_t), lower=True, check_finite=False)
    targets = data.targets
    quadratic = float(np.sum(targets * cho_solve(factor, targets, check_finite=False)))
    log_determinant = 2.0 * float(np.sum(np.log(np.diag(factor[0]))))
    count, columns = targets.shape
    return -0.5 * (quadratic + columns * (log_determinant + count * np.log(2.0 * np.pi)))


def predict(
    kernel: Kernel, data: Measurements, at: FloatArray, latency_s: float = 0.1, order: int = 5
) -> tuple[FloatArray, FloatArray]:
    """The autoregressive predictor: the position now, from late frames and prompt accelerations (4.3).

    At each time the last `order` frames that have arrived, and the accelerations from the oldest of them up
    to now. Without accelerations in `data` it is the position-only predictor.

    Parameters
    ----------
    kernel : Kernel
    data : Measurements
        `frame_t` are the times that the frames show; they arrive `latency_s` later.
    at : ndarray, shape (k,), s
        Increasing times.
    latency_s : float, s
    order : int
        How many frames the prediction looks back.

    Returns
    -------
    mean : ndarray, shape (k, c), m
        Predicted positions; nan before the first frame arrives.
    sigma : ndarray, shape (k,), m
        Their standard deviations.
    """
    mean, sigma = np.full((len(at), data.position.shape[1]), np.nan), np.full(len(at), np.nan)
    arrived = np.searchsorted(data.frame_t + latency_s, at + 1e-9, side="right")
    for k in np.flatnonzero(arrived):
        frames = slice(max(int(arrived[k]) - order, 0), int(arrived[k]))
        frame_t, position = data.frame_t[frames], data.position[frames]
        a, b = np.searchsorted(data.acc_t, [frame_t[0] - 1e-9, at[k] + 1e-9])
        level = position.mean(axis=0)
        window = Measurements(frame_t, position - level, data.acc_t[a:b], data.acceleration[a:b])
        posterior, now = Posterior(kernel, window), at[k : k + 1]
        mean[k], sigma[k] = posterior.position(now)[0] + level, np.sqrt(posterior.variance(now)[0])
    return mean, sigma
