"""Plain tables of inertial sensors: a row of `IMU_FORMATS` a device, all read by `ImuFormat`."""

from __future__ import annotations

import re

import numpy as np

from ...array_types import FloatArray
from .imu import ImuTable
from .imu_columns import Columns, ImuFormat, Increments, seconds
from .table import Table
from .units import plain_unit

_RATE_INTO_TOML = "write rate_hz into a recording.toml (`unocclude import describe` prints one)."

# ------------------------------------------------------------------------------ Xsens MTw, MTi (MT Manager)

_MT_OWN = ("quat_q0", "quat_w", "mat[1][1]", "roll", "velinc_x", "oriinc_q0", "oriinc_w", "acc_x", "utc_nano")
#: Ticks of SampleTimeFine, s (Xsens MT low-level protocol: 10 kHz).
_TICK_S = 1e-4


def _is_mt(layout: Table) -> bool:
    counted = layout.find("counter", "packetcounter", "sampletimefine")
    commented = any(line.lstrip().startswith("//") for line in layout.preamble)
    only_here = layout.find(*(name for name in _MT_OWN if name not in ("quat_w", "roll", "acc_x")))
    plain = layout.find("counter") is not None and layout.find("acc_x") is not None
    own = layout.find(*_MT_OWN) is not None
    return counted is not None and own and (commented or only_here is not None or plain)


def _mt_times(sheet: Table, _: str, rate: float | None) -> FloatArray | None:
    """Where no rate is stated: the UTC columns, else SampleTimeFine, else a column Time."""
    if rate is not None:
        return None
    utc = [sheet.find(f"utc_{part}") for part in ("hour", "minute", "second", "nano")]
    if None not in utc:
        hour, minute, second, nano = (sheet.numbers(column) for column in utc if column is not None)
        t_s = 3600 * hour + 60 * minute + second + 1e-9 * nano
        if np.isfinite(t_s).mean() > 0.5:
            return t_s
    column = sheet.find("sampletimefine")
    if column is None or not np.isfinite(sheet.numbers(column)).any():
        return seconds(sheet, sheet.find("time"))
    ticks = sheet.numbers(column)
    return ticks * _TICK_S if np.isfinite(ticks).mean() > 0.5 else None


#: Layout: MTw user manual, table of ASCII exports; `Counter` wraps at 65535.
_XSENS_MT = ImuFormat(
    key="xsens-mt",
    title="Xsens MT Manager export (MTw, MTi)",
    recognised_by=(
        "Counter or PacketCounter, and lines that begin with // or columns of MT Manager such as Mat[1][1]"
    ),
    fits=_is_mt,
    times=_mt_times,
    no_times=(
        "is an {title} that states neither a rate nor times; export it again with UTC time, or "
        + _RATE_INTO_TOML
    ),
    name=("deviceid", "device id"),
    rate=("update rate", "sample rate", "samplerate", "updaterate"),
    counter=("counter", "packetcounter"),
    counter_wraps=2**16,
    increments=Increments(
        names="VelInc and OriInc",
        velocity="velinc",
        rotation=("oriinc_{axis}", "oriinc_q{at}"),
        units="VelInc in m/s, OriInc",
        lacks=lambda layout, table: (
            "without raw sensors; export it again with calibrated data (acceleration and rate of turn:"
            " Acc_X .., Gyr_X ..)."
        ),
        no_rate="has no increasing times; export it again.",
    ),
)

# -------------------------------------------------------------------------------------- Xsens (Movella) DOT

_DOT_FUSED = ("quat_w", "euler_x", "freeacc_x")


def _is_dot(layout: Table) -> bool:
    """Whether the columns are a DOT's, and not those of MT Manager: `//` above them, or some of its own."""
    if layout.find("sampletimefine", "packetcounter") is None:
        return False
    others = ("quat_q0", "mat[1][1]", "utc_nano", "utc_year", "velinc_x", "oriinc_q0", "oriinc_w", "counter")
    if any(line.lstrip().startswith("//") for line in layout.preamble) or layout.find(*others) is not None:
        return False
    return layout.find("acc_x", "gyr_x", "dv[1]", "dv_x", "iv_x", *_DOT_FUSED) is not None


def _dot_lacks(layout: Table, table: ImuTable) -> str:
    if table.acc is not None:
        has = "acceleration but no angular velocity"
    elif table.gyro is not None:
        has = "angular velocity but no acceleration (free acceleration is without gravity)"
    else:
        fused = layout.find(*_DOT_FUSED) is not None
        has = "quaternions and free acceleration only" if fused else "no raw sensors"
    return (
        f"that contains {has}; record 'Custom mode 5' or 'Rate quantities', which contain acceleration and"
        " angular velocity."
    )


#: Layout: Xsens DOT user manual, sections 4.2 (outputs, `SampleTimeFine` in us).
_XSENS_DOT = ImuFormat(
    key="xsens-dot",
    title="Xsens DOT export",
    recognised_by=(
        "the columns SampleTimeFine or PacketCounter beside Acc_X, dv[1], Quat_W, Euler_X or FreeAcc_X"
    ),
    fits=_is_dot,
    gyro_unit="deg/s",
    time=("sampletimefine",),
    time_unit="us",
    name=("devicetag", "device tag"),
    rate=("outputrate", "output rate"),
    counter=("packetcounter",),
    counter_wraps=2**32,
    increments=Increments(
        names="The increments dv and dq",
        velocity="dv",
        signs=("123", "xyz"),
        rotation=("dq_{axis}", "dq[{at}]"),
        units="dv in m/s, dq",
        lacks=_dot_lacks,
        no_rate=(
            "has increments but neither SampleTimeFine nor OutputRate; export it again with SampleTimeFine."
        ),
    ),
)

# ---------------------------------------------------------------------------------------- Shimmer Consensys

_SHIMMER_COLUMN = re.compile(r"(.*?_)?(accel(?:_ln|_wr)?|gyro|mag)_[xyz]_(cal|raw|uncal)")
#: Preferred first; the synchronised ones are on one clock for all sensors of a session.
_SHIMMER_TIMES = (
    *("timestampsync_unix", "timestamp_unix", "timestampsync_formattedunix", "timestamp_formattedunix"),
    *("timestampsync", "timestamp"),
)


def _is_shimmer(layout: Table) -> bool:
    matches = [_SHIMMER_COLUMN.fullmatch(label) for label in layout.labels]
    return any(match and match.group(2) != "mag" for match in matches)


def _shimmer_times(sheet: Table, prefix: str, _: float | None) -> FloatArray | None:
    for name in _SHIMMER_TIMES:
        t_s = seconds(sheet, sheet.find(f"{prefix}{name}_cal"), "ms")
        if t_s is not None:
            return t_s
    column = sheet.find(f"{prefix}timestamp_raw")
    return None if column is None else sheet.numbers(column) / 32768  # ticks of the device's clock


def _shimmer_notes(layout: Table, prefix: str) -> list[str]:
    """Of the two accelerometers the wide-range one is taken, which fast arms do not clip."""
    wide, low = (
        all(f"{prefix}accel_{kind}_{axis}_cal" in layout.labels for axis in "xyz") for kind in ("wr", "ln")
    )
    if wide and low:
        return ["Of its two accelerometers the wide-range one was taken (the low-noise one clips at 2 g)."]
    if low:
        return ["Its accelerometer is the low-noise one, which clips at 2 g; record the wide-range one."]
    return []


def _shimmer_lacks(layout: Table) -> str:
    matches = [_SHIMMER_COLUMN.fullmatch(label) for label in layout.labels]
    raw = any(match and match.group(3) != "cal" for match in matches)
    what = "uncalibrated values only" if raw else "no gyroscope or no accelerometer"
    return f"that contains {what}; record both sensors and export calibrated data (the columns end in _CAL)."


_SHIMMER = ImuFormat(
    key="shimmer",
    title="Shimmer Consensys export",
    recognised_by="columns such as Shimmer_952D_Accel_WR_X_CAL and Shimmer_952D_Gyro_X_CAL",
    fits=_is_shimmer,
    lacks=_shimmer_lacks,
    sensor=_SHIMMER_COLUMN,
    acc=("{}accel_wr", "{}accel_ln", "{}accel"),
    gyro=("{}gyro",),
    mag=("{}mag",),
    axes="_{}_cal",
    gyro_unit="deg/s",
    times=_shimmer_times,
    notes=_shimmer_notes,
)

# ------------------------------------------------------------------------------------------------ APDM Opal

_APDM_COLUMN = re.compile(r"(.+/)(acceleration|angular velocity|magnetic field|orientation)/(x|y|z|scalar)")
_APDM = ImuFormat(
    key="apdm",
    title="APDM Opal CSV",
    recognised_by="columns such as Wrist/Acceleration/X and Wrist/Angular Velocity/X",
    fits=lambda layout: any(_APDM_COLUMN.fullmatch(label) for label in layout.labels),
    lacks=(
        "without both acceleration and angular velocity of a sensor; export the raw data (CSV with"
        " Acceleration and Angular Velocity)."
    ),
    sensor=_APDM_COLUMN,
    acc=("{}acceleration",),
    gyro=("{}angular velocity",),
    mag=("{}magnetic field",),
    time=("time", "time (s)", "timestamp"),
    rate=("sample rate",),
)

# ------------------------------------------------------------------------------------- x-IMU3, NGIMU, x-IMU


def _is_ximu(layout: Table) -> bool:
    """Whether the columns are x-io's: the words in full, in deg/s or g."""
    columns = [layout.axes("gyroscope"), layout.axes("accelerometer")]
    units = {plain_unit(layout.units[c[0]]) for c in columns if c is not None}
    return bool(units & {"deg/s", "g"}) and layout.find("timestamp", "time", "packet number") is not None


_XIMU = ImuFormat(
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
    no_times="has a packet number and no times; " + _RATE_INTO_TOML,
    counter=("packet number",),
)

# ------------------------------------------------------------------------------------- NilsPod (NilsPodLib)

_NILSPOD_TIMES = ("t", "utc", "utc_datetime", "local_datetime")
#: A raw sample of 16 bits reads in the hundreds or thousands; an accelerometer's usual size in g.
_RAW, _ONE_G = 150.0, (0.85, 1.15)


def _is_nilspod(layout: Table) -> bool:
    """Whether the columns are NilsPodLib's; `time`, which others write too, counts beside own ones alone."""
    written = {"acc_x", "gyr_x"} & set(layout.names)  # lower case in the file, unlike Xsens
    own = layout.find("analog_0", "baro") is not None
    times = (*_NILSPOD_TIMES, "n_samples", "sample_counter", *(("time", "") if own else ()))
    return bool(written) and layout.find(*times) is not None


def _nilspod_unit(form: ImuFormat, sheet: Table, columns: Columns | None, notes: list[str]) -> str:
    """m/s^2, as NilsPodLib calibrates, or g, as some versions did."""
    assert columns is not None
    size = np.linalg.norm(sheet.vectors(columns), axis=1)
    median = float(np.nanmedian(size)) if np.isfinite(size).any() else 0.0
    if median > _RAW:
        raise form.refused(
            sheet,
            "of uncalibrated values; export calibrated data (dataset.calibrate_imu() before to_csv).",
        )
    if not sheet.unit(columns[0]) and _ONE_G[0] < median < _ONE_G[1]:
        notes.append("The accelerometer states no unit; gravity is 1, so it is in g.")
        return "g"
    return "m/s^2"


_NILSPOD = ImuFormat(
    key="nilspod",
    title="NilsPod CSV",
    recognised_by="the columns acc_x and gyr_x beside t, utc, baro or analog_0",
    fits=_is_nilspod,
    lacks="without both acc and gyr; export both sensors (factory or Ferraris-calibrated).",
    acc_unit=_nilspod_unit,
    gyro_unit="deg/s",
    time=(*_NILSPOD_TIMES, "time"),
    no_times=(
        "counts samples and states no rate; export it with the index 'time' or 'utc', or " + _RATE_INTO_TOML
    ),
    rate=("sampling rate", "sampling_rate_hz"),
    settles_unit=True,
)

#: Where two recognise a table, the upper one has it.
IMU_FORMATS = (_XSENS_MT, _XSENS_DOT, _SHIMMER, _APDM, _XIMU, _NILSPOD)
