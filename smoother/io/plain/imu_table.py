"""An IMU's samples of one pose or session from a CSV file."""

from __future__ import annotations

import os

import numpy as np

from ...array_types import FloatArray
from ...errors import RecordingError
from ...recording import ImuStream
from .table import read_table, vectors

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
    t_s, acc, gyro, mag = imu_columns(path)
    if len(t_s) < 2 or not (np.diff(t_s) > 0).all():
        raise RecordingError(f"{path}: t_s must increase from row to row, over two rows at least; mend it.")
    if mag is not None and not np.isfinite(mag).all():
        mag = None
    if np.median(np.linalg.norm(acc, axis=1)) < 3:
        raise RecordingError(f"{path}: the specific force is near 1, not near 9.81; give it in m/s^2.")
    return ImuStream(name, t_s, acc, gyro, mag)


def imu_columns(
    path: str | os.PathLike[str],
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray | None]:
    """Times (n,), specific force, angular velocity and magnetic field (n, 3), in the file's units.

    The field is None where the file has no columns for it, nan where a cell is empty.
    """
    columns, _ = read_table(
        path, ("t_s", "ax", "ay", "az", "gx", "gy", "gz"), _MAGNETOMETER, empty=_MAGNETOMETER
    )
    acc, gyro = vectors(columns, "ax", "ay", "az"), vectors(columns, "gx", "gy", "gz")
    has_field = all(name in columns for name in _MAGNETOMETER)
    return columns["t_s"], acc, gyro, vectors(columns, *_MAGNETOMETER) if has_field else None
