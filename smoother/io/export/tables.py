"""A recovery as one set of columns, in CSV and Parquet files; tables as text."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from ...array_types import BoolArray, FloatArray
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
