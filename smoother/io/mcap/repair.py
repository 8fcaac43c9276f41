"""A damaged MCAP file written anew: every message that is whole, in the order of time, with a new index."""

from __future__ import annotations

import dataclasses
import json
import os
import tempfile
from collections import Counter
from collections.abc import Iterator
from io import BytesIO
from typing import IO, Any

import numpy as np

from ...array_types import IntArray
from ...errors import RecordingError
from ...runtime.outputs import writing
from ...runtime.printable import printable
from ..wire.layout import joined
from .container import Container
from .merge import Output
from .messages import ChunkMessages, Damage, Topic, damage_note

#: Metadata record that lists what the file had lost when it was repaired.
REPAIRED = "unocclude.repair"
#: This many messages are written together.
_TOGETHER = 4096


@dataclasses.dataclass
class RepairReport:
    """What was still in a damaged file."""

    source: str  # The damaged file's name
    messages: dict[str, int]  # Written, by topic
    missing: dict[str, int]  # Lost by topic, as the damaged file's own count says; empty where it has none
    losses: list[Damage]  # What is damaged, in the file's order
    notes: list[str]  # What was wrong, one sentence each
    attachments_left_out: int

    def to_dict(self) -> dict[str, Any]:
        """Plain values, fit for JSON."""
        return dataclasses.asdict(self)


def repair_container(
    source: str | os.PathLike[str], output: str | os.PathLike[str], force: bool = False
) -> RepairReport:
    """Write what is still in a damaged MCAP file as a whole one."""
    container = Container(source, unverified=True)
    with tempfile.TemporaryFile() as payloads:
        rows, topics = spooled(container, payloads)
        if not len(rows):
            raise RecordingError(
                " ".join(
                    [f"{source} has no complete message; nothing can be repaired.", *container.notes[:3]]
                )
            )
        messages: Counter[str] = Counter()
        for topic in topics:
            messages[topic.name] += topic.count
        with writing(output, force) as temporary, Output(temporary) as file:
            for name, values in container.metadata.items():
                if name != REPAIRED:
                    file.metadata(name, values)
            name = damage_note(container.path.name, "")
            told = [note.removeprefix(name) for note in container.notes]
            if notes := list(dict.fromkeys([*_noted(container.metadata), *told])):
                file.metadata(
                    REPAIRED, {"notes": json.dumps(notes), "missing": json.dumps(container.missing)}
                )
            left_out = _carried_over(container, file)
            file.copy(by_time(rows, topics, payloads))
    return RepairReport(
        container.path.name, dict(+messages), container.missing, container.damage, container.notes, left_out
    )


def _carried_over(container: Container, file: Output) -> int:
    """Write the attachments that are whole; how many are not."""
    left_out = 0
    for name in container.attachments:
        try:
            file.attachment(name, BytesIO(container.attachment(name)))
        except ValueError:
            left_out += 1
    return left_out


def repair_notes(metadata: dict[str, dict[str, str]]) -> list[str]:
    """What a repaired file had lost by its own record, as notes."""
    return [damage_note("that was repaired", printable(note[:1000])) for note in _noted(metadata)[:20]]


def _noted(metadata: dict[str, dict[str, str]]) -> list[str]:
    try:
        return [str(note) for note in json.loads(metadata.get(REPAIRED, {}).get("notes", "[]"))]
    except (ValueError, TypeError, RecursionError):
        return ["nothing of the lost part can be read."]


def spooled(container: Container, payloads: IO[bytes]) -> tuple[IntArray, list[Topic]]:
    """All payloads in a file; by message topic, number, log and publish time, place and size, (n, 6)."""
    parts: list[IntArray] = []
    place = 0
    for chunk in container.chunks():
        data, start, stop = joined(chunk.chunk, chunk.start, chunk.stop)
        columns = (chunk.topic, chunk.sequence, chunk.log_ns, chunk.publish_ns, place + start, stop - start)
        parts.append(np.stack(columns, axis=1))
        payloads.write(data)
        place += len(data)
    return (np.concatenate(parts) if parts else np.empty((0, 6), np.int64)), container.topics


def by_time(rows: IntArray, topics: list[Topic], payloads: IO[bytes]) -> Iterator[ChunkMessages]:
    """Messages by log time; those of one time in the order in which they came."""
    order = np.argsort(rows[:, 2], kind="stable")
    for start in range(0, len(order), _TOGETHER):
        mine = rows[order[start : start + _TOGETHER]]
        data = []
        for place, size in mine[:, 4:].tolist():
            payloads.seek(place)
            data.append(payloads.read(size))
        topic, sequence, log_ns, publish_ns, _, sizes = mine.T
        ends = np.cumsum(sizes)
        yield ChunkMessages(topics, topic, sequence, log_ns, publish_ns, b"".join(data), ends - sizes, ends)
