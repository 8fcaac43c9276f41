"""A recovery as a CSV file."""

from __future__ import annotations

import os
from collections.abc import Iterator

import numpy as np

from ...array_types import FloatArray
from ...result import Recovery
from ...result.columns import Column, columns_of
from ...result.untrusted import usable
from ..mcap.messages import nanoseconds
from .rows import write_rows


def export_csv(recovery: Recovery, path: str | os.PathLike[str], force: bool = False) -> None:
    """Write one row a forearm-IMU sample; cells are empty where the method has no answer."""
    names, numbers = zip(*((name, values) for name, values, _ in file_columns(recovery)), strict=True)
    marks = 2 * recovery.trusted.astype(np.uint8) + usable(recovery)
    words = np.array(["0,0", "0,1", "1,0", "1,1"] if recovery.has_verdict else [",0", ",1"] * 2)
    stamp = nanoseconds(recovery.t_s, recovery.origin_ns)
    whole, rest = np.divmod(np.abs(stamp), 1_000_000_000)
    line = "%s%d.%09d,%d" + ",%.9f" * len(names) + ",%s\n"
    columns = [np.where(stamp < 0, "-", ""), whole, rest, recovery.occluded, *numbers, words[marks]]
    write_rows(path, ",".join(["t_s", "occluded", *names, "trusted", "usable"]) + "\n", line, columns, force)


def file_columns(recovery: Recovery) -> Iterator[tuple[str, FloatArray, Column]]:
    """Name and numbers (N,) of each column of files, nan where there is no answer, and what it is part of."""
    for column in columns_of(recovery):
        values = np.where(np.isfinite(column.values), column.values, np.nan).reshape(len(recovery), -1)
        for name, each in zip(column.flat, values.T, strict=True):
            yield name.replace("velocity_", "v"), each, column
