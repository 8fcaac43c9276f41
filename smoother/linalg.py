"""Small operations on stacked arrays."""

from __future__ import annotations

import numpy as np

from .recording import FloatArray


def interpolate(t: FloatArray, values: FloatArray, at: FloatArray) -> FloatArray:
    """Linear interpolation of stacked values (n, ...) at times, held beyond the ends."""
    if len(t) == 1:
        return np.repeat(values, len(at), axis=0)
    right = np.clip(np.searchsorted(t, at), 1, len(t) - 1)
    u = np.clip((at - t[right - 1]) / (t[right] - t[right - 1]), 0.0, 1.0)
    u = u.reshape(-1, *([1] * (values.ndim - 1)))
    return (1.0 - u) * values[right - 1] + u * values[right]


def rotate_covariance(R: FloatArray, covariance: FloatArray) -> FloatArray:
    """R C R' for stacks (..., 3, 3)."""
    return R @ covariance @ np.swapaxes(R, -1, -2)


def skew(v: FloatArray) -> FloatArray:
    """The matrix of the cross product, [v]x, for stacks (..., 3)."""
    matrix = np.zeros((*v.shape[:-1], 3, 3))
    matrix[..., 0, 1], matrix[..., 0, 2], matrix[..., 1, 2] = -v[..., 2], v[..., 1], -v[..., 0]
    return matrix - np.swapaxes(matrix, -1, -2)


def inverse(matrix: FloatArray) -> FloatArray:
    """Inverse of symmetric matrices (..., n, n), kept symmetric."""
    answer = np.linalg.inv(matrix)
    return np.asarray(0.5 * (answer + np.swapaxes(answer, -1, -2)), dtype=np.float64)
