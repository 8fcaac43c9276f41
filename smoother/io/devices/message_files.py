"""Recordings of messages: ROS 1 bags, MCAP of others, XDF of the Lab Streaming Layer."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import RecordingError
from ...linalg import interpolate
from ...recording import JOINTS, CameraFrame
from ...runtime.store import Store
from ..mcap.messages import nanoseconds, seconds
from ..recording.inertial import LEFT_OUT, settle_imus
from ..recording.read import open_recording
from ..recording.streams import ArmFrames, ImuSamples, RecordingFile
from ..tables.columns import find_sensors, imu_of, joint_label, stem_of, with_halves_joined
from ..tables.imu import ImuTable
from ..tables.joints import AZURE, JointName, find_joint_columns, joint_name, words_of
from ..tables.skeleton_formats import kinect_states, states_of
from ..tables.skeletons import Conventions, RawSkeleton, SkeletonTable
from ..tables.table import Format, begins, shown
from ..tables.units import METRES


def read_mcap(path: Path) -> list[ImuTable | SkeletonTable]:
    """IMUs and arms of an MCAP file, as `unocclude smooth` reads them too."""
    file = open_recording(path, truth=False)
    by_body: dict[tuple[str, int], list[ArmFrames]] = {}
    for arm in file.arms:
        by_body.setdefault((arm.topic, arm.body), []).append(arm)
    tables: list[ImuTable | SkeletonTable] = [_skeleton(arms) for arms in by_body.values()]
    tables += _imu_tables(file) or file.halves
    if not tables:
        listed = ", ".join(f"{topic.name} ({topic.schema}, {topic.encoding})" for topic in file.topics)
        raise RecordingError(
            f"{path} has no IMU and no skeleton that can be read (topics:"
            f" {shown(listed or 'none', 150)});"
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
    key="mcap",
    title="MCAP recording",
    kind="recording",
    recognised_by="MCAP's first bytes",
    recognises=begins(b"\x89MCAP0\r\n"),
    read=read_mcap,
)


def _imu_tables(file: RecordingFile) -> list[ImuTable]:
    """The IMUs of a file, in SI units since it was read."""
    tables = []
    for imu in file.imus:
        t_s = seconds(imu.stamp_ns, 0)
        table = ImuTable(imu.topic.strip("/"), t_s, imu.acc, imu.gyro, imu.mag, units=imu.units)
        table.made_of = imu.made_of
        tables.append(table)
    return tables


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


_IMU = "sensor_msgs/msg/Imu"
_MARKERS = "visualization_msgs/msg/MarkerArray"
_FIELD = "sensor_msgs/msg/MagneticField"
_JOINT_STATE = "sensor_msgs/msg/JointState"
_ADD = 0  # Marker.ADD
#: Joints of the arms, and what shows how the body stands, by their number in the SDK.
_NUMBERED: dict[int, JointName] = {
    number: name for number, written in enumerate(AZURE) if (name := joint_name(written)) is not None
}


@dataclass
class _Rows:
    """Bodies of one topic, one row per frame and body."""

    time: list[float] = field(default_factory=list)
    body: list[float] = field(default_factory=list)
    points: list[dict[int, tuple[float, float, float]]] = field(default_factory=list)
    foreign: int = 0


def read_rosbag1(path: Path) -> list[ImuTable | SkeletonTable]:
    """Bags of ROS 1; markers are bodies of the Azure Kinect's driver (id = body x 100 + joint)."""
    try:
        from rosbags.rosbag1 import Reader
    except ImportError:
        raise RecordingError(
            f"{path}: ROS 1 bags are read by the library rosbags; install it with: pip install"
            " '.[devices]' in the program's folder"
        ) from None
    try:
        with Reader(path) as reader:
            return _read(reader, path)
    except RecordingError:
        raise
    except Exception as error:  # whatever a damaged file leads the library into
        raise RecordingError(
            f"{path} is damaged and rosbags cannot read it ({shown(str(error), 80)}); `rosbag reindex`"
            " may correct it, or record again."
        ) from error


ROSBAG1 = Format(
    key="rosbag1",
    title="ROS 1 bag",
    kind="recording",
    recognised_by="the first bytes #ROSBAG V2.0",
    recognises=begins(b"#ROSBAG V2.0"),
    read=read_rosbag1,
)


def _read(reader: Any, path: Path) -> list[ImuTable | SkeletonTable]:
    wanted = [c for c in reader.connections if c.msgtype in (_IMU, _MARKERS, _FIELD)]
    types = _types(wanted)
    imus: dict[str, list[tuple[float, ...]]] = {}
    frame_ids: dict[str, str] = {}
    fields: dict[str, list[tuple[float, ...]]] = {}
    bodies: dict[str, _Rows] = {}
    for connection, log_ns, data in reader.messages(connections=wanted):
        message = types.deserialize_ros1(data, connection.msgtype)
        if connection.msgtype == _MARKERS:
            _add_bodies(bodies.setdefault(connection.topic, _Rows()), message, log_ns)
            continue
        t = _seconds(message.header.stamp) or log_ns * 1e-9
        if connection.msgtype == _FIELD:
            fields.setdefault(connection.topic, []).append((t, *_xyz(message.magnetic_field)))
            continue
        frame_ids[connection.topic] = message.header.frame_id
        row = (t, *_xyz(message.linear_acceleration), *_xyz(message.angular_velocity))
        imus.setdefault(connection.topic, []).append(row)
    tables: list[ImuTable | SkeletonTable] = [
        table for topic, rows in bodies.items() for table in _skeletons(topic, rows, path)
    ]
    streams = [_imu(topic, np.array(rows), fields) for topic, rows in sorted(imus.items())]
    file = RecordingFile(path, imus=streams)
    settle_imus(file, Store())
    tables += _imu_tables(file) or file.halves
    if not tables:
        listed = ", ".join(
            sorted({f"{c.topic} ({c.msgtype.replace('/msg/', '/')})" for c in reader.connections})
        )
        raise RecordingError(
            f"{path} has no sensor_msgs/Imu and no MarkerArray of a body (topics: {shown(listed, 150)});"
            " record the IMU's topic and the body tracking's."
        )
    tables[0].notes += [note for note in file.notes if file.imus or not note.endswith(LEFT_OUT)]
    angles = sorted({c.topic for c in reader.connections if c.msgtype == _JOINT_STATE})
    if angles:
        tables[0].notes.append(
            f"{', '.join(angles)}: sensor_msgs/JointState contains angles, not joint positions; ignored."
        )
    return tables


def _types(connections: list[Any]) -> Any:
    """The messages' definitions, as the bag has them."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    types = get_typestore(Stores.EMPTY)
    for connection in connections:
        text = getattr(connection.msgdef, "data", connection.msgdef)
        types.register(get_types_from_msg(text, connection.msgtype))
    return types


def _seconds(stamp: Any) -> float:
    return float(stamp.sec) + 1e-9 * float(stamp.nanosec)


def _xyz(vector: Any) -> tuple[float, float, float]:
    return float(vector.x), float(vector.y), float(vector.z)


def _imu(topic: str, rows: np.ndarray, fields: dict[str, list[tuple[float, ...]]]) -> ImuSamples:
    """One IMU, with the magnetometer of the same name space, if there is one."""
    imu = ImuSamples(topic, "", nanoseconds(rows[:, 0], 0), rows[:, 1:4], rows[:, 4:7])
    near = [name for name in fields if name.rpartition("/")[0] == topic.rpartition("/")[0]]
    if len(near) == 1 and len(fields[near[0]]) > 1:
        samples = np.array(fields[near[0]])
        samples = samples[np.argsort(samples[:, 0], kind="stable")]
        at = np.clip(rows[:, 0], samples[0, 0], samples[-1, 0])
        imu.mag = interpolate(samples[:, 0], samples[:, 1:], at)
    return imu


def _add_bodies(rows: _Rows, message: Any, log_ns: int) -> None:
    added = [marker for marker in message.markers if marker.action == _ADD]
    stamp = next((s for marker in added if (s := _seconds(marker.header.stamp))), log_ns * 1e-9)
    by_body: dict[int, dict[int, tuple[float, float, float]]] = {}
    for marker in added:
        body, joint = divmod(int(marker.id), 100)
        if not 0 <= joint < len(AZURE) or body < 0:
            rows.foreign += 1
        elif joint in _NUMBERED:
            by_body.setdefault(body, {})[joint] = _xyz(marker.pose.position)
    for number, points in by_body.items() or [(None, {})]:
        rows.time.append(stamp)
        rows.body.append(float("nan") if number is None else float(number))
        rows.points.append(points)


def _skeletons(topic: str, rows: _Rows, path: Path) -> list[SkeletonTable]:
    """Bodies of a topic; none where its markers are something else."""
    count = sum(map(len, rows.points))
    if not count or rows.foreign > 0.05 * count:
        return []
    raw = RawSkeleton(path, {}, time=np.array(rows.time), time_scale=1.0, body=np.array(rows.body))
    nothing = (float("nan"),) * 3
    for number, name in _NUMBERED.items():
        position = np.array([points.get(number, nothing) for points in rows.points], dtype=float)
        if name.joint:
            raw.position[name.joint] = position
        else:
            raw.rest.append((name, position))
    raw.notes.append(f"Bodies are of the topic {topic}.")
    return raw.skeletons(Conventions("m", CameraFrame.OPTICAL))


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


def read_xdf(path: Path) -> list[ImuTable | SkeletonTable]:
    """Streams whose channels' labels are a sensor's axes or joints; the file's clock offsets are applied."""
    streams = [stream for entry in _loaded(path) if (stream := _stream(entry)) is not None]
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
    key="xdf",
    title="XDF recording (Lab Streaming Layer)",
    kind="recording",
    recognised_by="the first bytes XDF:",
    recognises=begins(b"XDF:"),
    read=read_xdf,
)


def _loaded(path: Path) -> list[dict[str, Any]]:
    try:
        import pyxdf
    except ImportError:
        raise RecordingError(
            f"{path}: XDF files are read by the library pyxdf; install it with: pip install pyxdf"
        ) from None
    try:
        with _silent("pyxdf"):
            streams, _ = pyxdf.load_xdf(str(path), dejitter_timestamps=False, verbose=False)
    except Exception as error:  # whatever a damaged file leads the library into
        raise RecordingError(
            f"{path} is damaged and pyxdf cannot read it ({shown(str(error), 80)}); copy it again."
        ) from error
    return list(streams)


@contextmanager
def _silent(name: str) -> Iterator[None]:
    """Keep a library's warnings off the terminal."""
    logger = logging.getLogger(name)
    before, logger.propagate = logger.propagate, False
    handler = logging.NullHandler()
    logger.addHandler(handler)
    try:
        yield
    finally:
        logger.removeHandler(handler)
        logger.propagate = before


def _stream(entry: dict[str, Any]) -> _Stream | None:
    """A stream with numbers and stamps; None for markers in words, and for what is empty."""
    info = entry.get("info", {})
    values = entry.get("time_series")
    t_s = np.asarray(entry.get("time_stamps", ()), dtype=float)
    if not isinstance(values, np.ndarray) or values.ndim != 2 or len(t_s) != len(values) or len(t_s) < 2:
        return None
    if values.dtype.kind not in "fiu" or values.shape[1] < 3:
        return None
    channels = _channels(info, values.shape[1])
    rate = _rate(_text(info, "nominal_srate"))
    return _Stream(
        _text(info, "name"),
        _text(info, "type"),
        rate,
        [_text(channel, "label") or _text(channel, "name") for channel in channels],
        [_text(channel, "type") for channel in channels],
        [_text(channel, "unit") for channel in channels],
        t_s,
        values,
    )


def _channels(info: dict[str, Any], count: int) -> list[dict[str, Any]]:
    """The file's description of each channel; a joint's name and its axis are put together as the label."""
    try:
        channels = [dict(channel) for channel in info["desc"][0]["channels"][0]["channel"]]
    except (KeyError, IndexError, TypeError, ValueError):
        channels = []
    channels = (channels + [{}] * count)[:count]
    for channel in channels:
        marker = _text(channel, "marker") or _text(channel, "object")
        if label := joint_label(marker, _text(channel, "type")):
            channel["label"] = [label]
    return channels


def _text(entry: Any, key: str) -> str:
    value = entry.get(key) if isinstance(entry, dict) else None
    value = value[0] if isinstance(value, list) and value else value
    return str(value) if isinstance(value, str | int | float) else ""


def _rate(text: str) -> float | None:
    try:
        rate = float(text)
    except ValueError:
        return None
    return rate if 0 < rate < 1e5 else None


def _xdf_skeletons(stream: _Stream, path: Path) -> list[SkeletonTable]:
    """Bodies of a stream whose labels name joints."""
    columns = find_joint_columns(stream.labels)
    if not columns.has_arm():
        return []
    values = stream.values.astype(float)
    raw = RawSkeleton(
        path,
        {joint: values[:, triple] for joint, triple in columns.axes.items()},
        states_of({joint: values[:, column] for joint, column in columns.confidence.items()}, kinect_states),
        time=stream.t_s,
        time_scale=1.0,
        body=None
        if columns.body is None
        else np.where(values[:, columns.body] > 0, values[:, columns.body], np.nan),
        rest=[(name, values[:, triple]) for name, triple in columns.rest],
    )
    if raw.body is not None and not np.isfinite(raw.body).any():
        raw.body = None
    raw.notes.append(f"Joints are of the stream {stream.name} ({stream.kind}).")
    words = {word for label in stream.labels for word in words_of(label)}
    frame = (
        CameraFrame.OPTICAL if words & {"navel", "clavicle"}
        else CameraFrame.KINECT if "spine" in words and words & {"base", "mid"}
        else None
    )  # fmt: skip
    stated = stream.units[next(iter(columns.axes.values()))[0]].strip().lower()
    unit = {1.0: "m", 0.01: "cm", 0.001: "mm"}.get(METRES.get(stated, 0.0), "")
    return raw.skeletons(Conventions(unit, frame))


def _imus(streams: list[_Stream], path: Path) -> tuple[list[ImuTable], list[str]]:
    """Sensors of all streams, and why some were left out; halves of a sensor are put together."""
    whole: list[ImuTable] = []
    halves: list[ImuTable] = []
    reasons: list[str] = []
    for stream in streams:
        if find_joint_columns(stream.labels).has_arm():
            continue
        for sensor in find_sensors(stream.labels, stream.types, f"{stream.name} {stream.kind}"):
            name = "_".join(part for part in (stream.name, sensor.name.replace(" ", "_")) if part)
            table, why = imu_of(name, stream.t_s, stream.values, sensor, stream.units, stream.rate_hz)
            if table is None:
                reasons.append(why)
            elif table.acc is not None and table.gyro is not None:
                whole.append(table)
            else:
                halves.append(table)
    joined, _, alone = with_halves_joined(halves, str(path))
    for table in joined:
        table.name = stem_of(table.name).replace(" ", "_") or "imu"
    return whole + joined, reasons + alone
