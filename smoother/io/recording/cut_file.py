"""Parts of a recording's file, by times on the recording's own axis; a table of trials that names them."""

from __future__ import annotations

import json
import math
import os
from collections import Counter
from collections.abc import Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import Unpack

import numpy as np

from ...array_types import BoolArray
from ...errors import RecordingError
from ...runtime.outputs import writing
from ..mcap.container import Container
from ..mcap.merge import Output
from ..mcap.messages import Messages
from ..tables.columns import read_exact
from .choose import Selection
from .read import METADATA, RESULT_PREFIX, open_recording, select_recordings

#: Metadata record of a part: of which recording, from when to when.
CUT = "unocclude.cut"
#: A topic of these schemas with this few messages was sent once for the whole recording.
_SAID_ONCE = 20
_STATIC = ("TFMessage", "FrameTransform", "FrameTransforms", "CameraInfo", "CameraCalibration")
#: After every message.
_END = np.iinfo(np.int64).max
#: A part that begins or ends so little beyond the recording is not said to, s.
_SPARE_S = 0.5


@dataclass(frozen=True)
class Part:
    """A part of a recording."""

    name: str  # For messages, and kept in the part's file
    path: Path  # To write
    from_s: float  # On the recording's axis, the end left out; infinite for the recording's
    to_s: float


def cut_file(
    source: str | os.PathLike[str],
    parts: Sequence[Part],
    *,
    force: bool = False,
    **selection: Unpack[Selection],
) -> tuple[list[dict[str, object]], list[str]]:
    """Write parts of a recording; every command reads them, and times are those of the whole."""
    name = Path(source).name
    file = open_recording(source, truth=False)
    if any(topic.name.startswith(RESULT_PREFIX) for topic in file.topics):
        raise RecordingError(
            f"{name} is a result of `unocclude smooth`; cut the recording, and smooth the part"
        )
    recording = select_recordings(file, **selection)[0]
    shift_ns = next((imu.log_shift_ns for imu in file.imus if imu.topic == recording.imu.name), 0)
    streams = (recording.imu.t_s, recording.arm.t_s)
    first_s, last_s = max(float(t[0]) for t in streams), min(float(t[-1]) for t in streams)
    lasts, notes = f"the recording, which lasts from {first_s:.2f} to {last_s:.2f} s", []
    for part in parts:
        if part.from_s >= last_s or part.to_s <= first_s:
            raise RecordingError(f"{name}: {part.name} (from {part.from_s:g} s) lies outside {lasts}")
        beyond = math.isfinite(part.to_s) and part.to_s > last_s + _SPARE_S
        if beyond or part.from_s < min(first_s - _SPARE_S, 0.0):
            notes.append(f"{part.name} reaches beyond {lasts}.")
    once = {
        topic.name
        for topic in file.topics
        if topic.count <= _SAID_ONCE and topic.schema.replace(".", "/").rpartition("/")[2] in _STATIC
    }
    container, zero_ns = Container(source), recording.origin_ns + shift_ns
    with ExitStack() as stack:
        outputs = [
            _PartOutput(
                part, zero_ns, stack.enter_context(Output(stack.enter_context(writing(part.path, force))))
            )
            for part in parts
        ]
        for chunk in container.chunks():
            is_once = np.array([topic.label in once for topic in container.topics])[chunk.topic]
            for output in outputs:
                output.take(container, chunk, is_once)
        return [output.finished(container, name) for output in outputs], notes


class _PartOutput:
    """A part of an MCAP file with all topics as they are, while the file is read."""

    def __init__(self, part: Part, zero_ns: int, output: Output) -> None:
        self._part, self._output = part, output
        self._start_ns = max(zero_ns + round(1e9 * part.from_s), 0)
        self._end_ns = zero_ns + round(1e9 * part.to_s) if math.isfinite(part.to_s) else _END
        self._before, self._inside, self._written = Counter[str](), Counter[str](), Counter[str]()

    def take(self, container: Container, chunk: Messages, is_once: BoolArray) -> None:
        """Write what is in the part, and earlier messages that apply to the whole recording."""
        before = chunk.log_ns < self._start_ns
        inside = ~before & (chunk.log_ns < self._end_ns)
        written = inside | (before & is_once)
        counted = ((self._before, before), (self._inside, inside), (self._written, written))
        for counts, rows in counted:
            for position, of_topic in enumerate(np.bincount(chunk.topic[rows]).tolist()):
                counts[container.topics[position].name] += of_topic
        if written.any():
            mine = chunk.select(np.flatnonzero(written))
            # their own stamps stay
            self._output.copy(container.topics, mine._replace(log_ns=np.maximum(mine.log_ns, self._start_ns)))

    def finished(self, container: Container, source: str) -> dict[str, object]:
        """Write the metadata; what is stated of the part."""
        part = self._part
        if not +self._inside:
            raise RecordingError(
                f"{source}: there is no message between {part.from_s:g} and {part.to_s:g} s ({part.name})"
            )
        records = {name: values for name, values in container.metadata.items() if name != CUT}
        about = records.get(METADATA, {})
        with suppress(KeyError, ValueError, TypeError, AttributeError):  # it is checked where it is read
            records[METADATA] = {**about, "truth_score": self._scored(json.loads(about["truth_score"]))}
        bounds = {"from_s": repr(part.from_s), "to_s": repr(part.to_s)}
        for name, values in {**records, CUT: {"source": source, "name": part.name, **bounds}}.items():
            self._output.metadata(name, values)
        stated = {"name": part.name, "file": str(part.path), "from_s": part.from_s, "to_s": part.to_s}
        return {**stated, "messages": dict(+self._written)}

    def _scored(self, runs_by_topic: dict[str, list[list[int]]]) -> str:
        """Rows of a truth that are scored, counted from the part's start."""
        scored = {}
        for topic, runs in runs_by_topic.items():
            before, inside = self._before[topic], self._inside[topic]
            moved = [[min(max(edge - before, 0), inside) for edge in run] for run in runs]
            scored[topic] = [run for run in moved if run[1] > run[0]]
        return json.dumps(scored)


#: Columns of the table; `label` may be missing.
COLUMNS = ("name", "start_s", "end_s")
#: What no system has in the name of a file.
_FORBIDDEN = set('/\\:*?"<>|') | {chr(code) for code in range(32)}
_LONGEST_NAME = 100


def read_trials(path: Path, folder: Path, labels: Sequence[str] = ()) -> list[Part]:
    """The trials of a CSV table with the columns name, start_s, end_s and, optionally, label."""
    numbers, words = read_exact(path, COLUMNS, ("label",), words=("name", "label"), separator=None)
    names, times = words["name"], (numbers[column].tolist() for column in COLUMNS[1:])
    trials = list(zip(names, words.get("label", names), *times, strict=True))
    for row, (name, _, start_s, end_s) in enumerate(trials, 1):
        if not name or len(name) > _LONGEST_NAME or _FORBIDDEN & set(name) or name.strip(".") == "":
            raise RecordingError(
                f"{path}, row {row}: '{name[:_LONGEST_NAME]}' is not a valid file name; name every trial by"
                " letters, numbers, spaces and dashes"
            )
        if not start_s < end_s:
            raise RecordingError(f"{path}, row {row}: {name} ends at {end_s:g} s, before it starts")
    chosen = [each for each in trials if not labels or {*each[:2]} & set(labels)]
    if not chosen:
        there = ", ".join(dict.fromkeys(label or name for name, label, *_ in trials))
        raise RecordingError(
            f"{path}: there is no trial with the label {', '.join(labels)}; the table has {there}"
        )
    keys = [name.casefold() for name, *_ in chosen]
    taken, parts = set(keys), []
    for (name, _, start_s, end_s), key in zip(chosen, keys, strict=True):  # those with one name are numbered
        if keys.count(key) > 1:
            name = next(new for k in count(1) if (new := f"{name}_{k}").casefold() not in taken)
            taken.add(name.casefold())
        parts.append(Part(name, folder / f"{name}.mcap", start_s, end_s))
    return parts
