"""Messages of IMUs, poses and skeletons decoded in batches."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from ...array_types import FloatArray, IntArray
from ...recording import JOINTS, CameraFrame, JointState
from ...runtime.store import Column, Store, batches, sampled
from ..mcap.messages import Topic, TopicMessages, ros_stamps
from ..wire import cdr
from ..wire import protobuf_decode as proto
from ..wire.layout import Block, Grouper, MessageLayout, axes
from ..wire.schemas import message_class
from .streams import ArmFrames, FieldSamples, ImuSamples, PoseSamples


@dataclass
class Decoder:
    """Decodes the messages of one topic, a batch at a time."""

    topic: Topic  # The topic
    grouper: Grouper  # Sorts its messages by layout
    is_cdr: bool = True
    store: Store = field(default_factory=Store)
    frame_id: str = ""
    gathered: list[Column] = field(default_factory=list)
    #: Columns that may hold nothing.
    optional: ClassVar[Collection[int]] = ()

    def feed(self, messages: TopicMessages) -> None:
        """Take a batch of messages."""
        parts = []
        for index, block, layout in self.grouper.groups_in(messages.chunk, messages.start, messages.stop):
            self.frame_id = layout.texts.get("frame_id", self.frame_id)
            log_ns = messages.log_ns[index]
            stamp = self.stamps(block, layout, log_ns)
            parts.append((index, stamp, log_ns - stamp, *self.columns(block, layout)))
        for column, values in enumerate(in_order(parts)):
            if column == len(self.gathered):
                optional = column in self.optional
                self.gathered.append(Column(self.store, values.shape[1:], values.dtype, optional))
            self.gathered[column].append(values)

    def stamps(self, block: Block, layout: MessageLayout, log_ns: IntArray) -> IntArray:
        """Stamps (rows,), ns; log times where they are zero."""
        if not self.is_cdr:
            return proto.stamps(block, layout, log_ns)
        stamp = ros_stamps(block, layout)
        return np.where(stamp == 0, log_ns, stamp)

    def columns(self, block: Block, layout: MessageLayout) -> tuple[FloatArray, ...]:
        """What the messages carry, an array (rows, ...) each."""
        raise NotImplementedError

    def joined(self) -> list[NDArray]:
        """Stamps, log times less stamps, and columns of all messages, in the file's order."""
        return [column.done() for column in self.gathered]


class ImuDecoder(Decoder):
    """sensor_msgs/msg/Imu and unocclude.Imu."""

    optional = (4,)

    def columns(self, block: Block, layout: MessageLayout) -> tuple[FloatArray, ...]:
        """Specific force, angular velocity, magnetic field (nan where there is none)."""
        nothing = np.full((len(block), 3), np.nan)
        if self.is_cdr:
            acc, gyro = layout.get(block, "acc"), layout.get(block, "gyro")
            return acc.astype(float), gyro.astype(float), nothing
        acc = layout.vector(block, axes("linear_acceleration"))
        gyro = layout.vector(block, axes("angular_velocity"))
        has_mag = any(name in layout.fields for name in axes("magnetic_field"))
        return acc, gyro, layout.vector(block, axes("magnetic_field")) if has_mag else nothing

    def stream(self) -> ImuSamples | None:
        """All samples, or None where there are none."""
        if not self.gathered:
            return None
        stamp, delay, acc, gyro, mag = self.joined()
        has_mag = any(np.isfinite(mag[part]).any() for part in batches(len(mag)))
        shift = int(np.median(sampled(delay)))
        return ImuSamples(self.topic.label, self.frame_id, stamp, acc, gyro, mag if has_mag else None, shift)


class FieldDecoder(Decoder):
    """sensor_msgs/msg/MagneticField."""

    def columns(self, block: Block, layout: MessageLayout) -> tuple[FloatArray, ...]:
        """Magnetic field."""
        return (layout.get(block, "mag").astype(float),)

    def stream(self) -> FieldSamples | None:
        """All samples, or None where there are none."""
        if not self.gathered:
            return None
        stamp, _, mag = self.joined()
        return FieldSamples(self.topic.label, self.frame_id, stamp, mag)


class PoseDecoder(Decoder):
    """geometry_msgs/msg/PoseStamped and foxglove.PoseInFrame."""

    def columns(self, block: Block, layout: MessageLayout) -> tuple[FloatArray, ...]:
        """Position, quaternion (qw, qx, qy, qz); an orientation of zeros is none."""
        if self.is_cdr:
            position = layout.get(block, "position").astype(float)
            quaternion = layout.get(block, "quaternion").astype(float)[:, [3, 0, 1, 2]]
        else:
            position = layout.vector(block, axes("pose.position"))
            quaternion = layout.vector(block, axes("pose.orientation", "wxyz"))
        quaternion[~(np.linalg.norm(quaternion, axis=1) > 0.5)] = np.nan
        return position, quaternion

    def stream(self) -> PoseSamples | None:
        """All poses, or None where there are none."""
        if not self.gathered:
            return None
        stamp, _, position, quaternion = self.joined()
        return PoseSamples(self.topic.label, self.frame_id, stamp, position, quaternion)


def plain_decoder(topic: Topic, store: Store | None = None) -> ImuDecoder | FieldDecoder | PoseDecoder | None:
    """The decoder of a topic of IMU samples, magnetic fields or poses; None for other topics."""
    store = store or Store()
    if topic.encoding == "cdr":
        kind = topic.schema.replace("/msg/", "/")
        if kind == "sensor_msgs/Imu":
            return ImuDecoder(topic, Grouper(cdr.imu), store=store)
        if kind == "sensor_msgs/MagneticField":
            return FieldDecoder(topic, Grouper(cdr.magnetic_field), store=store)
        if kind == "geometry_msgs/PoseStamped":
            return PoseDecoder(topic, Grouper(cdr.pose_stamped), store=store)
    elif topic.encoding == "protobuf":
        if topic.schema == "unocclude.Imu":
            return ImuDecoder(topic, proto_grouper(topic.schema), is_cdr=False, store=store)
        if topic.schema == "foxglove.PoseInFrame":
            return PoseDecoder(topic, proto_grouper(topic.schema), is_cdr=False, store=store)
    return None


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
#: State of a joint that a row does not contain.
UNREPORTED = -128


class JointRows:
    """Arms in messages, gathered over a recording: a row is one arm in one message."""

    def __init__(self, store: Store | None = None):
        self._store = store or Store()
        self._message = Column(self._store, (), np.int64)
        self._arm = Column(self._store, (), np.int64)
        self._arms: set[int] = set()
        self._position = Column(self._store, (len(JOINTS), 3))
        self._state = Column(self._store, (len(JOINTS),), np.int8)

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
        alone = len(self._arms) == 1 and len(frame) == len(frames) and self._is_count(frame)
        arms = []
        for which in sorted(self._arms):
            body, side = divmod(which, len(SIDES))
            if alone:
                positions, states = (
                    position,
                    np.maximum(state, np.int8(0), out=state, where=state == UNREPORTED),
                )
            else:
                positions, states = self._scattered(frame, arm == which, position, state, len(frames))
            arms.append(
                ArmFrames(topic, frame_id, body, SIDES[side], frames, positions, states, camera_frame)
            )
        return arms

    def _scattered(
        self,
        frame: IntArray,
        mine: NDArray[np.bool_],
        position: FloatArray,
        state: NDArray[np.int8],
        count: int,
    ) -> tuple[FloatArray, NDArray[np.int8]]:
        """Rows to the frames that they are of."""
        positions = self._store.array((count, len(JOINTS), 3))
        states = np.zeros((count, len(JOINTS)), np.int8)
        for part in batches(len(frame)):
            at, said, there = frame[part][mine[part]], state[part][mine[part]], position[part][mine[part]]
            row, joint = np.nonzero(said != UNREPORTED)
            states[at[row], joint] = said[row, joint]
            positions[at[row], joint] = there[row, joint]
        return positions, states

    def _is_count(self, number: IntArray) -> bool:
        """Whether numbers (n,) are 0, 1, 2, .."""
        parts = batches(len(number))
        return all((number[part] == np.arange(part.start, part.stop)).all() for part in parts)


def frames_of(stamp_ns: IntArray) -> tuple[IntArray, IntArray | None]:
    """Different stamps in the order in which they came first, and which of them each is (None: its own)."""
    if (stamp_ns[1:] > stamp_ns[:-1]).all():
        return stamp_ns, None
    if (stamp_ns[1:] >= stamp_ns[:-1]).all():
        is_new = np.append(True, stamp_ns[1:] != stamp_ns[:-1])
        return stamp_ns[is_new], np.cumsum(is_new) - 1
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
    """unocclude.Skeleton: one body, or an arm of it, a message."""

    topic: Topic
    grouper: Grouper
    store: Store = field(default_factory=Store)
    frame_id: str = ""
    camera_frame: CameraFrame | None = None
    #: The messages' repeated field.
    elements: ClassVar[str] = "joints"

    def __post_init__(self) -> None:
        self._rows = JointRows(self.store)
        self._stamps = Column(self.store, (), np.int64)

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
        for i in range(layout.counts.get(self.elements, 0)):
            path = f"{self.elements}.{i}"
            code = joint_code(layout.texts.get(f"{path}.name", ""))
            if code is None:
                continue
            side, joint = code
            if side not in sides:
                shape = (count, len(JOINTS))
                sides[side] = np.full(shape, UNREPORTED, np.int8), np.full((*shape, 3), np.nan)
            state, position = sides[side]
            state[:, joint], position[:, joint] = self.joint(block, layout, path)
        return [(index, index, body, np.full(count, side), *said) for side, said in sorted(sides.items())]

    def joint(self, block: Block, layout: MessageLayout, path: str) -> tuple[NDArray, FloatArray]:
        """States (rows,) and positions (rows, 3) of a joint."""
        said = layout.integer(block, f"{path}.state")
        if (said.view(np.uint64) > JointState.TRACKED).any():  # damaged
            said = np.where(said.view(np.uint64) > JointState.TRACKED, JointState.NOT_TRACKED, said)
        return said, layout.vector(block, axes(f"{path}.position"))

    def found(self) -> tuple[IntArray, list[ArmFrames]]:
        """Stamps of all messages, ns, and all arms; asked for once."""
        stamp_ns = self._stamps.done()
        return stamp_ns, self._rows.arms(stamp_ns, self.topic.label, self.frame_id, self.camera_frame)

    def arms(self) -> list[ArmFrames]:
        """All arms found; asked for once."""
        return self.found()[1]


@dataclass
class MarkerDecoder:
    """visualization_msgs/msg/MarkerArray as the Azure Kinect ROS driver publishes body tracking."""

    topic: Topic
    grouper: Grouper
    store: Store = field(default_factory=Store)
    frame_id: str = ""
    foreign: int = 0
    seen: int = 0

    def __post_init__(self) -> None:
        self._rows = JointRows(self.store)
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
            stamp = ros_stamps(block, layout)
            stamp = np.where(stamp == 0, messages.log_ns[index], stamp)
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


def skeleton_decoder(topic: Topic, store: Store | None = None) -> SkeletonDecoder | MarkerDecoder | None:
    """The decoder of a skeleton topic; None for other topics."""
    store = store or Store()
    if topic.encoding == "protobuf" and topic.schema == "unocclude.Skeleton":
        return SkeletonDecoder(topic, proto_grouper(topic.schema), store)
    if topic.encoding == "cdr" and topic.schema.replace("/msg/", "/") == "visualization_msgs/MarkerArray":
        textured = b"texture_resource" in topic.schema_data or not topic.schema_data
        return MarkerDecoder(topic, Grouper(partial(cdr.marker_array, textured=textured)), store)
    return None
