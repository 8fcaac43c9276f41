"""An IMU's samples of one pose or session from a CSV file."""

from __future__ import annotations

import os

import numpy as np

from ...errors import RecordingError
from ...recording import ImuStream
from .table import read_table

_MAGNETOMETER = ("mx", "my", "mz")


def read_imu_table(path: str | os.PathLike[str], name: str) -> ImuStream:
    """Read `t_s, ax, ay, az, gx, gy, gz [, mx, my, mz]`: s, m/s^2, rad/s, any unit for the field.

    Parameters
    ----------
    path : path-like
        The file.
    name : str
        What to call the IMU.

    Returns
    -------
    ImuStream
        Its samples; without a field where a cell of it is empty.

    Raises
    ------
    RecordingError
        The file or a column is missing, a cell is not a number, or the times do not increase.
    """
    if not os.path.isfile(path):
        raise RecordingError(f"{path} does not exist; check the name.")
    columns, _ = read_table(
        path, ("t_s", "ax", "ay", "az", "gx", "gy", "gz"), _MAGNETOMETER, empty=_MAGNETOMETER
    )

    def vectors(*names: str) -> np.ndarray:
        return np.stack([columns[each] for each in names], axis=1)

    t_s, mag = columns["t_s"], None
    if len(t_s) < 2 or not (np.diff(t_s) > 0).all():
        raise RecordingError(f"{path}: t_s must increase from row to row, over two rows at least; mend it.")
    acc, gyro = vectors("ax", "ay", "az"), vectors("gx", "gy", "gz")
    if all(each in columns for each in _MAGNETOMETER):
        mag = vectors(*_MAGNETOMETER)
        mag = mag if np.isfinite(mag).all() else None
    if np.median(np.linalg.norm(acc, axis=1)) < 3:
        raise RecordingError(f"{path}: the specific force is near 1, not near 9.81; give it in m/s^2.")
    return ImuStream(name, t_s, acc, gyro, mag)
