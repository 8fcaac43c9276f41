"""A recovery as a Parquet file: the CSV's columns with their units."""

from __future__ import annotations

import json
import os
from typing import TYPE_CHECKING

import numpy as np

from ...result import Recovery
from ...runtime.outputs import writing
from ...runtime.printable import plain
from ..mcap.stamps import nanoseconds
from ..result.metadata import recovery_values
from ..result.usable import usable
from .csv import column_groups

if TYPE_CHECKING:
    import pyarrow

#: Key of the file's metadata under which the rest of the result lies, as JSON.
METADATA_KEY = b"unocclude"
_GROUP = 100_000


def export_parquet(
    recovery: Recovery, path: str | os.PathLike[str], version: str = "unknown", force: bool = False
) -> None:
    """Write one row a forearm-IMU sample, null where the method has no answer.

    The columns are those of the CSV export and `stamp_ns`; `occluded`, `trusted` (null where nobody
    judged) and `usable` are booleans. Each
    column's metadata has `unit` and `description`; the file's metadata has the key `unocclude`, a JSON object
    with method, configuration, figures, calibration, gaps, clock and notes.

    Parameters
    ----------
    recovery : Recovery
        One arm.
    path : path-like
        The file to write.
    version : str
        Of the program that made the recovery.
    force : bool
        Overwrite a file that exists.

    Raises
    ------
    UnoccludeError
        The file exists and `force` is not given, or it cannot be written.
    """
    import pyarrow as pa
    from pyarrow import parquet

    stamp = nanoseconds(recovery.t_s, recovery.origin_ns)
    good = "there is an answer that is not distrusted, below the limit on sigma if one was set"
    columns = [
        ("t_s", pa.array(stamp * 1e-9), "s", "the IMU's own stamp"),
        ("occluded", pa.array(recovery.occluded), "", "the camera did not see the forearm"),
    ]
    for group in column_groups(recovery):
        for name, values in zip(group.names, group.values.T, strict=True):
            array = pa.array(np.ascontiguousarray(values), from_pandas=True)
            columns.append((name, array, group.unit, group.description))
    columns.append(
        ("trusted", trusted_array(recovery), "", "the answer is to be trusted; null where nobody judged")
    )
    columns.append(("usable", pa.array(usable(recovery)), "", good))
    columns.append(("stamp_ns", pa.array(stamp), "ns", "the IMU's own stamp"))
    fields = [
        pa.field(name, array.type, metadata={"unit": unit, "description": description})
        for name, array, unit, description in columns
    ]
    rest = {key: json.loads(text) for key, text in recovery_values(recovery, version).items()}
    text = json.dumps(
        plain(rest), ensure_ascii=False, allow_nan=False
    )  # NaN is no JSON, and others read this
    schema = pa.schema(fields, metadata={METADATA_KEY: text.encode()})
    table = pa.Table.from_arrays([array for _, array, _, _ in columns], schema=schema)
    with writing(path, force) as temporary:
        parquet.write_table(table, temporary, compression="zstd", row_group_size=_GROUP)


def trusted_array(recovery: Recovery) -> pyarrow.BooleanArray:
    """(N,) whether samples are to be trusted; null where nobody judged."""
    import pyarrow as pa

    return pa.array(recovery.trusted) if recovery.has_verdict else pa.nulls(len(recovery), pa.bool_())
