"""An MCAP file read front to back in flat memory.

Messages are read in file order, so that a truncated file gives all that it still
has; the mcap package gives nothing of a chunk that is cut. Behind a damage reading resumes at the next
records that make sense (`top_level`); what was lost is counted. The summary at the file's end
(`summary`) serves for channels whose own records are lost, and shows how many messages are missing.
Messages stay columns: 0.05 s where the package takes 0.75 s.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np
from mcap.records import Channel, Schema
from numpy.typing import NDArray

from ...array_types import IntArray
from ...errors import RecordingError
from ...runtime.inputs import check_input
from ..wire.layout import Buffer, joined
from .chunk_source import ChunkSource, Definitions
from .messages import ChunkMessages, DamageLog, Loss, McapMessage, Topic, TopicMessages, plain_name
from .records import HEAD, MAGIC, MESSAGE, Summary, find, read_summary

#: Log times beyond this, ns, do not fit what times are counted in.
_LATEST = np.uint64(np.iinfo(np.int64).max - 1)


class Container:
    """A file to be read once, front to back."""

    def __init__(
        self,
        path: str | os.PathLike[str],
        unverified: bool = False,
        definitions: tuple[dict[int, Schema], dict[int, Channel]] | None = None,
    ):
        self.path = Path(path)
        self._log = DamageLog(self.path.name)
        self._definitions = Definitions(self._log, *(definitions or ()))
        self._source = ChunkSource(self.path, self._log, self._definitions, unverified)
        self.topics, self.metadata = self._definitions.topics, self._source.metadata
        self.notes, self.losses = self._log.notes, self._log.losses
        self.missing: dict[str, int] = {}
        self._read = np.zeros(1 << 16, np.int64)  # messages by position in `topics`

    @property
    def attachments(self) -> int:
        """Attachments met so far; they are not read."""
        return self._source.attachments

    @property
    def definitions(self) -> tuple[dict[int, Schema], dict[int, Channel]]:
        """Schemas and channels met so far, by their numbers."""
        return self._definitions.schemas, self._definitions.channels

    def by_topic(self, wanted: Callable[[Topic], bool]) -> Iterator[dict[int, TopicMessages]]:
        """Yield the messages of wanted topics a chunk at a time, by position of the topic in `topics`."""
        for chunk, index in self._chunks():
            heads, start, stop, number = self._messages_in(chunk, index)
            by_topic: dict[int, TopicMessages] = {}
            for position, mine in _by_number(number):
                topic, log_ns = self.topics[position], heads["log"][mine]
                topic.note(log_ns)
                if wanted(topic):
                    by_topic[position] = TopicMessages(log_ns.view(np.int64), chunk, start[mine], stop[mine])
            if by_topic:
                yield by_topic

    def batches(self, wanted: Callable[[Topic], bool]) -> Iterator[dict[int, list[McapMessage]]]:
        """The same with an object for each message: for topics whose messages are few, or large."""
        for chunk in self.by_topic(wanted):
            yield {position: self._one_by_one(position, rows) for position, rows in chunk.items()}

    def messages(self) -> Iterator[McapMessage]:
        """Yield all messages in the file's order."""
        for chunk in self.chunks(lambda topic: True):
            for number, log_ns, data in zip(
                chunk.topic.tolist(), chunk.log_ns.tolist(), chunk.data, strict=True
            ):
                yield McapMessage(chunk.topics[number], log_ns, memoryview(data))

    def _one_by_one(self, position: int, messages: TopicMessages) -> list[McapMessage]:
        topic, view = self.topics[position], memoryview(messages.chunk)
        columns = messages.log_ns.view(np.uint64), messages.start, messages.stop
        return [
            McapMessage(topic, log_ns, view[start:stop])
            for log_ns, start, stop in zip(*(column.tolist() for column in columns), strict=True)
        ]

    def chunks(self, wanted: Callable[[Topic], bool]) -> Iterator[ChunkMessages]:
        """Yield the messages of wanted topics a chunk at a time, in the file's order."""
        topics: list[Topic] = []
        numbers: dict[int, int] = {}  # by position in `topics` of the file; -1: not wanted
        for chunk, index in self._chunks():
            heads, start, stop, number = self._messages_in(chunk, index)
            new_number = np.full(len(self.topics), -1, np.int64)
            for position, _ in _by_number(number):
                if position not in numbers:
                    topic = self.topics[position]
                    numbers[position] = len(topics) if wanted(topic) else -1
                    topics += [topic] * (numbers[position] >= 0)
                new_number[position] = numbers[position]
            topic_of = new_number[number]
            mine = topic_of >= 0
            payloads: Buffer = chunk
            if not mine.all():
                heads, topic_of = heads[mine], topic_of[mine]
                payloads, start, stop = joined(chunk, start[mine], stop[mine])  # the others need not be kept
            if len(heads):
                sequence, log_ns, publish_ns = (
                    heads[name].astype(np.int64) for name in ("sequence", "log", "publish")
                )
                yield ChunkMessages(topics, topic_of, sequence, log_ns, publish_ns, payloads, start, stop)

    def _messages_in(
        self, chunk: bytes, index: Sequence[bytes]
    ) -> tuple[NDArray, IntArray, IntArray, IntArray]:
        """Heads of a chunk's messages, where their payloads start and stop, the positions of their topics."""
        log, definitions, source = self._log, self._definitions, self._source
        records = find(chunk, index, not log.is_cut)
        log.is_cut |= records.is_cut
        place, heads = records.place, records.heads
        defined = [
            (definitions.define(d.opcode, chunk[d.start : d.stop], source.is_checked), d.start)
            for d in records.definitions
        ]
        late = heads["log"] > _LATEST
        if late.any():
            heads["log"][late] = _LATEST
            what = f"{int(late.sum())} messages have log times after the year 2262, the latest possible"
            log.lost(Loss(what, source.place, source.place))
        channel = heads["channel"]
        if (definitions.number[channel] < 0).any():
            definitions.define_lost(np.unique(channel))
        number = definitions.number[channel]
        for new, start in defined:  # messages before their channel's record are not known to be of it
            if new is None:
                continue
            early = (channel == new) & (place < start)
            if early.any() and not definitions.is_described(new):
                number[early] = -1
        if (number < 0).any():
            known = number >= 0
            times = heads["log"][~known]
            what = f"{len(times)} messages of channels that no record before them describes were dropped"
            log.lost(Loss(what, source.place, source.place, int(times.min()), int(times.max())))
            heads, place, number = heads[known], place[known], number[known]
        if len(heads):
            log.met(heads["log"])
            counts = np.bincount(number)
            self._read[: len(counts)] += counts
        if records.damaged:
            what = f"{records.damaged} bytes of the chunk at byte {source.place} are damaged"
            log.lost(Loss(f"{what} and were passed over", source.place, source.place))
        return heads, place + MESSAGE.itemsize, place + HEAD.size + heads["length"].astype(np.int64), number

    def _chunks(self) -> Iterator[tuple[bytes, list[bytes]]]:
        """Yield chunks of schema, channel and message records, each with the index records behind it."""
        check_input(self.path, RecordingError)
        try:
            size = self.path.stat().st_size
            with open(self.path, "rb") as file:
                magic = file.read(len(MAGIC))
                self._definitions.summary = read_summary(file, size)
                self._check_magic(magic, self._definitions.summary)
                yield from self._source.chunks(file, size)
        except OSError as error:
            raise RecordingError(_unreadable(self.path, error)) from error
        self._log.finish()
        self._compare_counts()
        if self._log.is_cut:
            self._log.note("the file ends in the middle of the recording; everything before the cut was read")

    def _compare_counts(self) -> None:
        """Compare what was read with the file's own count."""
        if not self._definitions.summary.is_sound:
            return
        stated: dict[str, int] = {}
        for channel, count in self._definitions.summary.counts.items():
            name = self._definitions.name_of(channel)
            stated[name] = stated.get(name, 0) + count
        read: dict[str, int] = {}
        for topic, count in zip(self.topics, self._read.tolist(), strict=False):
            read[topic.name] = read.get(topic.name, 0) + count
        self.missing = {
            name: count - read.get(name, 0) for name, count in stated.items() if count > read.get(name, 0)
        }
        more = [
            f"{count - stated[name]} of {plain_name(name)}"
            for name, count in read.items()
            if 0 < stated.get(name, 0) < count
        ]
        if more:
            self._log.note(f"messages are there beyond the file's own count: {', '.join(more[:8])}")
        if self.missing:
            missing = [
                f"{count} of {stated[name]} of {plain_name(name)}" for name, count in self.missing.items()
            ]
            more = [f"{len(missing) - 8} topics more"] if len(missing) > 8 else []
            self._log.note(
                f"by the file's own count messages are missing: {', '.join([*missing[:8], *more])}"
            )

    def _check_magic(self, magic: bytes, summary: Summary) -> None:
        if not magic:
            raise RecordingError(f"{self.path} is empty (0 bytes); record or copy it again.")
        if magic == MAGIC:
            return
        alike = sum(a == b for a, b in zip(magic, MAGIC, strict=False))
        if not summary.is_there and alike < len(MAGIC) - 2:
            raise RecordingError(
                f"{self.path} is not an MCAP file; convert a ROS bag with `mcap convert`, and the files of"
                " devices with `unocclude import files`."
            )
        self._log.note("the first bytes are damaged")


def _by_number(number: IntArray) -> list[tuple[int, IntArray]]:
    """The numbers that occur, in the order in which they first do, and where each does."""
    there = [(int(k), np.flatnonzero(number == k)) for k in np.flatnonzero(np.bincount(number))]
    return sorted(there, key=lambda each: int(each[1][0]))


def _unreadable(path: Path, error: OSError) -> str:
    if isinstance(error, FileNotFoundError):
        return f"{path} does not exist; check the name."
    if isinstance(error, IsADirectoryError) or path.is_dir():
        return f"{path} is a folder; name an MCAP file, or import plain files with `unocclude import csv`."
    return f"{path} cannot be read: {error.strerror or error}."
