"""Parts of a recording's file, by times on the recording's own axis."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Unpack

from ...errors import RecordingError
from ...runtime.store import Store
from ..mcap.cut_container import Part, cut_container
from .read import METADATA, RESULT_PREFIX, open_recording
from .select import select_recordings
from .selection import Selection


def cut_file(
    source: str | os.PathLike[str],
    parts: Sequence[Part],
    *,
    force: bool = False,
    store: Store | None = None,
    **selection: Unpack[Selection],
) -> tuple[list[dict[str, object]], list[str]]:
    """Write parts of a recording; every command reads them, and times are those of the whole.

    Parameters
    ----------
    source : path-like
        An MCAP file.
    parts : sequence of Part
        Times as `smooth` and `info` state them: seconds after the recording's zero, by the forearm IMU.
    force : bool
        Overwrite outputs that exist.
    store : Store, optional
        Where what grows with the recording's length lives.
    imu, skeleton, side, body
        Of a file with several; its time is that of the arm chosen.

    Returns
    -------
    written : list of dict
        As of `cut_container`.
    notes : list of str
        Parts that reach beyond the recording.

    Raises
    ------
    RecordingError
        It is a result, cannot be read, or a part lies outside it; in one sentence.
    """
    name = Path(source).name
    file = open_recording(source, truth=False, store=store)
    if any(topic.name.startswith(RESULT_PREFIX) for topic in file.topics):
        raise RecordingError(
            f"{name} is a result of `unocclude smooth`; cut the recording, and smooth the part"
        )
    recording = select_recordings(file, store=store, **selection)[0]
    shift_ns = next((imu.log_shift_ns for imu in file.imus if imu.topic == recording.imu.name), 0)
    streams = (recording.imu.t_s, recording.arm.t_s)
    first_s, last_s = max(float(t[0]) for t in streams), min(float(t[-1]) for t in streams)
    notes = []
    for part in parts:
        if part.from_s >= last_s or part.to_s <= first_s:
            raise RecordingError(
                f"{name}: {part.name} (from {part.from_s:g} s) lies outside the recording, which"
                f" lasts from {first_s:.2f} to {last_s:.2f} s"
            )
        beyond = math.isfinite(part.to_s) and part.to_s > last_s + _SPARE_S
        if beyond or part.from_s < min(first_s - _SPARE_S, 0.0):
            lasts = f"the recording, which lasts from {first_s:.2f} to {last_s:.2f} s"
            notes.append(f"{part.name} reaches beyond {lasts}.")
    return cut_container(source, parts, recording.origin_ns + shift_ns, METADATA, force), notes


#: A part that begins or ends so little beyond the recording is not said to, s.
_SPARE_S = 0.5
