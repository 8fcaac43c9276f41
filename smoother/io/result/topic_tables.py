"""Topics of a result as tables of numbers, and drawn motions as messages."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from google.protobuf.message import DecodeError
from numpy.typing import NDArray

from ...array_types import IntArray
from ...body import FURTHER
from ...recording import JOINTS, JointTracks
from ...result import Draws
from ..mcap.messages import Topic, TopicMessages, seconds
from ..recording.decode import SkeletonDecoder, joint_code, proto_grouper
from ..recording.read import RESULT_PREFIX
from ..wire import protobuf_decode as proto
from ..wire.layout import Block, Grouper, MessageLayout, axes
from ..wire.schemas import message_class


class TopicTable:
    """Columns of one topic, gathered batch by batch in the file's order.

    Parameters
    ----------
    topic : Topic
        With the schema that its messages are decoded by.
    """

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


def draw_messages(draws: Draws, stamp: IntArray, first: IntArray, frame_id: str) -> Iterator[bytes]:
    """Drawn motions, encoded.

    Parameters
    ----------
    draws : Draws
    stamp : ndarray of int, shape (m,), ns
        Of all drawn times.
    first : ndarray of int
        Some of `message_rows`.
    frame_id : str
        Of the camera.

    Yields
    ------
    message : bytes
        One each.
    """
    for start in first.tolist():
        rows = slice(start, start + ROWS)
        message = message_class(SCHEMA)()
        message.timestamp.FromNanoseconds(int(stamp[start]))
        message.frame_id, message.motions = frame_id, len(draws)
        message.offset.extend((stamp[rows] - stamp[start]).tolist())
        for name, values in draws.columns().items():
            part = np.moveaxis(values[:, rows], 0, 1)
            known = np.isfinite(part)
            filled = np.where(known, part, 0.0)
            scale = float(np.abs(filled).max(initial=0.0)) / _MOST or 1.0
            whole = np.rint(filled / scale).astype(_KIND)
            whole[~known] = _NOTHING
            message.drawn.add(name=name, scale=scale, deviation=whole.tobytes())
        yield message.SerializeToString(deterministic=True)


class DrawsTable(TopicTable):
    """Drawn motions, gathered batch by batch in the file's order.

    Parameters
    ----------
    topic : Topic
    """

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
        """All of them.

        Parameters
        ----------
        seed : int
            As the metadata has it.
        origin : int, ns
            Of the recording.
        """
        stamp = np.concatenate(self._stamps)
        columns = {name: np.moveaxis(np.concatenate(parts), 0, 1) for name, parts in self._parts.items()}
        if any(values.shape[1] != len(stamp) for values in columns.values()):
            raise ValueError("drawn motions lack a quantity at some times")
        return Draws.from_columns(seconds(stamp, origin), seed, columns)
