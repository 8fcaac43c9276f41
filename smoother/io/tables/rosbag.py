"""Recordings of messages: MCAP of this program and others, ROS 1 bags."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import RecordingError
from ...linalg import interpolate
from ...recording import JOINTS, CameraFrame
from ..mcap.messages import nanoseconds, seconds
from ..recording.inertial import LEFT_OUT, settle_imus
from ..recording.read import open_recording
from ..recording.streams import ArmFrames, ImuSamples, RecordingFile
from .imu import ImuTable
from .joints import AZURE
from .skeletons import Conventions, RawSkeleton, SkeletonTable
from .table import Format, begins, shown


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
    settle_imus(file)
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
        else:
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
    raw = RawSkeleton(path, time=np.array(rows.time), time_scale=1.0, body=np.array(rows.body))
    nothing = (float("nan"),) * 3
    for number, name in enumerate(AZURE):
        raw.add(name, np.array([points.get(number, nothing) for points in rows.points], dtype=float))
    raw.notes.append(f"Bodies are of the topic {topic}.")
    return raw.skeletons(Conventions("m", CameraFrame.OPTICAL))
