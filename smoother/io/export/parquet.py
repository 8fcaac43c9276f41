"""A recovery, and motions drawn from it, as Parquet files: the CSV's columns with their units."""

from __future__ import annotations

import json
import os
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ...errors import UnoccludeError
from ...recording import JOINTS
from ...result import Draws, Recovery
from ...result.draws import turned_by
from ...result.untrusted import usable
from ...runtime.outputs import writing
from ...runtime.printable import plain
from ..mcap.messages import nanoseconds
from ..result.tables import rounded
from ..result.write import recovery_values
from .csv import file_columns

if TYPE_CHECKING:
    import pyarrow


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
    columns.append(
        ("trusted", trusted_array(recovery), "", "the answer is to be trusted; null without a verdict")
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
    )  # NaN is not JSON, and others read this
    schema = pa.schema(fields, metadata={METADATA_KEY: text.encode()})
    table = pa.Table.from_arrays([array for _, array, _, _ in columns], schema=schema)
    with writing(path, force) as temporary:
        parquet.write_table(table, temporary, compression="zstd", row_group_size=_GROUP)


def trusted_array(recovery: Recovery) -> pyarrow.BooleanArray:
    """(N,) whether samples are to be trusted; null without a verdict."""
    import pyarrow as pa

    return pa.array(recovery.trusted) if recovery.has_verdict else pa.nulls(len(recovery), pa.bool_())


def drawn_rows(recovery: Recovery) -> int:
    """Rows of the file: a row a motion and drawn time."""
    if recovery.draws is None:
        raise UnoccludeError(
            f"the result of {recovery.name} has no drawn motions; run `unocclude smooth` with --draws 64"
        )
    return len(recovery.draws) * len(recovery.draws.t_s)


def export_draws(
    recovery: Recovery, path: str | os.PathLike[str], force: bool = False, version: str = "unknown"
) -> None:
    """Write every drawn motion, one after the other, a row a drawn time; null where there is no answer."""
    import pyarrow as pa
    from pyarrow import parquet

    drawn_rows(recovery)
    draws = recovery.draws
    assert draws is not None
    answer = recovery.rows(np.clip(np.searchsorted(recovery.t_s, draws.t_s), 0, len(recovery) - 1))
    stamp = nanoseconds(draws.t_s, recovery.origin_ns)
    trusted = trusted_array(answer)
    about: dict[str, str | int] = {"version": version, "name": recovery.name, "side": recovery.side}
    about |= {"motions": len(draws), "seed": draws.seed}
    with writing(path, force) as temporary:
        writer = None
        for k in range(len(draws)):
            columns: dict[str, NDArray] = {"motion": np.full(len(stamp), k, np.int32)}
            columns |= {"t_s": stamp * 1e-9, "stamp_ns": stamp, **_motion(answer, draws, k)}
            arrays = {name: pa.array(each, from_pandas=True) for name, each in columns.items()}
            table = pa.table(arrays | {"trusted": trusted})
            if writer is None:
                schema = table.schema.with_metadata({METADATA_KEY: json.dumps(about).encode()})
                # numbers of one size, byte by byte, shrink best
                split = [name for name, each in columns.items() if each.dtype == np.float32]
                writer = parquet.ParquetWriter(
                    temporary,
                    schema,
                    compression="zstd",
                    use_dictionary=[name for name in arrays if name not in split],
                    use_byte_stream_split=split,
                )
            writer.write_table(table.cast(schema))
        if writer is not None:
            writer.close()


def _motion(answer: Recovery, draws: Draws, k: int) -> dict[str, NDArray]:
    """A motion's columns (m,); the answer is that of the drawn times."""
    groups = {
        ("imu_x", "imu_y", "imu_z"): answer.position + draws.position[k],
        ("imu_qw", "imu_qx", "imu_qy", "imu_qz"): turned_by(draws.rotation[k], answer.quaternion),
    }
    for joint in (name for name in JOINTS if name in draws.joints):
        names = (f"{joint}_x", f"{joint}_y", f"{joint}_z")
        groups[names] = answer.joints[joint] + draws.joints[joint][k]
    return {
        name: rounded(values)
        for names, group in groups.items()
        for name, values in zip(names, group.T, strict=True)
    }
