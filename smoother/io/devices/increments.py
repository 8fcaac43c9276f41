"""Strap-down increments (velocity and orientation per sample) as accelerations and angular velocities."""

from __future__ import annotations

import numpy as np

from ...array_types import FloatArray


def acceleration_of(velocity_increment: FloatArray, rate_hz: float) -> FloatArray:
    """Mean specific force over each sample, (n, 3) in m/s^2, of velocity increments (n, 3) in m/s."""
    return velocity_increment * rate_hz


def angular_velocity_of(rotation_increment: FloatArray, rate_hz: float) -> FloatArray:
    """Mean angular velocity over each sample.

    Parameters
    ----------
    rotation_increment : ndarray, shape (n, 4)
        Unit quaternions w, x, y, z that turn by one sample.
    rate_hz : float, Hz
        Samples a second.

    Returns
    -------
    ndarray, shape (n, 3), rad/s
        The rotation vector of the increment, times the rate.
    """
    w, xyz = rotation_increment[:, :1], rotation_increment[:, 1:]
    xyz = np.where(w < 0, -xyz, xyz)
    sine = np.linalg.norm(xyz, axis=1, keepdims=True)
    angle = 2 * np.arctan2(sine, np.abs(w))
    # At small angles the rotation vector is twice the vector part.
    factor = np.where(sine > 1e-9, angle / np.maximum(sine, 1e-12), 2.0)
    return xyz * factor * rate_hz


def rate_of(t_s: FloatArray | None) -> float | None:
    """Samples a second by the usual step of stamps (n,) in any order; None where there is no step."""
    if t_s is None:
        return None
    steps = np.diff(np.unique(t_s[np.isfinite(t_s)]))
    return float(1 / np.median(steps)) if len(steps) else None
