"""Skeleton messages to the arms that they show."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np
from numpy.typing import NDArray

from ..recording import JOINTS, CameraFrame, FloatArray, IntArray, JointState
from . import cdr, proto
from .decode import proto_grouper
from .layout import Block, Grouper, Layout
from .messages import Message, Topic
from .streams import ArmFrames

_BILLION = 1_000_000_000
SIDES = ("", "left", "right")
#: Joint index of the Azure Kinect Body Tracking SDK to side and joint, as positions in SIDES, JOINTS.
_AZURE = {5: (1, 0), 6: (1, 1), 7: (1, 2), 8: (1, 3), 12: (2, 0), 13: (2, 1), 14: (2, 2), 15: (2, 3)}
_AZURE_JOINTS = 32
_ADD = 0  # Marker.ADD; the others delete


def joint_code(name: str) -> tuple[int, int] | None:
    """Position in SIDES and in JOINTS of a joint's name (`wrist`, `wrist_left`); None for others."""
    joint, _, side = name.strip().lower().partition("_")
    return (SIDES.index(side), JOINTS.index(joint)) if joint in JOINTS and side in SIDES else None


@dataclass
class JointRows:
    """Joints as rows, gathered over a recording, and what becomes of them.

    Each call of `add` takes arrays (rows,) of the frame's stamp, body, side, joint, state, and the
    position (rows, 3).
    """

    frames: list[IntArray] = field(default_factory=list)
    rows: list[tuple[NDArray, ...]] = field(default_factory=list)

    def add(
        self,
        stamp: IntArray,
        body: IntArray,
        side: IntArray,
        joint: IntArray,
        state: IntArray,
        position: FloatArray,
    ) -> None:
        """Take rows."""
        self.rows.append((stamp, body, side, joint, state, position))

    def arms(self, topic: str, frame_id: str, camera_frame: CameraFrame | None) -> list[ArmFrames]:
        """Every arm of every body; all frames belong to all of them, so that absence is seen."""
        if not self.rows:
            return []
        stamp, body, side, joint, state, position = map(np.concatenate, zip(*self.rows, strict=True))
        unique, first = np.unique(np.concatenate(self.frames), return_index=True)
        frames = unique[np.argsort(first)]  # in the order they came, so that backward stamps are seen
        rank = np.empty(len(unique), np.int64)
        rank[np.argsort(first)] = np.arange(len(unique))
        frame = rank[np.searchsorted(unique, stamp)]
        arms = []
        for which in np.unique(body * len(SIDES) + side):
            mine = body * len(SIDES) + side == which
            positions = np.full((len(frames), len(JOINTS), 3), np.nan)
            states = np.zeros((len(frames), len(JOINTS)), np.int8)
            positions[frame[mine], joint[mine]] = position[mine]
            states[frame[mine], joint[mine]] = state[mine]
            positions[states == JointState.NOT_TRACKED] = np.nan
            number, side_index = divmod(int(which), len(SIDES))
            arms.append(
                ArmFrames(topic, frame_id, number, SIDES[side_index], frames, positions, states, camera_frame)
            )
        return arms


@dataclass
class SkeletonDecoder:
    """unocclude.Skeleton: one body, or an arm of it, a message."""

    topic: Topic
    grouper: Grouper
    frame_id: str = ""
    rows: JointRows = field(default_factory=JointRows)
    camera_frame: CameraFrame | None = None

    def feed(self, messages: Sequence[Message]) -> None:
        """Take a batch of messages."""
        log_ns = np.array([message.log_ns for message in messages], np.uint64).astype(np.int64)
        stamps = np.zeros(len(messages), np.int64)
        read = np.zeros(len(messages), bool)
        for index, block, layout in self.grouper.groups([bytes(message.data) for message in messages]):
            self.frame_id = layout.texts.get("frame_id", self.frame_id)
            stamp = proto.stamps(block, layout, log_ns[index])
            stamps[index], read[index] = stamp, True
            self._joints(stamp, block, layout)
        self.rows.frames.append(stamps[read])

    def _joints(self, stamp: IntArray, block: Block, layout: Layout) -> None:
        body = layout.integer(block, "body")
        for i in range(layout.counts.get("joints", 0)):
            code = joint_code(layout.texts.get(f"joints.{i}.name", ""))
            if code is None:
                continue
            side, joint = (np.full(len(block), value) for value in code)
            position = layout.vector(block, [f"joints.{i}.position.{axis}" for axis in "xyz"])
            self.rows.add(stamp, body, side, joint, layout.integer(block, f"joints.{i}.state"), position)

    def arms(self) -> list[ArmFrames]:
        """All arms found."""
        return self.rows.arms(self.topic.name, self.frame_id, self.camera_frame)


@dataclass
class MarkerDecoder:
    """visualization_msgs/msg/MarkerArray as the Azure Kinect ROS driver publishes body tracking.

    A marker's id is body * 100 + joint index; a body that was not found has no markers, and an
    array without markers has no stamp: its time is the log time, less the delay of its neighbours.
    """

    topic: Topic
    grouper: Grouper
    frame_id: str = ""
    rows: JointRows = field(default_factory=JointRows)
    foreign: int = 0
    seen: int = 0
    _log: list[IntArray] = field(default_factory=list)
    _stamp: list[IntArray] = field(default_factory=list)

    def feed(self, messages: Sequence[Message]) -> None:
        """Take a batch of messages."""
        log_ns = np.array([message.log_ns for message in messages], np.uint64).astype(np.int64)
        stamps = np.zeros(len(messages), np.int64)
        for index, block, layout in self.grouper.groups([bytes(message.data) for message in messages]):
            if not layout.counts["markers"]:
                continue
            self.frame_id = layout.texts.get("frame_id", self.frame_id)
            seconds = layout.get(block, "sec")[:, 0].astype(np.int64)
            stamp = seconds * _BILLION + layout.get(block, "nsec")[:, 0].astype(np.int64)
            stamp = np.where(stamp == 0, log_ns[index], stamp)
            added = layout.many(block, "action")[:, :, 0] == _ADD
            stamps[index] = np.where(added.any(axis=1), stamp, 0)
            self._markers(stamp, added, block, layout)
        self._log.append(log_ns)
        self._stamp.append(stamps)

    def _markers(self, stamp: IntArray, added: NDArray[np.bool_], block: Block, layout: Layout) -> None:
        ids = layout.many(block, "id")[:, :, 0].astype(np.int64)
        index = ids % 100
        self.seen += int(added.sum())
        self.foreign += int((added & (index >= _AZURE_JOINTS)).sum())
        position = layout.many(block, "position").astype(float)
        for azure, (side, joint) in _AZURE.items():
            row, column = np.nonzero(added & (index == azure) & (ids >= 0))
            if len(row):
                constant = np.ones(len(row), np.int64)
                state = constant * JointState.TRACKED
                body = ids[row, column] // 100
                self.rows.add(
                    stamp[row], body, constant * side, constant * joint, state, position[row, column]
                )

    def arms(self) -> list[ArmFrames]:
        """All arms found; none where the markers are of another kind."""
        if not self._log or self.foreign > 0.05 * self.seen:
            return []
        log, stamp = np.concatenate(self._log), np.concatenate(self._stamp)
        has = stamp != 0
        if has.any():
            delay = np.interp(np.arange(len(log)), np.flatnonzero(has), (log - stamp)[has].astype(float))
            stamp = np.where(has, stamp, log - delay.astype(np.int64))
        self.rows.frames = [stamp]
        return self.rows.arms(self.topic.name, self.frame_id, CameraFrame.OPTICAL)


def skeleton_decoder(topic: Topic) -> SkeletonDecoder | MarkerDecoder | None:
    """The decoder of a skeleton topic; None for other topics."""
    if topic.encoding == "protobuf" and topic.schema == "unocclude.Skeleton":
        return SkeletonDecoder(topic, proto_grouper(topic.schema))
    if topic.encoding == "cdr" and topic.schema.replace("/msg/", "/") == "visualization_msgs/MarkerArray":
        textured = b"texture_resource" in topic.schema_data or not topic.schema_data
        return MarkerDecoder(topic, Grouper(partial(cdr.marker_array, textured=textured)))
    return None
