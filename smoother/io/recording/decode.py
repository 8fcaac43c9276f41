"""Messages of IMUs, poses and skeletons decoded in batches."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np
from numpy.typing import NDArray

from ...array_types import FloatArray, IntArray
from ...recording import JOINTS, CameraFrame, JointState
from ...runtime.store import Column, batches, large_array, sampled
from ..mcap.messages import Topic, TopicMessages, ros_stamps
from ..wire import cdr
from ..wire import protobuf_decode as proto
from ..wire.layout import Block, Grouper, MessageLayout, axes
from ..wire.schemas import message_class
from .streams import ArmFrames, FieldSamples, ImuSamples, PoseSamples

#: Streams of plain columns by encoding and schema: what they are, and the walk over a ROS message.
_PLAIN: dict[tuple[str, str], tuple[str, Callable[[bytes], MessageLayout] | None]] = {
    ("cdr", "sensor_msgs/Imu"): ("imu", cdr.imu),
    ("cdr", "sensor_msgs/MagneticField"): ("field", cdr.magnetic_field),
    ("cdr", "geometry_msgs/PoseStamped"): ("pose", cdr.pose_stamped),
    ("protobuf", "unocclude.Imu"): ("imu", None),
    ("protobuf", "foxglove.PoseInFrame"): ("pose", None),
}
#: Their columns: the field of a ROS message, that of protobuf, its components.
_COLUMNS = {
    "imu": (
        ("acc", "linear_acceleration", "xyz"),
        ("gyro", "angular_velocity", "xyz"),
        ("mag", "magnetic_field", "xyz"),
    ),
    "field": (("mag", "magnetic_field", "xyz"),),
    "pose": (("position", "pose.position", "xyz"), ("quaternion", "pose.orientation", "xyzw")),
}


def stamps_of(block: Block, layout: MessageLayout, log_ns: IntArray) -> IntArray:
    """Stamps (rows,), ns; log times where they are zero."""
    if "sec" not in layout.fields:
        return proto.stamps(block, layout, log_ns)
    stamp = ros_stamps(block, layout)
    return np.where(stamp == 0, log_ns, stamp)


@dataclass
class PlainDecoder:
    """Decodes the IMU samples, magnetic fields or poses of one topic, a batch at a time."""

    topic: Topic
    kind: str  # Of `_COLUMNS`
    grouper: Grouper  # Sorts its messages by layout
    frame_id: str = ""
    gathered: list[Column] = field(default_factory=list)

    def feed(self, messages: TopicMessages) -> None:
        """Take a batch of messages."""
        parts = []
        for index, block, layout in self.grouper.groups_in(messages.chunk, messages.start, messages.stop):
            self.frame_id = layout.texts.get("frame_id", self.frame_id)
            log_ns = messages.log_ns[index]
            stamp = stamps_of(block, layout, log_ns)
            columns = (self._column(block, layout, *names) for names in _COLUMNS[self.kind])
            parts.append((index, stamp, log_ns - stamp, *columns))
        for column, values in enumerate(in_order(parts)):
            if column == len(self.gathered):
                self.gathered.append(Column(values.shape[1:], values.dtype))
            self.gathered[column].append(values)

    def _column(self, block: Block, layout: MessageLayout, ros: str, name: str, letters: str) -> FloatArray:
        """Values (rows, k); a magnetometer that is not there, and an orientation of zeros, is nan."""
        names = axes(name, letters)
        if ros in layout.fields:
            values = layout.get(block, ros).astype(float)
        elif name == "magnetic_field" and not layout.fields.keys() & set(names):
            values = np.full((len(block), 3), np.nan)
        else:
            values = layout.vector(block, names)
        if letters == "xyzw":
            values = values[:, [3, 0, 1, 2]]
            values[~(np.linalg.norm(values, axis=1) > 0.5)] = np.nan
        return values

    def joined(self) -> list[NDArray]:
        """Stamps, log times less stamps, and columns of all messages, in the file's order."""
        return [column.done() for column in self.gathered]

    def stream(self) -> ImuSamples | FieldSamples | PoseSamples | None:
        """All samples, or None where there are none."""
        if not self.gathered:
            return None
        stamp, delay, *columns = self.joined()
        named = (self.topic.label, self.frame_id, stamp)
        if self.kind == "field":
            return FieldSamples(*named, *columns)
        if self.kind == "pose":
            position, quaternion = columns
            return PoseSamples(*named, position, quaternion)
        acc, gyro, mag = columns
        shift = int(np.median(sampled(delay)))
        return ImuSamples(*named, acc, gyro, mag if np.isfinite(mag).any() else None, shift)


def in_order(parts: Sequence[tuple[NDArray, ...]]) -> list[NDArray]:
    """Columns of parts put together by the first of them, which is left out; none of no parts."""
    if len(parts) == 1:
        return list(parts[0][1:])
    if not parts:
        return []
    order = np.argsort(np.concatenate([part[0] for part in parts]), kind="stable")
    return [np.concatenate(column)[order] for column in zip(*(part[1:] for part in parts), strict=True)]


def proto_grouper(schema: str) -> Grouper:
    """Grouper for a protobuf message by its full name."""
    return Grouper(partial(proto.walk, message=message_class(schema)))


SIDES = ("", "left", "right")
#: The schema of keypoints in an image; a keypoint counts as tracked from this score on, as guessed from that.
KEYPOINTS = "unocclude.Keypoints2D"
TRACKED_SCORE, INFERRED_SCORE = 0.5, 0.1


def states_of_scores(score: FloatArray) -> NDArray[np.int8]:
    """The state of joints by a network's scores, 0 to 1; nan is none."""
    with np.errstate(invalid="ignore"):
        tracked, inferred = score >= TRACKED_SCORE, score >= INFERRED_SCORE
    return np.where(tracked, JointState.TRACKED, np.where(inferred, JointState.INFERRED, 0)).astype(np.int8)


#: State of a joint that a row does not contain.
UNREPORTED = -128


class JointRows:
    """Arms in messages, gathered over a recording: a row is one arm in one message."""

    def __init__(self) -> None:
        self._message = Column((), np.int64)
        self._arm = Column((), np.int64)
        self._arms: set[int] = set()
        self._position = Column((len(JOINTS), 3))
        self._state = Column((len(JOINTS),), np.int8)

    def add(
        self, message: IntArray, body: IntArray, side: IntArray, state: NDArray[np.int8], position: FloatArray
    ) -> None:
        """Take rows."""
        position[(state == JointState.NOT_TRACKED) | (state == UNREPORTED)] = np.nan
        arm = body * len(SIDES) + side
        self._arms.update(np.unique(arm).tolist())
        self._arm.append(arm)
        self._message.append(message)
        self._state.append(state)
        self._position.append(position)

    def add_joints(
        self,
        message: IntArray,
        body: IntArray,
        side: IntArray,
        joint: IntArray,
        state: IntArray,
        position: FloatArray,
    ) -> None:
        """Take joints (n,) one by one, with positions (n, 3); of a joint said twice the last counts."""
        if not len(message):
            return
        arms, arm = np.unique(body * len(SIDES) + side, return_inverse=True)
        code, row = np.unique(message * len(arms) + arm, return_inverse=True)
        states = np.full((len(code), len(JOINTS)), UNREPORTED, np.int8)
        positions = np.full((len(code), len(JOINTS), 3), np.nan)
        states[row, joint], positions[row, joint] = state, position
        which, side_of = np.divmod(arms[code % len(arms)], len(SIDES))
        self.add(code // len(arms), which, side_of, states, positions)

    def arms(
        self, stamp_ns: IntArray, topic: str, frame_id: str, camera_frame: CameraFrame | None
    ) -> list[ArmFrames]:
        """Every arm of every body; all frames belong to all of them, so that absence is seen."""
        if not len(self._message):
            return []
        frames, number = frames_of(stamp_ns)
        message, arm = self._message.done(), self._arm.done()
        position, state = self._position.done(), self._state.done()
        frame = message if number is None else number[message]
        arms = []
        for which in sorted(self._arms):
            body, side = divmod(which, len(SIDES))
            positions = large_array((len(frames), len(JOINTS), 3))
            states = np.zeros((len(frames), len(JOINTS)), np.int8)
            for part in batches(len(frame)):
                mine = arm[part] == which
                at, said, there = frame[part][mine], state[part][mine], position[part][mine]
                row, joint = np.nonzero(said != UNREPORTED)
                states[at[row], joint] = said[row, joint]
                positions[at[row], joint] = there[row, joint]
            arms.append(
                ArmFrames(topic, frame_id, body, SIDES[side], frames, positions, states, camera_frame)
            )
        return arms


def frames_of(stamp_ns: IntArray) -> tuple[IntArray, IntArray | None]:
    """Different stamps in the order in which they came first, and which of them each is (None: its own)."""
    if (stamp_ns[1:] > stamp_ns[:-1]).all():
        return stamp_ns, None
    unique, first, which = np.unique(stamp_ns, return_index=True, return_inverse=True)
    order = np.argsort(first)
    rank = np.empty(len(unique), np.int64)
    rank[order] = np.arange(len(unique))
    return unique[order], rank[which]


#: Joint index of the Azure Kinect Body Tracking SDK to side and joint, as positions in SIDES, JOINTS.
_AZURE = {5: (1, 0), 6: (1, 1), 7: (1, 2), 8: (1, 3), 12: (2, 0), 13: (2, 1), 14: (2, 2), 15: (2, 3)}
_AZURE_JOINTS = 32
_ADD = 0  # Marker.ADD; the others delete


def joint_code(name: str) -> tuple[int, int] | None:
    """Position in SIDES and in JOINTS of a joint's name (`wrist`, `wrist_left`); None for others."""
    joint, _, side = name.strip().lower().partition("_")
    return (SIDES.index(side), JOINTS.index(joint)) if joint in JOINTS and side in SIDES else None


@dataclass
class SkeletonDecoder:
    """unocclude.Skeleton or Keypoints2D: one body, or an arm of it, a message, or an image."""

    topic: Topic
    grouper: Grouper
    frame_id: str = ""

    def __post_init__(self) -> None:
        self._rows = JointRows()
        self._stamps = Column((), np.int64)

    def feed(self, messages: TopicMessages) -> None:
        """Take a batch of messages."""
        stamps, arms = [], []
        for index, block, layout in self.grouper.groups_in(messages.chunk, messages.start, messages.stop):
            self.frame_id = layout.texts.get("frame_id", self.frame_id)
            stamps.append((index, index, proto.stamps(block, layout, messages.log_ns[index])))
            arms += self._arms(index, block, layout)
        if not stamps:
            return
        read, stamp = in_order(stamps)
        if arms:
            message, *columns = in_order(arms)
            self._rows.add(np.searchsorted(read, message) + len(self._stamps), *columns)
        self._stamps.append(stamp)

    def _arms(self, index: IntArray, block: Block, layout: MessageLayout) -> list[tuple[NDArray, ...]]:
        """Each side in messages of one layout."""
        body, count = layout.integer(block, "body") & 0xFFFFFFFF, len(block)
        sides: dict[int, tuple[NDArray, NDArray]] = {}
        elements = "keypoints" if self.is_flat else "joints"
        for i in range(layout.counts.get(elements, 0)):
            path = f"{elements}.{i}"
            code = joint_code(layout.texts.get(f"{path}.name", ""))
            if code is None:
                continue
            side, joint = code
            if side not in sides:
                shape = (count, len(JOINTS))
                sides[side] = np.full(shape, UNREPORTED, np.int8), np.full((*shape, 3), np.nan)
            state, position = sides[side]
            state[:, joint], position[:, joint] = self._joint(block, layout, path)
        return [(index, index, body, np.full(count, side), *said) for side, said in sorted(sides.items())]

    @property
    def is_flat(self) -> bool:
        """Whether it has keypoints in images."""
        return self.topic.schema == KEYPOINTS

    def _joint(self, block: Block, layout: MessageLayout, path: str) -> tuple[NDArray, FloatArray]:
        """States (rows,) and positions (rows, 3) of a joint; of a keypoint u, v and the score."""
        if self.is_flat:
            values = layout.vector(block, [f"{path}.{name}" for name in ("u", "v", "score")])
            return states_of_scores(values[:, 2]), values
        said = layout.integer(block, f"{path}.state")
        if (said.view(np.uint64) > JointState.TRACKED).any():  # damaged
            said = np.where(said.view(np.uint64) > JointState.TRACKED, JointState.NOT_TRACKED, said)
        return said, layout.vector(block, axes(f"{path}.position"))

    def found(self) -> tuple[IntArray, list[ArmFrames]]:
        """Stamps of all messages, ns, and all arms; asked for once."""
        stamp_ns = self._stamps.done()
        return stamp_ns, self._rows.arms(stamp_ns, self.topic.label, self.frame_id, None)

    def arms(self) -> list[ArmFrames]:
        """All arms found; asked for once."""
        return self.found()[1]


@dataclass
class MarkerDecoder:
    """visualization_msgs/msg/MarkerArray as the Azure Kinect ROS driver publishes body tracking."""

    topic: Topic
    grouper: Grouper
    frame_id: str = ""
    foreign: int = 0
    seen: int = 0

    def __post_init__(self) -> None:
        self._rows = JointRows()
        self._log: list[IntArray] = []
        self._stamp: list[IntArray] = []
        self._fed = 0

    def feed(self, messages: TopicMessages) -> None:
        """Take a batch of messages."""
        stamps = np.zeros(len(messages.start), np.int64)
        joints: list[tuple[NDArray, ...]] = []
        for index, block, layout in self.grouper.groups_in(messages.chunk, messages.start, messages.stop):
            if not layout.counts["markers"]:
                continue
            self.frame_id = layout.texts.get("frame_id", self.frame_id)
            stamp = stamps_of(block, layout, messages.log_ns[index])
            added = layout.many(block, "action")[:, :, 0] == _ADD
            stamps[index] = np.where(added.any(axis=1), stamp, 0)
            joints += self._joints(index, added, block, layout)
        if joints:
            message, *columns = in_order(joints)
            self._rows.add_joints(message + self._fed, *columns)
        self._log.append(messages.log_ns)
        self._stamp.append(stamps)
        self._fed += len(stamps)

    def _joints(
        self, index: IntArray, added: NDArray[np.bool_], block: Block, layout: MessageLayout
    ) -> list[tuple[NDArray, ...]]:
        ids = layout.many(block, "id")[:, :, 0].astype(np.int64)
        azure = ids % 100
        self.seen += int(added.sum())
        self.foreign += int((added & (azure >= _AZURE_JOINTS)).sum())
        position = layout.many(block, "position").astype(float)
        joints: list[tuple[NDArray, ...]] = []
        for number, (side, joint) in _AZURE.items():
            row, column = np.nonzero(added & (azure == number) & (ids >= 0))
            if len(row):
                values = (np.full(len(row), value) for value in (side, joint, int(JointState.TRACKED)))
                message, body = index[row], ids[row, column] // 100
                joints.append((message, message, body, *values, position[row, column]))
        return joints

    def arms(self) -> list[ArmFrames]:
        """All arms found, asked for once; none where the markers are of another kind."""
        if not self._log or self.foreign > 0.05 * self.seen:
            return []
        log, stamp = np.concatenate(self._log), np.concatenate(self._stamp)
        has = stamp != 0
        if has.any() and not has.all():
            delay = np.interp(np.arange(len(log)), np.flatnonzero(has), (log - stamp)[has].astype(float))
            stamp = np.where(has, stamp, log - delay.astype(np.int64))
        return self._rows.arms(stamp, self.topic.label, self.frame_id, CameraFrame.OPTICAL)


Decoder = PlainDecoder | SkeletonDecoder | MarkerDecoder


def decoder_of(topic: Topic) -> Decoder | None:
    """The decoder of a topic of IMU samples, magnetic fields, poses or skeletons; None for other topics."""
    key = topic.encoding, topic.schema.replace("/msg/", "/")
    if key in _PLAIN:
        kind, walk = _PLAIN[key]
        grouper = proto_grouper(topic.schema) if walk is None else Grouper(walk)
        return PlainDecoder(topic, kind, grouper)
    if key in (("protobuf", "unocclude.Skeleton"), ("protobuf", KEYPOINTS)):
        return SkeletonDecoder(topic, proto_grouper(topic.schema))
    if key == ("cdr", "visualization_msgs/MarkerArray"):
        textured = b"texture_resource" in topic.schema_data or not topic.schema_data
        return MarkerDecoder(topic, Grouper(partial(cdr.marker_array, textured=textured)))
    return None
