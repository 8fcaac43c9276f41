"""How gravity turns in an accelerometer against what the gyroscope says: the gyroscope's unit."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter1d

from ...recording import FloatArray

#: Both are smoothed with this sigma, s, so that gravity leads.
SMOOTH_S = 0.15
#: Gravity must turn as the gyroscope says to this correlation, and so fast, rad/s rms.
CLEAR, LEAST = 0.5, 0.05
#: So many samples are looked at.
MOST = 20_000


def gyroscope_scale(t_s: FloatArray, acc: FloatArray, gyro: FloatArray) -> float | None:
    """By how much a gyroscope's values are larger than rad/s.

    The direction f of the specific force turns as `df/dt = -w x f` while gravity is most of it; the slope of
    one against the other is the inverse of the unit.

    Parameters
    ----------
    t_s : ndarray, shape (N,), s
        Times.
    acc : ndarray, shape (N, 3)
        Specific force in any unit.
    gyro : ndarray, shape (N, 3)
        Angular velocity in the unit that is asked for.

    Returns
    -------
    float or None
        About 1 for rad/s, 57.3 for deg/s; None where the motion does not tell.
    """
    t_s, acc, gyro = t_s[:MOST], acc[:MOST], gyro[:MOST]
    usable = np.isfinite(acc).all(axis=1) & np.isfinite(gyro).all(axis=1) & np.isfinite(t_s)
    t_s, acc, gyro = t_s[usable], acc[usable], gyro[usable]
    if len(t_s) < 50 or not t_s[-1] > t_s[0]:
        return None
    rate = (len(t_s) - 1) / (t_s[-1] - t_s[0])
    sigma = SMOOTH_S * rate
    force = gaussian_filter1d(acc, sigma, axis=0)
    turn = gaussian_filter1d(gyro - np.median(gyro, axis=0), sigma, axis=0)
    length = np.linalg.norm(force, axis=1, keepdims=True)
    quiet = (length[:, 0] > 0) & (np.abs(length[:, 0] / np.median(length) - 1) < 0.15)
    if quiet.sum() < 50:
        return None
    direction = force / np.maximum(length, 1e-9)
    moved = gaussian_filter1d(acc / np.maximum(length, 1e-9), sigma, axis=0, order=1) * rate
    said = -np.cross(turn, direction)
    a, b = moved[quiet].ravel(), said[quiet].ravel()
    if np.sqrt(np.mean(a**2)) < LEAST or not b.any():
        return None
    slope = float(a @ b / (b @ b))
    correlation = float(a @ b / np.sqrt((a @ a) * (b @ b)))
    return 1.0 / slope if correlation > CLEAR and slope > 0 else None
