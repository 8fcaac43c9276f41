"""Units that a file does not state, by the size of its values; every choice is said."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ...array_types import FloatArray
from ...errors import RecordingError
from ...units import GRAVITY
from .physical_units import TIME

#: Rates that a sensor may have, Hz: times are of the unit that gives one of these.
_RATES = (3.0, 2500.0)
#: Sizes that are gravity in m/s^2, in g and in mg.
_IS_GRAVITY, _IS_ONE_G, _IS_1000_MG = (8.0, 12.0), (0.85, 1.15), (700.0, 1300.0)
#: rad/s that no arm reaches in one sample of a hundred: larger values are deg/s.
_FAST = 40.0
#: A field of 15 to 120 uT whose middle half lies within a quarter is the earth's.
_FIELD, _FIELD_SPREAD = (15.0, 120.0), 0.25
#: A size that varies by less is the system's estimate of gravity, not a sensor.
_EXACT = 1e-4


def time_unit(stated: str, times: FloatArray) -> str | None:
    """Unit in which times (n,) give a rate that a sensor may have.

    Parameters
    ----------
    stated : str
        What a column's name says ("ms"), "" = nothing.
    times : ndarray, shape (n,)
        As written.

    Returns
    -------
    str or None
        The stated unit where it fits, else s, ms, us or ns; None where none of them does.
    """
    dt = np.diff(times[np.isfinite(times)])
    dt = dt[dt > 0]
    if not len(dt):
        return None
    mean = float(np.minimum(dt, 20 * np.median(dt)).mean())
    fitting = [unit for unit in ("s", "ms", "us", "ns") if _RATES[0] < 1 / (mean * TIME[unit]) < _RATES[1]]
    return stated if stated in fitting else next(iter(fitting), None)


def acceleration_unit(values: FloatArray, notes: list[str], source: Path) -> str:
    """Unit of an accelerometer (n, 3) that states none: m/s^2 as on Android, or g where gravity is 1.

    Parameters
    ----------
    values : ndarray, shape (n, 3)
        As written.
    notes : list of str
        The choice is added to it.
    source : Path
        The file, for messages.

    Returns
    -------
    str
        "m/s^2", "g" or "mg".

    Raises
    ------
    RecordingError
        The values hold gravity in none of them.
    """
    size = np.linalg.norm(values, axis=1)
    median = float(np.nanmedian(size)) if np.isfinite(size).any() else 0.0
    if _IS_ONE_G[0] < median < _IS_ONE_G[1]:
        notes.append("The accelerometer states no unit; gravity is 1, so it is in g.")
        return "g"
    if _IS_1000_MG[0] < median < _IS_1000_MG[1]:
        notes.append("The accelerometer states no unit; gravity is 1000, so it is in mg.")
        return "mg"
    if not 0.35 < median / GRAVITY < 2:
        raise RecordingError(
            f"{source} states no unit of acceleration, and its usual size of {median:.3g} is neither 9.81"
            " m/s^2 nor 1 g; export calibrated acceleration with gravity, or describe it in a recording.toml."
        )
    notes.append("The accelerometer states no unit; gravity is 9.8, so it is in m/s^2.")
    return "m/s^2"


def turning_unit(values: FloatArray, notes: list[str]) -> str:
    """Unit of a gyroscope (n, 3) that states none: rad/s as on Android, deg/s where it is too fast."""
    finite = np.abs(values[np.isfinite(values)])
    unit = "deg/s" if len(finite) and float(np.percentile(finite, 99)) > _FAST else "rad/s"
    notes.append(f"The gyroscope states no unit; by the size of its values it is in {unit}.")
    return unit


def unit_by_size(values: FloatArray, source: Path) -> str:
    """Unit, and with it the sensor, of a vector that says neither.

    Parameters
    ----------
    values : ndarray, shape (n, 3)
        As written, some of them finite.
    source : Path
        The file, for messages.

    Returns
    -------
    str
        "m/s^2" or "g" where its size is that of gravity, else "rad/s" or "deg/s".

    Raises
    ------
    RecordingError
        It is a magnetometer, or gravity as the system estimates it.
    """
    size = np.linalg.norm(values, axis=1)
    low, median, high = np.percentile(size[np.isfinite(size)], (25, 50, 75))
    if _IS_GRAVITY[0] < median < _IS_GRAVITY[1]:
        if high - low < _EXACT * median:
            raise RecordingError(
                f"{source} holds gravity as the system estimates it, not an accelerometer; log the raw"
                " accelerometer."
            )
        return "m/s^2"
    if _IS_ONE_G[0] < median < _IS_ONE_G[1] and high - low < 0.3:
        return "g"
    if _FIELD[0] < median < _FIELD[1] and high - low < _FIELD_SPREAD * median:
        raise RecordingError(
            f"{source} looks like a magnetometer (its size is {median:.0f} throughout); name the files of the"
            " accelerometer and the gyroscope."
        )
    return "deg/s" if float(np.percentile(size[np.isfinite(size)], 99)) > _FAST else "rad/s"
