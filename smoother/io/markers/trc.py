"""TRC files (Motion Analysis; OpenSim's marker format), with the habits of the programs that write them."""

from __future__ import annotations

import re
from itertools import pairwise
from pathlib import Path

import numpy as np

from ...array_types import FloatArray
from ...errors import RecordingError
from ...runtime.inputs import check_input
from ..tables.file_head import plain_minus, shown
from .trajectories import Markers, metres_in, told_apart, without_origin

#: Spellings of "no number", beyond those that `float` reads: Windows' and spreadsheets' ones.
_NOTHING = re.compile(
    r"[-+]?(nan\(.*\)|1\.?#(ind|qnan|snan|inf).*|#n/a|n/?a|null|none|missing|-+|\*+|inf(inity)?)",
    re.IGNORECASE,
)
#: Times that differ from the frame rate's by no more than this were rounded on writing, s.
ROUNDED_S = 0.00051
_DECIMAL_COMMA = re.compile(r"[-+]?\d*,\d*([eEdD][-+]?\d+)?")


def read_trc(path: Path) -> Markers:
    """Read a TRC file.

    Cells are parted by tabs, commas, semicolons or spaces; decimal commas, blank cells, nan in any
    spelling, exponents, Windows line ends, blank lines, names over the wrong columns and counts in the
    header that are wrong do no harm. Times are those of the column `Time`; where they are missing, of the
    frame rate.

    Raises
    ------
    RecordingError
        It is no TRC file, has no marker or frame, or a cell is not a number; the text names the line.
    """
    lines = _lines(path)
    place = next((k for k, line in enumerate(lines) if _starts(line, "frame#", "frame", "#frame")), None)
    if place is None:
        raise RecordingError(
            f"{path}: not a TRC file: no line begins with Frame#, above the markers' names; export it again"
        )
    header = _header(lines[:place])
    mark = _mark(lines[place])
    names, twice = told_apart([cell for cell in _cells(lines[place], mark)[2:] if cell.strip()])
    if not names:
        raise RecordingError(f"{path}: the line with Frame# names no marker; export the file again")
    # the line of X1 Y1 Z1 .. may be missing
    rows = [
        (number, line)
        for number, line in enumerate(lines[place + 1 :], place + 2)
        if line.strip(" \t,;") and not _starts(line, "x1", '"x1')
    ]
    if not rows:
        raise RecordingError(f"{path}: the file names {len(names)} markers and holds no frame")
    counted = header.get("numframes", "")
    cut_off = counted.isdigit() and int(counted) > len(rows) > 1
    if cut_off and len(_cells(rows[-1][1], mark)) < len(_cells(rows[-2][1], mark)):
        rows.pop()  # its last number may have lost digits
    table = _numbers(path, rows, mark, 2 + 3 * len(names))
    unit = header.get("units", "")
    if not unit:
        raise RecordingError(f"{path}: the header states no Units; add mm or m on its third line")
    position = without_origin(table[:, 2:].reshape(len(table), -1, 3)) * metres_in(unit, path)
    position[~np.isfinite(position).all(axis=2)] = np.nan
    rate = _rate(header)
    t_s, notes = _times(path, table, rate)
    if twice:
        notes.append(f"{path.name}: several markers are called {', '.join(dict.fromkeys(twice))}; numbered.")
    stated = header.get("nummarkers", "")
    if stated.isdigit() and int(stated) != len(names):
        notes.append(f"{path.name}: the header states {stated} markers and names {len(names)}.")
    if cut_off:
        notes.append(
            f"{path.name}: the header counts {counted} frames and the file holds {len(table)}; it may be"
            " cut off."
        )
    return Markers(names, t_s, position, rate, unit, source=str(path), notes=tuple(notes))


def _lines(path: Path) -> list[str]:
    check_input(path, RecordingError)
    raw = path.read_bytes()
    if b"\0" in raw[:4096]:
        raise RecordingError(f"{path}: not a TRC file: it holds no text; is it a C3D file with a wrong name?")
    text = raw.decode("utf-8-sig", errors="replace")
    return text.splitlines()


def _starts(line: str, *words: str) -> bool:
    cells = re.split(r"[\t,; ]+", line.strip(" \t,;"), maxsplit=1)
    return cells[0].strip().lower() in words


def _header(lines: list[str]) -> dict[str, str]:
    """Values of the header by name in small letters: the line under the line of names."""
    for above, below in pairwise(lines):
        if _starts(above, "datarate"):
            mark = _mark(above)
            names = [cell.strip().lower() for cell in _cells(above, mark)]
            return dict(zip(names, (cell.strip() for cell in _cells(below, mark)), strict=False))
    return {}


def _mark(line: str) -> str | None:
    """What parts the cells; None for spaces."""
    return next((mark for mark in ("\t", ";", ",") if mark in line), None)


def _cells(line: str, mark: str | None) -> list[str]:
    return line.split(mark) if mark else line.split()


def _numbers(path: Path, rows: list[tuple[int, str]], mark: str | None, width: int) -> FloatArray:
    """The table (N, width); cells that a line lacks at its end are nan."""
    parts = []
    for number, line in rows:
        cells = [cell.strip() for cell in _cells(line, mark)]
        if len(cells) > width and any(cells[width:]):
            raise RecordingError(
                f"{path}, line {number}: {len(cells)} cells where {(width - 2) // 3} markers make {width};"
                " a marker has no name, or a number has a comma for thousands"
            )
        if mark is None and len(cells) < width:
            raise RecordingError(
                f"{path}, line {number}: {len(cells)} cells where {width} are needed, and with spaces between"
                " them it is not clear which are missing; export the file with tabs"
            )
        parts.append(cells[:width] + [""] * (width - len(cells)))
    try:
        return np.array([[cell or "nan" for cell in row] for row in parts], dtype=np.float64)
    except ValueError:
        pass
    table = np.empty((len(parts), width))
    for k, row in enumerate(parts):
        for column, cell in enumerate(row):
            table[k, column] = _number(cell, path, rows[k][0], column)
    return table


def _number(cell: str, path: Path, line: int, column: int) -> float:
    try:
        return float(cell or "nan")
    except ValueError:
        pass
    text = plain_minus(cell.strip('"').replace(" ", ""))
    if _DECIMAL_COMMA.fullmatch(text):
        text = text.replace(",", ".")
    if not text or _NOTHING.fullmatch(text):
        return float("nan")
    try:
        return float(re.sub("[dD]", "e", text))  # Fortran's exponents
    except ValueError:
        raise RecordingError(
            f"{path}, line {line}: '{shown(cell, 40)}' in column {column + 1} is not a number; mend the cell"
        ) from None


def _rate(header: dict[str, str]) -> float:
    try:
        return float(header.get("datarate", "").replace(",", "."))
    except ValueError:
        return float("nan")


def _times(path: Path, table: FloatArray, rate: float) -> tuple[FloatArray, list[str]]:
    """Times (N,), s, and what is to be said of them."""
    t_s = table[:, 1]
    if not np.isfinite(t_s).all() or (len(t_s) > 1 and not np.ptp(t_s) > 0):
        if not (np.isfinite(rate) and rate > 0):
            raise RecordingError(f"{path}: neither the column Time nor DataRate tells the frames' times")
        first = table[0, 0] if np.isfinite(table[0, 0]) else 1.0
        even = np.asarray((first - 1.0 + np.arange(len(table))) / rate, dtype=np.float64)
        return even, [f"{path.name}: times are made of DataRate."]
    back = np.flatnonzero(np.diff(t_s) <= 0)
    if len(back):
        raise RecordingError(
            f"{path}: time does not go on after {t_s[back[0]]:g} s (frame {back[0] + 1}); export it again"
        )
    if len(t_s) < 2 or not rate > 0:
        return t_s, []
    regular = (np.arange(len(t_s)) - 0.5 * (len(t_s) - 1)) / rate + t_s.mean()
    off = np.abs(regular - t_s).max()
    if off <= ROUNDED_S:
        return t_s if off < 1e-9 else regular, []  # times written with three decimals jitter
    real = (len(t_s) - 1) / np.ptp(t_s)
    if abs(real / rate - 1) < 0.01:
        return t_s, []
    return t_s, [f"{path.name}: DataRate states {rate:g} Hz and the times make {real:g} Hz; the times count."]
