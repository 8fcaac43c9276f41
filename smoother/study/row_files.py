"""The Parquet files of a study's rows, read as one table."""

from __future__ import annotations

import errno
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

from .columns import schema

if TYPE_CHECKING:
    import pyarrow as pa


def rows_table(files: Sequence[str], columns: Iterable[str] | None = None) -> pa.Table:
    """The rows of all files, one after another; a column that a file lacks is null.

    Read by this thread alone: `pyarrow.dataset` waits for ever for a thread that found no memory.

    Parameters
    ----------
    files : sequence of str
        Of this version or an earlier one.
    columns : iterable of str, optional
        Names in `schema()`; None for all.

    Returns
    -------
    rows : pyarrow.Table

    Raises
    ------
    pyarrow.ArrowException, OSError
        A file cannot be read.
    MemoryError
        Memory does not suffice.
    """
    import pyarrow as pa

    wanted = schema() if columns is None else pa.schema([schema().field(name) for name in columns])
    return pa.concat_tables([wanted.empty_table(), *(_read_file(file, wanted) for file in files)])


def _read_file(file: str, wanted: pa.Schema) -> pa.Table:
    import pyarrow as pa
    from pyarrow import parquet

    try:
        with open(file, "rb") as stream, parquet.ParquetFile(stream, pre_buffer=False) as rows:
            there = [name for name in wanted.names if name in rows.schema_arrow.names]
            table = rows.read(there, use_threads=False)
            missing = rows.metadata.num_rows
    except OSError as error:
        if error.errno == errno.ENOMEM:
            raise MemoryError(str(error)) from error
        raise
    found = [
        table[field.name].cast(field.type) if field.name in there else pa.nulls(missing, field.type)
        for field in wanted
    ]
    return pa.table(found, schema=wanted)
