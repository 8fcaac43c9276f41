"""Plain tables of inertial sensors: a row of `IMU_FORMATS` a device or program."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from os.path import commonprefix
from pathlib import Path

import numpy as np

from ...array_types import FloatArray, IntArray
from ...errors import RecordingError
from ..recording.streams import ImuSamples, rows_of
from .columns import ImuKeys, imu_by_columns
from .guess import NO_GYRO_UNIT, Guess, bare_vector, guess_sensor, sensors_named, sensors_of
from .imu import UNUSED, Columns, unit_of, usual_size
from .joints import seconds, time_column
from .table import DeviceTable, FileHead, Format, plain_label, read_table, shown
from .units import ACCELERATION, ANGULAR_VELOCITY, plain_unit, time_unit


@dataclass(frozen=True)
class Device:
    """How a device's table is read: its vectors are found by their names, and labels are in lower case."""

    key: str  # As in `Format`, up to `recognised_by`
    title: str
    recognised_by: str
    fits: Callable[[DeviceTable], bool]  # Whether a table's columns are of this device
    lacks: str = ""  # What a table without both sensors is, and what to do; "" where the columns speak
    acc_unit: str = "m/s^2"  # Counts where the file states none; "" = as gravity shows
    gyro_unit: str = "rad/s"  # Counts where the file states none, and gravity does not contradict
    time: tuple[str, ...] = ("time",)  # Labels of the time's column, the preferred one first
    time_unit: str = "s"
    # Finds the times (n,), s, by the sensor's name and the stated rate, where `time` does not do
    times: Callable[[DeviceTable, str, float | None], FloatArray | None] | None = None
    name: tuple[str, ...] = ()  # Lines of the preamble that state the sensor's name
    counter: tuple[str, ...] = ()  # Labels of a packet counter, which starts anew at `counter_wraps`
    counter_wraps: int = 0
    notes: Callable[[DeviceTable, str], list[str]] | None = None  # Sentences on what was chosen
    # Forms of columns of velocity over a sample and of a quaternion's, which stand in for rates
    increments: tuple[tuple[str, ...], tuple[str, ...]] | None = None
    read: Callable[[DeviceTable, Device], list[ImuSamples]] | None = None  # Where the columns alone do not do


def imu_format(device: Device) -> Format:
    """The format of a device's table."""

    def recognises(head: FileHead) -> bool:
        try:
            return head.table is not None and device.fits(head.table)
        except RecordingError:  # of cells that are no numbers
            return False

    read = partial(_read, device=device)
    return Format(device.key, device.title, "imu", device.recognised_by, recognises, read)


def _read(path: Path, device: Device) -> list[ImuSamples]:
    """The sensors of a device's table, in the order of its columns."""
    table = read_table(path, f"a table of {device.title}")
    if not device.fits(table):
        names = shown(", ".join(table.names) or "none", 150)
        raise RecordingError(f"{path} is not of {device.title}; its columns are {names}.")
    table.refuse_nameless(most=1)  # one more is a counter or a comment of some exporter
    if device.read is not None or not device.lacks:
        return (device.read or _read_named)(table, device)
    sensors = [axes for axes in sensors_of(table).values() if {"acc", "gyro"} <= axes.keys()]
    found = [_sensor(table, device, each) for each in sensors]
    if not found and (imu := _of_increments(table, device)) is not None:
        found = [imu]
    if not found:
        raise RecordingError(f"{path} ({device.title}) is {device.lacks}")
    for imu in found:
        imu.notes[:0] = table.notes
    return found


def _sensor(table: DeviceTable, device: Device, axes: dict[str, Columns]) -> ImuSamples:
    """One sensor with both vectors."""
    acc, gyro, mag = axes["acc"], axes["gyro"], axes.get("mag")
    common = commonprefix([table.names[at] for at in (*acc, *gyro)])  # noqa: RUF071 (of names)
    imu = _empty(table, device, re.sub(r"[^/_]*$", "", common).rstrip("/_"))
    if mag is not None and np.isfinite(field := table.vectors(mag)).all():
        imu.mag = field
    imu.acc, acc_unit = _in_si(table, "acc", acc, device.acc_unit)
    imu.gyro, gyro_unit = _in_si(table, "gyro", gyro, device.gyro_unit)
    imu.units = f"{acc_unit}, {gyro_unit}"
    if not device.acc_unit and acc_unit != "m/s^2" and not table.units[acc[0]]:
        imu.notes.append(f"The accelerometer states no unit; it reads gravity in {acc_unit}.")
    return imu


def _empty(table: DeviceTable, device: Device, name: str) -> ImuSamples:
    """What a table states of a sensor beside its vectors."""
    rate = table.above_rate_hz()
    if device.times is not None:
        t_s = device.times(table, name, rate)
    else:
        t_s = seconds(table, table.find(*device.time), device.time_unit)
    return ImuSamples(
        name or table.stated(*device.name),
        t_s=t_s,
        rate_hz=rate,
        counter=_counter(table, table.find(*device.counter)),
        counter_wraps=device.counter_wraps,
        notes=[] if device.notes is None else device.notes(table, name),
    )


def _in_si(table: DeviceTable, kind: str, columns: Columns, usual: str = "") -> tuple[FloatArray, str]:
    """Three columns in SI units (n, 3), and their unit."""
    known = ACCELERATION if kind == "acc" else ANGULAR_VELOCITY
    values, stated = table.vectors(columns), table.units[columns[0]]
    if plain_unit(stated) and plain_unit(stated) not in known:
        raise RecordingError(
            f"{table.path} states the unit '{shown(stated, 40)}' of {shown(table.name(columns[0]), 60)};"
            f" export calibrated values in {next(iter(known))}."
        )
    unit, _ = unit_of(kind, values, stated, usual)
    if not unit:
        raise RecordingError(
            f"{table.path} states no unit of acceleration, and reads {usual_size(values):.3g} as a rule, not"
            " 9.81 m/s^2 or 1 g (uncalibrated?); export calibrated ones, or describe it in a recording.toml."
        )
    return values * known[unit], unit


def _counter(table: DeviceTable, column: int | None) -> IntArray | None:
    """Packet counter of a column, (n,); None where there is none, or some packet has none."""
    if column is None or not len(values := table.numbers(column)):
        return None
    usable = np.isfinite(values).all() and np.abs(values).max() < 2**53 and (values % 1 == 0).all()
    return values.astype(np.int64) if usable else None


def _of_increments(table: DeviceTable, device: Device) -> ImuSamples | None:
    """A sensor by its velocity (m/s) and rotation over a sample, if they are there."""
    from scipy.spatial.transform import Rotation

    if device.increments is None:
        return None
    forms, parts = device.increments
    velocity = table.axes(*forms, signs=("123", "xyz"))
    found = (table.find(*(part.format(axis=axis, at=at) for part in parts)) for at, axis in enumerate("wxyz"))
    rotation = [column for column in found if column is not None]
    if velocity is None or len(rotation) < 4:
        return None
    imu = _empty(table, device, "")
    rate = imu.rate_hz
    if rate is None and imu.t_s is not None:
        steps = np.diff(np.unique(imu.t_s[np.isfinite(imu.t_s)]))
        rate = float(1 / np.median(steps)) if len(steps) else None
    if rate is None:
        raise RecordingError(
            f"{table.path} has increments and no increasing times or rate; export it again with times."
        )
    turns = table.vectors(rotation)
    there = np.isfinite(turns).all(axis=1) & turns.any(axis=1)
    imu.acc, imu.gyro = table.vectors(velocity) * rate, np.full((len(turns), 3), np.nan)
    imu.gyro[there] = Rotation.from_quat(turns[there], scalar_first=True).as_rotvec() * rate
    first, quaternion = table.names[velocity[0]], table.names[rotation[0]]
    imu.units = f"{first} .. in m/s, {quaternion} .."
    imu.notes.append(
        f"The increments ({first} and {quaternion} ..) were multiplied by the rate of {rate:.4g} Hz to"
        " acceleration and angular velocity."
    )
    return imu


# -------------------------------------------------------------------------------------- what devices are like

#: Columns of MT Manager alone; ticks of its SampleTimeFine, s (Xsens MT low-level protocol: 10 kHz).
_MT_ONLY = ("quat_q0", "mat[1][1]", "velinc_x", "oriinc_q0", "oriinc_w", "utc_nano")
_TICK_S = 1e-4


def _is_commented(table: DeviceTable) -> bool:
    return any(line.lstrip().startswith("//") for line in table.preamble)


def _is_mt(table: DeviceTable) -> bool:
    if table.find("counter", "packetcounter", "sampletimefine") is None:
        return False
    plain = table.find("counter") is not None and table.find("acc_x") is not None
    only = table.find(*_MT_ONLY) is not None
    return only or (table.find("quat_w", "roll", "acc_x") is not None and (_is_commented(table) or plain))


def _mt_times(table: DeviceTable, _: str, rate: float | None) -> FloatArray | None:
    """Where no rate is stated: the UTC columns, else SampleTimeFine, else a column Time."""
    if rate is not None:
        return None
    utc = [table.find(f"utc_{part}") for part in ("hour", "minute", "second", "nano")]
    if None not in utc:
        t_s = table.vectors([at for at in utc if at is not None]) @ np.array([3600, 60, 1, 1e-9])
        if np.isfinite(t_s).mean() > 0.5:
            return t_s
    column = table.find("sampletimefine")
    if column is None or not (there := np.isfinite(ticks := table.numbers(column))).any():
        return seconds(table, table.find("time"))
    return ticks * _TICK_S if there.mean() > 0.5 else None


def _is_dot(table: DeviceTable) -> bool:
    """Whether the columns are a DOT's, and not those of MT Manager: `//` above them, or some of its own."""
    if table.find("sampletimefine", "packetcounter") is None or _is_commented(table):
        return False
    own = ("acc_x", "gyr_x", "dv[1]", "dv_x", "iv_x", "quat_w", "euler_x", "freeacc_x")
    return table.find(*_MT_ONLY, "utc_year", "counter") is None and table.find(*own) is not None


_SHIMMER = re.compile(r".*(accel(_ln|_wr)?|gyro)_[xyz]_(cal|raw|uncal)")
#: Preferred first; the synchronised ones are on one clock for all sensors of a session.
_SHIMMER_TIMES = (
    *("timestampsync_unix", "timestamp_unix", "timestampsync_formattedunix", "timestamp_formattedunix"),
    *("timestampsync", "timestamp"),
)


def _shimmer_times(table: DeviceTable, name: str, _: float | None) -> FloatArray | None:
    prefix = f"{plain_label(name)}_" if name else ""
    for label in _SHIMMER_TIMES:
        if (t_s := seconds(table, table.find(f"{prefix}{label}_cal"), "ms")) is not None:
            return t_s
    column = table.find(f"{prefix}timestamp_raw")
    return None if column is None else table.numbers(column) / 32768  # ticks of the device's clock


def _shimmer_notes(table: DeviceTable, name: str) -> list[str]:
    """Of the two accelerometers the wide-range one is taken, which fast arms do not clip."""
    prefix = f"{plain_label(name)}_" if name else ""
    wide, low = (table.find(f"{prefix}accel_{kind}_x_cal") is not None for kind in ("wr", "ln"))
    if wide and low:
        return ["Of its two accelerometers the wide-range one was taken (the low-noise one clips at 2 g)."]
    return ["Its accelerometer is the low-noise one, which clips at 2 g; record the wide-range one."] * low


_APDM = re.compile(r".+/((acceleration|angular velocity|magnetic field)/[xyz]|orientation/scalar)")


def _is_ximu(table: DeviceTable) -> bool:
    """Whether the columns are x-io's: the words in full, in deg/s or g."""
    sensors = ("gyroscope", "accelerometer")
    columns = (table.find(f"{sensor} x", f"{sensor}_x", f"{sensor}x") for sensor in sensors)
    units = {plain_unit(table.units[at]) for at in columns if at is not None}
    return bool(units & {"deg/s", "g"}) and table.find("timestamp", "time", "packet number") is not None


_NILSPOD_TIMES = ("t", "utc", "utc_datetime", "local_datetime")


def _is_nilspod(table: DeviceTable) -> bool:
    """Whether the columns are NilsPodLib's; `time`, which others write too, counts beside own ones alone."""
    written = {"acc_x", "gyr_x"} & set(table.names)  # lower case in the file, unlike Xsens
    own = table.find("analog_0", "baro") is not None
    times = (*_NILSPOD_TIMES, "n_samples", "sample_counter", *(("time", "") if own else ()))
    return bool(written) and table.find(*times) is not None


# ---------------------------------------------------------------------------- SensorLog (iPhone, Apple Watch)

#: Names of SensorLog, then of Core Motion as other apps write them (`acceleration` may be the user's alone).
_RAW: tuple[str, ...] = ("accelerometeracceleration{}", "acceleration.{}", "acceleration{}")
_USER: tuple[str, ...] = ("motionuseracceleration{}", "useracceleration.{}", "useracceleration{}", *_RAW[1:])
_GRAVITY: tuple[str, ...] = ("motiongravity{}", "gravity.{}", "gravity{}")
_GYRO, _RATE = ("gyrorotation{}",), ("motionrotationrate{}", "rotationrate.{}", "rotationrate{}")
#: Vectors that make an IMU, the preferred ones first: of the raw sensors, of Core Motion, of both.
_LOGGED = (((_RAW,), _GYRO), ((_USER, _GRAVITY), _RATE), ((_RAW,), _RATE), ((_USER, _GRAVITY), _GYRO))


def _read_sensorlog(table: DeviceTable, device: Device) -> list[ImuSamples]:
    """Raw accelerometer and gyroscope, else Core Motion's; the sign of gravity is turned to specific force.

    Source of the sign: Apple, "Getting raw accelerometer events" and `CMDeviceMotion.gravity` (-1 on z, lying
    face up); specific force is the opposite, 1 g upwards.
    """
    there = {
        stem: columns
        for stem in (_RAW, _USER, _GRAVITY, _GYRO, _RATE)
        if (columns := table.axes(*stem)) is not None
        and any(text.lower() not in ("", "null", "nan") for text in table.texts(columns[0]))
    }  # sensors that were off leave theirs empty or null
    forces, turning = next((each for each in _LOGGED if there.keys() >= {*each[0], each[1]}), ((), ()))
    if not forces:
        raise RecordingError(
            f"{table.path} is a {device.title} without both accelerometer and gyroscope; log 'Accelerometer'"
            " and 'Gyroscope', or 'Device Motion' with user acceleration and gravity."
        )
    written = np.sum([table.vectors(there[stem]) for stem in forces], axis=0)
    unit = unit_of("acc", written, table.units[there[forces[0]][0]])[0] or "g"
    # Sensor Logger's 'Standardise Units & Frames' writes Android's units and signs
    is_turned = unit == "m/s^2" and table.find("seconds_elapsed") is not None
    said = "iOS writes gravity, which points down; the signs were turned to specific force."
    notes = [] if is_turned else [said]
    if len(forces) > 1:
        notes.append("Acceleration is the sum of user acceleration and gravity of Core Motion.")
    if turning == _RATE:
        notes.append("Angular velocity is Core Motion's, which removes an estimate of the bias.")
    gyro, gyro_unit = _in_si(table, "gyro", there[turning], "rad/s")
    stamp = f"{'motion' if len(forces) > 1 else 'accelerometer'}timestamp_sincereboot"
    timed = (table.find(stamp), table.find("loggingtime"), time_column(table))
    t_s = next((each for at in timed if (each := seconds(table, at)) is not None), None)
    if t_s is None:
        raise RecordingError(
            f"{table.path} has no times; log them too (loggingTime, timestamp since reboot)."
        )
    acc = written * (ACCELERATION[unit] if is_turned else -ACCELERATION[unit])
    units = f"{unit}, {gyro_unit}"
    return [ImuSamples("", t_s=t_s, acc=acc, gyro=gyro, units=units, notes=[*table.notes, *notes])]


# ----------------------------------------------------------------- tables whose columns identify themselves

#: Columns of a table without header that are looked at: six are MetaBase's, some exporters write more.
_WIDEST = 20
_EPOCH_CELL, _TIME_CELL = re.compile(r"1\d{12}(\.\d*)?"), re.compile(r"\d{4}-\d\d-\d\dT.*")
#: Columns that name the device of a row, without signs.
_DEVICE = ("device", "devicename", "deviceid", "imu", "sensorid", "sensorname", "sensor", "mac", "node")
_KIND = ("sensor", "sensor_type", "sensortype", "sensorname", "sensor_name", "type", "name", "sensor id")
#: Of the app Sensor Logger, whose columns are time, seconds_elapsed, z, y, x on both systems.
_SENSOR_LOGGER = (
    "Assumed Android's signs, gravity up; on an iPhone, Sensor Logger writes the opposite unless"
    " 'Standardise Units & Frames' is on."
)


def _is_metamotion(table: DeviceTable) -> bool:
    """Whether the columns are MetaBase's, or without header its epochs and times."""
    if not table.names:
        marks = zip((_EPOCH_CELL, _TIME_CELL), (0, 1), strict=True)
        return 6 <= table.width <= _WIDEST and all(mark.fullmatch(table.texts(at)[0]) for mark, at in marks)
    elapsed = table.find("elapsed")
    return table.find("epoch", "epoc") is not None and elapsed is not None and table.units[elapsed] == "s"


_PHYPHOX = re.compile(
    r"((lineare? )?(acceleration|beschleunigung|accelerazione)|(accélération|aceleración)( linéaire| lineal)?"
    r"|gyroscope|gyroskop|giroscopio|) ?x"
)


def _is_phyphox(table: DeviceTable) -> bool:
    """Whether the columns are phyphox's, whose units are always in the header."""
    time = table.find("time", "zeit", "zeitstempel", "temps", "tiempo", "tempo", "t")
    labelled = zip(table.labels, table.units, strict=False)
    units = {plain_unit(unit) for label, unit in labelled if _PHYPHOX.fullmatch(label)}
    in_si = bool(units & {"m/s^2", "rad/s"}) and not units & {"g", "deg/s"}
    return in_si and time is not None and plain_unit(table.units[time]) == "s"


def _is_log(table: DeviceTable) -> bool:
    """Whether there is a time and a vector; without header four columns whose times are no dates."""
    if table.names:
        return time_column(table) is not None and bool(sensors_named(table) or bare_vector(table))
    if table.width != 4 or table.times(0)[1]:
        return False
    times = table.numbers(0)[:200]
    return len(times) > 3 and times[0] > 1e6 and time_unit("", times) is not None


def _names_sensors(table: DeviceTable) -> bool:
    """Whether both sensors are found; or one of them, and nothing about it is made up."""
    return {"acc", "gyro"} <= sensors_named(table).keys() or _guess(table).settled


def _guess(table: DeviceTable, usual_gyro: str = "") -> Guess:
    guess = guess_sensor(table, usual_gyro) if table.labels or table.width in (4, 7) else Guess()
    # without names both sensors are known by their motion alone
    by_motion = {"ax", "gx"} <= guess.columns.keys() and NO_GYRO_UNIT not in guess.unsure
    return guess if table.labels or table.width == 4 or by_motion else Guess()


def _read_named(table: DeviceTable, device: Device) -> list[ImuSamples]:
    """One sensor, or the half of one; `import describe` prints the same guess to be edited."""
    if not table.names and _is_metamotion(table):
        table.labels = ("epoch", "", "", "x", "y", "z", *[""] * (table.width - 6))
    kinds = table.find(*_KIND)
    bare = bare_vector(table) if not sensors_named(table) else None
    if kinds is not None and bare is not None and (halves := _by_sensor(table, kinds, bare)):
        return halves
    whole = {name: axes for name, axes in sensors_of(table).items() if {"acc", "gyro"} <= axes.keys()}
    if len(whole) < 2 or "" in whole:
        return _by_device(table, _of_guess(table, device, _guess(table, device.gyro_unit), bare is not None))
    guesses = {name: guess_sensor(table, device.gyro_unit, axes) for name, axes in whole.items()}
    known = {name: guess for name, guess in guesses.items() if guess.settled} or guesses
    return [
        replace(_of_guess(table, device, each), topic=name.replace(" ", "_")) for name, each in known.items()
    ]


def _of_guess(table: DeviceTable, device: Device, guess: Guess, is_bare: bool = False) -> ImuSamples:
    """The sensor, or half of one, of a guess that leaves nothing open."""
    if not guess.settled:
        raise RecordingError(
            f"{table.path} is a {device.title}, of which something is not known:"
            f" {' '.join(guess.unsure) or 'it names no sensor.'} `unocclude import describe {table.path}`"
            " prints a recording.toml to complete."
        )
    keys = ImuKeys.model_validate({**guess.keys, "file": table.path.name})
    imu = imu_by_columns(table, guess.columns, keys)
    imu.assumed, imu.notes = is_bare and imu.acc is None, list(table.notes)
    said = [f"{name} = {column}" for name, column in guess.columns.items()]
    units = [f"{value} ({guess.reasons.get(key, '')})" for key, value in guess.keys.items() if value != "iso"]
    imu.notes.insert(0, f"Its columns were taken as {', '.join(said)}; units: {', '.join(units) or 'none'}.")
    if {"time", "seconds_elapsed"} <= set(table.labels):
        imu.notes.append(_SENSOR_LOGGER)
    used = {str(column) for column in guess.columns.values()}
    if unused := [name for name in table.names if name and name not in used]:
        imu.notes.append(f"{UNUSED} columns {shown(', '.join(unused), 120)}.")
    lacking = len({"ax", "gx"} - guess.columns.keys())  # the last sentences say so
    imu.notes += guess.unsure[: len(guess.unsure) - lacking]
    return imu


def _by_device(table: DeviceTable, imu: ImuSamples) -> list[ImuSamples]:
    """The sensors of a table whose rows name the device that they are of."""
    plain = [re.sub(r"[^a-z]", "", label) for label in table.labels]
    at = next((plain.index(word) for word in _DEVICE if word in plain), None)
    cells = [] if at is None else table.texts(at)
    if "" in cells or not 1 < len(set(cells)) <= 30:  # of a recording
        return [imu]
    own = {name: np.array([cell == name for cell in cells]) for name in dict.fromkeys(cells)}
    return [replace(rows_of(imu, rows), topic=name, notes=list(imu.notes)) for name, rows in own.items()]


def _by_sensor(table: DeviceTable, kinds: int, columns: Columns) -> list[ImuSamples]:
    """The halves of a log whose rows name their sensor; [] where the names are of no use."""
    names, values = [text.lower() for text in table.texts(kinds)], table.vectors(columns)
    t_s, halves = seconds(table, time_column(table)), []
    for kind, part, known in (("acc", "acc", ACCELERATION), ("gyro", "gyr", ANGULAR_VELOCITY)):
        mine = [n for n in dict.fromkeys(names) if part in n and "lin" not in n and "uncal" not in n]
        if not mine:
            continue
        written = max(mine, key=lambda name: "total" in name)  # else acceleration may be the user's alone
        rows = np.array([name == written for name in names])
        unit, _ = unit_of(kind, values[rows], written.rpartition("_")[2])
        if not unit:
            raise RecordingError(
                f"{table.path}: the rows of '{written[:40]}' show no gravity; log the raw accelerometer."
            )
        half = ImuSamples("", t_s=None if t_s is None else t_s[rows], units=unit)
        setattr(half, kind, values[rows] * known[unit])
        half.notes = [*table.notes, f"Rows of '{written[:40]}' were read, in {unit}."]
        halves.append(half)
    return halves


# ---------------------------------------------------------------------------------------------- the formats

#: Of no device; only what no other format knows.
NAMED_IMU = imu_format(
    Device(
        "imu-table",
        "table of an IMU by its columns",
        "columns named after an accelerometer or a gyroscope and x, y, z; or date, x, y, z",
        _names_sensors,
        gyro_unit="",
    )
)
#: Where two recognise a table, the upper one has it.
IMU_FORMATS = tuple(
    imu_format(device)
    for device in (
        Device(  # MTw user manual, table of ASCII exports; `Counter` wraps at 65535
            "xsens-mt",
            "Xsens MT Manager export (MTw, MTi)",
            "Counter or PacketCounter, and lines that begin with // or columns of MT Manager such as"
            " Mat[1][1]",
            _is_mt,
            "without raw sensors; export it again with calibrated data (acceleration and rate of turn:"
            " Acc_X .., Gyr_X ..).",
            times=_mt_times,
            name=("deviceid", "device id"),
            counter=("counter", "packetcounter"),
            counter_wraps=2**16,
            increments=(("velinc_{}",), ("oriinc_{axis}", "oriinc_q{at}")),
        ),
        Device(  # Xsens DOT user manual, sections 4.2 (outputs, `SampleTimeFine` in us)
            "xsens-dot",
            "Xsens DOT export",
            "the columns SampleTimeFine or PacketCounter beside Acc_X, dv[1], Quat_W, Euler_X or FreeAcc_X",
            _is_dot,
            "without raw acceleration and angular velocity (free acceleration is without gravity); record"
            " 'Custom mode 5' or 'Rate quantities', which contain both.",
            gyro_unit="deg/s",
            time=("sampletimefine",),
            time_unit="us",
            name=("devicetag", "device tag"),
            counter=("packetcounter",),
            counter_wraps=2**32,
            increments=(("dv[{}]", "dv_{}"), ("dq_{axis}", "dq[{at}]")),
        ),
        Device(
            "shimmer",
            "Shimmer Consensys export",
            "columns such as Shimmer_952D_Accel_WR_X_CAL and Shimmer_952D_Gyro_X_CAL",
            lambda table: any(map(_SHIMMER.fullmatch, table.labels)),
            "without a calibrated accelerometer and gyroscope; record both sensors and export calibrated data"
            " (the columns end in _CAL).",
            gyro_unit="deg/s",
            times=_shimmer_times,
            notes=_shimmer_notes,
        ),
        Device(
            "apdm",
            "APDM Opal CSV",
            "columns such as Wrist/Acceleration/X and Wrist/Angular Velocity/X",
            lambda table: any(map(_APDM.fullmatch, table.labels)),
            "without both acceleration and angular velocity of a sensor; export the raw data (CSV with"
            " Acceleration and Angular Velocity).",
            time=("time", "time (s)", "timestamp"),
        ),
        Device(
            "x-imu",
            "x-IMU3 or NGIMU CSV",
            "columns such as Timestamp (us) or Time (s), Gyroscope X (deg/s), Accelerometer X (g)",
            _is_ximu,
            "without both gyroscope and accelerometer; export the inertial messages (Inertial.csv,"
            " sensors.csv).",
            acc_unit="g",
            gyro_unit="deg/s",
            time=("timestamp", "time"),
            time_unit="us",
            counter=("packet number",),
        ),
        Device(
            "nilspod",
            "NilsPod CSV",
            "the columns acc_x and gyr_x beside t, utc, baro or analog_0",
            _is_nilspod,
            "without both acc and gyr; export both sensors (factory or Ferraris-calibrated).",
            acc_unit="",  # m/s^2, as NilsPodLib calibrates, or g, as some versions did
            gyro_unit="deg/s",
            time=(*_NILSPOD_TIMES, "time"),
        ),
        Device(
            "metamotion",
            "MetaMotion CSV (accelerometer or gyroscope)",
            "epoch (ms), a time, elapsed (s) and x-axis (g) or x-axis (deg/s); without header, rows of these",
            _is_metamotion,
            gyro_unit="deg/s",
        ),
        Device(
            "sensorlog",
            "Core Motion CSV (iPhone, Apple Watch: SensorLog and others)",
            "columns such as accelerometerAccelerationX(G), motionRotationRateX(rad/s), rotationRate.x",
            lambda table: any(table.axes(*stem) is not None for stem in (_RAW[:1], _USER[:1], _GYRO, _RATE)),
            read=_read_sensorlog,
        ),
        Device(
            "phyphox",
            "phyphox CSV",
            "Time (s) beside Acceleration x (m/s^2), Gyroscope x (rad/s), or X (m/s^2), X (rad/s)",
            _is_phyphox,
            gyro_unit="",
        ),
        Device(
            "android",
            "plain sensor log (Android, Wear OS and the like)",
            "a time (timestamp, time, seconds_elapsed ..) beside acc x, gyro x or plain x, y, z",
            _is_log,
            gyro_unit="",
        ),
    )
)
