"""A damaged MCAP file written anew: every complete message, in the order of time, with a new index."""

from __future__ import annotations

import json
import os
import tempfile
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import IO, Any

import numpy as np

from ...array_types import IntArray
from ...errors import RecordingError
from ...runtime.outputs import writing
from ...runtime.printable import printable
from ..wire.layout import joined
from .container import Container
from .merge import Output
from .messages import ChunkMessages, Loss, Topic, damage_note

#: Metadata record that lists what the file had lost when it was repaired.
REPAIRED = "unocclude.repair"
#: This many messages are written together.
_TOGETHER = 4096


@dataclass
class RepairReport:
    """What was still in a damaged file."""

    source: str  # The damaged file's name
    messages: dict[str, int] = field(default_factory=dict)  # Written, by topic
    # Lost by topic, as the damaged file's own count says; empty where it has none
    missing: dict[str, int] = field(default_factory=dict)
    losses: list[Loss] = field(default_factory=list)  # What is damaged, in the file's order
    notes: list[str] = field(default_factory=list)  # What was wrong, one sentence each
    attachments: int = 0  # That were not carried over

    def to_dict(self) -> dict[str, Any]:
        """Plain values, fit for JSON."""
        return {
            "source": self.source,
            "messages": self.messages,
            "missing": self.missing,
            "losses": [loss.to_dict() for loss in self.losses],
            "attachments_left_out": self.attachments,
            "notes": self.notes,
        }


def repair_container(
    source: str | os.PathLike[str], output: str | os.PathLike[str], force: bool = False
) -> RepairReport:
    """Write what is still in a damaged MCAP file as a whole one."""
    container = Container(source, unverified=True)
    with tempfile.TemporaryFile() as payloads:
        rows, topics = spooled(container, payloads)
        if container.undescribed:
            container = Container(source, unverified=True, described=container.described)
            payloads.seek(0)
            payloads.truncate()
            rows, topics = spooled(container, payloads)
        counts = np.bincount(rows[:, 0], minlength=len(topics)).tolist()
        messages: Counter[str] = Counter()
        for topic, count in zip(topics, counts, strict=True):
            messages[topic.name] += count
        report = RepairReport(
            container.path.name,
            dict(+messages),
            container.missing,
            container.losses,
            list(container.notes),
            container.attachments,
        )
        if not len(rows):
            raise RecordingError(
                " ".join([f"{source} has no complete message; nothing can be repaired.", *report.notes[:3]])
            )
        with writing(output, force) as temporary, Output(temporary) as file:
            for name, values in container.metadata.items():
                if name != REPAIRED:
                    file.metadata(name, values)
            if report.notes or REPAIRED in container.metadata:
                file.metadata(REPAIRED, _told(report, container.metadata.get(REPAIRED, {})))
            file.interleave(by_time(rows, topics, payloads))
            file.write([])
    return report


def repair_notes(metadata: dict[str, dict[str, str]]) -> list[str]:
    """What a repaired file had lost by its own record, as notes."""
    try:
        notes = json.loads(metadata.get(REPAIRED, {}).get("notes", "[]"))
    except (ValueError, RecursionError):
        notes = ["nothing of the lost part can be read."]
    if not isinstance(notes, list):
        notes = [notes]
    return [damage_note("that was repaired", printable(str(note)[:1000])) for note in notes[:20]]


def _told(report: RepairReport, before: dict[str, str]) -> dict[str, str]:
    """The metadata record of a repaired file; what an earlier repair said stays."""
    try:
        earlier = [str(note) for note in json.loads(before.get("notes", "[]"))]
    except (ValueError, TypeError, RecursionError):
        earlier = []
    return {
        "notes": json.dumps(list(dict.fromkeys([*earlier, *report.notes]))),
        "missing": json.dumps(report.missing),
    }


def spooled(container: Container, payloads: IO[bytes]) -> tuple[IntArray, list[Topic]]:
    """All payloads in a file; by message topic, number, log and publish time, place and size, (n, 6)."""
    parts: list[IntArray] = []
    place = 0
    for chunk in container.chunks(lambda topic: True):
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
