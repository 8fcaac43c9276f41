"""A damaged MCAP file written anew: every complete message, in the order of time, with a new index."""

from __future__ import annotations

import json
import os
import tempfile
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any

import numpy as np

from ...array_types import IntArray
from ...errors import RecordingError
from ...runtime.outputs import writing
from ...runtime.printable import printable
from .container import Container
from .merge import Output
from .messages import ChunkMessages, Loss, Topic

#: Metadata record that says what the file had lost when it was repaired.
REPAIRED = "unocclude.repair"
#: So many messages are written together.
_TOGETHER = 4096


@dataclass
class RepairReport:
    """What was still in a damaged file.

    Attributes
    ----------
    source : str
        The damaged file's name.
    messages : dict of str to int
        Written, by topic.
    missing : dict of str to int
        Lost by topic, as the damaged file's own count says; empty where it has none.
    losses : list of Loss
        What is damaged, in the file's order.
    notes : list of str
        What was wrong, one sentence each.
    attachments : int
        That were not carried over.
    """

    source: str
    messages: dict[str, int] = field(default_factory=dict)
    missing: dict[str, int] = field(default_factory=dict)
    losses: list[Loss] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    attachments: int = 0

    def to_dict(self) -> dict[str, Any]:
        """Plain values, fit for JSON."""
        return {
            "source": self.source,
            "messages": self.messages,
            "missing": self.missing,
            "losses": [
                {
                    "what": loss.what,
                    "start_byte": loss.start,
                    "stop_byte": loss.stop,
                    "first_ns": loss.first_ns,
                    "last_ns": loss.last_ns,
                    "messages": loss.counts,
                    "messages_kept_unverified": loss.is_kept,
                }
                for loss in self.losses
            ],
            "attachments_left_out": self.attachments,
            "notes": self.notes,
        }


def repair_container(
    source: str | os.PathLike[str], output: str | os.PathLike[str], force: bool = False
) -> RepairReport:
    """Write what is still in a damaged MCAP file as a whole one.

    Messages of chunks that fail their checksum are written too, as nothing tells which of them is damaged;
    the file says so in its metadata, and whoever reads it is told.

    Parameters
    ----------
    source, output : path-like
        The damaged file, and where the whole one is to lie.
    force : bool
        Overwrite an output that exists.

    Returns
    -------
    RepairReport
        What was written, and what was lost where.

    Raises
    ------
    RecordingError
        The file cannot be read, or holds no complete message.
    """
    container = Container(source, unverified=True)
    with tempfile.TemporaryFile() as payloads:
        rows, topics = spooled(container, payloads)
        if any("no record before them" in loss.what for loss in container.losses):
            container = Container(source, unverified=True, definitions=container.definitions)
            payloads.seek(0)
            payloads.truncate()
            rows, topics = spooled(container, payloads)
        report = _report(container, topics, rows)
        if not len(rows):
            raise RecordingError(
                " ".join([f"{source} holds no complete message; nothing can be repaired.", *report.notes[:3]])
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
    """What a repaired file says that it had lost, as notes."""
    try:
        notes = json.loads(metadata.get(REPAIRED, {}).get("notes", "[]"))
    except (ValueError, RecursionError):
        notes = ["of what was lost nothing can be read."]
    if not isinstance(notes, list):
        notes = [notes]
    return [f"The file was repaired: {printable(str(note)[:1000])}" for note in notes[:20]]


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
    topics: list[Topic] = []
    for chunk in container.chunks(lambda topic: True):
        topics = chunk.topics
        sizes = np.fromiter(map(len, chunk.data), np.int64, len(chunk.data))
        ends = place + np.cumsum(sizes)
        columns = (chunk.topic, chunk.sequence, chunk.log_ns, chunk.publish_ns, ends - sizes, sizes)
        parts.append(np.stack(columns, axis=1))
        payloads.write(b"".join(chunk.data))
        place = int(ends[-1])
    return (np.concatenate(parts) if parts else np.empty((0, 6), np.int64)), topics


def by_time(rows: IntArray, topics: list[Topic], payloads: IO[bytes]) -> Iterator[ChunkMessages]:
    """Messages by log time; those of one time in the order in which they came."""
    order = np.argsort(rows[:, 2], kind="stable")
    for start in range(0, len(order), _TOGETHER):
        mine = rows[order[start : start + _TOGETHER]]
        data = []
        for place, size in mine[:, 4:].tolist():
            payloads.seek(place)
            data.append(payloads.read(size))
        yield ChunkMessages(topics, mine[:, 0], mine[:, 1], mine[:, 2], mine[:, 3], data)


def _report(container: Container, topics: list[Topic], rows: IntArray) -> RepairReport:
    counts: Counter[str] = Counter()
    for number, count in enumerate(np.bincount(rows[:, 0], minlength=len(topics)).tolist()):
        counts[topics[number].name] += count
    return RepairReport(
        Path(container.path).name,
        dict(counts),
        dict(container.missing),
        list(container.losses),
        list(container.notes),
        container.attachments,
    )
