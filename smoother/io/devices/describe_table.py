"""What a table of any layout seems to contain, for a recording.toml to begin with."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ...array_types import FloatArray
from ...errors import RecordingError
from ...units import STANDARD_GRAVITY
from ..tables.columns import ACCELERATION_WORDS, TIME_WORDS, TURNING_WORDS
from ..tables.imu import WRONG_SCALE, ImuTable, turn_scale
from ..tables.imu_columns import is_numeric
from ..tables.joints import JointColumns, find_joint_columns
from ..tables.skeletons import unit_by_arm
from ..tables.table import Table
from ..tables.units import ACCELERATION, ANGULAR_VELOCITY, SECONDS, TIME, from_1970, plain_unit, unit_of_step


@dataclass
class Guess:
    """What a table seems to contain."""

    kind: str = ""  # "imu", "skeleton" or "" where nothing fits
    columns: dict[str, object] = field(default_factory=dict)  # As in recording.toml
    # Further keys of the section (time_unit, accelerometer_unit ..)
    keys: dict[str, object] = field(default_factory=dict)
    reasons: dict[str, str] = field(default_factory=dict)  # Why, by column or key
    unsure: list[str] = field(default_factory=list)  # What to check, a sentence each


def toml_of(path: Path, guess: Guess, name: str) -> str:
    """A recording.toml of a guess, with its reasons as comments."""
    section = "camera" if guess.kind == "skeleton" else f"imu.{name}"
    lines = [f"[{section}]"]
    lines.append(f"{'skeleton' if guess.kind == 'skeleton' else 'file'} = {_value(path.name)}")
    for key, value in guess.keys.items():
        reason = guess.reasons.get(key, "")
        lines.append(f"{key} = {_value(value)}" + (f"  # {reason}" if reason else ""))
    lines += ["", f"[{section}.columns]"]
    for key, value in guess.columns.items():
        reason = guess.reasons.get(key[0], "") if guess.kind == "imu" and key[1:] == "x" else ""
        lines.append(f"{key} = {_value(value)}" + (f"  # {reason}" if reason else ""))
    return "\n".join(lines) + "\n"


def _value(value: object) -> str:
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{_value(str(key))} = {_value(one)}" for key, one in value.items()) + " }"
    if isinstance(value, list):
        return "[" + ", ".join(_value(one) for one in value) + "]"
    if isinstance(value, str):  # JSON lets one control character stand that TOML does not
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    return f"{value:g}"


def named(sheet: Table, column: int) -> str | int:
    """A column as recording.toml names it: by its name where it has one of its own, else by its number."""
    name = sheet.names[column] if sheet.names else ""
    return name if name and list(sheet.names).count(name) == 1 else column + 1


#: |specific force| at rest, within this of one g.
_REST = 0.25
#: A sensor's rates, Hz.
RATES_HZ = (4.0, 4000.0)


def described_time_unit(sheet: Table, column: int, least: float) -> tuple[str, str]:
    """Unit of a column of times, and why; "" where it is none, or fewer than `least` of its steps rise."""
    try:
        values, dates = sheet.times(column)
    except RecordingError:
        return "", ""
    if dates:
        return "iso", "dates"
    step = np.diff(values[np.isfinite(values)])
    step = step[step > 0]
    if len(step) < least * (len(values) - 1) or not len(step):
        return "", ""
    stated = plain_unit(sheet.unit(column))
    if stated in TIME:
        unit = next(unit for unit, seconds in SECONDS.items() if seconds == TIME[stated])
        return unit, f"stated ({sheet.unit(column)})"
    typical = float(np.median(step))
    unit = unit_of_step(typical, RATES_HZ, "", float(np.nanmedian(values))) or ""
    return unit, unit and f"steps of {typical:g} make {1 / (typical * SECONDS[unit]):.1f} samples per second"


def accelerometer_unit(sheet: Table, guess: Guess, acc: tuple[int, int, int] | None) -> None:
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
    sheet: Table,
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
        guess.reasons["gyroscope_unit"] = "it then rotates as gravity does in the accelerometer"
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
#: Words of a triple that a sensor does not measure.
_DERIVED = re.compile(
    r"free|linear|world|global|user|quat|euler|filtered|gravity|mat\b|roll|pitch|yaw|std", re.I
)


def guess_sensor(sheet: Table) -> Guess:
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


def _triples(sheet: Table, guess: Guess) -> list[tuple[int, int, int] | None]:
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
                f"unit {sheet.unit(columns[0])}" if by_unit else f"name {sheet.names[columns[0]]}"
            )
            break
    if kinds[0] is None and kinds[1] is None and not sheet.names:
        kinds[0], kinds[1] = _by_magnitude(sheet, guess)
    return kinds


def _axes_of(sheet: Table) -> list[tuple[str, tuple[int, int, int]]]:
    """Columns that are x, y, z of something, with the name of it, in the order of the table."""
    groups: dict[str, dict[str, int]] = {}
    for column, name in enumerate(sheet.names):
        label = sheet.labels[column]
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


def _by_magnitude(sheet: Table, guess: Guess) -> tuple[tuple[int, int, int] | None, ...]:
    """Accelerometer and gyroscope of a table without names: three columns whose length stays near one g."""
    columns = [column for column in range(sheet.width) if is_numeric(sheet, column)]
    if sheet.width == 4 and described_time_unit(sheet, 0, 0.95)[0] and set(columns) >= {1, 2, 3}:
        return _of_dates(sheet, guess)
    best, near, least = None, 0.0, np.inf
    for at in range(len(columns) - 2):
        three = (columns[at], columns[at + 1], columns[at + 2])
        length = np.linalg.norm(sheet.vectors(three), axis=1)
        share = _near_gravity(sheet.vectors(three))
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


def _near_gravity(vectors: FloatArray) -> float:
    """Share of the rows whose length is near one g, in the unit in which most are."""
    length = np.linalg.norm(vectors, axis=1)
    return max(float(np.mean(np.abs(length / one - 1) < 0.2)) for one in (1.0, STANDARD_GRAVITY, 1000.0))


def _of_dates(sheet: Table, guess: Guess) -> tuple[tuple[int, int, int] | None, ...]:
    """Sensor of a table of times and one vector without names: an accelerometer where it stays near one g."""
    three = (1, 2, 3)
    near = _near_gravity(sheet.vectors(three))
    if near > 0.5:
        guess.reasons["a"] = f"the length of these three stays near one g in {100 * near:.0f} % of the rows"
        return three, None
    guess.reasons["g"] = "the three columns behind the times, which show no gravity"
    guess.unsure.append(f"{sheet.path.name} names no columns: without gravity assumed a gyroscope.")
    return None, three


def _time(sheet: Table, guess: Guess, used: set[int]) -> FloatArray | None:
    """The column of times or counts, its unit, and the times in s."""
    names = sheet.labels or ("",) * sheet.width
    free = [column for column in range(sheet.width) if column not in used]
    timed = [column for column in free if re.search(_TIME, names[column].replace("_", " "))]
    counted = [column for column in free if re.search(_COUNTER, names[column].replace("_", " "))]
    for column in [*timed, *(column for column in free if column not in (*timed, *counted))]:
        scale, why = described_time_unit(sheet, column, 0.3 if column in timed else 0.95)
        if scale:
            guess.columns["t"] = named(sheet, column)
            guess.keys["time_unit"], guess.reasons["time_unit"] = scale, why
            values, dates = sheet.times(column)
            return values if dates else from_1970(values, scale) * SECONDS[scale]
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
        guess.unsure.append("rate_hz is a guess: write the rate that the sensor was set to.")
    return np.arange(len(sheet)) / rate if rate else None


def _stated_rate(sheet: Table) -> float | None:
    """A rate in Hz that the lines above the table state."""
    for line in sheet.preamble:
        if re.search(r"rate|freq|hz", line, re.I) and (number := re.search(r"(\d+(?:\.\d+)?)", line)):
            rate = float(number[1])
            if RATES_HZ[0] <= rate <= RATES_HZ[1]:
                return rate
    return None


def guess_skeleton(sheet: Table, joints: JointColumns) -> Guess:
    """Guess at a table with one row per frame, whose joints are known by their names."""
    axes, states, time = joints.axes, joints.confidence, joints.time
    guess = Guess("skeleton")
    for joint, columns in axes.items():
        guess.columns[joint] = [named(sheet, column) for column in columns]
        if joint in states:
            guess.columns[f"{joint}_state"] = named(sheet, states[joint])
    guess.reasons["columns"] = "names of joints"
    if states:
        cells = sorted({cell for column in states.values() for cell in set(sheet.texts(column))})[:4]
        words = dict(zip(cells, ("not_tracked", "inferred", "tracked", "tracked"), strict=False))
        guess.keys["states"] = words
        guess.reasons["states"] = "NOT KNOWN: the order of the values that occur"
        guess.unsure.append("states: what the values of the confidence mean is in the program's manual.")
    unit = unit_by_arm({joint: sheet.vectors(columns) for joint, columns in axes.items()})
    guess.keys["position_unit"] = unit[0] if unit else "m"
    guess.reasons["position_unit"] = "gives plausible arm lengths" if unit else "NOT KNOWN: no unit fits"
    scale, why = ("", "") if time is None else described_time_unit(sheet, time, 0.3)
    if time is not None and scale:
        guess.columns["t"] = named(sheet, time)
        guess.keys["time_unit"], guess.reasons["time_unit"] = scale, why
    else:
        guess.keys["rate_hz"] = 30.0
        guess.reasons["rate_hz"] = "NOT KNOWN: the file has no times"
        guess.unsure.append("rate_hz is a guess: write the camera's frames per second.")
    down, why = _down(sheet, axes)
    guess.keys["frame"] = down
    guess.reasons["frame"] = why
    guess.unsure.append("frame: the camera's axes; `smooth` reports if gravity contradicts them.")
    return guess


def _down(sheet: Table, axes: dict[str, tuple[int, int, int]]) -> tuple[str, str]:
    """The camera's frame in which wrists and elbows hang below shoulders most of the time."""
    downs = {"kinect": (1, -1), "optical": (1, 1), "zup": (2, -1)}
    score = dict.fromkeys(downs, 0.0)
    for side in ("left", "right"):
        if {f"shoulder_{side}", f"elbow_{side}"} <= axes.keys():
            arm = sheet.vectors(axes[f"elbow_{side}"]) - sheet.vectors(axes[f"shoulder_{side}"])
            for name, (axis, sign) in downs.items():
                score[name] += float(np.nansum(sign * arm[:, axis]))
    best = max(score, key=lambda name: score[name])
    return best, "upper arms hang down so" if score[best] > 0 else "NOT KNOWN"


def guess_of(sheet: Table) -> Guess:
    """Guess what a table contains."""
    joints = find_joint_columns(sheet.names) if sheet.names else None
    if joints is not None and joints.has_arm():
        return guess_skeleton(sheet, joints)
    return guess_sensor(sheet)
