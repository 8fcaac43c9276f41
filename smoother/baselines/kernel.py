"""What a Gaussian process knows of the positions between measurements: Feng's fusion (chapter 4), and its
predictor.

The process itself, its kernel and the likelihood of measurements are in `measurements.position_process`.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from ..array_types import FloatArray
from ..measurements.position_process import (
    FIRST,
    SECOND,
    STEP_S,
    VALUE,
    Kernel,
    Measurements,
    joint_covariance,
    mapped_covariance,
)


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
        return np.asarray(_to_measurements(self._kernel, at, VALUE, self._data) @ self._weights)

    def velocity(self, at: FloatArray) -> FloatArray:
        """(k, c) m/s at times (k,), the first difference about each (4.12)."""
        cross = _to_measurements(self._kernel, at, FIRST, self._data) / STEP_S
        return np.asarray(cross @ self._weights)

    def variance(self, at: FloatArray) -> FloatArray:
        """(k,) m^2 of the positions, the same for all columns."""
        cross = _to_measurements(self._kernel, at, VALUE, self._data)
        explained = np.einsum("ij,ji->i", cross, cho_solve(self._factor, cross.T, check_finite=False))
        return np.maximum(self._kernel.variance - explained, 0.0)


def _to_measurements(
    kernel: Kernel, at: FloatArray, rows: tuple[tuple[float, float], ...], data: Measurements
) -> FloatArray:
    return np.hstack(
        [
            mapped_covariance(kernel, at, rows, data.frame_t, VALUE),
            mapped_covariance(kernel, at, rows, data.acc_t, SECOND) * STEP_S**-2,
        ]
    )


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
