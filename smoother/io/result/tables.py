"""Every column of a recovery as Parquet tables, which are attachments of the result's file."""

from __future__ import annotations

import json
from typing import IO

import numpy as np
from numpy.typing import NDArray

from ...result import Recovery
from ...result.columns import SAMPLES
from ..mcap.messages import nanoseconds
from ..wire.layout import Buffer

Columns = dict[str, NDArray]
#: Rows that are written together: what passes through the memory.
_ROWS = 4_000
#: Drawn motions are rounded to this many parts of a metre, which is 8 micrometres, and of a radian.
_PARTS = 2.0**17
#: Columns of segments and of the trunk by the names of their attributes.
SEGMENT, TRUNK = ("position", "quaternion", "pose_covariance"), ("quaternion", "covariance")


def tables_of(recovery: Recovery) -> dict[str, Columns]:
    """The tables; what is of a joint or a segment stands behind its name and a slash."""
    r, origin = recovery, recovery.origin_ns
    samples = {"stamp_ns": nanoseconds(r.t_s, origin), **{name: getattr(r, name) for name in SAMPLES}}
    for joint, position in r.joints.items():
        samples |= {f"{joint}/position": position, f"{joint}/covariance": r.joint_covariance[joint]}
    for name, motion in r.segments.items():
        samples |= {f"{name}/{column}": getattr(motion, column) for column in SEGMENT}
    if r.trunk is not None:
        samples |= {f"trunk/{column}": getattr(r.trunk, column) for column in TRUNK}
    frames = {"stamp_ns": nanoseconds(r.arm.t_s, origin), "position": r.arm.position, "state": r.arm.state}
    tables = {"samples": samples, "frames": frames}
    if (residuals := r.residuals) is not None:
        columns = {name: getattr(residuals, name) for name in ("residual", "used", "reason")}
        tables["residuals"] = {"stamp_ns": nanoseconds(residuals.t_s, origin), **columns}
    if (draws := r.draws) is not None:
        drawn = {name: np.moveaxis(values, 0, 1) for name, values in draws.columns().items()}
        tables["draws"] = {"stamp_ns": nanoseconds(draws.t_s, origin), **drawn}
    return tables


def rounded(drawn: NDArray) -> NDArray:
    """Drawn motions as files have them: numbers of one size shrink best."""
    return np.rint(drawn * _PARTS).astype(np.float32) / np.float32(_PARTS)


def write_table(columns: Columns, file: IO[bytes]) -> None:
    """Write columns (n, ..); in the file a row of one is a list, and its shape stands beside it."""
    import pyarrow as pa
    from pyarrow import parquet

    def part(rows: slice) -> pa.Table:
        arrays, fields = [], []
        for name, values in columns.items():
            some = values[rows]
            some = rounded(some) if values.dtype == np.float32 else some
            array = pa.array(np.ascontiguousarray(some).reshape(-1))
            if values.ndim > 1:
                array = pa.FixedSizeListArray.from_arrays(array, int(np.prod(values.shape[1:])))
            arrays.append(array)
            fields.append(pa.field(name, array.type, metadata={"shape": json.dumps(values.shape[1:])}))
        return pa.Table.from_arrays(arrays, schema=pa.schema(fields))

    split = [f"{name}.list.element" if v.ndim > 1 else name for name, v in columns.items() if v.itemsize > 2]
    how = {"compression": "zstd", "compression_level": 1, "use_dictionary": False, "write_statistics": False}
    schema = part(slice(0, 0)).schema
    with parquet.ParquetWriter(file, schema, use_byte_stream_split=split, **how) as writer:
        for start in range(0, len(columns["stamp_ns"]), _ROWS):
            writer.write_table(part(slice(start, start + _ROWS)))


def read_table(data: Buffer) -> Columns:
    """What `write_table` wrote."""
    import pyarrow as pa
    from pyarrow import parquet

    file = parquet.ParquetFile(pa.BufferReader(pa.py_buffer(data)))
    columns = {}
    for field in file.schema_arrow:
        shape = json.loads(field.metadata[b"shape"])
        values = file.read([field.name])[field.name].combine_chunks()
        flat = values.flatten() if shape else values
        columns[field.name] = np.array(flat.to_numpy(zero_copy_only=False)).reshape(-1, *shape)
    return columns
