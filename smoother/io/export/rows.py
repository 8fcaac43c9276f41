"""Tables as text: a head, and a line a row."""

from __future__ import annotations

import os
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ...runtime.outputs import writing

_TOGETHER = 20_000


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
