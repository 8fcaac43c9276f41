"""Files that are not text: HDF5 of APDM, CWA of Axivity, Xsens' MVNX, recordings of messages and of LSL."""

from __future__ import annotations

import logging
import re
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from xml.etree.ElementTree import iterparse

import numpy as np
from numpy.typing import NDArray

from ...array_types import FloatArray
from ...errors import RecordingError
from ...recording import JOINTS, CameraFrame
from ...runtime.inputs import crashes_in_subprocess
from ...runtime.packages import extra_module
from ...units import STANDARD_GRAVITY
from ..mcap.messages import seconds
from ..recording.clean import LEFT_OUT
from ..recording.read import open_recording
from ..recording.streams import ArmFrames, ImuSamples, SkeletonTable
from .imu import (
    Columns,
    channel_labels,
    find_sensors,
    holds_gravity,
    stem_of,
    unit_of,
    with_halves_joined,
)
from .joints import find_joint_columns, has_arm, program_of
from .skeletons import Conventions, RawSkeleton
from .table import Format, begins, read_bytes, shown
from .units import ACCELERATION, ANGULAR_VELOCITY, METRES, plain_unit


def _read_apdm_hdf(path: Path) -> list[ImuSamples]:
    """Each sensor one IMU: m/s^2, rad/s, time in us since 1970."""
    h5py = extra_module("h5py", "h5py", "apdm")

    def read(file: Path) -> list[ImuSamples]:
        with h5py.File(file, "r") as opened:
            return _sensors(opened)

    if crashes_in_subprocess(path, read):  # of damaged lengths HDF5 takes all memory
        raise RecordingError(f"{path} is a damaged HDF5 file; export it again.")
    tables = read(path)
    if not tables:
        raise RecordingError(
            f"{path} has no raw sensors of an Opal; export 'raw data' as HDF5, or CSV, from the APDM program."
        )
    return tables


APDM_HDF = Format(
    "apdm-hdf5",
    "APDM Opal HDF5",
    "imu",
    "HDF5 with Sensors/<id>/Accelerometer or <id>/Calibrated/Accelerometers",
    begins(b"\x89HDF\r\n\x1a\n"),
    _read_apdm_hdf,
)


def _sensors(file: Any) -> list[ImuSamples]:
    if "Sensors" in file:
        groups = [(name, group, group) for name, group in file["Sensors"].items()]
    else:
        groups = [
            (name, group["Calibrated"], group) for name, group in file.items() if _has(group, "Calibrated")
        ]
    # what the wearer's places are called ("Right Wrist"): by monitor in older versions
    listed = (np.ravel(file.attrs.get(key, [])) for key in ("CaseIdList", "MonitorLabelList"))
    labels = {_text(monitor): _text(label) for monitor, label in zip(*listed, strict=False)}
    tables = []
    for name, values, group in groups:
        acc, gyro, mag = (_vector(values, kind) for kind in ("Accelerometer", "Gyroscope", "Magnetometer"))
        if acc is None or gyro is None:
            continue
        time = np.asarray(group["Time"], dtype=float).ravel() if _has(group, "Time") else None
        count = min(len(values) for values in (acc, gyro, time) if values is not None)
        rate = group.attrs.get("SampleRate", file.attrs.get("SampleRate"))
        configured = group["Configuration"].attrs if _has(group, "Configuration") else {}
        label = _text(configured.get("Label 0", "") if configured else group.attrs.get("MonitorLabel", ""))
        tables.append(
            ImuSamples(
                label or labels.get(name, "") or name,
                t_s=None if time is None else time[:count] * 1e-6,
                acc=acc[:count],
                gyro=gyro[:count],
                mag=None if mag is None or len(mag) < count else mag[:count],
                rate_hz=None if rate is None else float(np.ravel(rate)[0]),
                units="m/s^2, rad/s",
            )
        )
    return tables


def _has(group: Any, key: str) -> bool:
    return hasattr(group, "keys") and key in group


def _vector(group: Any, kind: str) -> FloatArray | None:
    """A sensor's samples (N, 3), whether its name has a plural s or not."""
    key = next((key for key in (kind, f"{kind}s") if _has(group, key)), None)
    if key is None:
        return None
    values = np.asarray(group[key], dtype=float)
    values = values.T if values.ndim == 2 and values.shape[0] == 3 != values.shape[1] else values
    return values if values.ndim == 2 and values.shape[1] == 3 else None


def _text(value: Any) -> str:
    return (value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)).strip("\0 ")


#: A data block: 512 bytes, little-endian (Open Movement, "AX3/AX6 technical documentation", CWA data blocks).
_FIELDS = (
    "S2 mark, <u2 length, <u2 fraction, <u4 session, <u4 sequence, <u4 time, <u2 light, <u2 temperature,"
    " u1 events, u1 battery, u1 rate, u1 axes, <i2 offset, <u2 count, 240<i2 data, <u2 checksum"
)
_BLOCK = np.dtype([(name, kind) for kind, name in map(str.split, _FIELDS.split(","))])
#: Gyroscope's range where the block states none, deg/s.
_USUAL_RANGE = 2000.0


def _read_axivity(path: Path) -> list[ImuSamples]:
    """Gyroscope in deg/s and accelerometer in g, 16 bits, in blocks with a time stamp each."""
    raw = read_bytes(path)
    blocks = np.frombuffer(raw, _BLOCK, count=len(raw) // _BLOCK.itemsize)
    data = blocks[(blocks["mark"] == b"AX") & (blocks["length"] == 508)]
    whole = (
        (data["axes"] & 15 == 2) & (data["axes"] >> 4 == 6) & (data["count"] * 6 <= 240) & (data["count"] > 0)
    )
    words = np.ascontiguousarray(data).view("<u2").reshape(len(data), 256)
    usable = data[
        whole & (words.sum(axis=1, dtype=np.uint64).astype(np.uint16) == 0)
    ]  # the checksum is right
    if not len(usable):
        axes = int(data["axes"][0] >> 4) if len(data) else 0
        what = f"has {axes} axes, no gyroscope" if axes == 3 else "has no intact blocks of samples"
        raise RecordingError(
            f"{path} is an {AXIVITY.title} that {what}; set up an AX6 with its gyroscope on."
        )
    cut = len(raw) % _BLOCK.itemsize != 0
    return [_samples(usable, len(data) - len(usable), cut)]


AXIVITY = Format(
    "axivity",
    "Axivity AX6 (CWA)",
    "imu",
    "a binary header that begins with MD, and blocks that begin with AX",
    begins(b"MD\xfc\x03", b"AX\xfc\x01"),
    _read_axivity,
)


def _samples(blocks: NDArray[np.void], left_out: int, cut: bool) -> ImuSamples:
    """Samples of intact blocks with six axes."""
    # A sample is in the rows of its block that are filled.
    filled = np.arange(40) < blocks["count"][:, None]
    values = blocks["data"].reshape(-1, 40, 6).astype(float)
    light = blocks["light"].astype(int)
    per_g = (1 << (8 + (light >> 13))).astype(float)
    code = (light >> 10) & 7
    full_scale = np.where(code > 0, 8000.0 / (1 << code), _USUAL_RANGE)
    gyro = values[:, :, :3] * (full_scale / 32768 * np.pi / 180)[:, None, None]
    acc = values[:, :, 3:] * (STANDARD_GRAVITY / per_g)[:, None, None]
    rate = 3200.0 / (1 << (15 - (blocks["rate"] & 15).astype(int)))
    t_s = _starts(blocks, rate)[:, None] + np.arange(40) / rate[:, None]
    notes = [f"Damaged blocks, left out: {left_out}."] if left_out else []
    if cut:  # a file is a whole number of blocks
        notes.append("The file is cut off within a block; what follows is lost. Download it again.")
    t_s = _even(t_s, blocks)[filled]
    return ImuSamples("", t_s=t_s, acc=acc[filled], gyro=gyro[filled], units="g, deg/s", notes=notes)


def _starts(blocks: NDArray[np.void], rate: FloatArray) -> FloatArray:
    """Time of each block's first sample, s since 1970 on the device's clock."""
    stamp = blocks["time"].astype(np.int64)
    year, month, day = 2000 + (stamp >> 26), (stamp >> 22) & 15, (stamp >> 17) & 31
    hour, minute, second = (stamp >> 12) & 31, (stamp >> 6) & 63, stamp & 63
    months = (year - 1970) * 12 + np.clip(month, 1, 12) - 1
    days = months.astype("datetime64[M]").astype("datetime64[D]").astype(np.int64) + day - 1
    whole = days * 86_400 + hour * 3600 + minute * 60 + second
    # A fraction is there where its top bit is set; the offset then counts the fraction's whole samples too.
    fractional = np.where(blocks["fraction"] & 0x8000, (blocks["fraction"].astype(np.int64) & 0x7FFF) << 1, 0)
    offset = blocks["offset"] + ((fractional * rate.astype(np.int64)) >> 16)
    return whole + fractional / 65536 - offset / rate


def _even(t_s: FloatArray, blocks: NDArray[np.void]) -> FloatArray:
    """Times (blocks, 40); samples are spread up to the next block where it follows at once."""
    count = blocks["count"].astype(int)
    starts, tick = t_s[:, 0], t_s[:, 1] - t_s[:, 0]
    follows = np.zeros(len(blocks), bool)
    length = np.diff(starts)
    # The crystal differs from its nominal rate by a few percent at most; a longer step is a pause.
    follows[:-1] = (np.diff(blocks["sequence"].astype(np.int64)) == 1) & (
        np.abs(length / (count[:-1] * tick[:-1]) - 1) < 0.1
    )
    tick[:-1] = np.where(follows[:-1], length / count[:-1], tick[:-1])
    return starts[:, None] + np.arange(40) * tick[:, None]


_ACC, _GYRO, _MAG = "sensorAcceleration", "sensorAngularVelocity", "sensorMagneticField"
_EXPORT = "export it again with sensor data 'acceleration' and 'angular velocity' (calibrated sensor data) on"


_ROOT = re.compile(r"\s*(<\?xml.*?\?>\s*)?(<!--.*?-->\s*)*<mvnx\b", re.DOTALL)


def _read_mvnx(path: Path) -> list[ImuSamples]:
    """Sensors of a suit, each one IMU: m/s^2 and rad/s in the sensor's axes."""
    rows: dict[str, list[str]] = {_ACC: [], _GYRO: [], _MAG: []}
    names: list[str] = []
    times: list[float] = []
    rate, is_free = None, False
    for event, element in iterparse(path, events=("start", "end")):
        tag = element.tag.rpartition("}")[2]
        if event == "start":
            if tag == "subject":
                rate = _number(element.get("frameRate"))
            elif tag == "sensor":
                names.append(element.get("label", ""))
        elif tag == "frame":
            if element.get("type", "normal") == "normal":
                times.append(_number(element.get("time")) or 0.0)
                for child in element:
                    tag = child.tag.rpartition("}")[2]
                    is_free |= tag == "sensorFreeAcceleration"
                    if tag in rows:
                        rows[tag].append(child.text or "")
            element.clear()
    if not rows[_ACC] or not rows[_GYRO]:
        has = "free acceleration and orientation only" if is_free else "no raw sensors"
        raise RecordingError(f"{path} is an {MVNX.title} that contains {has}; {_EXPORT}.")
    for key in (_ACC, _GYRO):
        if len(rows[key]) != len(times):
            raise RecordingError(f"{path} has {key} in {len(rows[key])} of {len(times)} frames; {_EXPORT}.")
    acc, gyro = _vectors(path, _ACC, rows[_ACC]), _vectors(path, _GYRO, rows[_GYRO])
    mag = _vectors(path, _MAG, rows[_MAG]) if len(rows[_MAG]) == len(times) else None
    count = acc.shape[1]
    if gyro.shape[1] != count:
        raise RecordingError(f"{path} has {count} accelerometers and {gyro.shape[1]} gyroscopes; {_EXPORT}.")
    if not holds_gravity(acc.reshape(-1, 3)):
        raise RecordingError(f"{path} contains acceleration without gravity; {_EXPORT}.")
    stamps = np.array(times) * 1e-3
    stamped = bool((np.diff(stamps) > 0).any())
    names += [f"sensor {at + 1}" for at in range(len(names), count)]
    return [
        ImuSamples(
            names[at],
            t_s=stamps.copy() if stamped else None,
            acc=acc[:, at],
            gyro=gyro[:, at],
            mag=None if mag is None or mag.shape[1] != count else mag[:, at],
            rate_hz=rate,
            units="m/s^2, rad/s",
        )
        for at in range(count)
    ]


MVNX = Format(
    "mvnx",
    "Xsens MVNX",
    "imu",
    "XML whose root is mvnx",
    lambda head: bool(_ROOT.match(head.text[:4000])),
    _read_mvnx,
)


def _vectors(path: Path, key: str, texts: list[str]) -> FloatArray:
    """Vectors of all sensors, shape (frames, sensors, 3)."""
    counts = {len(text.split()) for text in texts}
    try:
        if len(counts) == 1:
            return np.array(" ".join(texts).split(), dtype=float).reshape(len(texts), -1, 3)
    except ValueError:
        pass
    raise RecordingError(
        f"{path}: {key} is not three numbers per sensor, as many in every frame; export it again."
    )


def _number(text: str | None) -> float | None:
    try:
        value = float(text or "")
    except ValueError:
        return None
    return value if np.isfinite(value) else None


def read_mcap(path: Path) -> list[ImuSamples | SkeletonTable]:
    """IMUs and arms of an MCAP file, as `unocclude smooth` reads them too."""
    file = open_recording(path, truth=False)
    by_body: dict[tuple[str, int], list[ArmFrames]] = {}
    for arm in file.arms:
        by_body.setdefault((arm.topic, arm.body), []).append(arm)
    tables: list[ImuSamples | SkeletonTable] = [_skeleton(arms) for arms in by_body.values()]
    tables += [
        replace(imu, topic=imu.topic.strip("/"), t_s=seconds(imu.stamp_ns, 0), notes=[]) for imu in file.imus
    ]
    tables += [] if file.imus else file.halves
    if not tables:
        listed = ", ".join(f"{topic.name} ({topic.schema}, {topic.encoding})" for topic in file.topics)
        raise RecordingError(
            f"{path} has no IMU and no skeleton that can be read (topics: {shown(listed or 'none', 150)});"
            " record sensor_msgs/Imu and the body tracking's MarkerArray."
        )
    tables[0].notes += [note for note in file.notes if file.imus or not note.endswith(LEFT_OUT)]
    for table in tables:
        if isinstance(table, SkeletonTable) and file.camera_frame is not None:
            table.frame = file.camera_frame
        if isinstance(table, SkeletonTable) and file.gravity_hint is not None:
            table.gravity_hint = file.gravity_hint
    return tables


MCAP = Format(
    "mcap", "MCAP recording", "recording", "MCAP's first bytes", begins(b"\x89MCAP0\r\n"), read_mcap
)


def _skeleton(arms: list[ArmFrames]) -> SkeletonTable:
    """One body of the arms that it has."""
    first = arms[0]
    table = SkeletonTable(first.body, seconds(first.stamp_ns, 0), {}, {}, first.camera_frame, units="m")
    for arm in arms:
        for at, joint in enumerate(JOINTS):
            if (arm.state[:, at] != 0).any():
                name = f"{joint}_{arm.side}" if arm.side else joint
                table.position[name], table.state[name] = arm.position[:, at], arm.state[:, at]
    return table


#: What is read of a bag; `JointState` so that it can be said that it contains angles.
_KINDS = (
    *("sensor_msgs/msg/Imu", "sensor_msgs/msg/MagneticField", "sensor_msgs/msg/JointState"),
    *("visualization_msgs/msg/MarkerArray",),
)


def read_rosbag1(path: Path) -> list[ImuSamples | SkeletonTable]:
    """Bags of ROS 1, whose messages become those of ROS 2 in an MCAP file that is read."""
    reader_module = extra_module("rosbags.rosbag1", "rosbags", "devices")
    with TemporaryDirectory() as folder:
        copy = Path(folder) / path.with_suffix(".mcap").name
        with reader_module.Reader(path) as reader:
            _write_messages(reader, copy)
        try:
            return read_mcap(copy)
        except RecordingError as error:
            raise RecordingError(str(error).replace(str(copy), str(path))) from error


ROSBAG1 = Format(
    "rosbag1", "ROS 1 bag", "recording", "the first bytes #ROSBAG V2.0", begins(b"#ROSBAG V2.0"), read_rosbag1
)


def _write_messages(reader: Any, copy: Path) -> None:
    """Messages of a bag that can be used, as an MCAP file; of the other topics their names."""
    from mcap.writer import CompressionType, Writer
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    header = {"std_msgs/msg/Header": get_typestore(Stores.ROS2_FOXY).fielddefs["std_msgs/msg/Header"]}
    types, channels = get_typestore(Stores.EMPTY), {}
    with copy.open("wb") as stream:
        writer = Writer(stream, compression=CompressionType.NONE)
        writer.start()
        for connection in reader.connections:
            text = ""
            if connection.msgtype in _KINDS:
                types.register({**get_types_from_msg(connection.msgdef.data, connection.msgtype), **header})
                text, _ = types.generate_msgdef(connection.msgtype, ros_version=2)
            schema = writer.register_schema(connection.msgtype, "ros2msg", text.encode())
            channels[connection.id] = writer.register_channel(connection.topic, "cdr", schema)
        wanted = [each for each in reader.connections if each.msgtype in _KINDS]
        for connection, log_ns, data in reader.messages(connections=wanted) if wanted else ():
            message = bytes(types.ros1_to_cdr(data, connection.msgtype))
            writer.add_message(channels[connection.id], log_ns, message, log_ns)
        writer.finish()


#: What is larger is not a measurement in any unit.
_DAMAGED = 1e9


@dataclass(frozen=True)
class _Stream:
    """One stream with numbers."""

    name: str
    kind: str
    rate_hz: float | None
    labels: list[str]
    types: list[str]
    units: list[str]
    t_s: np.ndarray
    values: np.ndarray


def read_xdf(path: Path) -> list[ImuSamples | SkeletonTable]:
    """Streams whose channels' labels are a sensor's axes or joints; the file's clock offsets are applied."""
    import pyxdf

    logger = logging.getLogger("pyxdf")  # its warnings stay off the terminal
    logger.propagate, logger.handlers = False, [logging.NullHandler()]
    loaded, _ = pyxdf.load_xdf(str(path), dejitter_timestamps=False, verbose=False)
    streams = [stream for entry in loaded if (stream := _stream(entry)) is not None]
    skeletons = [table for stream in streams for table in _xdf_skeletons(stream, path)]
    imus, reasons = _imus(streams, path)
    if not skeletons and not imus:
        listed = (
            "; ".join(f"{s.name} ({s.kind}, {len(s.labels)} channels)" for s in streams)
            or "none with numbers"
        )
        why = f"; {reasons[0]}" if reasons else ""
        raise RecordingError(
            f"{path} has no stream of an accelerometer, a gyroscope or joints by its channels' labels"
            f" (streams: {shown(listed, 150)}{why}); stream them with labels such as acc_x, gyro_x,"
            " WristRight_X and units."
        )
    for reason in reasons:
        (imus or skeletons)[0].notes.append(f"A stream was left out: {reason}.")
    for number, table in enumerate(skeletons):
        table.body = number if len({other.body for other in skeletons}) < len(skeletons) else table.body
    return [*skeletons, *imus]


XDF = Format(
    "xdf",
    "XDF recording (Lab Streaming Layer)",
    "recording",
    "the first bytes XDF:",
    begins(b"XDF:"),
    read_xdf,
)


def _stream(entry: dict[str, Any]) -> _Stream | None:
    """A stream with numbers and stamps; None for markers in words, and for what is empty."""
    info, values = entry.get("info", {}), entry.get("time_series")
    t_s = np.asarray(entry.get("time_stamps", ()), dtype=float)
    if not isinstance(values, np.ndarray) or values.ndim != 2 or len(t_s) != len(values) or len(t_s) < 2:
        return None
    if values.dtype.kind not in "fiu" or values.shape[1] < 3:
        return None
    try:
        channels = [dict(channel) for channel in info["desc"][0]["channels"][0]["channel"]]
    except (KeyError, IndexError, TypeError, ValueError):
        channels = []
    channels = (channels + [{}] * values.shape[1])[: values.shape[1]]
    labels, types, units = channel_labels(partial(_stated, channel) for channel in channels)
    rate = 0.0
    with suppress(ValueError):
        rate = float(_stated(info, "nominal_srate"))
    rate_hz = rate if 0 < rate < 1e5 else None
    return _Stream(_stated(info, "name"), _stated(info, "type"), rate_hz, labels, types, units, t_s, values)


def _stated(entry: Any, key: str) -> str:
    value = entry.get(key) if isinstance(entry, dict) else None
    value = value[0] if isinstance(value, list) and value else value
    return str(value) if isinstance(value, str | int | float) else ""


def _xdf_skeletons(stream: _Stream, path: Path) -> list[SkeletonTable]:
    """Bodies of a stream whose labels name joints."""
    columns = find_joint_columns(stream.labels)
    if not has_arm(columns.axes):
        return []
    values = stream.values.astype(float)
    raw = RawSkeleton(path, time=stream.t_s, time_unit="s")
    raw.add_columns(columns, lambda at: values[:, at], lambda at: values[:, at])
    raw.notes.append(f"Joints are of the stream {stream.name} ({stream.kind}).")
    if columns.body is not None and (body := values[:, columns.body] > 0).any():
        raw.body = np.where(body, values[:, columns.body], np.nan)
    frames = {"azure": CameraFrame.OPTICAL, "kinect": CameraFrame.KINECT}
    stated = METRES.get(stream.units[next(iter(columns.axes.values()))[0]].strip().lower())
    unit = next((unit for unit in ("m", "cm", "mm") if METRES[unit] == stated), "")
    return raw.skeletons(Conventions(unit, frames.get(program_of(stream.labels))))


def _imus(streams: list[_Stream], path: Path) -> tuple[list[ImuSamples], list[str]]:
    """Sensors of all streams, and why some were left out; halves of a sensor are put together."""
    whole: list[ImuSamples] = []
    halves: list[ImuSamples] = []
    reasons: list[str] = []
    for stream in streams:
        if has_arm(find_joint_columns(stream.labels).axes):
            continue
        sensors = find_sensors(stream.labels, stream.types, f"{stream.name} {stream.kind}")
        for name, axes in sensors.items():
            table, why = _imu(stream, "_".join(filter(None, (stream.name, name.replace(" ", "_")))), axes)
            if why:
                reasons.append(why)
            else:
                (halves if table.acc is None or table.gyro is None else whole).append(table)
    joined, _, alone = with_halves_joined(halves, str(path))
    for table in joined:
        table.topic = stem_of(table.topic).replace(" ", "_") or "imu"
    return whole + joined, reasons + alone


def _imu(stream: _Stream, name: str, axes: dict[str, Columns]) -> tuple[ImuSamples, str]:
    """A sensor's samples in SI units; or why its units are not known."""
    values = np.where(np.abs(stream.values) < _DAMAGED, stream.values, np.nan)
    vectors = {kind: values[:, columns].astype(float) for kind, columns in axes.items()}
    table = ImuSamples(name, t_s=stream.t_s, mag=vectors.get("mag"), rate_hz=stream.rate_hz)
    units = []
    for kind, known in (("acc", ACCELERATION), ("gyro", ANGULAR_VELOCITY)):
        if kind not in vectors:
            continue
        stated = stream.units[axes[kind][0]]
        unit, why = unit_of(kind, vectors[kind], stated, "", table.acc, table.t_s, table.rate_hz)
        if not unit or (not why and unit == "rad/s"):
            return table, f"{name}: the unit of {kind} is not stated, and the motion does not show it"
        if plain_unit(stated) not in known:
            table.notes.append(f"{name}: assumed {unit} for {kind} ({why or 'it is too fast in rad/s'}).")
        setattr(table, kind, vectors[kind] * known[unit])
        units.append(unit)
    table.units = ", ".join(units)
    return table, ""
