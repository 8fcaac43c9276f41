"""Which columns or channels are a sensor's axes, by their names, types and units."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...array_types import FloatArray
from ...errors import RecordingError
from .imu import ImuTable, paired, turn_scale
from .joints import words_of
from .table import shown
from .units import ACCELERATION, ANGULAR_VELOCITY, SECONDS, plain_unit, unit_of_step

#: All in lower case; English first.
TIME_WORDS = ("time", "zeit", "zeitstempel", "temps", "tiempo", "tempo")
ACCELERATION_WORDS = (
    *("acceleration", "accelerometer", "beschleunigung", "beschleunigungssensor"),
    *("accélération", "aceleración", "accelerazione"),
)
LINEAR_WORDS = (
    *("linear acceleration", "lineare beschleunigung", "accélération linéaire", "aceleración lineal"),
)
TURNING_WORDS = (
    *("gyroscope", "gyroscope rotation", "rotation rate", "angular velocity"),
    *("gyroskop", "drehrate", "drehgeschwindigkeit", "winkelgeschwindigkeit"),
    *("giroscopio", "velocidad angular", "velocità angolare", "vitesse angulaire"),
)


_ACC = {"acc", "accel", "accelerations", "acce", *(w for w in ACCELERATION_WORDS if " " not in w)}
_GYRO = {
    *("gyr", "gyro", "gyroscope", "gyroscopes", "angvel", "angular", "omega", "rotationrate", "gyration"),
    *("turn", "gyros", "ang", "angulaire"),
    *(word for word in TURNING_WORDS if " " not in word),
}
_MAG = {"mag", "magn", "magnetometer", "magnetic", "magfield"}
_LETTERS = {"a": "acc", "g": "gyro", "w": "gyro", "m": "mag"}
#: Words of columns that are not a raw signal of a sensor.
_DERIVED = {
    "free",
    "linear",
    "quat",
    "quaternion",
    "euler",
    "orientation",
    "angle",
    "norm",
    "magnitude",
    "bias",
}
_NOISE = {
    *(
        "velocity",
        "rate",
        "field",
        "x",
        "y",
        "z",
        "channel",
        "ch",
        "cal",
        "calibrated",
        "raw",
        "wr",
        "ln",
        "data",
    ),
    *("stream", "lsl", "ms", "s", "deg", "rad", "g", "imu", "sensor"),
}
#: A gyroscope's values beyond this are deg/s, whatever moved: 60 rad/s is 3400 deg/s.
_FASTEST_RAD_S = 60.0
#: What is larger is not a measurement in any unit.
_DAMAGED = 1e9


@dataclass(frozen=True)
class SensorChannels:
    """Channels (from 0) of one sensor."""

    name: str  # What the labels call it, "" where they do not
    axes: dict[str, tuple[int, int, int]]  # Columns of x, y, z of `acc`, `gyro`, `mag`


def kind_of(words: Sequence[str]) -> str:
    """What words speak of: `acc`, `gyro`, `mag`, or ""."""
    present = set(words)
    if present & _DERIVED or ("rotation" in present and not present & {"rate"}):
        return ""
    for kind, names in (("gyro", _GYRO), ("acc", _ACC), ("mag", _MAG)):
        if present & names or (kind == "gyro" and {"rotation", "rate"} <= present):
            return kind
    return ""


def find_sensors(labels: Sequence[str], types: Sequence[str], stream: str) -> list[SensorChannels]:
    """Sensors among the channels of a stream."""
    groups: dict[str, dict[str, dict[int, int]]] = {}
    of_stream = kind_of(words_of(stream))
    for at, (label, channel_type) in enumerate(zip(labels, types, strict=True)):
        words = words_of(label)
        type_words = words_of(channel_type)
        axis = next((w[-1] for w in reversed([*type_words, *words]) if w[-1:] in "xyz" and _is_axis(w)), "")
        kind = kind_of(words) or _of_letters(words) or kind_of(type_words)
        if set(words) & _DERIVED or set(type_words) & _DERIVED:
            continue
        if not kind and axis and len(labels) in (3, 4):
            kind = of_stream
        if not kind and len(labels) == 3 and of_stream and not any(labels):
            kind, axis = of_stream, "xyz"[at]
        if kind and axis:
            name = " ".join(w for w in words if not _says_what(w))
            groups.setdefault(name, {}).setdefault(kind, {}).setdefault("xyz".index(axis), at)
    sensors = []
    for name, kinds in groups.items():
        axes = {
            kind: (columns[0], columns[1], columns[2]) for kind, columns in kinds.items() if len(columns) == 3
        }
        if axes.keys() & {"acc", "gyro"}:
            sensors.append(SensorChannels(name, axes))
    return sensors


def joint_label(marker: str, kind: str) -> str:
    """A channel's label of a marker (or object) and the channel's type in the MoCap meta-data of XDF."""
    kind = kind.lower()
    if marker and kind.startswith("position") and kind[-1:] in "xyz":
        return f"{marker}_{kind[-1]}"
    return f"{marker}_{kind}" if marker and kind in ("confidence", "trackingstate") else ""


def stem_of(name: str) -> str:
    """A stream's name without accelerometer or gyroscope, to find what belongs together."""
    return " ".join(word for word in words_of(name) if not _says_what(word))


def with_halves_joined(
    tables: Sequence[ImuTable], source: str
) -> tuple[list[ImuTable], list[ImuTable], list[str]]:
    """IMUs of halves whose names differ in the sensor alone; the halves left over, and why."""
    joined: list[ImuTable] = []
    alone: list[ImuTable] = []
    stems = [" ".join(word for word in stem_of(table.name).split() if word != "linear") for table in tables]
    for stem in dict.fromkeys(stems):
        mine = [table for table, each in zip(tables, stems, strict=True) if each == stem]
        acc, gyro = ([t for t in mine if getattr(t, part) is not None] for part in ("acc", "gyro"))
        if len(acc) == len(gyro) == 1:
            table = paired(mine, source)
            table.notes.insert(0, f"{acc[0].name} and {gyro[0].name} were taken as one IMU.")
            table.made_of = acc[0].name, gyro[0].name
            joined.append(table)
        else:
            alone += mine
    only = ["an accelerometer" if table.acc is not None else "a gyroscope" for table in alone]
    why = [f"{t.name} is {what} alone, and both are needed" for t, what in zip(alone, only, strict=True)]
    return joined, alone, why


def _says_what(word: str) -> bool:
    known = _ACC | _GYRO | _MAG | _NOISE
    return word in known or (word[:-1] in known and word[-1:] in "xyz") or _of_letters([word]) != ""


def _is_axis(word: str) -> bool:
    return word in "xyz" or word[:-1] in _ACC | _GYRO | _MAG | {"a", "g", "w", "m"}


def _of_letters(words: Sequence[str]) -> str:
    """Kind of `ax`, `gy`, `mz`; "" for others."""
    return next((_LETTERS[w[0]] for w in words if len(w) == 2 and w[0] in _LETTERS and w[1] in "xyz"), "")


def imu_of(
    name: str,
    t_s: FloatArray,  # (N,) s
    values: FloatArray,  # (N, channels)
    sensor: SensorChannels,
    units: Sequence[str],
    rate: float | None,  # Hz
) -> tuple[ImuTable | None, str]:
    """A sensor's samples in SI units."""
    values = np.where(np.abs(values) < _DAMAGED, values, np.nan)
    table = ImuTable(name, t_s, None, None, rate_hz=rate)
    said = []
    if "acc" in sensor.axes:
        unit = plain_unit(units[sensor.axes["acc"][0]])
        table.acc = values[:, sensor.axes["acc"]].astype(float)
        if unit not in ACCELERATION:
            unit = _unit_by_gravity(table.acc)
            if not unit:
                return None, f"{name}: the accelerometer's unit is not stated, and no gravity shows it"
            table.notes.append(f"{name}: assumed {unit} for the accelerometer (it then shows gravity).")
        table.acc *= ACCELERATION[unit]
        said.append(unit)
    if "gyro" in sensor.axes:
        unit = plain_unit(units[sensor.axes["gyro"][0]])
        table.gyro = values[:, sensor.axes["gyro"]].astype(float)
        if unit not in ANGULAR_VELOCITY:
            unit = _unit_by_turning(table)
            if not unit:
                return None, f"{name}: the gyroscope's unit is not stated, and the motion does not show it"
            table.notes.append(f"{name}: assumed {unit} for the gyroscope (it then turns as gravity does).")
        table.gyro *= ANGULAR_VELOCITY[unit]
        said.append(unit)
    if "mag" in sensor.axes:
        table.mag = values[:, sensor.axes["mag"]].astype(float)
    table.units = ", ".join(said)
    return table, ""


def _unit_by_gravity(acc: FloatArray) -> str:
    """Unit in which most samples are about gravity; "" where none is."""
    size = np.linalg.norm(acc, axis=1)
    median = float(np.nanmedian(size)) if np.isfinite(size).any() else 0.0
    for unit in ("m/s^2", "g", "mg"):
        if 0.7 < median * ACCELERATION[unit] / 9.81 < 1.4:
            return unit
    return ""


def _unit_by_turning(table: ImuTable) -> str:
    """Unit of the gyroscope by its size, or by how fast gravity turns in the sensor's axes; "" if unclear."""
    assert table.gyro is not None
    finite = table.gyro[np.isfinite(table.gyro)]
    if len(finite) and float(np.percentile(np.abs(finite), 99)) > _FASTEST_RAD_S:
        return "deg/s"
    scale = turn_scale(table)
    if scale is None:
        return ""
    if 0.3 < scale < 3.0:
        return "rad/s"
    return "deg/s" if 0.3 < np.degrees(scale) < 3.0 else ""


#: The axis letter in a column's name: between signs, a capital behind a word, or the last letter.
_AXIS = re.compile(r"(?<![A-Za-z])[xyzXYZ](?![A-Za-z])|(?<=[a-z])[XYZ](?![a-z])|(?<=[A-Za-z])[xyzXYZ]$")
_AXES = ("xyz", "XYZ")
#: Of several incomplete vectors this many are named.
_MOST = 3


@dataclass(frozen=True)
class MissingAxis:
    """Two columns of a vector without the third."""

    missing: str  # Name of the column that is not there, spelled as the others are
    present: tuple[str, str]  # Names of the two that are

    @property
    def is_of_sensor(self) -> bool:
        """Whether it is of an accelerometer or a gyroscope, or of nothing that its name says ("x-axis")."""
        plain = re.split(r"[(\[]", self.missing)[0]
        words = words_of(plain)
        if len(words) == 1 and len(words[0]) == 2:  # ax, gy
            return words[0][0] in "agw"
        words = [word for word in words if word != "rotation"]  # of a gyroscope, or beside one of its words
        kind = kind_of([*words, *(word[:-1] for word in words if word[-1:] in "xyz")])
        return kind in ("acc", "gyro") or set(words) <= {"x", "y", "z", "axis"}


def missing_axes(names: Sequence[str]) -> list[MissingAxis]:
    """Vectors among the columns of a table of which two axes are there and one is not."""
    there = set(names)
    found: dict[str, MissingAxis] = {}
    for name in names:
        for match in reversed(list(_AXIS.finditer(name))):  # the last letter that has a sibling counts
            axes = _AXES[match[0].isupper()]
            triple = [name[: match.start()] + axis + name[match.end() :] for axis in axes]
            present = [each for each in triple if each in there]
            if len(present) == 3:
                break
            if len(present) == 2:
                missing = next(each for each in triple if each not in there)
                found.setdefault(missing, MissingAxis(missing, (present[0], present[1])))
                break
    return list(found.values())


def missing_axes_words(missing: Sequence[MissingAxis]) -> str:
    """What is missing, for a sentence: "no column Gyr_Z beside Gyr_X and Gyr_Y"."""
    said = [
        f"no column {shown(each.missing, 60)} beside {shown(' and '.join(each.present), 120)}"
        for each in missing[:_MOST]
    ]
    more = f" (and {len(missing) - _MOST} more like it)" if len(missing) > _MOST else ""
    return " and ".join(said) + more


#: This share of the steps of a column of times rises, and lies within these parts of the usual one.
_RISES, _EVEN, _EVEN_SHARE = 0.95, (0.3, 3.0), 0.8
#: Fewer rows than these rise by chance.
_FEWEST = 8


def time_among(
    columns: Mapping[str, FloatArray], rates_hz: tuple[float, float], source: Path, notes: list[str]
) -> tuple[str, str]:
    """The column that is the time, and its unit, among those (n,) that nothing else is known of."""
    for name, values in columns.items():
        if {"x", "y", "z", "w"} & set(words_of(name)):
            continue
        step = np.diff(values[np.isfinite(values)])
        moved = step[step != 0]
        if len(values) < _FEWEST or len(moved) < 0.3 * (len(values) - 1) or not (moved > 0).mean() > _RISES:
            continue
        usual = float(np.median(moved))
        unit = unit_of_step(usual, rates_hz, "", float(np.nanmedian(values)))
        if usual == 1 and (values % 1 == 0)[np.isfinite(values)].all() and np.nanmax(values) < 1e11:
            notes.append(f"The column {shown(name, 60)} counts rows or packets and is not the time.")
            continue
        even = ((step > _EVEN[0] * usual) & (step < _EVEN[1] * usual)).mean() > _EVEN_SHARE
        if unit is None and not even:
            continue
        if unit is None or not even or not (step > 0).all() or not np.isfinite(values).all():
            raise RecordingError(
                f"{source} has no time by its name, and its column {shown(name, 60)} rises like one, but it"
                " is not certain that it is, or in which unit; call it time_s, time_ms, time_us, time_ns or"
                f" time_ticks, or describe it in a recording.toml (`unocclude import describe {source}`)."
            )
        notes.append(
            f"The column {shown(name, 60)} was taken for the time, in {unit}: it alone rises evenly, with"
            f" {1 / (usual * SECONDS[unit]):.4g} rows per second."
        )
        return name, unit
    return "", ""
