"""Messages of IMUs, poses and skeletons decoded in batches."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np
from numpy.typing import NDArray

from ...array_types import FloatArray, IntArray
from ...recording import JOINTS, CameraFrame, JointState
from ...runtime.store import GatheredRows, batches, large_array, sampled
from ..mcap.messages import Messages, Topic
from ..wire import cdr
from ..wire import protobuf as proto
from ..wire.layout import Block, Grouper, MessageLayout, axes
from ..wire.schemas import message_class
from .streams import ArmFrames, ImuSamples, PoseSamples

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


class Decoder:
    """Decodes the messages of one topic, a batch at a time."""

    def __init__(self, topic: Topic, grouper: Grouper) -> None:
        self.topic, self.grouper, self.frame_id = topic, grouper, ""

    def groups(self, messages: Messages) -> list[tuple[IntArray, IntArray, Block, MessageLayout]]:
        """Messages of one layout each: numbers among those that can be read, log times, bytes, the layout."""
        groups = list(self.grouper.groups_in(messages.chunk, messages.start, messages.stop))
        read = np.sort(np.concatenate([index for index, _, _ in groups] or [np.empty(0, np.int64)]))
        for _, _, layout in groups:
            self.frame_id = layout.texts.get("frame_id", self.frame_id)
        return [
            (np.searchsorted(read, index), messages.log_ns[index], block, layout)
            for index, block, layout in groups
        ]


class PlainDecoder(Decoder):
    """IMU samples, magnetic fields or poses."""

    def __init__(self, topic: Topic, grouper: Grouper, kind: str) -> None:
        super().__init__(topic, grouper)
        self.kind = kind  # Of `_COLUMNS`
        # stamps, log times less stamps, the values
        self._gathered = [GatheredRows((), np.int64), GatheredRows((), np.int64)]
        self._gathered += [GatheredRows((len(letters),)) for *_, letters in _COLUMNS[kind]]

    def feed(self, messages: Messages) -> None:
        """Take a batch of messages."""
        groups = self.groups(messages)
        count = sum(len(row) for row, *_ in groups)
        columns: list[NDArray] = [np.empty(count, np.int64), np.empty(count, np.int64)]
        columns += [np.empty((count, len(letters))) for *_, letters in _COLUMNS[self.kind]]
        for row, log_ns, block, layout in groups:
            stamp = layout.stamps(block, log_ns)
            decoded = [self._column(block, layout, *names) for names in _COLUMNS[self.kind]]
            for column, values in zip(columns, (stamp, log_ns - stamp, *decoded), strict=True):
                column[row] = values
        for gathered, column in zip(self._gathered, columns, strict=True):
            gathered.append(column)

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

    def stream(self) -> ImuSamples | PoseSamples | None:
        """All samples in the file's order, asked for once; None where there are none."""
        if not len(self._gathered[0]):
            return None
        stamp, delay, *columns = (column.done() for column in self._gathered)
        named = (self.topic.label, self.frame_id, stamp)
        if self.kind == "field":
            return ImuSamples(*named, mag=columns[0])
        if self.kind == "pose":
            position, quaternion = columns
            return PoseSamples(*named, position, quaternion)
        acc, gyro, mag = columns
        shift, field = int(np.median(sampled(delay))), mag if np.isfinite(mag).any() else None
        return ImuSamples(*named, acc, gyro, field, shift, units="m/s^2, rad/s")


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
        body: IntArray | int,
        code: tuple[int, int],  # side and joint
        state: IntArray,
        position: FloatArray,
    ) -> None:
        """Take one joint (n,) with positions (n, 3); of a joint said twice in a message the last counts."""
        position[state == JointState.NOT_TRACKED] = np.nan
        bodies = np.broadcast_to(body, message.shape)
        self._arms |= {(each, code[0]) for each in np.unique(bodies).tolist()}
        self._message.append(message)
        self._body.append(bodies)
        self._codes.append(np.stack([*np.broadcast_arrays(*code, state)], axis=1).astype(np.int8))
        self._position.append(position)

    def arms(
        self, stamp_ns: IntArray, topic: str, frame_id: str, camera_frame: CameraFrame | None
    ) -> list[ArmFrames]:
        """Every arm of every body; all frames belong to all of them, so that absence is seen."""
        if not len(self._message):
            return []
        frames, number = _frames_of(stamp_ns)
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


def _frames_of(stamp_ns: IntArray) -> tuple[IntArray, IntArray | None]:
    """Different stamps in the order in which they came first, and which of them each is (None: its own)."""
    if (stamp_ns[1:] > stamp_ns[:-1]).all():
        return stamp_ns, None
    unique, first, which = np.unique(stamp_ns, return_index=True, return_inverse=True)
    order = np.argsort(first)
    return unique[order], np.argsort(order)[which]


#: Joint index of the Azure Kinect Body Tracking SDK to side and joint, as positions in SIDES, JOINTS.
_AZURE = {5: (1, 0), 6: (1, 1), 7: (1, 2), 8: (1, 3), 12: (2, 0), 13: (2, 1), 14: (2, 2), 15: (2, 3)}
_AZURE_JOINTS = 32
_ADD = 0  # Marker.ADD; the others delete


def joint_code(name: str) -> tuple[int, int] | None:
    """Position in SIDES and in JOINTS of a joint's name (`wrist`, `wrist_left`); None for others."""
    joint, _, side = name.strip().lower().partition("_")
    return (SIDES.index(side), JOINTS.index(joint)) if joint in JOINTS and side in SIDES else None


#: Rows of a batch with a joint, their body, its side and number, its state and position.
_Said = tuple[IntArray, IntArray, tuple[int, int], IntArray, FloatArray]


class JointDecoder(Decoder):
    """unocclude.Skeleton or Keypoints2D: one body, or an arm of it, a message, or an image."""

    camera_frame: CameraFrame | None = None

    def __init__(self, topic: Topic, grouper: Grouper) -> None:
        super().__init__(topic, grouper)
        self.is_flat = topic.schema == KEYPOINTS  # keypoints in images
        self._rows, self._stamp, self._log = (
            JointRows(),
            GatheredRows((), np.int64),
            GatheredRows((), np.int64),
        )

    def feed(self, messages: Messages) -> None:
        """Take a batch of messages."""
        groups, before = self.groups(messages), len(self._stamp)
        stamp, log = np.empty((2, sum(len(row) for row, *_ in groups)), np.int64)
        for row, log_ns, block, layout in groups:
            stamp[row], log[row] = self._stamps(block, layout, log_ns), log_ns
            for mine, body, code, state, position in self._joints(block, layout):
                self._rows.add(before + row[mine], body, code, state, position)
        self._stamp.append(stamp)
        self._log.append(log)

    def _stamps(self, block: Block, layout: MessageLayout, log_ns: IntArray) -> IntArray:
        """Stamps (rows,), zero where there is none."""
        return layout.stamps(block, log_ns)

    def _joints(self, block: Block, layout: MessageLayout) -> Iterator[_Said]:
        """The joints in messages of one layout; of a keypoint the position is u, v and the score."""
        body, row = layout.integer(block, "body") & 0xFFFFFFFF, np.arange(len(block))
        elements = "keypoints" if self.is_flat else "joints"
        for i in range(layout.counts.get(elements, 0)):
            path = f"{elements}.{i}"
            if (code := joint_code(layout.texts.get(f"{path}.name", ""))) is None:
                continue
            if self.is_flat:
                place = layout.vector(block, [f"{path}.{name}" for name in ("u", "v", "score")])
                state = states_of_scores(place[:, 2]).astype(np.int64)
            else:
                place = layout.vector(block, axes(f"{path}.position"))
                said = layout.integer(block, f"{path}.state").view(np.uint64)
                state = np.where(said > JointState.TRACKED, JointState.NOT_TRACKED, said)  # damaged
            yield row, body, code, state.astype(np.int64), place

    def arms(self) -> list[ArmFrames]:
        """All arms found, asked for once.

        Where there is no stamp it is as far before the log time as those around it.
        """
        stamp, log = self._stamp.done(), self._log.done()
        has = stamp != 0
        if has.any() and not has.all():
            delay = np.interp(np.arange(len(log)), np.flatnonzero(has), (log - stamp)[has].astype(float))
            stamp = np.where(has, stamp, log - delay.astype(np.int64))
        return self._rows.arms(stamp, self.topic.label, self.frame_id, self.camera_frame)


class MarkerDecoder(JointDecoder):
    """visualization_msgs/msg/MarkerArray as the Azure Kinect ROS driver publishes body tracking."""

    camera_frame = CameraFrame.OPTICAL
    foreign = seen = 0

    def _stamps(self, block: Block, layout: MessageLayout, log_ns: IntArray) -> IntArray:
        if not layout.counts["markers"]:
            return np.zeros(len(block), np.int64)
        added = (layout.many(block, "action")[:, :, 0] == _ADD).any(axis=1)
        return np.where(added, layout.stamps(block, log_ns), 0)

    def _joints(self, block: Block, layout: MessageLayout) -> Iterator[_Said]:
        if not layout.counts["markers"]:
            return
        ids = layout.many(block, "id")[:, :, 0].astype(np.int64)
        added = layout.many(block, "action")[:, :, 0] == _ADD
        position, azure = layout.many(block, "position").astype(float), ids % 100
        self.seen += int(added.sum())
        self.foreign += int((added & (azure >= _AZURE_JOINTS)).sum())
        for number, code in _AZURE.items():
            row, column = np.nonzero(added & (azure == number) & (ids >= 0))
            state = np.full(len(row), int(JointState.TRACKED))
            yield row, ids[row, column] // 100, code, state, position[row, column]

    def arms(self) -> list[ArmFrames]:
        """All arms found, asked for once; none where the markers are of another kind."""
        return [] if self.foreign > 0.05 * self.seen else super().arms()


def decoder_of(topic: Topic) -> PlainDecoder | JointDecoder | None:
    """The decoder of a topic of IMU samples, magnetic fields, poses or skeletons; None for other topics."""
    schema = topic.schema.replace("/msg/", "/")
    if (kind := _PLAIN.get((topic.encoding, schema))) is not None:
        is_ros = topic.encoding == "cdr"
        return PlainDecoder(
            topic, Grouper(partial(cdr.walk, kind=schema)) if is_ros else _proto(schema), kind
        )
    if topic.encoding == "protobuf" and schema in ("unocclude.Skeleton", KEYPOINTS):
        return JointDecoder(topic, _proto(schema))
    if (topic.encoding, schema) == ("cdr", "visualization_msgs/MarkerArray"):
        return MarkerDecoder(topic, Grouper(cdr.markers_of(topic.schema_data)))
    return None


def _proto(schema: str) -> Grouper:
    return Grouper(partial(proto.walk, message=message_class(schema)))
