"""Plain tables of inertial sensors: a row of `IMU_FORMATS` a device or program.

Tables of devices have the vectors' columns that their row names; of others the columns identify themselves.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from ...array_types import FloatArray, IntArray
from ...errors import RecordingError
from .columns import Guess, ImuKeys, bare_vector, guess_sensor, imu_by_columns, sensors_named
from .imu import (
    UNUSED,
    Columns,
    ImuTable,
    unit_of,
    usual_size,
)
from .table import FileHead, Format, Table, is_data, read_table, shown, split_line
from .times import seconds, time_column
from .units import ACCELERATION, ANGULAR_VELOCITY, plain_unit, time_unit

Fits = Callable[[Table], bool]
#: Whether a file without header is of a format.
Headless = Callable[[FileHead, Table], bool]


@dataclass(frozen=True)
class Device:
    """How a device's table is read: labels are in lower case, of stems see `Table.axes`."""

    key: str  # As in `Format`, up to `recognised_by`
    title: str
    recognised_by: str
    fits: Fits  # Whether a table's columns are of this device
    lacks: str | Callable[[Table, ImuTable], str] = ""  # What a table without both sensors is, and what to do
    acc: tuple[str, ...] = ("acc",)  # Stems of the vectors' columns, the preferred one first
    gyro: tuple[str, ...] = ("gyr",)
    mag: tuple[str, ...] = ("mag",)
    acc_unit: str = "m/s^2"  # Counts where the file states none; "" = as gravity shows
    gyro_unit: str = "rad/s"  # Counts where the file states none, and gravity does not contradict
    settles_unit: bool = False  # The gyroscope's unit, where it is not stated, is the one that gravity shows
    time: tuple[str, ...] = ("time",)  # Labels of the time's column, the preferred one first
    time_unit: str = "s"
    # Finds the times (n,), s, by what names the sensor and the stated rate, where `time` does not do
    times: Callable[[Table, str, float | None], FloatArray | None] | None = None
    no_times: str = ""  # What a table without times and a rate is, and what to do
    name: tuple[str, ...] = ()  # Lines of the preamble that state the sensor's name and rate
    rate: tuple[str, ...] = ()
    counter: tuple[str, ...] = ()  # Labels of a packet counter, which starts anew at `counter_wraps`
    counter_wraps: int = 0
    sensor: re.Pattern[str] | None = None  # Of a table with several sensors: what is before their columns
    notes: Callable[[Table, str], list[str]] | None = None  # Sentences on what was chosen
    # Stem of columns of velocity over a sample and forms of a quaternion's, which stand in for rates
    increments: tuple[str, tuple[str, ...]] | None = None


def _read_device(path: Path, device: Device) -> list[ImuTable]:
    """The sensors of a device's table, in the order of its columns."""
    table = _fitting(path, device.title, device.fits)
    prefixes = [""]
    if device.sensor is not None:
        matches = [device.sensor.fullmatch(label) for label in table.labels]
        prefixes = list(dict.fromkeys(match.group(1) or "" for match in matches if match))
    nothing = ImuTable("", None, None, None)
    found = [imu for prefix in prefixes if (imu := _sensor(table, device, prefix)) is not None]
    if not found:
        raise _refused(table, device, nothing)
    for imu in found:
        imu.notes[:0] = table.notes
    return found


def _fitting(path: Path, title: str, fits: Fits) -> Table:
    table = read_table(path, f"a table of {title}")
    if not fits(table):
        names = shown(", ".join(table.names) or "none", 150)
        raise RecordingError(f"{path} is not of {title}; its columns are {names}.")
    table.refuse_nameless(most=1)  # one more is a counter or a comment of some exporter
    return table


def _refused(table: Table, device: Device, imu: ImuTable) -> RecordingError:
    article = "an" if device.title[0] in "AXx" else "a"
    lacks = device.lacks if isinstance(device.lacks, str) else device.lacks(table, imu)
    return RecordingError(f"{table.path} is {article} {device.title} {lacks}")


def _sensor(table: Table, device: Device, prefix: str) -> ImuTable | None:
    """One sensor; None where it lacks one of the two vectors."""
    acc, gyro, mag = (
        table.axes(*(stem.format(prefix, "{}") for stem in stems))
        for stems in (device.acc, device.gyro, device.mag)
    )
    if (acc is None or gyro is None) and device.increments is None:
        return None
    rate = table.stated_number(*device.rate)
    if device.times is not None:
        t_s = device.times(table, prefix, rate)
    else:
        t_s = seconds(table, table.find(*device.time), device.time_unit)
    if device.no_times and t_s is None and rate is None:
        raise RecordingError(f"{table.path} {device.no_times}")
    imu = ImuTable(
        table.names[acc[0]][: len(prefix) - 1] if prefix and acc else table.stated(*device.name),
        t_s,
        None,
        None,
        rate_hz=rate,
        counter=_counter(table, table.find(*device.counter)),
        counter_wraps=device.counter_wraps,
        notes=[] if device.notes is None else device.notes(table, prefix),
        gyro_unit_assumed=device.settles_unit and gyro is not None and not table.unit(gyro[0]),
    )
    units = []
    for kind, columns, usual in (("acc", acc, device.acc_unit), ("gyro", gyro, device.gyro_unit)):
        if columns is not None:
            values, unit = _in_si(table, kind, columns, usual)
            setattr(imu, kind, values)
            units.append(unit)
            if not usual and unit != "m/s^2" and not table.unit(columns[0]):
                imu.notes.append(f"The accelerometer states no unit; it reads gravity in {unit}.")
    if mag is not None and np.isfinite(field := table.vectors(mag)).all():
        imu.mag = field
    imu.units = ", ".join(units)
    if acc is None or gyro is None:
        _fill_from_increments(table, device, imu)
    return imu


def _in_si(table: Table, kind: str, columns: Columns, usual: str = "") -> tuple[FloatArray, str]:
    """Three columns in SI units (n, 3), and their unit."""
    known = ACCELERATION if kind == "acc" else ANGULAR_VELOCITY
    values, stated = table.vectors(columns), table.unit(columns[0])
    unit, _ = unit_of(kind, values, stated, usual)
    if plain_unit(stated) and plain_unit(stated) not in known:
        raise RecordingError(
            f"{table.path} states the unit '{shown(stated, 40)}' of {shown(table.name(columns[0]), 60)};"
            f" export calibrated values in {next(iter(known))}."
        )
    if not unit:
        raise RecordingError(
            f"{table.path} states no unit of acceleration, and its usual size of"
            f" {usual_size(values):.3g} is neither 9.81 m/s^2 nor 1 g (uncalibrated values?);"
            " export calibrated acceleration with gravity, or describe it in a recording.toml."
        )
    return values * known[unit], unit


def _counter(table: Table, column: int | None) -> IntArray | None:
    """Packet counter of a column, (n,); None where there is none, or some packet has none."""
    if column is None:
        return None
    values = table.numbers(column)
    usable = len(values) and np.isfinite(values).all() and np.abs(values).max() < 2**53
    return np.round(values).astype(np.int64) if usable and (values == np.round(values)).all() else None


def _fill_from_increments(table: Table, device: Device, imu: ImuTable) -> None:
    """Both vectors from velocity (m/s) and rotation over a sample; they must be there."""
    assert device.increments is not None
    stem, forms = device.increments
    velocity = table.axes(stem, signs=("123", "xyz"))
    rotation = [
        at
        for number, axis in enumerate("wxyz")
        if (at := table.find(*(form.format(axis=axis, at=number) for form in forms))) is not None
    ]
    if velocity is None or len(rotation) < 4:
        raise _refused(table, device, imu)
    rate = imu.rate_hz
    if rate is None and imu.t_s is not None:
        steps = np.diff(np.unique(imu.t_s[np.isfinite(imu.t_s)]))
        rate = float(1 / np.median(steps)) if len(steps) else None
    if rate is None:
        raise RecordingError(
            f"{table.path} has increments and no increasing times or rate; export it again with times."
        )
    imu.acc = table.vectors(velocity) * rate
    imu.gyro = _angular_velocity(table.vectors(rotation), rate)
    names = f"{table.names[velocity[0]]} and {table.names[rotation[0]]}"
    imu.units = f"{table.names[velocity[0]]} .. in m/s, {table.names[rotation[0]]} .."
    imu.notes.append(
        f"The increments ({names} ..) were multiplied by the rate of {rate:.4g} Hz to"
        " acceleration and angular velocity."
    )


def _angular_velocity(rotation: FloatArray, rate_hz: float) -> FloatArray:  # (n, 4) -> (n, 3) rad/s
    """Mean angular velocity over each sample, nan where there is none."""
    from scipy.spatial.transform import Rotation

    velocity = np.full((len(rotation), 3), np.nan)
    there = np.isfinite(rotation).all(axis=1) & rotation.any(axis=1)
    velocity[there] = Rotation.from_quat(rotation[there][:, [1, 2, 3, 0]]).as_rotvec() * rate_hz
    return velocity


_RATE_INTO_TOML = "write rate_hz into a recording.toml (`unocclude import describe` prints one)."

# ------------------------------------------------------------------------------ Xsens MTw, MTi (MT Manager)

_MT_ONLY = ("quat_q0", "mat[1][1]", "velinc_x", "oriinc_q0", "oriinc_w", "utc_nano")
#: Ticks of SampleTimeFine, s (Xsens MT low-level protocol: 10 kHz).
_TICK_S = 1e-4


def _is_commented(table: Table) -> bool:
    return any(line.lstrip().startswith("//") for line in table.preamble)


def _is_mt(table: Table) -> bool:
    if table.find("counter", "packetcounter", "sampletimefine") is None:
        return False
    plain = table.find("counter") is not None and table.find("acc_x") is not None
    own = table.find(*_MT_ONLY, "quat_w", "roll", "acc_x") is not None
    return own and (_is_commented(table) or table.find(*_MT_ONLY) is not None or plain)


def _mt_times(table: Table, _: str, rate: float | None) -> FloatArray | None:
    """Where no rate is stated: the UTC columns, else SampleTimeFine, else a column Time."""
    if rate is not None:
        return None
    utc = [
        at for part in ("hour", "minute", "second", "nano") if (at := table.find(f"utc_{part}")) is not None
    ]
    if len(utc) == 4:
        t_s = table.vectors(utc) @ np.array([3600, 60, 1, 1e-9])
        if np.isfinite(t_s).mean() > 0.5:
            return t_s
    column = table.find("sampletimefine")
    if column is None or not np.isfinite(table.numbers(column)).any():
        return seconds(table, table.find("time"))
    ticks = table.numbers(column)
    return ticks * _TICK_S if np.isfinite(ticks).mean() > 0.5 else None


#: Layout: MTw user manual, table of ASCII exports; `Counter` wraps at 65535.
_XSENS_MT = Device(
    key="xsens-mt",
    title="Xsens MT Manager export (MTw, MTi)",
    recognised_by=(
        "Counter or PacketCounter, and lines that begin with // or columns of MT Manager such as Mat[1][1]"
    ),
    fits=_is_mt,
    lacks=(
        "without raw sensors; export it again with calibrated data (acceleration and rate of turn: Acc_X ..,"
        " Gyr_X ..)."
    ),
    times=_mt_times,
    no_times=(
        "is an Xsens MT Manager export (MTw, MTi) that states neither a rate nor times; export it again with"
        f" UTC time, or {_RATE_INTO_TOML}"
    ),
    name=("deviceid", "device id"),
    rate=("update rate", "sample rate", "samplerate", "updaterate"),
    counter=("counter", "packetcounter"),
    counter_wraps=2**16,
    increments=("velinc", ("oriinc_{axis}", "oriinc_q{at}")),
)

# -------------------------------------------------------------------------------------- Xsens (Movella) DOT

_DOT_FUSED = ("quat_w", "euler_x", "freeacc_x")


def _is_dot(table: Table) -> bool:
    """Whether the columns are a DOT's, and not those of MT Manager: `//` above them, or some of its own."""
    if table.find("sampletimefine", "packetcounter") is None or _is_commented(table):
        return False
    own = ("acc_x", "gyr_x", "dv[1]", "dv_x", "iv_x", *_DOT_FUSED)
    return table.find(*_MT_ONLY, "utc_year", "counter") is None and table.find(*own) is not None


def _dot_lacks(table: Table, imu: ImuTable) -> str:
    if imu.acc is not None:
        has = "acceleration but no angular velocity"
    elif imu.gyro is not None:
        has = "angular velocity but no acceleration (free acceleration is without gravity)"
    else:
        fused = table.find(*_DOT_FUSED) is not None
        has = "quaternions and free acceleration only" if fused else "no raw sensors"
    return (
        f"that contains {has}; record 'Custom mode 5' or 'Rate quantities', which contain acceleration and"
        " angular velocity."
    )


#: Layout: Xsens DOT user manual, sections 4.2 (outputs, `SampleTimeFine` in us).
_XSENS_DOT = Device(
    key="xsens-dot",
    title="Xsens DOT export",
    recognised_by=(
        "the columns SampleTimeFine or PacketCounter beside Acc_X, dv[1], Quat_W, Euler_X or FreeAcc_X"
    ),
    fits=_is_dot,
    lacks=_dot_lacks,
    gyro_unit="deg/s",
    time=("sampletimefine",),
    time_unit="us",
    name=("devicetag", "device tag"),
    rate=("outputrate", "output rate"),
    counter=("packetcounter",),
    counter_wraps=2**32,
    increments=("dv", ("dq_{axis}", "dq[{at}]")),
)

# ---------------------------------------------------------------------------------------- Shimmer Consensys

_SHIMMER_COLUMN = re.compile(r"(.*?_)?(accel(?:_ln|_wr)?|gyro|mag)_[xyz]_(cal|raw|uncal)")
#: Preferred first; the synchronised ones are on one clock for all sensors of a session.
_SHIMMER_TIMES = (
    *("timestampsync_unix", "timestamp_unix", "timestampsync_formattedunix", "timestamp_formattedunix"),
    *("timestampsync", "timestamp"),
)


def _shimmer_columns(table: Table) -> list[re.Match[str]]:
    return [match for label in table.labels if (match := _SHIMMER_COLUMN.fullmatch(label))]


def _shimmer_times(table: Table, prefix: str, _: float | None) -> FloatArray | None:
    for name in _SHIMMER_TIMES:
        if (t_s := seconds(table, table.find(f"{prefix}{name}_cal"), "ms")) is not None:
            return t_s
    column = table.find(f"{prefix}timestamp_raw")
    return None if column is None else table.numbers(column) / 32768  # ticks of the device's clock


def _shimmer_notes(table: Table, prefix: str) -> list[str]:
    """Of the two accelerometers the wide-range one is taken, which fast arms do not clip."""
    wide, low = (table.axes(f"{prefix}accel_{kind}_{{}}_cal") is not None for kind in ("wr", "ln"))
    if wide and low:
        return ["Of its two accelerometers the wide-range one was taken (the low-noise one clips at 2 g)."]
    return ["Its accelerometer is the low-noise one, which clips at 2 g; record the wide-range one."] * low


def _shimmer_lacks(table: Table, _: ImuTable) -> str:
    raw = any(match.group(3) != "cal" for match in _shimmer_columns(table))
    what = "uncalibrated values only" if raw else "no gyroscope or no accelerometer"
    return f"that contains {what}; record both sensors and export calibrated data (the columns end in _CAL)."


_SHIMMER = Device(
    key="shimmer",
    title="Shimmer Consensys export",
    recognised_by="columns such as Shimmer_952D_Accel_WR_X_CAL and Shimmer_952D_Gyro_X_CAL",
    fits=lambda table: any(match.group(2) != "mag" for match in _shimmer_columns(table)),
    lacks=_shimmer_lacks,
    sensor=_SHIMMER_COLUMN,
    acc=("{}accel_wr_{}_cal", "{}accel_ln_{}_cal", "{}accel_{}_cal"),
    gyro=("{}gyro_{}_cal",),
    mag=("{}mag_{}_cal",),
    gyro_unit="deg/s",
    times=_shimmer_times,
    notes=_shimmer_notes,
)

# ----------------------------------------------------------------------- APDM Opal, x-IMU3 and NGIMU, NilsPod

_APDM_COLUMN = re.compile(r"(.+/)(acceleration|angular velocity|magnetic field|orientation)/(x|y|z|scalar)")
_APDM = Device(
    key="apdm",
    title="APDM Opal CSV",
    recognised_by="columns such as Wrist/Acceleration/X and Wrist/Angular Velocity/X",
    fits=lambda table: any(_APDM_COLUMN.fullmatch(label) for label in table.labels),
    lacks=(
        "without both acceleration and angular velocity of a sensor; export the raw data (CSV with"
        " Acceleration and Angular Velocity)."
    ),
    sensor=_APDM_COLUMN,
    acc=("{}acceleration/{}",),
    gyro=("{}angular velocity/{}",),
    mag=("{}magnetic field/{}",),
    time=("time", "time (s)", "timestamp"),
    rate=("sample rate",),
)


def _is_ximu(table: Table) -> bool:
    """Whether the columns are x-io's: the words in full, in deg/s or g."""
    columns = [table.axes("gyroscope"), table.axes("accelerometer")]
    units = {plain_unit(table.units[c[0]]) for c in columns if c is not None}
    return bool(units & {"deg/s", "g"}) and table.find("timestamp", "time", "packet number") is not None


_XIMU = Device(
    key="x-imu",
    title="x-IMU3 or NGIMU CSV",
    recognised_by="columns such as Timestamp (us) or Time (s), Gyroscope X (deg/s), Accelerometer X (g)",
    fits=_is_ximu,
    lacks=(
        "without both gyroscope and accelerometer; export the inertial messages (Inertial.csv, sensors.csv)."
    ),
    acc=("accelerometer",),
    gyro=("gyroscope",),
    mag=("magnetometer",),
    acc_unit="g",
    gyro_unit="deg/s",
    time=("timestamp", "time"),
    time_unit="us",
    no_times=f"has a packet number and no times; {_RATE_INTO_TOML}",
    counter=("packet number",),
)
_NILSPOD_TIMES = ("t", "utc", "utc_datetime", "local_datetime")


def _is_nilspod(table: Table) -> bool:
    """Whether the columns are NilsPodLib's; `time`, which others write too, counts beside own ones alone."""
    written = {"acc_x", "gyr_x"} & set(table.names)  # lower case in the file, unlike Xsens
    own = table.find("analog_0", "baro") is not None
    times = (*_NILSPOD_TIMES, "n_samples", "sample_counter", *(("time", "") if own else ()))
    return bool(written) and table.find(*times) is not None


_NILSPOD = Device(
    key="nilspod",
    title="NilsPod CSV",
    recognised_by="the columns acc_x and gyr_x beside t, utc, baro or analog_0",
    fits=_is_nilspod,
    lacks="without both acc and gyr; export both sensors (factory or Ferraris-calibrated).",
    acc_unit="",  # m/s^2, as NilsPodLib calibrates, or g, as some versions did
    gyro_unit="deg/s",
    time=(*_NILSPOD_TIMES, "time"),
    no_times=(
        f"counts samples and states no rate; export it with the index 'time' or 'utc', or {_RATE_INTO_TOML}"
    ),
    rate=("sampling rate", "sampling_rate_hz"),
    settles_unit=True,
)

# ---------------------------------------------------------------------------- SensorLog (iPhone, Apple Watch)

_LOGGED = {
    "raw": "accelerometeracceleration",
    "user": "motionuseracceleration",
    "gravity": "motiongravity",
    "gyro": "gyrorotation",
    "rate": "motionrotationrate",
}
_LOGGED_TIMES = ("loggingtime", "timestamp", "time", "locationtimestamp_since1970")


def _is_sensorlog(table: Table) -> bool:
    return any(table.axes(_LOGGED[name]) is not None for name in ("raw", "user", "gyro", "rate"))


def _read_sensorlog(path: Path, title: str) -> list[ImuTable]:
    """Raw accelerometer and gyroscope, else Core Motion's; the sign of gravity is turned to specific force.

    Source of the sign: Apple, "Getting raw accelerometer events" and `CMDeviceMotion.gravity` (-1 on z, lying
    face up); specific force is the opposite, 1 g upwards.
    """
    table = _fitting(path, title, _is_sensorlog)
    there = {
        name: columns
        for name, stem in _LOGGED.items()
        if (columns := table.axes(stem)) is not None
        and any(text.lower() not in ("", "null", "nan") for text in table.texts(columns[0]))
    }  # sensors that were off leave theirs empty or null
    summed = {"user", "gravity"} <= there.keys()
    if not ("raw" in there or summed) or not {"gyro", "rate"} & there.keys():
        raise RecordingError(
            f"{path} is a {title} without both accelerometer and gyroscope; log 'Accelerometer' and"
            " 'Gyroscope', or 'Device Motion' with user acceleration and gravity."
        )
    notes = ["iOS writes gravity, which points down; the signs were turned to specific force."]
    own_gyro = "gyro" in there and ("raw" in there or "rate" not in there)
    own_acc = "raw" in there and (own_gyro or not summed)
    names = ("raw",) if own_acc else ("user", "gravity")
    parts = [_in_si(table, "acc", there[name], "g") for name in names]
    if not own_acc:
        notes.append("Acceleration is the sum of user acceleration and gravity of Core Motion.")
    if not own_gyro:
        notes.append("Angular velocity is Core Motion's, which removes an estimate of the bias.")
    gyro, gyro_unit = _in_si(table, "gyro", there["gyro" if own_gyro else "rate"], "rad/s")
    stamp = "accelerometertimestamp_sincereboot" if own_acc else "motiontimestamp_sincereboot"
    times = (seconds(table, table.find(label)) for label in (stamp, *_LOGGED_TIMES))
    t_s = next((each for each in times if each is not None), None)
    if t_s is None:
        raise RecordingError(f"{path} has no times; log them too (loggingTime, timestamp since reboot).")
    imu = ImuTable(
        "", t_s, -np.sum([values for values, _ in parts], axis=0), gyro, units=f"{parts[0][1]}, {gyro_unit}"
    )
    imu.notes = [*table.notes, *notes]
    return [imu]


# ----------------------------------------------------------------- tables whose columns identify themselves

_EPOCHS = ("epoch", "epoc")
_EPOCH_CELL = re.compile(r"1\d{12}(\.\d*)?")
_TIME_CELL = re.compile(r"\d{4}-\d\d-\d\dT.*")
_KIND = ("sensor", "sensor_type", "sensortype", "sensorname", "sensor_name", "type", "name", "sensor id")
#: Of the app Sensor Logger, whose columns are time, seconds_elapsed, z, y, x on both systems.
_SENSOR_LOGGER = (
    "Assumed Android's signs, gravity up; on an iPhone, Sensor Logger writes the opposite unless"
    " 'Standardise Units & Frames' is on."
)


def _is_metamotion(table: Table) -> bool:
    """Whether the columns are MetaBase's; a table without header has six of them."""
    if not table.names:
        return table.width >= 6
    elapsed = table.find("elapsed")
    return table.find(*_EPOCHS) is not None and elapsed is not None and table.units[elapsed] == "s"


def _is_headless_metamotion(head: FileHead, table: Table) -> bool:
    cells = split_line(head.lines[table.first_row], table.separator)
    return table.width >= 6 and bool(_EPOCH_CELL.fullmatch(cells[0]) and _TIME_CELL.fullmatch(cells[1]))


_PHYPHOX = (
    *("acceleration", "beschleunigung", "accélération", "aceleración", "accelerazione", "gyroscope"),
    *("gyroskop", "giroscopio", "linear acceleration", "lineare beschleunigung"),
    *("accélération linéaire", "aceleración lineal"),
)


def _is_phyphox(table: Table) -> bool:
    """Whether the columns are phyphox's, whose units are always in the header."""
    time = table.find("time", "zeit", "zeitstempel", "temps", "tiempo", "tempo", "t")
    if time is None or plain_unit(table.units[time]) != "s":
        return False
    vectors = (table.axes(*_PHYPHOX), table.axes(""))
    units = {plain_unit(table.units[c[0]]) for c in vectors if c is not None}
    return bool(units & {"m/s^2", "rad/s"}) and not units & {"g", "deg/s"}


def _is_log(table: Table) -> bool:
    """Whether there is a time and a vector; four columns without header are a time and a vector."""
    if not table.names:
        return table.width == 4
    return time_column(table) is not None and bool(sensors_named(table) or bare_vector(table))


def _is_headless_log(head: FileHead, table: Table) -> bool:
    """Whether four columns are a time and a vector."""
    rows = [split_line(line, table.separator) for line in head.lines[table.first_row :][:200]]
    rows = [row for row in rows if len(row) == table.width and all(map(is_data, row))]
    try:
        times = np.array([float(row[0].replace(",", ".")) for row in rows])
    except ValueError:
        return False
    return table.width == 4 and len(times) > 3 and times[0] > 1e6 and time_unit("", times) is not None


def _names_sensors(table: Table) -> bool:
    """Whether both sensors are found; or one of them, and nothing about it is made up."""
    try:
        return {"acc", "gyro"} <= sensors_named(table).keys() or _guess(table).settled
    except RecordingError:
        return False


def _guess(table: Table, usual_gyro: str = "") -> Guess:
    return guess_sensor(table, usual_gyro) if table.labels or table.width == 4 else Guess()


def read_named(path: Path, title: str, fits: Fits, usual_gyro: str = "") -> list[ImuTable]:
    """One sensor, or the half of one; `import describe` prints the same guess to be edited."""
    table = _fitting(path, title, fits)
    if not table.names and table.width >= 6:  # MetaMotion's
        table.labels = ("epoch", "", "", "x", "y", "z", *[""] * (table.width - 6))
    kinds = table.find(*_KIND)
    bare = bare_vector(table) if not sensors_named(table) else None
    if kinds is not None and bare is not None and (halves := _by_sensor(table, kinds, bare)):
        return halves
    guess = _guess(table, usual_gyro)
    if not guess.settled:
        raise RecordingError(
            f"{path} is a {title}, of which something is not known:"
            f" {' '.join(guess.unsure) or 'it names no sensor.'} `unocclude import describe {path}` prints a"
            " recording.toml to complete."
        )
    imu = imu_by_columns(table, guess.columns, ImuKeys.model_validate({**guess.keys, "file": path.name}))
    said = [f"{name} = {column}" for name, column in guess.columns.items()]
    units = [f"{value} ({guess.reasons.get(key, '')})" for key, value in guess.keys.items() if value != "iso"]
    imu.notes.insert(0, f"Its columns were taken as {', '.join(said)}; units: {', '.join(units) or 'none'}.")
    if {"time", "seconds_elapsed"} <= set(table.labels):
        imu.notes.append(_SENSOR_LOGGER)
    used = {str(column) for column in guess.columns.values()}
    if unused := [name for name in table.names if name and name not in used]:
        imu.notes.append(f"{UNUSED} columns {shown(', '.join(unused), 120)}.")
    imu.notes += [each for each in guess.unsure if "There is no" not in each]
    imu.gyro_unit_assumed = any("gyroscope's unit is guessed" in each for each in guess.unsure)
    return [imu]


def _by_sensor(table: Table, kinds: int, columns: Columns) -> list[ImuTable]:
    """The halves of a log whose rows name their sensor; [] where the names are of no use."""
    names, values, halves = (
        np.array([text.lower() for text in table.texts(kinds)]),
        table.vectors(columns),
        [],
    )
    t_s = seconds(table, time_column(table))
    for kind, part in (("acc", "acc"), ("gyro", "gyr")):
        rows = np.array([part in name and "lin" not in name and "uncal" not in name for name in names], bool)
        if not rows.any():
            continue
        written, known = names[rows][0], ACCELERATION if kind == "acc" else ANGULAR_VELOCITY
        unit, _ = unit_of(kind, values[rows], written.rpartition("_")[2])
        if not unit:
            raise RecordingError(
                f"{table.path}: the rows of '{written[:40]}' show no gravity; log the raw accelerometer."
            )
        half = ImuTable("", None if t_s is None else t_s[rows], None, None, units=unit)
        setattr(half, kind, values[rows] * known[unit])
        half.notes = [*table.notes, f"Rows of '{written[:40]}' were read, in {unit}."]
        halves.append(half)
    return halves


# ---------------------------------------------------------------------------------------------- the formats


def imu_format(device: Device) -> Format:
    """The format of a device's table."""
    recognises = partial(_recognises, fits=device.fits)
    read = partial(_read_device, device=device)
    return Format(device.key, device.title, "imu", device.recognised_by, recognises, read)


def _recognises(head: FileHead, fits: Fits, headless: Headless | None = None) -> bool:
    table = head.table
    if table is None:
        return False
    return headless(head, table) if headless is not None and not table.names else fits(table)


def _named(
    key: str,
    title: str,
    recognised_by: str,
    fits: Fits,
    headless: Headless | None = None,
    usual_gyro: str = "",
) -> Format:
    read = partial(read_named, title=title, fits=fits, usual_gyro=usual_gyro)
    recognises = partial(_recognises, fits=fits, headless=headless)
    return Format(key, title, "imu", recognised_by, recognises, read)


_SENSORLOG_TITLE = "SensorLog CSV (iPhone, Apple Watch)"
#: Of no device; only what no other format knows.
NAMED_IMU = _named(
    "imu-table",
    "table of an IMU by its columns",
    "columns named after an accelerometer or a gyroscope and x, y, z; or date, x, y, z",
    _names_sensors,
)
#: Where two recognise a table, the upper one has it.
IMU_FORMATS = (
    *map(imu_format, (_XSENS_MT, _XSENS_DOT, _SHIMMER, _APDM, _XIMU, _NILSPOD)),
    _named(
        "metamotion",
        "MetaMotion CSV (accelerometer or gyroscope)",
        "epoch (ms), a time, elapsed (s) and x-axis (g) or x-axis (deg/s); without header, rows of these",
        _is_metamotion,
        _is_headless_metamotion,
        "deg/s",
    ),
    Format(
        "sensorlog",
        _SENSORLOG_TITLE,
        "imu",
        "columns such as accelerometerAccelerationX(G), gyroRotationX(rad/s), motionRotationRateX(rad/s)",
        partial(_recognises, fits=_is_sensorlog),
        partial(_read_sensorlog, title=_SENSORLOG_TITLE),
    ),
    _named(
        "phyphox",
        "phyphox CSV",
        "Time (s) beside Acceleration x (m/s^2), Gyroscope x (rad/s), or X (m/s^2), X (rad/s)",
        _is_phyphox,
    ),
    _named(
        "android",
        "plain sensor log (Android, Wear OS and the like)",
        "a time (timestamp, time, seconds_elapsed ..) beside acc x, gyro x or plain x, y, z",
        _is_log,
        _is_headless_log,
    ),
)
