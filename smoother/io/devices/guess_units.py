"""Guesses at the units of a table's columns, each with its reason."""

from __future__ import annotations

import numpy as np

from ...array_types import FloatArray
from ...errors import RecordingError
from ...units import STANDARD_GRAVITY
from .guess import Guess
from .imu_checks import WRONG_SCALE, turn_scale
from .physical_units import ACCELERATION, ANGULAR_VELOCITY, TIME, plain_unit
from .protocol import ImuTable
from .sheet import Sheet

#: |specific force| at rest, within this of one g.
_REST = 0.25
#: A sensor's rates, Hz.
RATES_HZ = (4.0, 4000.0)


def time_unit(sheet: Sheet, column: int) -> tuple[str, str]:
    """Unit of a column of times, and why; "" where it is none."""
    try:
        values, dates = sheet.times(column)
    except RecordingError:
        return "", ""
    if dates:
        return "iso", "dates"
    step = np.diff(values[np.isfinite(values)])
    step = step[step > 0]
    if len(step) < (0.3 if sheet.layout.names else 0.95) * (len(values) - 1) or not len(step):
        return "", ""
    stated = plain_unit(sheet.unit(column))
    if stated in TIME:
        unit = {1.0: "s", 1e-3: "ms", 1e-6: "us", 1e-9: "ns"}[TIME[stated]]
        return unit, f"stated ({sheet.unit(column)})"
    typical = float(np.median(step))
    for unit, seconds in (("s", 1.0), ("ms", 1e-3), ("us", 1e-6), ("ns", 1e-9)):
        if RATES_HZ[0] <= 1 / (typical * seconds) <= RATES_HZ[1] and not (unit == "s" and typical == 1):
            return unit, f"steps of {typical:g} make {1 / (typical * seconds):.1f} samples a second"
    return "", ""


def accelerometer_unit(sheet: Sheet, guess: Guess, acc: tuple[int, int, int] | None) -> None:
    """By what the quiet rows read."""
    if acc is None:
        return
    rest = _rest_length(sheet.vectors(acc))
    names = {"m/s^2": STANDARD_GRAVITY, "g": 1.0, "mg": 1000.0}
    fitting = [unit for unit, length in names.items() if abs(rest / length - 1) < _REST]
    stated = plain_unit(sheet.unit(acc[0]))
    if not fitting:
        guess.keys["accelerometer_unit"] = "m/s^2"
        guess.reasons["accelerometer_unit"] = f"NOT KNOWN: the quiet rows read {rest:.3g}"
        guess.unsure.append(
            "Gravity seems to have been taken out of the accelerometer (or its unit is another): record the"
            " raw specific force, which reads 9.81 m/s^2 at rest."
        )
        return
    guess.keys["accelerometer_unit"] = fitting[0]
    guess.reasons["accelerometer_unit"] = f"the quiet rows read {rest:.3g}" + (
        f", and the file states {sheet.unit(acc[0])}" if stated in ACCELERATION else ""
    )


def gyroscope_unit(
    sheet: Sheet,
    guess: Guess,
    t_s: FloatArray | None,
    acc: tuple[int, int, int] | None,
    gyro: tuple[int, int, int] | None,
) -> None:
    """By what the file states, by how gravity turns in the sensor, by magnitude."""
    if gyro is None:
        return
    values = sheet.vectors(gyro)
    stated = plain_unit(sheet.unit(gyro[0]))
    if stated in ANGULAR_VELOCITY:
        unit = {1.0: "rad/s", np.pi / 180: "deg/s"}.get(ANGULAR_VELOCITY[stated], "mdps")
        guess.keys["gyroscope_unit"] = unit
        guess.reasons["gyroscope_unit"] = f"stated ({sheet.unit(gyro[0])})"
        return
    if unit := _by_resolution(values):
        guess.keys["gyroscope_unit"] = unit
        guess.reasons["gyroscope_unit"] = "its smallest step is that of a 16-bit sensor in this unit"
        return
    scale = None
    if t_s is not None and acc is not None:
        force = sheet.vectors(acc)
        force = force * (STANDARD_GRAVITY / _rest_length(force))
        scale = turn_scale(ImuTable("", t_s, force, values))
    fast = float(np.nanpercentile(np.linalg.norm(values, axis=1), 99))
    if scale is not None:
        unit = "deg/s" if scale < 1 / WRONG_SCALE else "rad/s"
        guess.keys["gyroscope_unit"] = unit
        guess.reasons["gyroscope_unit"] = "so it turns as gravity does in the accelerometer"
        return
    guess.keys["gyroscope_unit"] = "deg/s" if fast > 20 else "rad/s"
    guess.reasons["gyroscope_unit"] = f"it reads up to {fast:.3g}"
    guess.unsure.append("The gyroscope's unit is guessed by its size alone: check it in the device's manual.")


def _by_resolution(gyro: FloatArray) -> str:
    """The unit in which the smallest step of the values is a common range's 16-bit step; "" where in none."""
    steps = np.diff(np.unique(gyro[np.isfinite(gyro).all(axis=1)].ravel()))
    steps = steps[steps > 1e-7 * max(float(np.nanmax(np.abs(gyro), initial=0.0)), 1e-9)]
    if len(steps) < 10:
        return ""
    smallest = float(np.quantile(steps, 0.1))
    if not np.mean(np.abs(steps / smallest - np.rint(steps / smallest)) < 0.02) > 0.9:
        return ""  # no grid: calibrated or filtered values
    for unit, per_degree in (("deg/s", 1.0), ("rad/s", np.pi / 180)):
        for most in (125, 250, 500, 1000, 2000, 4000):
            if abs(smallest / (most / 32768 * per_degree) - 1) < 0.01:
                return unit
    return ""


def _rest_length(acc: FloatArray) -> float:
    """Median length of the specific force over the quietest fifth of the rows."""
    length = np.linalg.norm(acc, axis=1)
    length = length[np.isfinite(length)]
    if len(length) < 10:
        return float(np.median(length)) if len(length) else float("nan")
    change = np.abs(length - np.median(length))
    return float(np.median(length[change <= np.quantile(change, 0.2)]))
