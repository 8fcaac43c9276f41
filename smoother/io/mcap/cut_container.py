"""Parts of an MCAP file by time: all topics, as they are, with what was said once at the beginning."""

from __future__ import annotations

import json
import math
import os
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...array_types import IntArray
from ...errors import RecordingError
from ...runtime.outputs import writing
from .container import Container
from .merge import Output
from .messages import Topic
from .repair import by_time, spooled

#: Metadata record of a part: of which recording, from when to when.
CUT = "unocclude.cut"
#: A topic of these schemas with this few messages was sent once for the whole recording.
_SAID_ONCE = 20
#: After every message.
_END = np.iinfo(np.int64).max
_STATIC = ("TFMessage", "FrameTransform", "FrameTransforms", "CameraInfo", "CameraCalibration")


@dataclass(frozen=True)
class Part:
    """A part of a recording."""

    name: str  # For messages, and kept in the part's file
    path: Path  # To write
    from_s: float  # On the recording's axis, the end left out; infinite for the recording's
    to_s: float  # On the recording's axis, the end left out; infinite for the recording's


def cut_container(
    source: str | os.PathLike[str],
    parts: Sequence[Part],
    zero_ns: int,
    of_recording: str,
    force: bool = False,
) -> list[dict[str, object]]:
    """Write parts of an MCAP file; the file is read once."""
    container = Container(source)
    written: list[dict[str, object]] = []
    with tempfile.TemporaryFile() as payloads:
        rows, topics = spooled(container, payloads)
        rows = rows[np.argsort(rows[:, 2], kind="stable")]
        for part in parts:
            start_ns = max(zero_ns + round(1e9 * part.from_s), 0)
            end_ns = zero_ns + round(1e9 * part.to_s) if math.isfinite(part.to_s) else _END
            first, last = np.searchsorted(rows[:, 2], [start_ns, end_ns]).tolist()
            if first == last:
                raise RecordingError(
                    f"{Path(source).name}: there is no message between {part.from_s:g} and {part.to_s:g} s"
                    f" ({part.name})"
                )
            before = rows[:first][np.isin(rows[:first, 0], _said_once(topics))].copy()
            before[:, 2] = start_ns  # their own stamps stay
            mine = np.concatenate([before, rows[first:last]])
            record = {"source": Path(source).name, "name": part.name}
            record |= {"from_s": repr(part.from_s), "to_s": repr(part.to_s)}
            with writing(part.path, force) as temporary, Output(temporary) as output:
                for name, values in _metadata(container, of_recording, topics, rows, first, last):
                    output.metadata(name, values)
                output.metadata(CUT, record)
                output.interleave(by_time(mine, topics, payloads))
                output.write([])
            counts = np.bincount(mine[:, 0], minlength=len(topics)).tolist()
            messages = {topic.name: count for topic, count in zip(topics, counts, strict=True) if count}
            about = {"name": part.name, "file": str(part.path), "from_s": part.from_s, "to_s": part.to_s}
            written.append({**about, "messages": messages})
    return written


def _said_once(topics: Sequence[Topic]) -> list[int]:
    """Positions of the topics whose few messages apply to the whole recording."""
    return [
        number
        for number, topic in enumerate(topics)
        if topic.count <= _SAID_ONCE and topic.schema.replace(".", "/").rpartition("/")[2] in _STATIC
    ]


def _metadata(
    container: Container,
    of_recording: str,
    topics: Sequence[Topic],
    rows: IntArray,
    first: int,
    last: int,
) -> Iterator[tuple[str, dict[str, str]]]:
    """The file's metadata records; rows of a truth that are scored are counted from the part's start."""
    for name, values in container.metadata.items():
        if name == CUT:
            continue
        if name == of_recording and "truth_score" in values:
            with suppress(ValueError, TypeError, AttributeError):  # its content is checked where it is read
                scored = {}
                for topic, runs in json.loads(values["truth_score"]).items():
                    numbers = [k for k, each in enumerate(topics) if each.name == topic]
                    of_topic = np.isin(rows[:, 0], numbers)
                    before, inside = int(of_topic[:first].sum()), int(of_topic[first:last].sum())
                    moved = [[min(max(edge - before, 0), inside) for edge in run] for run in runs]
                    scored[topic] = [run for run in moved if run[1] > run[0]]
                values = {**values, "truth_score": json.dumps(scored)}
        yield name, values
