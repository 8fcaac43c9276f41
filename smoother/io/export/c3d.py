"""Markers to a C3D file, the binary format of motion capture laboratories."""

from __future__ import annotations

import errno
import os
import shutil
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ...array_types import FloatArray
from ...errors import UnoccludeError
from ...runtime.outputs import locked, writing
from .trc import blank

#: The header counts frames in 16 bits, and readers follow it.
MOST_FRAMES = 65_535
_BLOCK = 512
_LINE, _LINES = 120, 200
_INTEGER = 2  # ezc3d's number of the type


@dataclass(frozen=True)
class C3dContent:
    """What a C3D file holds.

    Attributes
    ----------
    names : sequence of str
        Of the points, M.
    position : ndarray, shape (N, M, 3), m
        nan where there is none. The file holds millimetres and says so.
    rate_hz : float
        Frames a second.
    residual : ndarray, shape (N, M), optional
        Of each point by the format's convention: -1 none, 0 computed, above 0 measured; -1 wherever the
        position is not finite. None: 0 and -1.
    descriptions : sequence of str
        Of the points, or empty.
    channels : mapping of str to (ndarray, str)
        Further signals (N,) at the frames' rate, by name, with their unit.
    events : sequence of (str, float)
        Label and time (s from the first frame), with `context` for all of them.
    context : str
        "Left", "Right" or "General".
    parameters : mapping of str to sequence of str
        Group UNOCCLUDE: texts by parameter name.
    """

    names: Sequence[str]
    position: FloatArray
    rate_hz: float
    residual: FloatArray | None = None
    descriptions: Sequence[str] = ()
    channels: Mapping[str, tuple[FloatArray, str]] = field(default_factory=dict)
    events: Sequence[tuple[str, float]] = ()
    context: str = "General"
    parameters: Mapping[str, Sequence[str]] = field(default_factory=dict)


def write_c3d(path: str | os.PathLike[str], content: C3dContent, force: bool = False) -> None:
    """Write a C3D file (floating point, millimetres).

    Parameters
    ----------
    path : path-like
        The file to write.
    content : C3dContent
        What it is to hold.
    force : bool
        Overwrite a file that exists.

    Raises
    ------
    UnoccludeError
        The file exists and `force` is not given, it cannot be written, or it has too many frames for
        the format.
    """
    frames = len(content.position)
    check_frames(path, frames, content.rate_hz)
    file = _assemble(content)
    with writing(path, force) as temporary:
        named = temporary.with_name(f"{temporary.name}.c3d")  # ezc3d insists on the ending
        try:
            with locked(named):
                file.write(os.fspath(named))
                _check_size(named, frames, 4 * len(content.names) + len(content.channels))
                shutil.copyfile(named, temporary)
        finally:
            named.unlink(missing_ok=True)


def check_frames(name: str | os.PathLike[str], frames: int, rate_hz: float) -> None:
    """Refuse what is too long for the format.

    Raises
    ------
    UnoccludeError
        There are more frames than a C3D file holds.
    """
    if frames > MOST_FRAMES:
        slower = np.floor(100 * rate_hz * MOST_FRAMES / frames) / 100
        raise UnoccludeError(
            f"{name}: a C3D file holds {MOST_FRAMES} frames at most and this would have {frames};"
            f" give --rate {slower:g} or less, or export to trc or parquet"
        )


def _assemble(content: C3dContent) -> Any:
    import ezc3d

    file = ezc3d.c3d()
    position = blank(1000.0 * content.position)
    known = np.isfinite(position[..., 0])
    residual = np.where(known, 0.0 if content.residual is None else content.residual, -1.0)
    point = file["parameters"]["POINT"]
    point["RATE"]["value"] = [float(content.rate_hz)]
    point["UNITS"]["value"] = ["mm"]
    point["LABELS"]["value"] = list(content.names)
    if content.descriptions:
        point["DESCRIPTIONS"]["value"] = list(content.descriptions)
    homogeneous = np.ones((4, position.shape[1], len(position)))
    homogeneous[:3] = position.transpose(2, 1, 0)
    file["data"]["points"] = homogeneous
    file["data"]["meta_points"]["residuals"] = residual.T[None]
    file["data"]["meta_points"]["camera_masks"] = np.zeros((7, *residual.T.shape), dtype=bool)
    if content.channels:
        analog = file["parameters"]["ANALOG"]
        analog["RATE"]["value"] = [float(content.rate_hz)]
        analog["LABELS"]["value"] = list(content.channels)
        analog["UNITS"]["value"] = [unit for _, unit in content.channels.values()]
        file["data"]["analogs"] = np.stack([values for values, _ in content.channels.values()])[None]
    if content.events:
        _add_events(file, content)
    for name, texts in content.parameters.items():
        # A dimension of a parameter is one byte: longer texts go on in the next line.
        plain = [text.encode("ascii", "replace").decode() for text in texts]
        lines = [line for text in plain for line in textwrap.wrap(text, _LINE)]
        file.add_parameter("UNOCCLUDE", name, lines[:_LINES])
    return file


def _add_events(file: Any, content: C3dContent) -> None:
    """The group EVENT as other software writes it: times in minutes and seconds."""
    count = len(content.events)
    times = np.array([time for _, time in content.events])
    file.add_parameter("EVENT", "USED", [count])
    file["parameters"]["EVENT"]["USED"]["type"] = _INTEGER
    file["parameters"]["EVENT"]["USED"]["value"] = np.array([count])
    file.add_parameter("EVENT", "CONTEXTS", [content.context] * count)
    file.add_parameter("EVENT", "LABELS", [label for label, _ in content.events])
    file.add_parameter("EVENT", "TIMES", np.stack([times // 60, times % 60]))


def _check_size(path: Path, frames: int, numbers: int) -> None:
    """ezc3d says nothing when the disk is full; a file that was cut short is not to be delivered."""
    size = path.stat().st_size if path.exists() else 0
    start = 0
    if size >= _BLOCK:
        with open(path, "rb") as file:
            start = (int.from_bytes(file.read(18)[16:18], "little") - 1) * _BLOCK
    if size < start + 4 * frames * numbers or start <= 0:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
