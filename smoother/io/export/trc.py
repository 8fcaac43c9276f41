"""Markers to a TRC file, the text format of OpenSim and of optical motion capture."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ...array_types import FloatArray
from ...runtime.outputs import writing

#: Millimetres in the file, with so many decimals: a nanometre.
UNIT, PER_METRE, DECIMALS = "mm", 1000.0, 6
_ROWS = 20_000
_COLUMNS = ["DataRate", "CameraRate", "NumFrames", "NumMarkers", "Units"]
_COLUMNS += ["OrigDataRate", "OrigDataStartFrame", "OrigNumFrames"]


def write_trc(
    path: str | os.PathLike[str],
    names: Sequence[str],
    t_s: FloatArray,
    position: FloatArray,
    rate_hz: float,
    force: bool = False,
) -> None:
    """Write marker positions; cells are blank where a marker has none.

    Parameters
    ----------
    path : path-like
        The file to write.
    names : sequence of str
        Of the markers, M.
    t_s : ndarray, shape (N,), s
        Times.
    position : ndarray, shape (N, M, 3), m
        nan where there is none. The file holds millimetres and says so.
    rate_hz : float
        Of the rows, for the header.
    force : bool
        Overwrite a file that exists.

    Raises
    ------
    UnoccludeError
        The file exists and `force` is not given, or it cannot be written.
    """
    rate = f"{rate_hz:.10g}"
    count = str(len(t_s))
    head = [
        ["PathFileType", "4", "(X/Y/Z)", Path(path).name],
        _COLUMNS,
        [rate, rate, count, str(len(names)), UNIT, rate, "1", count],
        ["Frame#", "Time", *(cell for name in names for cell in (name, "", ""))],
        ["", "", *(f"{axis}{number}" for number in range(1, len(names) + 1) for axis in "XYZ")],
    ]
    # A tab ends every row: OpenSim drops an empty cell at the end of a line.
    line = "%d\t%.9f" + f"\t%.{DECIMALS}f" * (3 * len(names)) + "\t\n"
    with writing(path, force) as temporary, open(temporary, "w", encoding="utf-8", newline="") as file:
        file.write("".join("\t".join(cells) + "\n" for cells in head) + "\n")
        for start in range(0, len(t_s), _ROWS):
            part = slice(start, start + _ROWS)
            values = blank(PER_METRE * position[part]).reshape(-1, 3 * len(names)).tolist()
            times = t_s[part].tolist()
            rows = [
                line % (start + number + 1, time, *row)
                for number, (time, row) in enumerate(zip(times, values, strict=True))
            ]
            file.write("".join(rows).replace("nan", ""))


def blank(position: FloatArray) -> FloatArray:
    """Positions (.., 3) in which one that is not whole, or not finite, is nan on every axis."""
    whole = np.isfinite(position).all(axis=-1, keepdims=True)
    return np.where(whole, position, np.nan)
