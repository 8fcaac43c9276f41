"""What is ready to be written in a format, and tables as text: a head, and a line a row."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...runtime.outputs import writing

_TOGETHER = 20_000


@dataclass(frozen=True)
class Export:
    """An arm in a format: all that can fail for the data's sake is behind us."""

    rows: int  # In the file
    write: Callable[[Path, bool], None]  # Writes it to a path; the second argument is `force`
    rate_hz: float | None = None  # Rows per second where the step is constant
    frame: str | None = None  # Axes of the positions
    notes: tuple[str, ...] = ()  # What a reader must know, one sentence each


def write_rows(
    path: str | os.PathLike[str], head: str, line: str, columns: Sequence[NDArray], force: bool = False
) -> None:
    """Write columns (n,) or (n, k) by a format of their cells; those that are nan are left empty."""
    with writing(path, force) as temporary, open(temporary, "w", encoding="utf-8", newline="") as file:
        file.write(head)
        for start in range(0, len(columns[0]), _TOGETHER):
            parts = (np.asarray(column[start : start + _TOGETHER]) for column in columns)
            cells = [cell.tolist() for part in parts for cell in part.reshape(len(part), -1).T]
            file.write("".join([line % row for row in zip(*cells, strict=True)]).replace("nan", ""))
