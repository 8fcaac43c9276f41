"""Schemas and channels of a file, from wherever in it they can be had."""

from __future__ import annotations

from io import BytesIO

import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Schema
from numpy.typing import NDArray

from .losses import DamageLog, plain_name
from .messages import Topic
from .records import find
from .summary import BROKEN, Summary


class Definitions:
    """The channels of a file.

    Attributes
    ----------
    topics : list of Topic
        Channels met so far.
    number : ndarray of int, shape (65536,)
        By channel, its position in `topics`; -1 where it is not known.
    schemas, channels : dict
        Records met so far, by their numbers.

    Parameters
    ----------
    log : DamageLog
        Where damage is taken down.
    schemas, channels : dict, optional
        By number, for channels whose records come late or are lost.
    """

    def __init__(
        self,
        log: DamageLog,
        schemas: dict[int, Schema] | None = None,
        channels: dict[int, Channel] | None = None,
    ):
        self.topics: list[Topic] = []
        self.number = np.full(1 << 16, -1, np.int64)
        self.summary = Summary()
        self._log = log
        self.schemas: dict[int, Schema] = {}
        self.channels: dict[int, Channel] = {}
        self._others = dict(schemas or {}), dict(channels or {})

    def define(self, opcode: int, content: bytes, is_checked: bool) -> int | None:
        """Take in a schema or a channel; the number of a channel that is new.

        Parameters
        ----------
        opcode : int
            Of the record.
        content : bytes
            The record.
        is_checked : bool
            Its chunk has a checksum, which is right.
        """
        stream = ReadDataStream(BytesIO(content))
        try:
            if opcode == Opcode.SCHEMA:
                schema = Schema.read(stream)
                its = self.summary.schemas.get(schema.id)
                if its is not None and its.name != schema.name and self.summary.is_checked and not is_checked:
                    schema = its
                self.schemas[schema.id] = schema
                return None
            channel = Channel.read(stream)
        except BROKEN:
            self._log.note("a schema or channel record is damaged")
            return None
        twin = self.summary.channels.get(channel.id)
        if twin is not None and twin.topic != channel.topic and self.summary.is_sound:
            self._log.note(f"channel {channel.id} is described in two ways")
            if self.summary.is_checked and not is_checked:
                channel = twin
        if self.number[channel.id] >= 0:
            return None
        self._take(channel, self.schemas)
        return int(channel.id)

    def define_lost(self, numbers: NDArray[np.uint16]) -> None:
        """Channels whose own records are lost or come late, as the file's end describes them."""
        others = [self._others, (self.summary.schemas, self.summary.channels)]
        for number in numbers.tolist():
            for schemas, channels in others:
                if self.number[number] < 0 and number in channels:
                    self._take(channels[number], {**schemas, **self.schemas})
                    name = plain_name(channels[number].topic)
                    self._log.note(f"the record of channel {name} is missing and was taken from elsewhere")

    def is_described(self, channel: int) -> bool:
        """Whether a channel is described elsewhere than in the chunk at hand."""
        is_there = channel in self._others[1] or channel in self.summary.channels
        if is_there:
            self._log.note(f"messages of {plain_name(self.name_of(channel))} come before its record")
        return is_there

    def take_unverified(self, data: bytes) -> None:
        """Schemas and channels of a chunk that fails its checksum, for want of better ones."""
        schemas, channels = self._others
        for definition in find(data, [], True).definitions:
            stream = ReadDataStream(BytesIO(data[definition.start : definition.stop]))
            try:
                if definition.opcode == Opcode.SCHEMA:
                    schema = Schema.read(stream)
                    schemas.setdefault(schema.id, self.summary.schemas.get(schema.id) or schema)
                else:
                    channel = Channel.read(stream)
                    channels.setdefault(channel.id, self.summary.channels.get(channel.id) or channel)
            except BROKEN:
                continue

    def name_of(self, channel: int) -> str:
        """Topic of a channel, as far as it is known."""
        position = int(self.number[channel])
        if position >= 0:
            return self.topics[position].name
        for _, channels in (self._others, (self.summary.schemas, self.summary.channels)):
            if channel in channels:
                return channels[channel].topic
        return f"channel {channel}"

    def _take(self, channel: Channel, schemas: dict[int, Schema]) -> None:
        self.channels[channel.id] = channel
        its = schemas.get(channel.schema_id) or self.summary.schemas.get(channel.schema_id)
        name, encoding, data = (its.name, its.encoding, its.data) if its else ("", "", b"")
        topic = Topic(channel.topic, name, encoding, data, channel.message_encoding, dict(channel.metadata))
        # Recorders that split or restart make a second channel of the same topic.
        for position, known in enumerate(self.topics):
            if (known.name, known.schema, known.encoding) == (topic.name, topic.schema, topic.encoding):
                self.number[channel.id] = position
                break
        else:
            self.number[channel.id] = len(self.topics)
            self.topics.append(topic)
