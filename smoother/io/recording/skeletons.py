"""Skeleton messages to the arms that they show."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial

import numpy as np
from numpy.typing import NDArray

from ...array_types import IntArray
from ...recording import JOINTS, CameraFrame, JointState
from ...runtime.store import Column, Store
from ..mcap.messages import Topic, TopicMessages
from ..mcap.stamps import ros_stamps
from ..wire import cdr
from ..wire import protobuf_decode as proto
from ..wire.layout import Block, Grouper, MessageLayout, axes
from .decode import in_order, proto_grouper
from .joint_rows import SIDES, UNREPORTED, JointRows
from .streams import ArmFrames

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
        """What messages of one layout say of each side."""
        body, count = layout.integer(block, "body") & 0xFFFFFFFF, len(block)
        sides: dict[int, tuple[NDArray, NDArray]] = {}
        for i in range(layout.counts.get("joints", 0)):
            code = joint_code(layout.texts.get(f"joints.{i}.name", ""))
            if code is None:
                continue
            side, joint = code
            if side not in sides:
                shape = (count, len(JOINTS))
                sides[side] = np.full(shape, UNREPORTED, np.int8), np.full((*shape, 3), np.nan)
            state, position = sides[side]
            said = layout.integer(block, f"joints.{i}.state")
            if (said.view(np.uint64) > JointState.TRACKED).any():  # damaged
                said = np.where(said.view(np.uint64) > JointState.TRACKED, JointState.NOT_TRACKED, said)
            state[:, joint] = said
            position[:, joint] = layout.vector(block, axes(f"joints.{i}.position"))
        return [(index, index, body, np.full(count, side), *said) for side, said in sorted(sides.items())]

    def found(self) -> tuple[IntArray, list[ArmFrames]]:
        """Stamps of all messages, ns, and all arms; asked for once."""
        stamp_ns = self._stamps.done()
        return stamp_ns, self._rows.arms(stamp_ns, self.topic.label, self.frame_id, self.camera_frame)

    def arms(self) -> list[ArmFrames]:
        """All arms found; asked for once."""
        return self.found()[1]


@dataclass
class MarkerDecoder:
    """visualization_msgs/msg/MarkerArray as the Azure Kinect ROS driver publishes body tracking.

    A marker's id is body * 100 + joint index; a body that was not found has no markers, and an
    array without markers has no stamp: its time is the log time, less the delay of its neighbours.
    """

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
