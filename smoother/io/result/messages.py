"""What a result has beside its trajectory as messages, and its topics as tables of numbers."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from google.protobuf.message import DecodeError
from numpy.typing import NDArray

from ...array_types import IntArray
from ...body import FURTHER
from ...measurements.visibility import Gap
from ...recording import JOINTS, JointTracks
from ...result import Draws, FrameResiduals, GapVerdict, Recovery
from ...result.segment_motion import SegmentMotion
from ...rotation import Rotation
from ..mcap.messages import Topic, TopicMessages, nanoseconds, seconds
from ..recording.decode import SkeletonDecoder, joint_code, proto_grouper
from ..recording.read import RESULT_PREFIX
from ..wire import protobuf_decode as proto
from ..wire.layout import Block, Grouper, MessageLayout, axes
from ..wire.protobuf_encode import alike
from ..wire.schemas import message_class
from .drawing import AlikeRows


def gap_messages(
    gaps: Sequence[Gap],
    start_ns: IntArray,  # int (n,) ns
    end_ns: IntArray,  # int (n,) ns
    side: str,
    verdicts: Sequence[GapVerdict] | None = None,
) -> tuple[list[bytes], list[bytes]]:
    """Events (`foxglove.Event`) and lines (`foxglove.Log`), encoded."""
    events, lines = [], []
    each_verdict: Sequence[GapVerdict | None] = [None] * len(gaps) if verdicts is None else verdicts
    for gap, verdict, start, end in zip(gaps, each_verdict, start_ns.tolist(), end_ns.tolist(), strict=True):
        event = message_class("foxglove.Event")()
        event.start_time.FromNanoseconds(start)
        event.end_time.FromNanoseconds(end)
        values = {"kind": "occluded", "length_s": f"{gap.length_s:.3f}"}
        values |= {"side": side} if side else {}
        values |= {"open": "start"} if gap.open_start else {}
        values |= {"open": "end"} if gap.open_end else {}
        if verdict is not None:
            values["trusted"] = str(verdict.trusted).lower()
            values |= {} if verdict.trusted else {"reasons": "; ".join(verdict.reasons)}
        for key, value in values.items():
            event.metadata.add(key=key, value=value)
        events.append(event.SerializeToString(deterministic=True))
        line = message_class("foxglove.Log")()
        line.timestamp.FromNanoseconds(start)
        line.level = line.WARNING
        line.message = f"{side} forearm occluded for {gap.length_s:.2f} s".lstrip()
        if verdict is not None and not verdict.trusted:
            line.level = line.ERROR
            line.message += f"; the answer is not to be trusted: {'; '.join(verdict.reasons)}"
        line.name = "unocclude"
        lines.append(line.SerializeToString(deterministic=True))
    return events, lines


def residual_messages(
    residuals: FrameResiduals, joints: Sequence[int], frame_id: str, stamp: IntArray
) -> Iterator[AlikeRows]:
    """Frames with the same reasons, and the unocclude.Residuals that contains them."""
    for pattern, rows in alike(residuals.reason):
        reasons = [residuals.reasons[code].sentence for code in pattern]
        own = [{"name": JOINTS[i], "reason": reasons[i]} for i in joints]

        def columns(rows: IntArray) -> dict[str, NDArray]:
            each = {"timestamp": stamp[rows]}
            for k, i in enumerate(joints):
                each |= {f"joints.{k}.residual": residuals.residual[rows, i]}
                each |= {f"joints.{k}.used": residuals.used[rows, i].astype(np.int64)}
            return each

        yield rows, {"frame_id": frame_id, "joints": own}, columns


def joints_with_residuals(residuals: FrameResiduals) -> list[int]:
    """Joints of which there is anything to say."""
    present = np.zeros(len(JOINTS), bool)
    for part in residuals.batches():
        present |= np.isfinite(part.residual).any(axis=(0, 2)) | part.used.any(axis=0)
        present |= (part.reason != 0).any(axis=0)
    return np.flatnonzero(present).tolist()


def segment_poses(r: Recovery, motion: SegmentMotion) -> Recovery:
    """A further IMU's poses, without velocities, in the forearm's place."""
    return replace(
        r,
        position=motion.position,
        quaternion=motion.quaternion,
        pose_covariance=motion.pose_covariance,
        velocity=np.full_like(r.velocity, np.nan),
    )


def thorax_poses(r: Recovery) -> Recovery | None:
    """The thorax's orientation, drawn at the arm's shoulder, likewise."""
    if r.trunk is None:
        return None
    known = np.asarray(np.isfinite(r.trunk.quaternion).all(axis=1))
    covariance = np.zeros((len(r), 6, 6))
    covariance[:, 3:, 3:] = r.trunk.covariance
    at = np.nan_to_num(r.joints["shoulder"]) if "shoulder" in r.joints else np.zeros((len(r), 3))
    return replace(
        r,
        position=np.where(known[:, None], at, np.nan),
        quaternion=r.trunk.quaternion,
        pose_covariance=covariance,
        velocity=np.full_like(r.velocity, np.nan),
    )


def odometry(r: Recovery, frame_id: str, body: str, stamp: IntArray) -> Iterator[AlikeRows]:
    """The samples with a position, those with orientation and velocity apart, as foxglove.Odometry."""
    has_position = np.isfinite(r.position).all(axis=1)
    has = np.isfinite(r.quaternion).all(axis=1), np.isfinite(r.velocity).all(axis=1)
    for pattern, mine in alike(np.stack([has_position, *has], axis=1)):
        _, turned, moving = pattern
        if not pattern[0]:
            continue

        def columns(rows: IntArray, turned: int = turned, moving: int = moving) -> dict[str, NDArray]:
            velocity, spread = r.velocity[rows], r.velocity_covariance[rows]
            if turned:
                back = Rotation.from_quat(r.quaternion[rows], scalar_first=True).inv().as_matrix()
                velocity = np.einsum("nij,nj->ni", back, velocity)
                spread = back @ spread @ back.transpose(0, 2, 1)
            whole = np.zeros((len(rows), 6, 6))
            whole[:, :3, :3] = spread
            each = {"timestamp": stamp[rows], "pose.position": r.position[rows]}
            each |= {"pose.orientation": r.quaternion[rows][:, [1, 2, 3, 0]]} if turned else {}
            each |= {"linear_velocity": velocity} if moving else {}
            covariance = np.nan_to_num(r.pose_covariance[rows], nan=0.0)
            return each | {
                "pose_covariance": covariance.reshape(-1, 36),
                "velocity_covariance": np.nan_to_num(whole, nan=0.0).reshape(-1, 36),
            }

        constants: dict[str, Any] = {"frame_id": frame_id, "body_frame_id": body if turned else frame_id}
        yield mine, constants | {"pose": {"orientation": {"w": 1.0}}}, columns


class TopicTable:
    """Columns of one topic, gathered batch by batch in the file's order."""

    def __init__(self, topic: Topic):
        self.grouper: Grouper = proto_grouper(topic.schema)
        self.parts: list[tuple[IntArray, dict[str, NDArray]]] = []
        self.fed = 0

    def feed(self, messages: TopicMessages) -> None:
        """Decode some messages."""
        for index, block, layout in self.grouper.groups_in(messages.chunk, messages.start, messages.stop):
            stamp = proto.stamps(block, layout, np.zeros(len(index), np.int64))
            self.parts.append((index + self.fed, {"stamp": stamp, **self.columns(block, layout)}))
        self.fed += len(messages.start)

    def columns(self, block: Block, layout: MessageLayout) -> dict[str, NDArray]:
        """Columns of messages of one layout, besides their stamps."""
        raise NotImplementedError

    def done(self) -> dict[str, NDArray]:
        """All columns, in order of time."""
        names = {name for _, columns in self.parts for name in columns}
        # Times within a topic increase; messages of different layouts come one layout after the other.
        order = np.argsort(np.concatenate([columns["stamp"] for _, columns in self.parts]), kind="stable")
        return {name: np.concatenate([columns[name] for _, columns in self.parts])[order] for name in names}


class OdometryTable(TopicTable):
    """Poses and velocities of an IMU."""

    def columns(self, block: Block, layout: MessageLayout) -> dict[str, NDArray]:
        """Columns; `turned` is False where a message has no orientation."""
        rows = len(block)
        turned = layout.texts.get("frame_id") != layout.texts.get("body_frame_id")
        velocity = np.full((rows, 3), np.nan)
        if "linear_velocity.x" in layout.fields:
            velocity = layout.vector(block, axes("linear_velocity"))
        return {
            "position": layout.vector(block, axes("pose.position")),
            "quaternion": layout.vector(block, axes("pose.orientation", "wxyz")),
            "velocity": velocity,
            "covariance": layout.get(block, "pose_covariance"),
            "velocity_covariance": layout.get(block, "velocity_covariance"),
            "turned": np.full(rows, turned),
        }


class JointsTable(TopicTable):
    """Recovered joints with their covariance."""

    def columns(self, block: Block, layout: MessageLayout) -> dict[str, NDArray]:
        """Columns by joint, and `JOINT_covariance`."""
        columns: dict[str, NDArray] = {"occluded": layout.integer(block, "occluded")}
        for i in range(layout.counts.get("joints", 0)):
            code = joint_code(layout.texts[f"joints.{i}.name"])
            if code is None:
                continue
            joint = JOINTS[code[1]]
            columns[joint] = layout.vector(block, axes(f"joints.{i}.position"))
            columns[f"{joint}_covariance"] = layout.get(block, f"joints.{i}.position_covariance")
        return columns


class ResidualTable(TopicTable):
    """Residuals of the camera's joints, and the sentences that their reasons number."""

    def __init__(self, topic: Topic):
        super().__init__(topic)
        self.reasons = [""]

    def columns(self, block: Block, layout: MessageLayout) -> dict[str, NDArray]:
        """Columns; `reason` is an index into `reasons`."""
        rows = len(block)
        residual = np.full((rows, len(JOINTS), 3), np.nan)
        used = np.zeros((rows, len(JOINTS)), np.int64)
        reason = np.zeros(len(JOINTS), np.uint8)
        for i in range(layout.counts.get("joints", 0)):
            joint = JOINTS.index(layout.texts[f"joints.{i}.name"])
            residual[:, joint] = layout.vector(block, axes(f"joints.{i}.residual"))
            used[:, joint] = layout.integer(block, f"joints.{i}.used")
            reason[joint] = self._code(layout.texts.get(f"joints.{i}.reason", ""))
        return {"residual": residual, "used": used, "reason": np.tile(reason, (rows, 1))}

    def _code(self, sentence: str) -> int:
        """Number of a sentence, in the order in which they are met."""
        if sentence not in self.reasons:
            self.reasons.append(sentence)
        return self.reasons.index(sentence)


class CameraTable(TopicTable):
    """The camera's joints on the IMU's clock."""

    def __init__(self, topic: Topic):
        super().__init__(topic)
        self.decoder = SkeletonDecoder(topic, proto_grouper(topic.schema))

    def feed(self, messages: TopicMessages) -> None:
        """Decode some messages."""
        self.decoder.feed(messages)

    def tracks(self, name: str, origin: int) -> JointTracks:
        """The joints of the one arm; `origin` in ns."""
        stamp, arms = self.decoder.found()
        if not arms:
            nothing = np.full((len(stamp), len(JOINTS), 3), np.nan)
            return JointTracks(
                name, seconds(stamp, origin), nothing, np.zeros((len(stamp), len(JOINTS)), np.int8)
            )
        return JointTracks(name, seconds(arms[0].stamp_ns, origin), arms[0].position, arms[0].state)


TABLES: dict[str, type[TopicTable]] = {
    "forearm": OdometryTable,
    **{segment.name: OdometryTable for segment in FURTHER},
    "trunk": OdometryTable,
    "skeleton": JointsTable,
    "residuals": ResidualTable,
    "camera": CameraTable,
}


def kind_of(topic: Topic) -> str:
    """What follows the prefix of a result's topics, without the arm."""
    return topic.name.removeprefix(RESULT_PREFIX).partition("/")[0]


SCHEMA = "unocclude.Draws"
#: Drawn times in a message.
ROWS = 25
#: The number that marks a missing answer; the largest number beside it is as far from zero on the other side.
_NOTHING, _MOST = -32768, 32767
_KIND = np.dtype("<i2")


def message_rows(draws: Draws) -> IntArray:
    """The first of each message's drawn times."""
    return np.arange(0, len(draws.t_s), ROWS)


def draw_messages(draws: Draws, first: IntArray, origin_ns: int, frame_id: str) -> Iterator[bytes]:
    """Drawn motions, encoded."""
    rows = slice(int(first[0]), int(first[-1]) + ROWS)
    stamp = nanoseconds(draws.t_s[rows], origin_ns)
    columns = {name: _whole_numbers(values[:, rows]) for name, values in draws.columns().items()}
    for number in range(len(first)):
        mine = slice(number * ROWS, (number + 1) * ROWS)
        message = message_class(SCHEMA)()
        message.timestamp.FromNanoseconds(int(stamp[mine.start]))
        message.frame_id, message.motions = frame_id, len(draws)
        message.offset.extend((stamp[mine] - stamp[mine.start]).tolist())
        for name, (whole, scales) in columns.items():
            message.drawn.add(name=name, scale=scales[number], deviation=whole[mine].tobytes())
        yield message.SerializeToString(deterministic=True)


def _whole_numbers(values: NDArray) -> tuple[NDArray, list[float]]:
    """Deviations (n, m, 3) by time as whole numbers (m, 3 n), and what they are to be multiplied by."""
    part = np.moveaxis(values, 0, 1).copy().reshape(values.shape[1], -1)
    known = np.isfinite(part)
    part[~known] = 0.0
    largest = np.maximum(part.max(axis=1, initial=0.0), -part.min(axis=1, initial=0.0))
    scale = np.maximum.reduceat(largest, np.arange(0, len(part), ROWS)).astype(float) / _MOST
    scale[scale == 0.0] = 1.0
    part /= scale.astype(part.dtype).repeat(ROWS)[: len(part), None]
    whole = np.rint(part, out=part).astype(_KIND)
    whole[~known] = _NOTHING
    return whole, scale.tolist()


class DrawsTable(TopicTable):
    """Drawn motions, gathered batch by batch in the file's order."""

    def __init__(self, topic: Topic):
        super().__init__(topic)
        self._stamps: list[IntArray] = []
        self._parts: dict[str, list[NDArray]] = {}

    def feed(self, messages: TopicMessages) -> None:
        """Decode some messages."""
        for start, stop in zip(messages.start.tolist(), messages.stop.tolist(), strict=True):
            try:
                message = message_class(SCHEMA).FromString(messages.chunk[start:stop])
            except DecodeError as error:
                raise ValueError(str(error)) from error
            offset = np.array(message.offset, np.int64)
            self._stamps.append(message.timestamp.ToNanoseconds() + offset)
            for drawn in message.drawn:
                whole = np.frombuffer(drawn.deviation, _KIND).reshape(len(offset), message.motions, 3)
                values = np.where(whole == _NOTHING, np.nan, whole * drawn.scale).astype(np.float32)
                self._parts.setdefault(drawn.name, []).append(values)

    def draws(self, seed: int, origin: int) -> Draws:
        """All of them."""
        stamp = np.concatenate(self._stamps)
        columns = {name: np.moveaxis(np.concatenate(parts), 0, 1) for name, parts in self._parts.items()}
        if any(values.shape[1] != len(stamp) for values in columns.values()):
            raise ValueError("drawn motions lack a quantity at some times")
        return Draws.from_columns(seconds(stamp, origin), seed, columns)
