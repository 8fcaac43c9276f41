"""Messages in JSON (MCAP's encoding `json`), as web and Python recorders write them: decoded one by one."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any

import numpy as np

from ...recording import JOINTS, JointState
from ...runtime.store import Column, Store
from ..mcap.messages import SECOND_NS, Topic, TopicMessages
from .decode import SIDES, JointRows, joint_code
from .streams import ArmFrames, FieldSamples, ImuSamples, PoseSamples

_NAN = float("nan")
_STATES = {
    **dict.fromkeys((0, "0", "NOT_TRACKED", "not_tracked"), JointState.NOT_TRACKED),
    **dict.fromkeys((1, "1", "INFERRED", "inferred"), JointState.INFERRED),
    **dict.fromkeys((2, "2", "TRACKED", "tracked"), JointState.TRACKED),
}


def json_kind(topic: Topic) -> str:
    """What a topic in JSON holds: `imu`, `field`, `pose`, `skeleton`, or "" for others.

    By the schema's name (`sensor_msgs/Imu`, `unocclude.Imu`, `foxglove.PoseInFrame`), or by the fields that
    its JSON schema names.
    """
    if topic.encoding != "json":
        return ""
    name = re.split(r"[./]", topic.schema)[-1].lower()
    kinds = {
        "imu": "imu",
        "magneticfield": "field",
        "posestamped": "pose",
        "poseinframe": "pose",
        "skeleton": "skeleton",
    }
    if name in kinds:
        return kinds[name]
    text = topic.schema_data[:20_000].decode("utf-8", "replace")
    return "imu" if '"linear_acceleration"' in text and '"angular_velocity"' in text else ""


@dataclass
class JsonGrouper:
    """Counts the messages that could not be read, as `Grouper` does.

    Attributes
    ----------
    broken : int
        Messages that are not JSON or lack a field.
    """

    broken: int = 0


@dataclass
class JsonDecoder:
    """Messages of one topic in JSON.

    Attributes
    ----------
    topic : Topic
        The topic.
    kind : str
        See `json_kind`.
    """

    topic: Topic
    kind: str
    store: Store = field(default_factory=Store)
    frame_id: str = ""

    def __post_init__(self) -> None:
        self.grouper = JsonGrouper()
        self._stamps = Column(self.store, (), np.int64)
        self._delay = Column(self.store, (), np.int64)
        self._rows = JointRows(self.store)
        widths = {"imu": 9, "field": 3, "pose": 7}
        self._values = Column(self.store, (widths.get(self.kind, 1),))
        self._count = 0

    def feed(self, messages: TopicMessages) -> None:
        """Take a batch of messages."""
        stamps: list[int] = []
        delays: list[int] = []
        values: list[tuple[float, ...]] = []
        joints: list[tuple[float, ...]] = []
        ranges = zip(messages.start.tolist(), messages.stop.tolist(), messages.log_ns.tolist(), strict=True)
        for start, stop, log_ns in ranges:
            try:
                message = json.loads(bytes(messages.chunk[start:stop]))
                stamp = stamp_ns(message) or log_ns
                if not abs(stamp) < 2**62:
                    raise ValueError("no time")
                row = _VALUES[self.kind](message)
            except (ValueError, TypeError, KeyError, AttributeError, RecursionError, OverflowError):
                self.grouper.broken += 1
                continue
            header = message.get("header", message)
            if isinstance(header, Mapping) and isinstance(header.get("frame_id"), str):
                self.frame_id = header["frame_id"]
            if self.kind == "skeleton":
                joints += [(self._count + len(stamps), *joint) for joint in row]
            else:
                values.append(row)
            stamps.append(stamp)
            delays.append(log_ns - stamp)
        if not stamps:
            return
        self._stamps.append(np.array(stamps, np.int64))
        self._delay.append(np.array(delays, np.int64))
        self._count += len(stamps)
        if values:
            self._values.append(np.array(values, float))
        if joints:
            table = np.array(joints, float)
            message_of, body, side, joint_of, state = table[:, :5].astype(np.int64).T
            self._rows.add_joints(message_of, body, side, joint_of, state, table[:, 5:])


class JsonStream(JsonDecoder):
    """IMU samples, magnetic fields or poses in JSON."""

    def stream(self) -> ImuSamples | FieldSamples | PoseSamples | None:
        """All samples, or None where there are none."""
        if not self._count:
            return None
        stamp, values = self._stamps.done(), self._values.done()
        name = self.topic.label
        if self.kind == "field":
            return FieldSamples(name, self.frame_id, stamp, values)
        if self.kind == "pose":
            quaternion = values[:, 3:].copy()
            quaternion[~(np.linalg.norm(quaternion, axis=1) > 0.5)] = np.nan
            return PoseSamples(name, self.frame_id, stamp, values[:, :3], quaternion)
        mag = values[:, 6:] if np.isfinite(values[:, 6:]).any() else None
        shift = int(np.median(self._delay.done()))
        return ImuSamples(name, self.frame_id, stamp, values[:, :3], values[:, 3:6], mag, shift)


class JsonSkeleton(JsonDecoder):
    """Skeletons in JSON."""

    def arms(self) -> list[ArmFrames]:
        """All arms; asked for once."""
        if not self._count:
            return []
        return self._rows.arms(self._stamps.done(), self.topic.label, self.frame_id, None)


def stamp_ns(message: Mapping[str, Any]) -> int:
    """Stamp of a message, ns; 0 where it has none.

    ROS's `header.stamp` with `sec` and `nsec` or `nanosec`, Foxglove's `timestamp` likewise, an RFC 3339
    date (protobuf's JSON), or a number of seconds.
    """
    header = message.get("header")
    stamp = (
        header.get("stamp") if isinstance(header, Mapping) else message.get("timestamp", message.get("stamp"))
    )
    if isinstance(stamp, Mapping):
        whole = int(stamp.get("sec", stamp.get("secs", stamp.get("seconds", 0))))
        part = next((stamp[name] for name in ("nanosec", "nsec", "nsecs", "nanos") if name in stamp), 0)
        return whole * SECOND_NS + int(part)
    if isinstance(stamp, str):
        date = re.fullmatch(r"(\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d)(?:\.(\d{1,9}))?Z?", stamp)
        if date is None:
            raise ValueError("no date")
        whole = int(datetime.fromisoformat(date.group(1)).replace(tzinfo=UTC).timestamp())
        return whole * SECOND_NS + int((date.group(2) or "0").ljust(9, "0"))
    return round(float(stamp) * 1e9) if isinstance(stamp, int | float) and abs(stamp) < 9e9 else 0


def _xyz(value: Any) -> tuple[float, float, float]:
    """A vector; protobuf's JSON leaves zeros out."""
    if isinstance(value, list | tuple):
        x, y, z = value
        return float(x), float(y), float(z)
    return float(value.get("x", 0.0)), float(value.get("y", 0.0)), float(value.get("z", 0.0))


def _imu(message: Mapping[str, Any]) -> tuple[float, ...]:
    mag = message.get("magnetic_field", message.get("magneticField"))
    acc = (
        message["linear_acceleration"] if "linear_acceleration" in message else message["linearAcceleration"]
    )
    gyro = message["angular_velocity"] if "angular_velocity" in message else message["angularVelocity"]
    return (*_xyz(acc), *_xyz(gyro), *((_NAN,) * 3 if mag is None else _xyz(mag)))


def _field(message: Mapping[str, Any]) -> tuple[float, ...]:
    return _xyz(message["magnetic_field"] if "magnetic_field" in message else message["magneticField"])


def _pose(message: Mapping[str, Any]) -> tuple[float, ...]:
    turn = message["pose"].get("orientation", {})
    quaternion = (float(turn.get(name, 0.0)) for name in "wxyz")
    return (*_xyz(message["pose"]["position"]), *quaternion)


def _skeleton(message: Mapping[str, Any]) -> list[tuple[float, ...]]:
    """Body, side, joint, state and position of each joint."""
    body = float(message.get("body", 0))
    if not 0 <= body < 2**31:
        raise ValueError("no number of a body")
    rows = []
    for joint in message.get("joints", []):
        code = joint_code(str(joint.get("name", "")))
        if code is None or code[0] >= len(SIDES) or code[1] >= len(JOINTS):
            continue
        state = _STATES[joint.get("state", 0)]
        rows.append((body, *map(float, code), float(state), *_xyz(joint.get("position", {}))))
    return rows


_VALUES: dict[str, Any] = {"imu": _imu, "field": _field, "pose": _pose, "skeleton": _skeleton}


def json_decoder(topic: Topic, store: Store | None = None) -> JsonStream | JsonSkeleton | None:
    """The decoder of a topic in JSON; None for others."""
    kind = json_kind(topic)
    if not kind:
        return None
    store = store or Store()
    return JsonSkeleton(topic, kind, store) if kind == "skeleton" else JsonStream(topic, kind, store)


#: Encodings whose content is what the schema says.
_ENCODINGS = {"cdr", "protobuf", "ros1", "json"}
#: Schemas of motion, time and lenses: they contain no image, name or address of a person.
_SCHEMAS = {
    f"{package}{name}"
    for package, names in {
        "sensor_msgs/": (
            "Imu",
            "MagneticField",
            "JointState",
            "CameraInfo",
            "Temperature",
            "FluidPressure",
            "TimeReference",
        ),
        "geometry_msgs/": (
            "Pose",
            "PoseStamped",
            "PoseWithCovarianceStamped",
            "PoseArray",
            "Transform",
            "TransformStamped",
            "Point",
            "PointStamped",
            "Vector3",
            "Vector3Stamped",
            "Quaternion",
            "QuaternionStamped",
            "Twist",
            "TwistStamped",
            "TwistWithCovarianceStamped",
            "Accel",
            "AccelStamped",
            "AccelWithCovarianceStamped",
            "Wrench",
            "WrenchStamped",
        ),
        "nav_msgs/": ("Odometry",),
        "std_msgs/": (
            "Bool",
            "Header",
            "Time",
            "Duration",
            "Float32",
            "Float64",
            "Int8",
            "Int16",
            "Int32",
            "Int64",
            "UInt8",
            "UInt16",
            "UInt32",
            "UInt64",
        ),
        "tf2_msgs/": ("TFMessage",),
        "tf/": ("tfMessage",),
        "rosgraph_msgs/": ("Clock",),
        "visualization_msgs/": ("MarkerArray",),
        "foxglove.": (
            "FrameTransform",
            "FrameTransforms",
            "PoseInFrame",
            "PosesInFrame",
            "JointState",
            "JointStates",
            "Odometry",
            "CameraCalibration",
            "Event",
        ),
        "unocclude.": (
            "Imu",
            "Skeleton",
            "Keypoints2D",
            "Residuals",
        ),
    }.items()
    for name in names
}


#: How the sentence on topics that were left out begins.
NOT_PASSED_THROUGH = "Not carried over"


def may_copy(topic: Topic, passthrough_images: bool) -> bool:
    """Whether a topic of a recording is copied into files made of it.

    Images in any form, sound, text, positions on Earth and whatever is not known do not, unless asked for.

    Parameters
    ----------
    topic : Topic
        By its schema and encoding; its name is not used.
    passthrough_images : bool
        Copy everything.
    """
    if passthrough_images or json_kind(topic):
        return True
    return topic.encoding in _ENCODINGS and topic.schema.replace("/msg/", "/") in _SCHEMAS


@dataclass
class Passthrough:
    """Decides of topics and remembers which were left out.

    Attributes
    ----------
    passthrough_images : bool
        Copy everything.
    left_out : dict of str to str
        Schemas by topics that were not copied.
    """

    passthrough_images: bool
    left_out: dict[str, str] = field(default_factory=dict)

    def __call__(self, topic: Topic) -> bool:
        """Whether to copy a topic."""
        if may_copy(topic, self.passthrough_images):
            return True
        self.left_out[topic.name] = topic.schema or topic.encoding or "no schema"
        return False

    @property
    def sentence(self) -> str:
        """What was left out, for the user; "" for nothing."""
        if not self.left_out:
            return ""
        listed = [f"{name} ({schema})" for name, schema in sorted(self.left_out.items())]
        more = f" and {len(listed) - 5} more" if len(listed) > 5 else ""
        return (
            f"{NOT_PASSED_THROUGH}, since they may show or name the person: {', '.join(listed[:5])}{more};"
            " --passthrough-images carries all topics over."
        )
