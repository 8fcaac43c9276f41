"""A recovery as a Parquet file: the CSV's columns with their units."""

from __future__ import annotations

import json
import os
from typing import TYPE_CHECKING

import numpy as np

from ...result import Recovery
from ...result.untrusted import usable
from ...runtime.outputs import writing
from ...runtime.printable import plain
from ..mcap.messages import nanoseconds
from ..result.write import recovery_values
from .csv import file_columns

if TYPE_CHECKING:
    pass


#: Key of the file's metadata that contains the rest of the result, as JSON.
METADATA_KEY = b"unocclude"
_GROUP = 100_000


def export_parquet(
    recovery: Recovery, path: str | os.PathLike[str], force: bool = False, version: str = "unknown"
) -> None:
    """Write one row a forearm-IMU sample, null where the method has no answer."""
    import pyarrow as pa
    from pyarrow import parquet

    stamp = nanoseconds(recovery.t_s, recovery.origin_ns)
    good = "there is an answer that is not distrusted, below the limit on sigma if one was set"
    columns = [
        ("t_s", pa.array(stamp * 1e-9), "s", "the IMU's own stamp"),
        ("occluded", pa.array(recovery.occluded), "", "the camera did not see the forearm"),
    ]
    for name, values, column in file_columns(recovery):
        array = pa.array(np.ascontiguousarray(values), from_pandas=True)
        columns.append((name, array, column.unit, column.description))
    trusted = pa.array(recovery.trusted) if recovery.has_verdict else pa.nulls(len(recovery), pa.bool_())
    columns.append(("trusted", trusted, "", "the answer is to be trusted; null without a verdict"))
    columns.append(("usable", pa.array(usable(recovery)), "", good))
    columns.append(("stamp_ns", pa.array(stamp), "ns", "the IMU's own stamp"))
    fields = [
        pa.field(name, array.type, metadata={"unit": unit, "description": description})
        for name, array, unit, description in columns
    ]
    rest = {key: json.loads(text) for key, text in recovery_values(recovery, version).items()}
    text = json.dumps(
        plain(rest), ensure_ascii=False, allow_nan=False
    )  # NaN is not JSON, and others read this
    schema = pa.schema(fields, metadata={METADATA_KEY: text.encode()})
    table = pa.Table.from_arrays([array for _, array, _, _ in columns], schema=schema)
    with writing(path, force) as temporary:
        parquet.write_table(table, temporary, compression="zstd", row_group_size=_GROUP)
