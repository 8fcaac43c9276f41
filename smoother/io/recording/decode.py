"""Messages of IMUs, poses and skeletons decoded in batches."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np
from numpy.typing import NDArray

from ...array_types import FloatArray, IntArray
from ...recording import JOINTS, CameraFrame, JointState
from ...runtime.store import GatheredRows, batches, large_array, sampled
from ..mcap.messages import Messages, Topic
from ..wire import cdr
from ..wire import protobuf_decode as proto
from ..wire.layout import Block, Grouper, MessageLayout, axes
from ..wire.schemas import message_class
from .streams import ArmFrames, FieldSamples, ImuSamples, PoseSamples

#: Streams of plain columns by encoding and schema.
_PLAIN = {
    ("cdr", "sensor_msgs/Imu"): "imu",
    ("cdr", "sensor_msgs/MagneticField"): "field",
    ("cdr", "geometry_msgs/PoseStamped"): "pose",
    ("protobuf", "unocclude.Imu"): "imu",
    ("protobuf", "foxglove.PoseInFrame"): "pose",
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


@dataclass
class PlainDecoder:
    """Decodes the IMU samples, magnetic fields or poses of one topic, a batch at a time."""

    topic: Topic
    kind: str  # Of `_COLUMNS`
    grouper: Grouper  # Sorts its messages by layout
    frame_id: str = ""
    _gathered: list[GatheredRows] = field(default_factory=list)

    def feed(self, messages: Messages) -> None:
        """Take a batch of messages."""
        parts = []
        for index, block, layout in self.grouper.groups_in(messages.chunk, messages.start, messages.stop):
            self.frame_id = layout.texts.get("frame_id", self.frame_id)
            log_ns = messages.log_ns[index]
            stamp = layout.stamps(block, log_ns)
            columns = (self._column(block, layout, *names) for names in _COLUMNS[self.kind])
            parts.append((index, stamp, log_ns - stamp, *columns))
        for column, values in enumerate(in_order(parts)):
            if column == len(self._gathered):
                self._gathered.append(GatheredRows(values.shape[1:], values.dtype))
            self._gathered[column].append(values)

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

    def stamps(self) -> IntArray:
        """Of all messages, ns; asked for once, as `stream` is."""
        return self._gathered[0].done() if self._gathered else np.empty(0, np.int64)

    def stream(self) -> ImuSamples | FieldSamples | PoseSamples | None:
        """All samples in the file's order, or None where there are none."""
        if not self._gathered:
            return None
        stamp, delay, *columns = (column.done() for column in self._gathered)
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
    return [column[order] for column in _behind_each_other(parts)]


def _behind_each_other(parts: Sequence[tuple[NDArray, ...]]) -> list[NDArray]:
    """Columns of parts, without the first."""
    return [np.concatenate(column) for column in zip(*(part[1:] for part in parts), strict=True)]


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


class JointRows:
    """Joints in messages, gathered over a recording: a row is one joint of an arm in one message."""

    def __init__(self) -> None:
        self._message, self._body = GatheredRows((), np.int64), GatheredRows((), np.int64)
        self._codes = GatheredRows((3,), np.int8)  # side, joint, state
        self._position = GatheredRows((3,))
        self._arms: set[tuple[int, int]] = set()

    def add(
        self,
        message: IntArray,
        body: IntArray,
        side: IntArray,
        joint: IntArray,
        state: IntArray,
        position: FloatArray,
    ) -> None:
        """Take joints (n,) with positions (n, 3); of a joint said twice in a message the last counts."""
        position[state == JointState.NOT_TRACKED] = np.nan
        arms = np.unique(body * len(SIDES) + side).tolist()
        self._arms |= {divmod(arm, len(SIDES)) for arm in arms}
        self._message.append(message)
        self._body.append(body)
        self._codes.append(np.stack([side, joint, state], axis=1).astype(np.int8))
        self._position.append(position)

    def arms(
        self, stamp_ns: IntArray, topic: str, frame_id: str, camera_frame: CameraFrame | None
    ) -> list[ArmFrames]:
        """Every arm of every body; all frames belong to all of them, so that absence is seen."""
        if not len(self._message):
            return []
        frames, number = frames_of(stamp_ns)
        message, body, codes = self._message.done(), self._body.done(), self._codes.done()
        position = self._position.done()
        arms = []
        for of_body, of_side in sorted(self._arms):
            positions = large_array((len(frames), len(JOINTS), 3))
            states = np.zeros((len(frames), len(JOINTS)), np.int8)
            for part in batches(len(message)):
                mine = (body[part] == of_body) & (codes[part, 0] == of_side)
                at, (_, joint, state) = message[part][mine], codes[part][mine].T
                row = at if number is None else number[at]
                states[row, joint], positions[row, joint] = state, position[part][mine]
            named = (topic, frame_id, of_body, SIDES[of_side])
            arms.append(ArmFrames(*named, frames, positions, states, camera_frame))
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


#: Rows of a batch with a joint, and its body, side, joint, state and position.
_Said = tuple[IntArray, IntArray, int, int, IntArray, FloatArray]


@dataclass
class JointDecoder:
    """unocclude.Skeleton or Keypoints2D: one body, or an arm of it, a message, or an image."""

    topic: Topic
    grouper: Grouper
    frame_id: str = ""
    camera_frame: CameraFrame | None = None

    def __post_init__(self) -> None:
        self._rows, self._stamps, self._logs = (
            JointRows(),
            GatheredRows((), np.int64),
            GatheredRows((), np.int64),
        )

    def feed(self, messages: Messages) -> None:
        """Take a batch of messages."""
        stamps: list[tuple[NDArray, ...]] = []
        joints: list[tuple[NDArray, ...]] = []
        for index, block, layout in self.grouper.groups_in(messages.chunk, messages.start, messages.stop):
            self.frame_id = layout.texts.get("frame_id", self.frame_id)
            log_ns = messages.log_ns[index]
            stamp, said = self._decoded(block, layout, log_ns)
            stamps.append((index, index, stamp, log_ns))
            for row, body, side, joint, state, position in said:
                codes = (np.full(len(row), code, np.int64) for code in (side, joint))
                joints.append((index[row], index[row], body, *codes, state, position))
        if not stamps:
            return
        read, stamp, log_ns = in_order(stamps)
        if joints:
            message, *columns = in_order(joints) if len(stamps) > 1 else _behind_each_other(joints)
            self._rows.add(np.searchsorted(read, message) + len(self._stamps), *columns)
        self._stamps.append(stamp)
        self._logs.append(log_ns)

    def _decoded(self, block: Block, layout: MessageLayout, log_ns: IntArray) -> tuple[IntArray, list[_Said]]:
        """Stamps (rows,), zero where there is none, and the joints in messages of one layout."""
        said: list[_Said] = []
        body, row = layout.integer(block, "body") & 0xFFFFFFFF, np.arange(len(block))
        elements = "keypoints" if self.is_flat else "joints"
        for i in range(layout.counts.get(elements, 0)):
            path = f"{elements}.{i}"
            if (code := joint_code(layout.texts.get(f"{path}.name", ""))) is not None:
                said.append((row, body, *code, *self._joint(block, layout, path)))
        return layout.stamps(block, log_ns), said

    @property
    def is_flat(self) -> bool:
        """Whether it has keypoints in images."""
        return self.topic.schema == KEYPOINTS

    def _joint(self, block: Block, layout: MessageLayout, path: str) -> tuple[IntArray, FloatArray]:
        """States (rows,) and positions (rows, 3) of a joint; of a keypoint u, v and the score."""
        if self.is_flat:
            values = layout.vector(block, [f"{path}.{name}" for name in ("u", "v", "score")])
            return states_of_scores(values[:, 2]).astype(np.int64), values
        said = layout.integer(block, f"{path}.state").view(np.uint64)
        state = np.where(said > JointState.TRACKED, JointState.NOT_TRACKED, said)  # damaged
        return state.astype(np.int64), layout.vector(block, axes(f"{path}.position"))

    def stamps(self) -> IntArray:
        """Of all messages, ns; where there is none, as far before the log time as those around it."""
        stamp, log = self._stamps.done(), self._logs.done()
        has = stamp != 0
        if has.any() and not has.all():
            delay = np.interp(np.arange(len(log)), np.flatnonzero(has), (log - stamp)[has].astype(float))
            stamp = np.where(has, stamp, log - delay.astype(np.int64))
        return stamp

    def arms(self) -> list[ArmFrames]:
        """All arms found; asked for once."""
        return self._rows.arms(self.stamps(), self.topic.label, self.frame_id, self.camera_frame)


@dataclass
class MarkerDecoder(JointDecoder):
    """visualization_msgs/msg/MarkerArray as the Azure Kinect ROS driver publishes body tracking."""

    camera_frame: CameraFrame | None = CameraFrame.OPTICAL
    foreign: int = 0
    seen: int = 0

    def _decoded(self, block: Block, layout: MessageLayout, log_ns: IntArray) -> tuple[IntArray, list[_Said]]:
        if not layout.counts["markers"]:
            return np.zeros(len(block), np.int64), []
        ids = layout.many(block, "id")[:, :, 0].astype(np.int64)
        added = layout.many(block, "action")[:, :, 0] == _ADD
        position, azure = layout.many(block, "position").astype(float), ids % 100
        self.seen += int(added.sum())
        self.foreign += int((added & (azure >= _AZURE_JOINTS)).sum())
        said: list[_Said] = []
        for number, code in _AZURE.items():
            row, column = np.nonzero(added & (azure == number) & (ids >= 0))
            state = np.full(len(row), int(JointState.TRACKED))
            said.append((row, ids[row, column] // 100, *code, state, position[row, column]))
        return np.where(added.any(axis=1), layout.stamps(block, log_ns), 0), said

    def arms(self) -> list[ArmFrames]:
        """All arms found, asked for once; none where the markers are of another kind."""
        return [] if self.foreign > 0.05 * self.seen else super().arms()


Decoder = PlainDecoder | JointDecoder


def decoder_of(topic: Topic) -> Decoder | None:
    """The decoder of a topic of IMU samples, magnetic fields, poses or skeletons; None for other topics."""
    key = topic.encoding, topic.schema.replace("/msg/", "/")
    if key in _PLAIN:
        is_ros = topic.encoding == "cdr"
        grouper = Grouper(partial(cdr.walk, kind=key[1])) if is_ros else proto_grouper(topic.schema)
        return PlainDecoder(topic, _PLAIN[key], grouper)
    if key in (("protobuf", "unocclude.Skeleton"), ("protobuf", KEYPOINTS)):
        return JointDecoder(topic, proto_grouper(topic.schema))
    if key == ("cdr", "visualization_msgs/MarkerArray"):
        return MarkerDecoder(topic, Grouper(cdr.markers_of(topic.schema_data)))
    return None
