"""A guess at which columns of a table are an accelerometer's, a gyroscope's and the time."""

from __future__ import annotations

import re

import numpy as np

from ...array_types import FloatArray
from ...units import STANDARD_GRAVITY
from .guess import Guess, is_numeric, named
from .guess_units import RATES_HZ, accelerometer_unit, gyroscope_unit, time_unit
from .physical_units import ACCELERATION, ANGULAR_VELOCITY, plain_unit
from .sensor_words import ACCELERATION_WORDS, TIME_WORDS, TURNING_WORDS
from .sheet import Sheet

#: Words of a column's name by what the column is.
_ACCELEROMETER = (
    r"(?:^|[^a-z])(?:a|acc|accel|accelero\w*|lacc|specific ?force|"
    + "|".join(ACCELERATION_WORDS)
    + r")(?=$|[^a-z])"
)
_GYROSCOPE = (
    r"(?:^|[^a-z])(?:g|w|gyr|gyro|gyrosc\w*|omega|angular ?\w*|rot\w*|turn ?rate|"
    + "|".join(TURNING_WORDS)
    + r")(?=$|[^a-z])"
)
_MAGNETOMETER = r"(?:^|[^a-z])(?:m|mag|magn\w*|field)(?=$|[^a-z])"
_TIME = (
    "|".join(TIME_WORDS)
    + r"|stamp|epoc|elapsed|(?:^|[^a-z])(?:t|seconds?|sec|clock|millis|micros)(?=$|[^a-z])"
)
_COUNTER = r"(?:^|[^a-z])(?:counter|count|packet\w*|sample\w*|index|frame\w*|no|n|seq\w*|row)(?=$|[^a-z])"
_SHORT = re.compile(r"^(a|g|w|m)_?([xyz])$")
_AXIS = re.compile(r"(?:^|[^a-z0-9])([xyz])(?=$|[^a-z0-9])|(?<=[a-z])([XYZ])$|(?<=[a-z])([xyz])$")
#: Words that say that a triple is not what a sensor measures.
_DERIVED = re.compile(
    r"free|linear|world|global|user|quat|euler|filtered|gravity|mat\b|roll|pitch|yaw|std", re.I
)


def guess_sensor(sheet: Sheet) -> Guess:
    """Guess at an inertial sensor's table; `kind` is "" where it is none."""
    guess = Guess("imu")
    acc, gyro, mag = _triples(sheet, guess)
    if acc is None and gyro is None:
        return Guess(unsure=["No three columns look like an accelerometer's or a gyroscope's."])
    for letter, columns in (("a", acc), ("g", gyro), ("m", mag)):
        for axis, column in zip("xyz", columns or (), strict=False):
            guess.columns[letter + axis] = named(sheet, column)
    used = {column for columns in (acc, gyro, mag) for column in columns or ()}
    t_s = _time(sheet, guess, used)
    accelerometer_unit(sheet, guess, acc)
    gyroscope_unit(sheet, guess, t_s, acc, gyro)
    if acc is None or gyro is None:
        missing = "accelerometer" if acc is None else "gyroscope"
        guess.unsure.append(
            f"There is no {missing} here; name its file too: file = [.., ..], columns = [{{..}}, {{..}}]."
        )
    return guess


def _triples(sheet: Sheet, guess: Guess) -> list[tuple[int, int, int] | None]:
    """Columns of accelerometer, gyroscope and magnetometer: by names, by units, by magnitude."""
    triples = _axes_of(sheet)
    kinds: list[tuple[int, int, int] | None] = [None, None, None]
    for number, (what, pattern, units) in enumerate(
        (
            ("a", _ACCELEROMETER, ACCELERATION),
            ("g", _GYROSCOPE, ANGULAR_VELOCITY),
            ("m", _MAGNETOMETER, {}),
        )
    ):
        for stem, columns in triples:
            stated = {plain_unit(sheet.unit(column)) for column in columns}
            by_unit = bool(stated) and stated <= set(units)
            by_name = bool(re.search(pattern, stem)) or stem == what
            if columns in kinds or not (by_unit or by_name) or _DERIVED.search(stem):
                continue
            if not by_unit and any(stated & set(other) for other in (ACCELERATION, ANGULAR_VELOCITY)):
                continue
            kinds[number] = columns
            guess.reasons[what] = (
                f"unit {sheet.unit(columns[0])}" if by_unit else f"name {sheet.layout.names[columns[0]]}"
            )
            break
    if kinds[0] is None and kinds[1] is None and not sheet.layout.names:
        kinds[0], kinds[1] = _by_magnitude(sheet, guess)
    return kinds


def _axes_of(sheet: Sheet) -> list[tuple[str, tuple[int, int, int]]]:
    """Columns that are x, y, z of something, with the name of it, in the order of the table."""
    groups: dict[str, dict[str, int]] = {}
    for column, name in enumerate(sheet.layout.names):
        label = sheet.layout.labels[column]
        plain = name.split("(")[0].split("[")[0].strip()
        if short := _SHORT.match(label.replace(" ", "")):
            groups.setdefault(short[1], {}).setdefault(short[2], column)
            continue
        found = list(_AXIS.finditer(plain)) or list(_AXIS.finditer(plain.lower()))
        if found:
            axis = next(part for part in found[-1].groups() if part)
            stem = (plain[: found[-1].start()] + " " + plain[found[-1].end() :]).strip(" _-./").lower()
            groups.setdefault(stem.replace("_", " "), {}).setdefault(axis.lower(), column)
    return [(stem, (axes["x"], axes["y"], axes["z"])) for stem, axes in groups.items() if len(axes) == 3]


def _by_magnitude(sheet: Sheet, guess: Guess) -> tuple[tuple[int, int, int] | None, ...]:
    """Accelerometer and gyroscope of a table without names: three columns whose length stays near one g."""
    columns = [column for column in range(sheet.layout.width) if is_numeric(sheet, column)]
    best, near, least = None, 0.0, np.inf
    for at in range(len(columns) - 2):
        three = (columns[at], columns[at + 1], columns[at + 2])
        length = np.linalg.norm(sheet.vectors(three), axis=1)
        share = max(float(np.mean(np.abs(length / one - 1) < 0.2)) for one in (1.0, STANDARD_GRAVITY, 1000.0))
        spread = float(np.nanstd(length) / np.nanmedian(length))
        # a part of a quaternion stays near 1 as well, and far more evenly than any force
        if share > 0.5 and 1e-3 < spread < least:
            best, near, least = three, share, spread
    if best is None:
        return None, None
    guess.reasons["a"] = f"the length of these three stays near one g in {100 * near:.0f} % of the rows"
    guess.unsure.append("The file names no columns; check which is which.")
    for first in (best[2] + 1, best[0] - 3):
        three = (first, first + 1, first + 2)
        if all(column in columns for column in three) and (first > 0 or first + 3 == best[0] != 3):
            guess.reasons["g"] = "the three columns beside the accelerometer"
            return best, three
    return best, None


def _time(sheet: Sheet, guess: Guess, used: set[int]) -> FloatArray | None:
    """The column of times or counts, its unit, and the times in s."""
    names = sheet.layout.labels or ("",) * sheet.layout.width
    free = [column for column in range(sheet.layout.width) if column not in used]
    timed = [column for column in free if re.search(_TIME, names[column].replace("_", " "))]
    counted = [column for column in free if re.search(_COUNTER, names[column].replace("_", " "))]
    for column in [*timed, *(free if not sheet.layout.names else [])]:
        scale, why = time_unit(sheet, column)
        if scale:
            guess.columns["t"] = named(sheet, column)
            guess.keys["time_unit"], guess.reasons["time_unit"] = scale, why
            values, dates = sheet.times(column)
            factor = 1.0 if dates else {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}[scale]
            return values * factor
    rate = _stated_rate(sheet)
    for column in counted:
        if is_numeric(sheet, column) and np.median(np.diff(sheet.numbers(column))) >= 1:
            guess.columns["t"] = named(sheet, column)
            guess.keys["time_unit"] = "counter"
            guess.reasons["time_unit"] = "a counter, and no column of times"
            break
    guess.keys["rate_hz"] = rate or 100.0
    if rate:
        guess.reasons["rate_hz"] = "stated above the table"
    else:
        guess.reasons["rate_hz"] = "NOT KNOWN: the file has no times and states no rate"
        guess.unsure.append("rate_hz is made up: write the rate that the sensor was set to.")
    return np.arange(len(sheet)) / rate if rate else None


def _stated_rate(sheet: Sheet) -> float | None:
    """A rate in Hz that the lines above the table state."""
    for line in sheet.layout.preamble:
        if re.search(r"rate|freq|hz", line, re.I) and (number := re.search(r"(\d+(?:\.\d+)?)", line)):
            rate = float(number[1])
            if RATES_HZ[0] <= rate <= RATES_HZ[1]:
                return rate
    return None
