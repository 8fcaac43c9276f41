"""Recordings of messages: MCAP of this program and others, ROS 1 bags."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from ...errors import RecordingError
from ...recording import JOINTS
from ...runtime.packages import extra_module
from ..mcap.messages import seconds
from ..recording.clean import LEFT_OUT
from ..recording.read import open_recording
from ..recording.streams import ArmFrames
from .imu import ImuTable
from .skeletons import SkeletonTable
from .table import Format, begins, shown


def read_mcap(path: Path) -> list[ImuTable | SkeletonTable]:
    """IMUs and arms of an MCAP file, as `unocclude smooth` reads them too."""
    file = open_recording(path, truth=False)
    by_body: dict[tuple[str, int], list[ArmFrames]] = {}
    for arm in file.arms:
        by_body.setdefault((arm.topic, arm.body), []).append(arm)
    tables: list[ImuTable | SkeletonTable] = [_skeleton(arms) for arms in by_body.values()]
    for imu in file.imus:
        name, t_s = imu.topic.strip("/"), seconds(imu.stamp_ns, 0)
        one = ImuTable(name, t_s, imu.acc, imu.gyro, imu.mag, units=imu.units, made_of=imu.made_of)
        tables.append(one)
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


def read_rosbag1(path: Path) -> list[ImuTable | SkeletonTable]:
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
