"""What a table seems to contain, by its names, units and values, in the keys of recording.toml."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ...array_types import FloatArray
from ...errors import RecordingError
from .imu import Columns, Sensors, find_sensors, holds_gravity, kind_of_unit, unit_of, usual_size
from .joints import (
    JointColumns,
    find_joint_columns,
    has_arm,
    stated_time_unit,
    time_among,
    time_column,
    words_of,
)
from .skeletons import unit_by_arm
from .table import DeviceTable, shown
from .units import ACCELERATION, SECONDS, SENSOR_RATES, gravity_unit, in_seconds, split_unit, time_unit

#: How a reason begins that is made up.
UNKNOWN = "NOT KNOWN"
_NO_SENSOR = (
    "No three columns look like an accelerometer's or a gyroscope's (linear acceleration is without gravity,"
    " and is not read)."
)
NO_GYRO_UNIT = "The gyroscope's unit is guessed by its size alone: check it in the device's manual."


@dataclass
class Guess:
    """What a table seems to contain, with the keys of recording.toml."""

    kind: str = ""  # "imu", "skeleton" or "" where nothing fits
    columns: dict[str, Any] = field(default_factory=dict)  # As in recording.toml
    keys: dict[str, Any] = field(default_factory=dict)  # Further ones (time_unit, accelerometer_unit ..)
    reasons: dict[str, str] = field(default_factory=dict)  # Why, by column or key
    unsure: list[str] = field(default_factory=list)  # What to check, a sentence each

    @property
    def settled(self) -> bool:
        """Whether times and units of an IMU are known."""
        made_up = any(reason.startswith(UNKNOWN) for reason in self.reasons.values())
        timed = "t" in self.columns or "rate_hz" in self.keys
        return bool({"ax", "gx"} & self.columns.keys()) and timed and not made_up

    def set(self, key: str, value: object, reason: str, unsure: str = "") -> None:
        """Set a key, with its reason."""
        self.keys[key], self.reasons[key] = value, reason
        self.unsure += [unsure] if unsure else []

    def set_time(self, table: DeviceTable, column: int, unit: str, why: str) -> None:
        """Set the column of times and its unit."""
        self.columns["t"] = _named(table, column)
        self.set("time_unit", unit, why)


def toml_of(path: Path, guess: Guess, name: str) -> str:
    """A recording.toml of a guess, with its reasons as comments."""
    import tomlkit

    def line(key: str, value: Any) -> str:
        item: Any = tomlkit.item(value) if not isinstance(value, dict) else tomlkit.inline_table()
        if isinstance(value, dict):
            item.update(value)
        reason = guess.reasons.get(key, "")
        return f"{key} = {item.as_string()}" + (f"  # {reason}" if reason else "")

    is_camera = guess.kind == "skeleton"
    section = "camera" if is_camera else f"imu.{name}"
    keys = {"skeleton" if is_camera else "file": path.name, **guess.keys}
    lines = [f"[{section}]", *(line(*each) for each in keys.items())]
    lines += ["", f"[{section}.columns]", *(line(*each) for each in guess.columns.items())]
    return "\n".join(lines) + "\n"


def guess_of(table: DeviceTable) -> Guess:
    """Guess what a table contains."""
    joints = find_joint_columns(table.names)
    return _guess_skeleton(table, joints) if has_arm(joints.axes) else guess_sensor(table)


def _named(table: DeviceTable, column: int) -> str | int:
    """A column as recording.toml names it: by its name where it has one of its own, else by its number."""
    name = table.names[column] if table.names else ""
    return name if name and table.names.count(name) == 1 else column + 1


def guess_sensor(table: DeviceTable, usual_gyro: str = "", sensor: dict[str, Columns] | None = None) -> Guess:
    """Guess at a table's (first) sensor; `usual_gyro` counts where the gyroscope states no unit."""
    guess = Guess("imu")
    axes = sensor or _sensor_axes(table, guess)
    if not axes:
        return Guess(unsure=[_NO_SENSOR])
    for kind, columns in axes.items():
        guess.columns |= {kind[0] + axis: _named(table, at) for axis, at in zip("xyz", columns, strict=True)}
    t_s, rate = _guess_times(table, guess, axes)
    force = None
    if "acc" in axes:
        values = table.vectors(axes["acc"])
        unit, why = unit_of("acc", values, table.units[axes["acc"][0]])
        if unit and holds_gravity(values * ACCELERATION[unit]):
            guess.set("accelerometer_unit", unit, why)
            force = values * ACCELERATION[unit]
        else:
            size = f"{usual_size(values):.3g}"
            said = (
                "The acceleration is without gravity, or its unit is not known: record the raw accelerometer,"
                f" calibrated, which reads 9.81 m/s^2 or 1 g at rest, and not {size}."
            )
            guess.set("accelerometer_unit", unit or "m/s^2", f"{UNKNOWN}: it reads {size} as a rule", said)
    if "gyro" in axes:
        values = table.vectors(axes["gyro"])
        unit, why = unit_of("gyro", values, table.units[axes["gyro"][0]], usual_gyro, force, t_s, rate)
        size = why or f"it reads up to {np.nanpercentile(np.abs(values), 99):.3g}"
        guess.set("gyroscope_unit", unit, size, "" if why else NO_GYRO_UNIT)
    for kind, missing in (("acc", "accelerometer"), ("gyro", "gyroscope")):
        if kind not in axes:
            guess.unsure.append(
                f"There is no {missing} here; name its file too: file = [.., ..], columns = [{{..}}, {{..}}]."
            )
    return guess


# ------------------------------------------------------------------------------------- which are the sensors

#: Words of columns that say no more than an axis' sign does.
_BARE, _SIGNS = {"value", "values", "v", "axis"}, ("xyz", "012", "123")


def bare_vector(table: DeviceTable) -> Columns | None:
    """The one vector of a table whose names do not say of what; without names behind the times."""
    if not table.labels:
        return (1, 2, 3) if table.width == 4 else None
    rest = [[word for word in words_of(label) if word not in _BARE] for label in table.labels]
    triples = ([rest.index([axis]) if [axis] in rest else -1 for axis in signs] for signs in _SIGNS)
    return next(((x, y, z) for x, y, z in triples if min(x, y, z) >= 0), None)


def sensors_of(table: DeviceTable) -> Sensors:
    """Sensors among the columns of a table by names and units; counts of a converter are none."""
    names = [split_unit(name)[0] for name in table.names] or list(table.labels)
    names = ["" if re.search(r"(raw|uncal)$", name, re.IGNORECASE) else name for name in names]
    return find_sensors(names, units=table.units)


def sensors_named(table: DeviceTable) -> dict[str, Columns]:
    """Columns of accelerometer, gyroscope and magnetometer by names and units; those of one sensor first."""
    axes: dict[str, Columns] = {}
    for own in sorted(sensors_of(table).values(), key=lambda own: not {"acc", "gyro"} <= own.keys()):
        axes = {**own, **axes}
    return {kind: axes[kind] for kind in ("acc", "gyro", "mag") if kind in axes}


def _sensor_axes(table: DeviceTable, guess: Guess) -> dict[str, Columns]:
    axes = sensors_named(table)
    for kind, columns in axes.items():
        unit = table.units[columns[0]]
        by_unit = bool(unit) and kind_of_unit(unit) == kind
        guess.reasons[kind[0] + "x"] = f"unit {unit}" if by_unit else f"name {table.name(columns[0])}"
    bare = None if axes else bare_vector(table)
    if bare is None or (table.labels and not _is_of_numbers(table)):
        return axes if table.names else _by_magnitude(table, guess)
    kind = _kind_by_size(table, bare)
    near = "its size is gravity's" if kind == "acc" else "it shows no gravity"
    guess.reasons[kind[0] + "x"] = f"the only vector, and {near}"
    if kind == "gyro":
        guess.unsure.append(f"{table.path.name} names no columns: without gravity assumed a gyroscope.")
    return {kind: bare}


def _is_of_numbers(table: DeviceTable) -> bool:
    """Whether a table has neither words nor a quaternion: its x, y, z may be a sensor's."""
    time = time_column(table)
    numeric = (
        at == time or _time_unit(table, at, 0.0)[0] or table.is_numeric(at) for at in range(table.width)
    )
    turned = any({"q", "qx", "quat", "quaternion"} & set(words_of(label)) for label in table.labels)
    return time is not None and all(numeric) and not turned


#: A field of 15 to 120 uT whose middle half lies within a quarter is the earth's.
_FIELD, _FIELD_SPREAD = (15.0, 120.0), 0.25
#: Half of an accelerometer's samples in g are within these sizes, whatever the arm does.
_ABOUT_1_G = (0.7, 1.3)
#: A size that varies by less is the system's estimate of gravity, not a sensor.
_EXACT = 1e-4


def _kind_by_size(table: DeviceTable, columns: Columns) -> str:
    """Which sensor a vector that is named after none is, by the size of its values."""
    size = np.linalg.norm(table.vectors(columns), axis=1)
    size = size[np.isfinite(size)]
    if not len(size):
        raise RecordingError(f"{table.path} has no samples; export it again.")
    low, median, high = np.percentile(size, (25, 50, 75))
    spread, in_si = high - low, gravity_unit(float(median), 0.82, 1.22) == "m/s^2"
    if in_si and spread < _EXACT * median:
        raise RecordingError(
            f"{table.path} contains gravity as the system estimates it; log the raw accelerometer."
        )
    about_1_g = (size > _ABOUT_1_G[0]) & (size < _ABOUT_1_G[1])
    if (in_si and spread < median) or about_1_g.mean() > 0.5:
        return "acc"
    if _FIELD[0] < median < _FIELD[1] and spread < _FIELD_SPREAD * median:
        raise RecordingError(
            f"{table.path} looks like a magnetometer (its size is {median:.0f} throughout); name the files of"
            " the accelerometer and the gyroscope."
        )
    return "gyro"


def _by_magnitude(table: DeviceTable, guess: Guess) -> dict[str, Columns]:
    """Accelerometer and gyroscope of a table without names: three columns whose length stays near one g."""
    columns = [column for column in range(table.width) if table.is_numeric(column)]
    best, share, least = None, 0.0, np.inf
    for three in zip(columns, columns[1:], columns[2:], strict=False):
        length = np.linalg.norm(table.vectors(three), axis=1)
        near = max(float(np.mean(np.abs(length / one - 1) < 0.2)) for one in (1.0, 9.80665, 1000.0))
        spread = float(np.nanstd(length) / np.nanmedian(length))
        # a part of a quaternion stays near 1 as well, and far more evenly than any force
        if near > 0.5 and 1e-3 < spread < least:
            best, share, least = three, near, spread
    if best is None:
        return {}
    guess.reasons["ax"] = f"the length of these three stays near one g in {100 * share:.0f} % of the rows"
    guess.unsure.append("The file names no columns; check which is which.")
    for first in (best[2] + 1, best[0] - 3):
        if first > 0 and {first, first + 1, first + 2} <= set(columns):
            guess.reasons["gx"] = "the three columns beside the accelerometer"
            return {"acc": best, "gyro": (first, first + 1, first + 2)}
    return {"acc": best}


# ------------------------------------------------------------------------------------------ which is the time

#: Words in names of columns of times, and of counters.
_TIME_WORD = re.compile(
    r"time|zeit|temps|tiempo|tempo|stamp|epoc|elapsed"
    r"|(?:^|[^a-z])(?:t|seconds?|sec|clock|millis|micros)(?=$|[^a-z])"
)
_COUNTER = re.compile(
    r"(?:^|[^a-z])(?:counter|count|packet\w*|sample\w*|index|frame\w*|no|n|seq\w*|row)(?=$|[^a-z])"
)


def _guess_times(
    table: DeviceTable, guess: Guess, axes: dict[str, Columns]
) -> tuple[FloatArray | None, float | None]:
    """Set the column of times or counts and its unit; the times in s, or the rate."""
    plain = [label.replace("_", " ") for label in table.labels] or [""] * table.width
    used = {at for columns in axes.values() for at in columns}
    free = [column for column in range(table.width) if column not in used]
    best = time_column(table)
    by_word = (at for at in free if _TIME_WORD.search(plain[at]) or stated_time_unit(table, at))
    timed = [at for at in dict.fromkeys((best, *by_word)) if at is not None and at in free]
    counted = [at for at in free if _COUNTER.search(plain[at])]
    own = [at - 1 for kind, columns in axes.items() if kind != "mag" for at in columns]
    if {*own} <= {*timed}:  # each channel behind times of its own (Delsys)
        timed = own[:1]
        first = table.numbers(own[0])
        if not all(np.array_equal(first, table.numbers(at), equal_nan=True) for at in own):
            guess.unsure.append("Its channels have different times; export each sensor at one rate.")
            return None, None
    # packets of many samples have one stamp
    least = {at: 0.95 if not table.labels else 0.001 if at == best else 0.3 for at in timed}
    units = ((at, *_time_unit(table, at, least[at])) for at in timed)
    found = next(((at, unit, why) for at, unit, why in units if unit), None)
    if found is None:
        others = [at for at in free if at not in (*timed, *counted)]
        try:
            at, unit = time_among(table, others, SENSOR_RATES, table.notes)
            found = None if at is None else (at, unit, "dates" if unit == "iso" else "it alone rises evenly")
        except RecordingError as error:
            guess.unsure.append(str(error))
    if found is not None:
        guess.set_time(table, *found)
        return in_seconds(table.times(found[0])[0], found[1]), None
    for at in counted:
        if table.is_numeric(at) and np.median(np.diff(table.numbers(at))) >= 1:
            guess.set_time(table, at, "counter", "a counter, and no column of times")
            break
    rate = table.above_rate_hz()
    if rate and SENSOR_RATES[0] <= rate <= SENSOR_RATES[1]:
        guess.set("rate_hz", rate, "stated above the table")
        return None, rate
    said = (
        f"There is no column of times among {shown(', '.join(table.names), 150)}, and no stated rate: rate_hz"
        " is a guess, write the rate that the sensor was set to."
    )
    if best is not None and table.labels:
        said = (
            f"The times in {table.name(best)} ('{shown(table.texts(best)[0], 40)}') are not for certain s,"
            " ms, us, ns or ticks of 100 ns of a sensor at 3 to 2,500 Hz, nor dates; call the column time_s,"
            " time_ms, time_us, time_ns or time_ticks, or write dates as 2026-01-31 10:11:12.5."
        )
    guess.set("rate_hz", 100.0, f"{UNKNOWN}: the file has no times and states no rate", said)
    return None, None


def _time_unit(table: DeviceTable, column: int, least: float) -> tuple[str, str]:
    """Unit of a column of times, and why; "" where it is none, or fewer than `least` of its steps rise."""
    try:
        values, dates = table.times(column)
    except RecordingError:
        return "", ""
    if dates:
        return "iso", "dates"
    finite = np.isfinite(values)
    # a packet's stamp may stand at its first sample alone
    rows = np.maximum.accumulate(np.where(finite, np.arange(len(values)), 0))
    values = values[rows[: np.flatnonzero(np.append(True, finite))[-1]]]
    step = np.diff(values)
    step = step[step > 0]
    if not len(step) or len(step) < least * (len(values) - 1):
        return "", ""
    stated = stated_time_unit(table, column)
    unit = time_unit(stated, values) or ""
    if (unit and unit == stated) or (not unit and stated and table.units[column]):
        return unit or stated, f"stated ({table.units[column] or stated})"
    typical = float(np.median(step))
    return unit, unit and f"steps of {typical:g} make {1 / (typical * SECONDS[unit]):.1f} samples per second"


# ------------------------------------------------------------------------------------------------ a skeleton


def _guess_skeleton(table: DeviceTable, joints: JointColumns) -> Guess:
    """Guess at a table with one row per frame, whose joints are known by their names."""
    guess = Guess("skeleton")
    for joint, columns in joints.axes.items():
        guess.columns[joint] = [_named(table, column) for column in columns]
        if joint in joints.confidence:
            guess.columns[f"{joint}_state"] = _named(table, joints.confidence[joint])
    if joints.confidence:
        cells = {cell for column in joints.confidence.values() for cell in table.texts(column)}
        meanings = ("not_tracked", "inferred", "tracked", "tracked")
        guess.set(
            "states",
            dict(zip(sorted(cells)[:4], meanings, strict=False)),
            f"{UNKNOWN}: the order of the values that occur",
            "states: what the values of the confidence mean is in the program's manual.",
        )
    position = {joint: table.vectors(columns) for joint, columns in joints.axes.items()}
    unit = unit_by_arm(position)
    why = "gives plausible arm lengths" if unit else f"{UNKNOWN}: no unit fits"
    guess.set("position_unit", unit[0] if unit else "m", why)
    scale, why = ("", "") if joints.time is None else _time_unit(table, joints.time, 0.3)
    if joints.time is not None and scale:
        guess.set_time(table, joints.time, scale, why)
    else:
        said = "rate_hz is a guess: write the camera's frames per second."
        guess.set("rate_hz", 30.0, f"{UNKNOWN}: the file has no times", said)
    pairs = [(f"elbow_{side}", f"shoulder_{side}") for side in ("left", "right")]
    arms = [np.nansum(position[a] - position[b], axis=0) for a, b in pairs if {a, b} <= position.keys()]
    down = np.sum(arms, axis=0) if arms else np.zeros(3)
    score = {"kinect": -down[1], "optical": down[1], "zup": -down[2]}
    best = max(score, key=lambda name: score[name])
    said = "frame: the camera's axes; `smooth` reports if gravity contradicts them."
    guess.set("frame", best, "upper arms hang down so" if score[best] > 0 else UNKNOWN, said)
    return guess
