"""The arrays of a recovery as columns of a table, one a number, with units."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    import pyarrow

#: Units of the columns, by the beginning or the end of their name; metres otherwise.
_UNITS = (("t_s", "s"), ("occluded", ""), ("trusted", ""), ("velocity", "m/s"), ("_deg", "deg"))


def flat_columns(arrays: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The arrays of `Recovery.to_arrays`, one a number: `wrist_x`, `imu_qw` .."""
    columns = {}
    for name, values in arrays.items():
        if values.ndim == 1:
            columns[name] = values
            continue
        axes = ("qw", "qx", "qy", "qz") if values.shape[1] == 4 else ("x", "y", "z")
        stem = name.removesuffix("_quaternion")
        columns |= {f"{stem}_{axis}": values[:, k] for k, axis in enumerate(axes)}
    return columns


def arrow_table(columns: Mapping[str, np.ndarray], count: int) -> pyarrow.Table:
    """Columns as an Arrow table whose fields know their units; null where there is no answer.

    Parameters
    ----------
    columns : mapping of str to ndarray, shape (N,)
        By name. `trusted` may be missing: the table then has it, with nothing but null.
    count : int
        N.
    """
    import pyarrow as pa

    arrays = {
        name: pa.array(np.ascontiguousarray(values), from_pandas=True) for name, values in columns.items()
    }
    arrays.setdefault("trusted", pa.nulls(count, pa.bool_()))
    fields = [pa.field(name, array.type, metadata={"unit": _unit(name)}) for name, array in arrays.items()]
    return pa.Table.from_arrays(list(arrays.values()), schema=pa.schema(fields))


def _unit(name: str) -> str:
    if name.endswith(("_qw", "_qx", "_qy", "_qz")):
        return ""
    return next((unit for key, unit in _UNITS if key in name), "m")
