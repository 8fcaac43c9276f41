"""Small files of inertial sensors, in the layouts that devices write."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

GRAVITY = 9.80665


def motion(
    count: int = 400, rate_hz: float = 100.0, seed: int = 1, slower: float = 1.0
) -> tuple[np.ndarray, np.ndarray]:
    """Specific force (n, 3) in m/s^2 and angular velocity (n, 3) in rad/s of a sensor that turns slowly.

    `slower` divides the angular velocity.
    """
    t = np.arange(count) / rate_hz
    rng = np.random.default_rng(seed)
    phase, speed = rng.uniform(0, 6, 3), rng.uniform(0.5, 1.2, 3)
    gyro = 1.5 / slower * np.sin(2 * np.pi * speed * t[:, None] + phase)
    attitude = [Rotation.identity()]
    for rate in gyro[:-1]:
        attitude.append(attitude[-1] * Rotation.from_rotvec(rate / rate_hz))
    acc = Rotation.concatenate(attitude).inv().apply([0.0, 0.0, GRAVITY])
    return np.round(acc + rng.normal(0, 0.02, acc.shape), 6), np.round(gyro, 6)


def rows(*columns: np.ndarray, separator: str = ",", end: str = "", form: str = "{:.6f}") -> list[str]:
    """Lines of numbers; columns (n,) or (n, k), integers without decimals."""
    cells = []
    for column in columns:
        for values in np.atleast_2d(np.asarray(column).T):
            whole = np.issubdtype(values.dtype, np.integer)
            cells.append([str(v) if whole else form.format(v) for v in values])
    return [separator.join(row) + end for row in zip(*cells, strict=True)]


def printed(values: np.ndarray) -> np.ndarray:
    """Values as a file with six decimals has them."""
    return np.array([float(f"{v:.6f}") for v in np.ravel(values)]).reshape(np.shape(values))
