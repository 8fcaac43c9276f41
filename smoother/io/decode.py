"""Messages of a topic to the stream that they make up."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np
from numpy.typing import NDArray

from ..recording import FloatArray, IntArray
from . import cdr, proto
from .layout import Block, Grouper, Layout
from .messages import Message, Topic
from .schemas import message_class
from .streams import FieldSamples, ImuSamples, PoseSamples

_BILLION = 1_000_000_000


@dataclass
class Decoder:
    """Decodes the messages of one topic, a batch at a time.

    Attributes
    ----------
    topic : the topic.
    grouper : sorts its messages by layout.
    """

    topic: Topic
    grouper: Grouper
    frame_id: str = ""
    parts: list[tuple[NDArray, ...]] = field(default_factory=list)
    is_cdr: bool = True

    def feed(self, messages: Sequence[Message]) -> None:
        """Take a batch of messages."""
        payloads = [bytes(message.data) for message in messages]
        log_ns = np.fromiter((message.log_ns for message in messages), np.uint64, len(messages))
        for index, block, layout in self.grouper.groups(payloads):
            self.frame_id = layout.texts.get("frame_id", self.frame_id)
            log = log_ns[index].astype(np.int64)
            stamp = self.stamps(block, layout, log)
            self.parts.append((index + self._fed, stamp, log, *self.columns(block, layout)))
        self._fed += len(messages)

    _fed: int = 0

    def stamps(self, block: Block, layout: Layout, log_ns: IntArray) -> IntArray:
        """Stamps (rows,), ns; log times where they are zero."""
        if not self.is_cdr:
            return proto.stamps(block, layout, log_ns)
        seconds = layout.get(block, "sec")[:, 0].astype(np.int64)
        stamp = seconds * _BILLION + layout.get(block, "nsec")[:, 0].astype(np.int64)
        return np.where(stamp == 0, log_ns, stamp)

    def columns(self, block: Block, layout: Layout) -> tuple[FloatArray, ...]:
        """What the messages carry, an array (rows, ...) each."""
        raise NotImplementedError

    def joined(self) -> list[NDArray]:
        """Stamps, log times and columns of all messages, in the file's order."""
        order = np.argsort(np.concatenate([part[0] for part in self.parts]), kind="stable")
        return [np.concatenate(column)[order] for column in zip(*self.parts, strict=True)][1:]


class ImuDecoder(Decoder):
    """sensor_msgs/msg/Imu and unocclude.Imu."""

    def columns(self, block: Block, layout: Layout) -> tuple[FloatArray, ...]:
        """Specific force, angular velocity, magnetic field (nan where there is none)."""
        nothing = np.full((len(block), 3), np.nan)
        if self.is_cdr:
            acc, gyro = layout.get(block, "acc"), layout.get(block, "gyro")
            return acc.astype(float), gyro.astype(float), nothing
        acc = layout.vector(block, _xyz("linear_acceleration"))
        gyro = layout.vector(block, _xyz("angular_velocity"))
        has_mag = any(name in layout.fields for name in _xyz("magnetic_field"))
        return acc, gyro, layout.vector(block, _xyz("magnetic_field")) if has_mag else nothing

    def stream(self) -> ImuSamples | None:
        """All samples, or None where there are none."""
        if not self.parts:
            return None
        stamp, log, acc, gyro, mag = self.joined()
        has_mag = bool(np.isfinite(mag).any())
        shift = int(np.median(log - stamp))
        return ImuSamples(self.topic.name, self.frame_id, stamp, acc, gyro, mag if has_mag else None, shift)


class FieldDecoder(Decoder):
    """sensor_msgs/msg/MagneticField."""

    def columns(self, block: Block, layout: Layout) -> tuple[FloatArray, ...]:
        """Magnetic field."""
        return (layout.get(block, "mag").astype(float),)

    def stream(self) -> FieldSamples | None:
        """All samples, or None where there are none."""
        if not self.parts:
            return None
        stamp, _, mag = self.joined()
        return FieldSamples(self.topic.name, self.frame_id, stamp, mag)


class PoseDecoder(Decoder):
    """geometry_msgs/msg/PoseStamped and foxglove.PoseInFrame."""

    def columns(self, block: Block, layout: Layout) -> tuple[FloatArray, ...]:
        """Position, quaternion (x, y, z, w)."""
        if self.is_cdr:
            position, quaternion = layout.get(block, "position"), layout.get(block, "quaternion")
            return position.astype(float), quaternion.astype(float)
        orientation = [f"pose.orientation.{axis}" for axis in "xyzw"]
        return layout.vector(block, _xyz("pose.position")), layout.vector(block, orientation)

    def stream(self) -> PoseSamples | None:
        """All poses, or None where there are none; an orientation of zeros is none."""
        if not self.parts:
            return None
        stamp, _, position, quaternion = self.joined()
        quaternion = quaternion[:, [3, 0, 1, 2]]
        length = np.linalg.norm(quaternion, axis=1)
        quaternion[~(length > 0.5)] = np.nan
        return PoseSamples(self.topic.name, self.frame_id, stamp, position, quaternion)


def plain_decoder(topic: Topic) -> ImuDecoder | FieldDecoder | PoseDecoder | None:
    """The decoder of a topic of IMU samples, magnetic fields or poses; None for other topics."""
    if topic.encoding == "cdr":
        kind = topic.schema.replace("/msg/", "/")
        if kind == "sensor_msgs/Imu":
            return ImuDecoder(topic, Grouper(cdr.imu))
        if kind == "sensor_msgs/MagneticField":
            return FieldDecoder(topic, Grouper(cdr.magnetic_field))
        if kind == "geometry_msgs/PoseStamped":
            return PoseDecoder(topic, Grouper(cdr.pose_stamped))
    elif topic.encoding == "protobuf":
        if topic.schema == "unocclude.Imu":
            return ImuDecoder(topic, proto_grouper(topic.schema), is_cdr=False)
        if topic.schema == "foxglove.PoseInFrame":
            return PoseDecoder(topic, proto_grouper(topic.schema), is_cdr=False)
    return None


def proto_grouper(schema: str) -> Grouper:
    """Grouper for a protobuf message by its full name."""
    return Grouper(partial(proto.walk, message=message_class(schema)))


def _xyz(name: str) -> list[str]:
    return [f"{name}.{axis}" for axis in "xyz"]
