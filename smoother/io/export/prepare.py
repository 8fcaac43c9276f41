"""What formats have in common: a recovery as columns, at times with a constant step, ready to be written."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...array_types import BoolArray, FloatArray
from ...errors import UnoccludeError
from ...result import Recovery
from ...result.columns import Column, columns_of
from ...result.untrusted import usable
from ...runtime.outputs import writing
from ...runtime.printable import plain
from ..mcap.messages import nanoseconds
from ..result.write import recovery_values

#: Key of a Parquet file's metadata that contains the rest of the result, as JSON.
METADATA_KEY = b"unocclude"
#: Rows that are written together.
_TOGETHER, _GROUP = 20_000, 100_000


def file_columns(recovery: Recovery) -> Iterator[tuple[str, FloatArray, Column]]:
    """Name and numbers (N,) of each column of files, nan where there is no answer, and what it is part of."""
    for column in columns_of(recovery):
        values = np.where(np.isfinite(column.values), column.values, np.nan).reshape(len(recovery), -1)
        for name, each in zip(column.flat, values.T, strict=True):
            yield name.replace("velocity_", "v"), each, column


def marks_of(recovery: Recovery) -> dict[str, BoolArray]:
    """What files say of each sample (N,) beside its numbers; without a verdict nothing on trust."""
    trusted = {"trusted": recovery.trusted} if recovery.has_verdict else {}
    return {"occluded": recovery.occluded, **trusted, "usable": usable(recovery)}


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


def export_parquet(
    recovery: Recovery, path: str | os.PathLike[str], force: bool = False, version: str = "unknown"
) -> None:
    """Write one row a forearm-IMU sample, null where the method has no answer."""
    import pyarrow as pa
    from pyarrow import parquet

    stamp = nanoseconds(recovery.t_s, recovery.origin_ns)
    marks = {"trusted": pa.nulls(len(recovery), pa.bool_())} | marks_of(recovery)
    good = "there is an answer that is not distrusted, below the limit on sigma if one was set"
    columns = [
        ("t_s", stamp * 1e-9, "s", "the IMU's own stamp"),
        ("occluded", marks["occluded"], "", "the camera did not see the forearm"),
        *((name, values, of.unit, of.description) for name, values, of in file_columns(recovery)),
        ("trusted", marks["trusted"], "", "the answer is to be trusted; null without a verdict"),
        ("usable", marks["usable"], "", good),
        ("stamp_ns", stamp, "ns", "the IMU's own stamp"),
    ]
    arrays, fields = [], []
    for name, values, unit, description in columns:
        arrays.append(pa.array(values, from_pandas=True))
        about = {"unit": unit, "description": description}
        fields.append(pa.field(name, arrays[-1].type, metadata=about))
    rest = {key: json.loads(text) for key, text in recovery_values(recovery, version).items()}
    text = json.dumps(plain(rest), ensure_ascii=False, allow_nan=False)  # NaN is not JSON, and others read it
    table = pa.Table.from_arrays(arrays, schema=pa.schema(fields, metadata={METADATA_KEY: text.encode()}))
    with writing(path, force) as temporary:
        parquet.write_table(table, temporary, compression="zstd", row_group_size=_GROUP)


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


#: Stamps this near to a constant step are treated as constant, s.
STEADY_S = 1e-6
#: Samples farther apart than this, in steps, are not joined.
MOST_STEPS = 2.5


@dataclass(frozen=True)
class Export:
    """An arm in a format: all that can fail for the data's sake is behind us."""

    rows: int  # In the file
    write: Callable[[Path, bool], None]  # Writes it to a path; the second argument is `force`
    rate_hz: float | None = None  # Rows per second where the step is constant
    frame: str | None = None  # Axes of the positions
    notes: tuple[str, ...] = ()  # What a reader must know, one sentence each


@dataclass(frozen=True)
class Grid:
    """Times with a constant step."""

    t_s: FloatArray  # (G,) s: after the recovery's origin
    rate_hz: float  # Rows per second
    same: bool  # The times are the recovery's own: nothing is interpolated


def constant_step(recovery: Recovery, rate_hz: float | None = None) -> Grid:
    """The recovery's own times where their step is constant, else a grid from the first to the last."""
    t_s = recovery.t_s
    if len(t_s) < 2:
        raise UnoccludeError(
            f"{recovery.name}: {len(t_s)} samples are too few to export with a constant step"
        )
    mean = (len(t_s) - 1) / (t_s[-1] - t_s[0])
    even = t_s[0] + np.arange(len(t_s)) / mean
    steady = bool(np.abs(even - t_s).max() <= STEADY_S)
    if steady and (rate_hz is None or abs(rate_hz / mean - 1) < 1e-9):
        return Grid(t_s, float(mean), same=True)
    if rate_hz is None:
        # A sensor's rate is a round number where its stamps jitter.
        rate_hz = round(float(1.0 / np.median(np.diff(t_s))), 3)
    count = int(np.floor((t_s[-1] - t_s[0]) * rate_hz + 1e-9)) + 1
    return Grid(t_s[0] + np.arange(count) / rate_hz, rate_hz, same=False)


def at_grid(
    t_s: FloatArray,  # (n,) s
    values: FloatArray,  # (n, ..)
    grid: Grid,
    has: BoolArray | None = None,  # (n,): what there is; None for the finite ones
) -> FloatArray:  # (G, ..)
    """Values at the grid's times, nan where there are none.

    Samples of a recovery by cubic splines; a camera's frames, stated by `has`, by straight lines, and one
    alone at the time that is nearest.
    """
    from scipy.interpolate import CubicSpline

    if grid.same and has is None:
        return values
    flat = values.reshape(len(values), -1)
    out = np.full((len(grid.t_s), flat.shape[1]), np.nan)
    for run in unbroken(t_s, np.asarray(np.isfinite(flat).all(axis=1)) if has is None else has):
        own, first_s = t_s[run], t_s[run.start]
        first, last = np.searchsorted(grid.t_s, [first_s - STEADY_S, own[-1] + STEADY_S])
        at = grid.t_s[first:last]
        if has is None and len(own) > 1:
            out[first:last] = CubicSpline(own, flat[run])(at)
        elif len(at):
            for column, of_run in enumerate(flat[run].T):
                out[first:last, column] = np.interp(at, own, of_run)
        elif has is not None:
            place = int(np.abs(grid.t_s - first_s).argmin())
            if abs(grid.t_s[place] - first_s) <= 0.5 / grid.rate_hz:
                out[place] = flat[run.start]
    return out.reshape(len(grid.t_s), *values.shape[1:])


def unbroken(t_s: FloatArray, has: BoolArray) -> list[slice]:
    """Runs of samples that all have a value and follow each other in time."""
    step = float(np.median(np.diff(t_s))) if len(t_s) > 1 else 1.0
    index = np.flatnonzero(has)
    apart = (np.diff(index) > 1) | (np.diff(t_s[index]) > MOST_STEPS * step)
    parts = np.split(index, np.flatnonzero(apart) + 1)
    return [slice(int(part[0]), int(part[-1]) + 1) for part in parts if len(part)]
