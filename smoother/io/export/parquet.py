"""A recovery as a Parquet file: the CSV's columns with their units."""

from __future__ import annotations

import os
import re

import numpy as np

from ...result import Recovery
from ...runtime.atomic import writing
from ..mcap.stamps import nanoseconds
from ..result.metadata import recovery_values
from ..result.usable import usable
from .csv import csv_columns

#: Key of the file's metadata under which the rest of the result lies, as JSON.
METADATA_KEY = b"unocclude"
_UNITS = (
    (r"t_s", "s", "the IMU's own stamp"),
    (r"stamp_ns", "ns", "the IMU's own stamp"),
    (r"occluded", "", "the camera did not see the forearm"),
    (r"usable", "", "there is an answer, below the limit on sigma if one was set"),
    (r"imu_q[wxyz]", "1", "rotation IMU axes to camera, quaternion"),
    (r"sigma_deg", "deg", "square root of the trace of the orientation's covariance"),
    (r"(\w+_)?sigma_[xyz]", "m", "one standard deviation, an axis of the camera"),
    (r"v[xyz]", "m/s", "velocity of the IMU in the camera's frame"),
    (r"\w+_[xyz]", "m", "position in the camera's frame"),
)
_GROUP = 100_000


def export_parquet(
    recovery: Recovery, path: str | os.PathLike[str], version: str = "unknown", force: bool = False
) -> None:
    """Write one row a forearm-IMU sample, null where the method has no answer.

    The columns are those of the CSV export and `stamp_ns`; `occluded` and `usable` are booleans. Each
    column's metadata has `unit` and `description`; the file's metadata has the key `unocclude`, a JSON object
    with method, configuration, figures, calibration, gaps, clock and notes.

    Parameters
    ----------
    recovery : one arm.
    path : the file to write.
    version : of the program that made the recovery.
    force : overwrite a file that exists.

    Raises
    ------
    UnoccludeError
        The file exists and `force` is not given, or it cannot be written.
    """
    import pyarrow as pa
    from pyarrow import parquet

    header, values = csv_columns(recovery)
    stamp = nanoseconds(recovery.t_s, recovery.origin_ns)
    arrays = [pa.array(stamp * 1e-9), pa.array(recovery.occluded)]
    arrays += [pa.array(np.ascontiguousarray(column), from_pandas=True) for column in values.T]
    names = [*header, "usable", "stamp_ns"]
    arrays += [pa.array(usable(recovery)), pa.array(stamp)]
    fields = [_field(name, array.type) for name, array in zip(names, arrays, strict=True)]
    rest = (
        "{" + ", ".join(f'"{key}": {text}' for key, text in recovery_values(recovery, version).items()) + "}"
    )
    # NaN is no JSON, and others read this.
    schema = pa.schema(fields, metadata={METADATA_KEY: _strict(rest).encode()})
    table = pa.Table.from_arrays(arrays, schema=schema)
    with writing(path, force) as temporary:
        parquet.write_table(table, temporary, compression="zstd", row_group_size=_GROUP)


def _field(name: str, kind: object) -> object:
    import pyarrow as pa

    unit, said = next((unit, said) for pattern, unit, said in _UNITS if re.fullmatch(pattern, name))
    return pa.field(name, kind, metadata={"unit": unit, "description": said})


def _strict(text: str) -> str:
    import json

    def plain(value: object) -> object:
        if isinstance(value, dict):
            return {key: plain(item) for key, item in value.items()}
        if isinstance(value, list):
            return [plain(item) for item in value]
        return None if isinstance(value, float) and not np.isfinite(value) else value

    return json.dumps(plain(json.loads(text)), ensure_ascii=False, allow_nan=False)
