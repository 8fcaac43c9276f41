"""Inertial sensors in tables: which columns are one, its units, and two halves put together."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

import numpy as np

from ...array_types import FloatArray
from ...errors import RecordingError
from ...linalg import interpolate, median_rate_hz
from ...measurements.timestamps import pauses
from ...runtime.store import batches, by_rows, sampled
from ...units import STANDARD_GRAVITY
from ..recording.streams import ImuSamples, rows_of
from .joints import words_of
from .table import shown
from .units import ACCELERATION, ANGULAR_VELOCITY, TIME, gravity_unit, plain_unit, unit_of_rest

Columns = tuple[int, int, int]
#: Columns of x, y, z of `acc`, `gyro`, `mag` by what their labels call the sensor ("" where they do not).
Sensors = dict[str, dict[str, Columns]]


# ------------------------------------------------------------------------- which columns are a sensor's axes


def _words(*listed: str) -> set[str]:
    return {word for words in listed for word in words.split()}


#: Words for the sensors, in lower case; English first.
_ACC = _words(
    "acc accel accelerations acce accelero acceleration accelerometer",
    "beschleunigung beschleunigungssensor aceleracion accelerazione",
)
_GYRO = _words(
    "gyr gyro gyros gyroscope gyroscopes angvel omega rotationrate gyration turn ang angular",
    "gyroskop drehrate drehgeschwindigkeit winkelgeschwindigkeit giroscopio angolare angulaire",
)
_MAG = _words("mag magn magnetometer magnetic magfield")
_LETTERS = {"a": "acc", "g": "gyro", "w": "gyro", "m": "mag"}
#: Words of columns that are not a raw signal of a sensor.
_DERIVED = _words(
    "free linear lineare lineaire lineal linearacceleration linacc user gravity quat quaternion euler",
    "orientation angle norm magnitude bias mat roll pitch yaw",
)
_NOISE = _words(
    "velocity rate field x y z channel ch cal calibrated raw wr ln data stream lsl ms s deg rad g imu sensor",
    "total value values low noise wide range",
)
#: Of a Shimmer's two accelerometers the low-noise one, and names of raw ones in ROS and in Physics Toolbox.
_LOW_NOISE, _RAW_ALL_THE_SAME = {"ln", "noise"}, re.compile(r"linear_acceleration|^gF(?=[xyz]$)")


def kind_of(words: Sequence[str]) -> str:
    """What words speak of: `acc`, `gyro`, `mag`, or ""."""
    present = set(words)
    if present & _DERIVED or ("rotation" in present and not present & {"rate"}):
        return ""
    for kind, names in (("gyro", _GYRO), ("acc", _ACC), ("mag", _MAG)):
        if present & names or (kind == "gyro" and {"rotation", "rate"} <= present):
            return kind
    return ""


def kind_of_unit(unit: str) -> str:
    """What a unit is of: `acc`, `gyro`, or "" for others."""
    plain = plain_unit(unit)
    return "acc" if plain in ACCELERATION else "gyro" if plain in ANGULAR_VELOCITY else ""


def find_sensors(
    labels: Sequence[str], types: Sequence[str] = (), stream: str = "", units: Sequence[str] = ()
) -> Sensors:
    """Sensors among the channels of a stream, or the columns of a table."""
    groups: dict[str, dict[str, dict[str, int]]] = {}
    of_stream, count = kind_of(words_of(stream)), len(labels)
    # the low-noise one of two clips at 2 g; beside the total acceleration others are without gravity
    order = [("total" not in words, bool(_LOW_NOISE & {*words})) for words in map(words_of, labels)]
    for at, words in sorted(enumerate(map(words_of, labels)), key=lambda each: order[each[0]]):
        type_words = words_of(types[at]) if types else []
        if {*words, *type_words} & _DERIVED or (units and plain_unit(units[at]) in TIME):
            continue
        letters, by_unit = _of_letters(words), kind_of_unit(units[at]) if units else ""
        kind = kind_of(words) or letters or kind_of(type_words) or by_unit
        axis = next((w[-1] for w in reversed([*type_words, *words]) if _is_axis(w)), "")
        if units:  # columns of a table may be numbered
            axis = axis or next((w for w in reversed(words) if w in ("0", "1", "2", "3")), "")
        if not kind and axis in ("x", "y", "z") and count in (3, 4):
            kind = of_stream
        if not kind and count == 3 and of_stream and not any(labels):
            kind, axis = of_stream, "xyz"[at]
        if kind and axis and by_unit in ("", kind):
            by_letter = {*_LETTERS} if letters and not kind_of(words) else set()
            name = " ".join(w for w in words if not _says_what(w) and w != axis and w not in by_letter)
            groups.setdefault(name, {}).setdefault(kind, {}).setdefault(axis, at)
    found: Sensors = {}
    for name, kinds in groups.items():
        axes: dict[str, Columns] = {}
        for kind, by_axis in kinds.items():
            if signs := next((signs for signs in ("xyz", "012", "123") if {*signs} <= by_axis.keys()), ""):
                axes[kind] = (by_axis[signs[0]], by_axis[signs[1]], by_axis[signs[2]])
        if axes.keys() & {"acc", "gyro"}:
            found[name] = axes
    for name in [name for name, axes in found.items() if "acc" not in axes]:
        # of a sensor's two vectors one may have more words (Noraxon)
        near = [
            k for k, axes in found.items() if k and "gyro" not in axes and {*k.split()} <= {*name.split()}
        ]
        if len(near) == 1:
            found[near[0]] |= found.pop(name)
    respelled = [_RAW_ALL_THE_SAME.sub("acc_", label) for label in labels]
    if respelled != list(labels) and not any("acc" in axes for axes in found.values()):
        return find_sensors(respelled, types, stream, units)  # whether it holds gravity is looked at later
    return found


def channel_labels(channels: Iterable[Callable[[str], str]]) -> tuple[list[str], list[str], list[str]]:
    """Labels, types and units of a stream's channels, by what each states; as the MoCap meta-data have it."""
    labels, types, units = [], [], []
    for stated in channels:
        kind, marker = stated("type").lower(), stated("marker") or stated("object")
        own = ""  # a joint's name and its axis put together
        if marker and kind.startswith("position") and kind[-1:] in "xyz":
            own = f"{marker}_{kind[-1]}"
        elif marker and kind in ("confidence", "trackingstate"):
            own = f"{marker}_{kind}"
        labels.append(own or stated("label") or stated("name"))
        types.append(stated("type"))
        units.append(stated("unit"))
    return labels, types, units


def stem_of(name: str) -> str:
    """A stream's name without accelerometer or gyroscope, to find what belongs together."""
    return " ".join(word for word in words_of(name) if not _says_what(word))


def _says_what(word: str) -> bool:
    known = _ACC | _GYRO | _MAG | _NOISE
    return word in known or (word[:-1] in known and word[-1:] in "xyz") or _of_letters([word]) != ""


def _is_axis(word: str) -> bool:
    return word[-1:] in tuple("xyz") and (len(word) == 1 or word[:-1] in _ACC | _GYRO | _MAG | {*_LETTERS})


def _of_letters(words: Sequence[str]) -> str:
    """Kind of `ax`, `gy`, `mz`, or of `a_x`; "" for others."""
    pairs = [*words, *("".join(words[at : at + 2]) for at in range(len(words) - 1))]
    return next((_LETTERS[w[0]] for w in pairs if len(w) == 2 and w[0] in _LETTERS and w[1] in "xyz"), "")


#: The axis letter in a column's name: between signs, a capital behind a word, or the last letter.
_AXIS = re.compile(r"(?<![A-Za-z])[xyzXYZ](?![A-Za-z])|(?<=[a-z])[XYZ](?![a-z])|(?<=[A-Za-z])[xyzXYZ]$")


def missing_axes(names: Sequence[str]) -> dict[str, list[str]]:
    """Columns of a table that are not there, by name, while the two others of their vector are: those."""
    found: dict[str, list[str]] = {}
    for name in names:
        for match in reversed(list(_AXIS.finditer(name))):  # the last letter that has a sibling counts
            axes = "XYZ" if match[0].isupper() else "xyz"
            triple = [name[: match.start()] + axis + name[match.end() :] for axis in axes]
            present = [each for each in triple if each in names]
            if len(present) == 2:
                found.setdefault(next(each for each in triple if each not in names), present)
            if len(present) > 1:
                break
    return found


def is_of_sensor(name: str) -> bool:
    """Whether a column is of an accelerometer or a gyroscope, or of nothing that its name says ("x-axis")."""
    words = words_of(re.split(r"[(\[]", name)[0])
    if len(words) == 1 and len(words[0]) == 2:  # ax, gy
        return words[0][0] in "agw"
    words = [word for word in words if word != "rotation"]  # of a gyroscope, or beside one of its words
    kind = kind_of([*words, *(word[:-1] for word in words if word[-1:] in "xyz")])
    return kind in ("acc", "gyro") or set(words) <= {"x", "y", "z", "axis"}


def missing_axes_words(missing: dict[str, list[str]]) -> str:
    """What is missing, for a sentence: "no column Gyr_Z beside Gyr_X and Gyr_Y"."""
    said = (f"no column {shown(name, 60)} beside {' and '.join(two)}" for name, two in missing.items())
    return shown(" and ".join(said), 400)


# ------------------------------------------------------------------------------------------------- the units

#: A median below this part of gravity has no gravity, and above the other is none in m/s^2.
_NO_GRAVITY, _MOST_GRAVITY = 0.35, 2.0
#: No gyroscope of a body-worn sensor reads beyond this, rad/s per axis (2000 deg/s).
GYRO_LIMIT = 35.0
#: rad/s that no arm reaches in one sample of a hundred: larger values are deg/s.
_FAST = 40.0
#: Rotation is compared with gravity's over this time, s.
_OVER_S = 0.4
#: A unit is wrong by 57.3 where the scale lies beyond this factor; fast motion lowers it to 0.2.
_WRONG_SCALE = 7.5
#: Fewer samples, of which some may be damaged, do not show a unit.
_FEWEST = 100
#: The comparison counts from this correlation on.
_CLEAR = 0.5


def usual_size(values: FloatArray) -> float:
    """Median length of vectors (n, 3); 0 where there are none."""
    size = np.linalg.norm(values, axis=1)
    return float(np.nanmedian(size)) if np.isfinite(size).any() else 0.0


def unit_of(
    kind: str,
    values: FloatArray,
    stated: str,
    usual: str = "",
    force: FloatArray | None = None,
    t_s: FloatArray | None = None,
    rate: float | None = None,
) -> tuple[str, str]:
    """Unit of a sensor's values (n, 3) and why: stated, the usual one, or the one that gravity shows.

    The unit is "" where nothing shows it, and why where the gyroscope's size alone does.
    """
    known = ACCELERATION if kind == "acc" else ANGULAR_VELOCITY
    if (factor := known.get(plain_unit(stated))) is not None:
        return next(unit for unit, one in known.items() if one == factor), f"stated ({stated})"
    if usual:
        return usual, "that of this device"
    if kind == "acc":
        size = usual_size(values)
        in_si = _NO_GRAVITY < size / STANDARD_GRAVITY < _MOST_GRAVITY
        return gravity_unit(size) or ("m/s^2" if in_si else ""), f"it reads {size:.3g} as a rule"
    if unit := _unit_by_resolution(values):
        return unit, "its smallest step is that of a 16-bit sensor in this unit"
    if (scale := turn_scale(ImuSamples("", t_s=t_s, acc=force, gyro=values, rate_hz=rate))) is not None:
        unit = "deg/s" if scale < 1 / _WRONG_SCALE else "rad/s"
        return unit, "it then rotates as gravity does in the accelerometer"
    finite = np.abs(values[np.isfinite(values)])
    return ("deg/s" if len(finite) and float(np.percentile(finite, 99)) > _FAST else "rad/s"), ""


def _unit_by_resolution(gyro: FloatArray) -> str:
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


def rest_size(acc: FloatArray, gyro: FloatArray) -> tuple[float, float]:
    """Size of the specific force at rest, and of the fastest rotation, in the units of finite samples."""
    with np.errstate(over="ignore"):
        rate, size = np.linalg.norm(gyro, axis=1), np.linalg.norm(acc, axis=1)
    # The quietest fifth, whatever the gyroscope's unit and offset are.
    rest = size[rate <= np.percentile(rate, 20)]
    return float(np.median(rest)), float(np.percentile(rate, 99))


def in_shown_units(table: ImuSamples) -> ImuSamples:
    """An IMU in the units in which it reads gravity at rest and turns as gravity does, whatever was taken."""
    if table.acc is None or table.gyro is None:
        return table
    acc, gyro = sampled(table.acc), sampled(table.gyro)
    finite = np.isfinite(acc).all(axis=1) & np.isfinite(gyro).all(axis=1)
    if finite.sum() < _FEWEST:
        return table
    rest, fast = rest_size(acc[finite], gyro[finite])
    parts = (rows_of(table, part) for part in batches(len(table)))
    scale = next((scale for part in parts if (scale := turn_scale(part)) is not None), None)
    taken, degree, shown = "rad/s", ANGULAR_VELOCITY["deg/s"], {"acc": unit_of_rest(rest), "gyro": ""}
    if fast > GYRO_LIMIT if scale is None else scale < 1 / _WRONG_SCALE:
        shown["gyro"] = "deg/s"
    elif scale is not None and scale > _WRONG_SCALE and table.units.endswith("deg/s"):
        shown["gyro"], taken, degree = "rad/s", "deg/s", 1 / degree
    table, units = replace(table, notes=list(table.notes)), (table.units or "m/s^2, rad/s").split(", ")
    of = f"{table.topic}: the" if table.topic else "The"
    for at, kind, sensor, why in (
        (0, "acc", "accelerometer", "as gravity shows, not in m/s^2"),
        (-1, "gyro", "gyroscope", f"as the motion shows, not in {taken}"),
    ):
        if unit := shown[kind]:
            factor, units[at] = ACCELERATION[unit] if kind == "acc" else degree, unit
            setattr(table, kind, by_rows(lambda part, by=factor: part * by, getattr(table, kind)))
            table.notes.append(f"{of} {sensor} is in {unit}, {why} as stated or assumed; it was converted.")
    table.units = ", ".join(units)
    return table


def holds_gravity(acc: FloatArray) -> bool:
    """Whether accelerations (n, 3) in m/s^2 can be specific force: most are not near zero."""
    return usual_size(acc) > _NO_GRAVITY * STANDARD_GRAVITY


def turn_scale(table: ImuSamples) -> float | None:
    """How much faster gravity turns in the sensor's axes than its gyroscope says."""
    rate = _rate(table)
    if table.acc is None or table.gyro is None or rate is None:
        return None
    width = max(round(_OVER_S * rate), 2)
    finite = np.isfinite(table.acc).all(axis=1) & np.isfinite(table.gyro).all(axis=1)
    acc, gyro = table.acc[finite], table.gyro[finite]
    count = len(acc) // width
    if len(acc) < 8 * width:
        return None
    acc, gyro = (each[: count * width].reshape(count, width, 3).mean(axis=1) for each in (acc, gyro))
    turned = np.cross(acc[1:-1], gyro[1:-1])
    changed = (acc[2:] - acc[:-2]) / (2 * width / rate)
    power, common = float((turned**2).sum()), float((turned * changed).sum())
    both = np.sqrt(power * float((changed**2).sum()))
    return common / power if both > 0 and common / both > _CLEAR else None


def _rate(table: ImuSamples) -> float | None:
    if table.rate_hz:
        return table.rate_hz
    if table.t_s is None or len(table.t_s) < 10:
        return None
    dt = np.diff(table.t_s)
    dt = dt[np.isfinite(dt) & (dt > 0)]
    if not len(dt):
        return None
    # Repeated stamps are samples too, pauses are short ones.
    rate = len(table.t_s) / float(np.minimum(dt, 10 * np.median(dt)).sum())
    return rate if 1 < rate < 1e5 else None


# --------------------------------------------------------------------------------- two halves put together

#: How a note on what was not taken begins.
UNUSED = "Not used:"


def with_halves_joined(
    tables: Sequence[ImuSamples], source: str
) -> tuple[list[ImuSamples], list[ImuSamples], list[str]]:
    """IMUs of halves whose names differ in the sensor alone; the halves left over, and why."""
    joined: list[ImuSamples] = []
    alone: list[ImuSamples] = []
    by_stem: dict[str, list[ImuSamples]] = {}
    for table in tables:
        stem = " ".join(word for word in stem_of(table.topic).split() if word != "linear")
        by_stem.setdefault(stem, []).append(table)
    for mine in by_stem.values():
        acc, gyro = _having(mine, "acc"), _having(mine, "gyro")
        if len(acc) == len(gyro) == 1:
            table = paired(mine, source)
            table.notes.insert(0, f"{acc[0].topic} and {gyro[0].topic} were taken as one IMU.")
            table.made_of = acc[0].topic, gyro[0].topic
            joined.append(table)
        else:
            alone += mine
    only = ("a gyroscope" if table.acc is None else "an accelerometer" for table in alone)
    why = [f"{t.topic} is {what} alone, and both are needed" for t, what in zip(alone, only, strict=True)]
    return joined, alone, why


def _having(tables: list[ImuSamples], part: str) -> list[ImuSamples]:
    return [table for table in tables if getattr(table, part) is not None]


def paired(tables: list[ImuSamples], source: str) -> ImuSamples:
    """One IMU of tables that each contain a part of it, on the gyroscope's times."""
    if len(tables) == 1 and tables[0].acc is not None and tables[0].gyro is not None:
        return tables[0]
    tables = _told_apart(tables)
    acc, gyro = _only(tables, "acc", source), _only(tables, "gyro", source)
    if acc is gyro:
        raise RecordingError(f"{source}: one file contains the whole sensor already; name it alone.")
    assert acc.t_s is not None and gyro.t_s is not None and acc.acc is not None and gyro.gyro is not None
    first, last = max(acc.t_s[0], gyro.t_s[0]), min(acc.t_s[-1], gyro.t_s[-1])
    in_pause = np.isin(np.searchsorted(acc.t_s, gyro.t_s, side="right"), pauses(acc.t_s))
    keep = (gyro.t_s >= first) & (gyro.t_s <= last) & ~(in_pause & ~np.isin(gyro.t_s, acc.t_s))
    if keep.sum() < 2:
        raise RecordingError(
            f"{source}: accelerometer and gyroscope share too few samples ({last - first:.1f} s); export both"
            " from the same recording."
        )
    at = gyro.t_s[keep]
    mags = (interpolate(t.t_s, t.mag, at) for t in tables if t.mag is not None and t.t_s is not None)
    notes = [note for table in tables for note in table.notes]
    notes.append(
        f"The accelerometer ({median_rate_hz(acc.t_s):.1f} Hz) was interpolated to the gyroscope's times"
        f" ({median_rate_hz(gyro.t_s):.1f} Hz)."
    )
    if not keep.all():
        notes.append(f"Samples of the gyroscope without accelerometer, left out: {int((~keep).sum())}.")
    table = replace(
        gyro,
        topic=gyro.topic or acc.topic,
        t_s=at,
        acc=interpolate(acc.t_s, acc.acc, at),
        gyro=gyro.gyro[keep],
        mag=next(mags, None),
        counter=None,
        units=", ".join(dict.fromkeys(unit for unit in (acc.units, gyro.units) if unit)),
        notes=notes,
    )
    return in_shown_units(table)


#: Least ratio between a gyroscope's readings in deg/s and those of a shaken accelerometer in g.
_SHAKEN = 30.0


def _told_apart(tables: list[ImuSamples]) -> list[ImuSamples]:
    """Of two vectors without names, each too shaken to show gravity alone, the first is what reads 1 g."""
    if len(tables) != 2 or not all(table.assumed for table in tables):
        return tables
    written = [table.gyro / ANGULAR_VELOCITY[table.units] for table in tables if table.gyro is not None]
    force, turns = (0, 1) if usual_size(written[0]) < usual_size(written[1]) else (1, 0)
    size = usual_size(written[force])
    if gravity_unit(size) != "g" or usual_size(written[turns]) < _SHAKEN * size:
        return tables
    note = f"Of the two files it reads about 1 g as a rule ({size:.2f}): taken as the accelerometer instead."
    notes = [*tables[force].notes, note]
    acc = replace(tables[force], acc=written[force] * STANDARD_GRAVITY, gyro=None, units="g", notes=notes)
    return [acc, tables[turns]]


def _only(tables: list[ImuSamples], part: str, source: str) -> ImuSamples:
    """The one table that has a part."""
    name = {"acc": "accelerometer", "gyro": "gyroscope"}[part]
    having = _having(tables, part)
    if len(having) == 1:
        return having[0]
    if not having:
        said = dict.fromkeys(note for table in tables for note in table.notes if note.startswith(UNUSED))
        unused = f" ({' '.join(said).rstrip('.')})" if said else ""
        remedy = "export it as well and name both files: --imu forearm_right=acc.csv,gyro.csv."
        if len(tables) > 1:
            remedy = (
                "name its columns and unit in a recording.toml: [imu.forearm_right] with file = [.., ..],"
                " columns = [{t = 1, ax = 2, ..}, {t = 1, gx = 2, ..}] and accelerometer_unit."
            )
        raise RecordingError(f"{source} has no {name} that is recognised{unused}; {remedy}")
    acc, gyro = ([each.topic for each in _having(tables, kind)] for kind in ("acc", "gyro"))
    command = ""
    if acc and gyro and ", " not in source:
        command = f": --imu forearm_right={source}#{acc[0]},#{gyro[0]}"
    raise RecordingError(
        f"{source} has {len(having)} {name}s ({', '.join(table.topic for table in having)}); name one"
        f" accelerometer and one gyroscope{command}."
    )
