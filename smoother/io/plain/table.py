"""CSV files of a recording: columns of numbers and words, with errors that name the line."""

from __future__ import annotations

import csv
import os
import warnings
from collections.abc import Sequence
from itertools import islice
from pathlib import Path
from typing import TextIO

import numpy as np

from ...errors import RecordingError
from ...recording import FloatArray

_ROWS = 100_000


def read_table(
    path: str | os.PathLike[str],
    required: Sequence[str],
    optional: Sequence[str] = (),
    *,
    words: Sequence[str] = (),
    empty: Sequence[str] = (),
) -> tuple[dict[str, FloatArray], dict[str, list[str]]]:
    """Read the named columns of a comma-separated file whose first line is a header.

    Parameters
    ----------
    path : the file; other columns are passed over. Windows line ends, a byte-order mark and spaces
        around values do no harm.
    required, optional : columns to read; an optional one may be absent.
    words : columns that are text.
    empty : number columns that may have empty cells, read as nan.

    Returns
    -------
    Number columns (N,) and text columns, by name.

    Raises
    ------
    RecordingError
        The file or a column is missing, or a cell is not a number; the message names the line.
    """
    path = Path(path)
    try:
        if not words:
            numbers = _read_numbers(path, required, optional)
            if numbers is not None:
                return numbers, {}
        with open(path, encoding="utf-8-sig", newline="") as file:
            return _read(file, path, required, optional, words, empty)
    except FileNotFoundError:
        raise RecordingError(
            f"{path} does not exist, but recording.toml names it; add it or mend the name."
        ) from None
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        reason = error.strerror if isinstance(error, OSError) else str(error)
        raise RecordingError(f"{path} cannot be read as comma-separated text: {reason}.") from error


def _read_numbers(
    path: Path, required: Sequence[str], optional: Sequence[str]
) -> dict[str, FloatArray] | None:
    """The columns of a file that holds numbers and nothing else, some times faster; None for others."""
    with open(path, encoding="utf-8-sig") as file:
        header = [cell.strip() for cell in file.readline().split(",")]
        if not set(required) <= set(header):
            return None
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error")  # a file without rows is only warned of
                table = np.loadtxt(file, delimiter=",", comments=None, ndmin=2)
        except (ValueError, UserWarning):
            return None  # the slow way finds the place
    if table.shape[1] != len(header):
        return None
    names = [name for name in (*required, *optional) if name in header]
    return {name: np.ascontiguousarray(table[:, header.index(name)]) for name in names}


def _read(
    file: TextIO,
    path: Path,
    required: Sequence[str],
    optional: Sequence[str],
    words: Sequence[str],
    empty: Sequence[str],
) -> tuple[dict[str, FloatArray], dict[str, list[str]]]:
    reader = csv.reader(file, skipinitialspace=True)
    header = [cell.strip() for cell in next(reader, [])]
    _check_header(header, path, required)
    columns = [name for name in (*required, *optional) if name in header]
    places = {name: header.index(name) for name in columns}
    parts: dict[str, list[FloatArray]] = {name: [] for name in columns if name not in words}
    texts: dict[str, list[str]] = {name: [] for name in columns if name in words}
    while True:
        before = reader.line_num
        rows = list(islice(reader, _ROWS))
        if not rows:
            break
        wrong = [row for row in rows if len(row) != len(header)]
        if wrong:
            rows = _without_blank(rows, len(header), path, before)
        if not rows:
            continue
        cells = list(zip(*rows, strict=True))
        for name in texts:
            texts[name] += [cell.strip() for cell in cells[places[name]]]
        for name in parts:
            parts[name].append(_numbers(cells[places[name]], name, name in empty, path, before))
    numbers = {name: np.concatenate(part) if part else np.empty(0) for name, part in parts.items()}
    if not any(len(values) for values in numbers.values()):
        raise RecordingError(f"{path} has a header and no rows; export it again.")
    return numbers, texts


def _check_header(header: list[str], path: Path, required: Sequence[str]) -> None:
    if not any(header):
        raise RecordingError(f"{path} is empty; its first line must be the header {', '.join(required)}.")
    if len(header) == 1 and (";" in header[0] or "\t" in header[0]):
        mark = "semicolons" if ";" in header[0] else "tabs"
        raise RecordingError(
            f"{path} is separated by {mark}; export it with commas, and points as decimal marks."
        )
    missing = [name for name in required if name not in header]
    if missing:
        raise RecordingError(
            f"{path} has no column {', '.join(missing)}; its columns are {', '.join(header)}."
        )


def _without_blank(rows: list[list[str]], width: int, path: Path, before: int) -> list[list[str]]:
    """Rows without blank lines; a row of another width is an error."""
    kept = []
    for line, row in enumerate(rows, before + 1):
        if len(row) == width:
            kept.append(row)
        elif any(cell.strip() for cell in row):
            raise RecordingError(
                f"{path}, line {line}: {len(row)} cells where the header has {width}; mend the line."
            )
    return kept


def _numbers(cells: Sequence[str], name: str, may_be_empty: bool, path: Path, before: int) -> FloatArray:
    if may_be_empty:
        cells = [cell if cell and not cell.isspace() else "nan" for cell in cells]
    try:
        return np.array(cells, dtype=np.float64)
    except ValueError:
        pass
    for row, cell in enumerate(cells):
        try:
            float(cell)
        except ValueError:
            # Blank lines and quoted line ends shift rows against lines, so the line is looked up.
            line = _line_of(path, before, row)
            what = (
                f"{cell.strip()!r} in column {name} is not a number"
                if cell.strip()
                else f"column {name} is empty"
            )
            raise RecordingError(f"{path}, line {line}: {what}; mend the cell.") from None
    return np.array([float(cell) for cell in cells])


def _line_of(path: Path, before: int, row: int) -> int:
    """Line of the row-th filled row behind line `before`."""
    with open(path, encoding="utf-8-sig", newline="") as file:
        reader = csv.reader(file)
        for cells in reader:
            if reader.line_num <= before or not any(cell.strip() for cell in cells):
                continue
            if row == 0:
                return reader.line_num
            row -= 1
    return before
