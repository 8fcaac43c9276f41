"""A damaged MCAP file written anew: every message that is whole, with a new index."""

from __future__ import annotations

import dataclasses
import json
import os
from collections import Counter
from io import BytesIO
from typing import Any

from ...errors import RecordingError
from ...runtime.outputs import writing
from ...runtime.printable import printable
from .container import Container
from .merge import Output
from .messages import damage_note

#: Metadata record that lists what the file had lost when it was repaired.
REPAIRED = "unocclude.repair"


def repair_container(
    source: str | os.PathLike[str], output: str | os.PathLike[str], force: bool = False
) -> dict[str, Any]:
    """Write what is still in a damaged MCAP file as a whole one; what was there and is lost, as JSON."""
    container = Container(source, unverified=True)
    with writing(output, force) as temporary, Output(temporary) as file:
        for chunk in container.chunks():
            file.copy(container.topics, chunk)
        messages: Counter[str] = Counter()
        for topic in container.topics:
            messages[topic.name] += topic.count
        if not +messages:
            why = [f"{source} has no complete message; nothing can be repaired.", *container.notes[:3]]
            raise RecordingError(" ".join(why))
        for name, values in container.metadata.items():
            if name != REPAIRED:
                file.metadata(name, values)
        name, left_out = damage_note(container.path.name, ""), 0
        told = [note.removeprefix(name) for note in container.notes]
        if notes := list(dict.fromkeys([*_noted(container.metadata), *told])):
            file.metadata(REPAIRED, {"notes": json.dumps(notes), "missing": json.dumps(container.missing)})
        for name in container.attachments:
            try:
                file.attachment(name, BytesIO(container.attachment(name)))
            except ValueError:
                left_out += 1
    return {
        "source": container.path.name,
        "messages": dict(+messages),  # Written, by topic
        "missing": container.missing,  # Lost by topic, as the file's own count says; empty where it has none
        "losses": [dataclasses.asdict(each) for each in container.damage],  # In the file's order
        "notes": container.notes,  # What was wrong, one sentence each
        "attachments_left_out": left_out,
    }


def repair_notes(metadata: dict[str, dict[str, str]]) -> list[str]:
    """What a repaired file had lost by its own record, as notes."""
    return [damage_note("that was repaired", printable(note[:1000])) for note in _noted(metadata)[:20]]


def _noted(metadata: dict[str, dict[str, str]]) -> list[str]:
    try:
        return [str(note) for note in json.loads(metadata.get(REPAIRED, {}).get("notes", "[]"))]
    except (ValueError, TypeError, RecursionError):
        return ["nothing of the lost part can be read."]
