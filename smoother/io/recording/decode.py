"""Messages of a topic to the stream that they make up."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from ...array_types import FloatArray, IntArray
from ...runtime.store import Column, Store, batches, sampled
from ..mcap.messages import Topic, TopicMessages
from ..mcap.stamps import ros_stamps
from ..wire import cdr
from ..wire import protobuf_decode as proto
from ..wire.layout import Block, Grouper, MessageLayout, axes
from ..wire.schemas import message_class
from .streams import FieldSamples, ImuSamples, PoseSamples


@dataclass
class Decoder:
    """Decodes the messages of one topic, a batch at a time.

    Attributes
    ----------
    topic : Topic
        The topic.
    grouper : Grouper
        Sorts its messages by layout.
    """

    topic: Topic
    grouper: Grouper
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
