"""Protobuf messages that differ in their numbers alone, encoded together: the inverse of a layout.

One message is built by the library, its layout is walked, and the columns of all rows are put where its
numbers are: 0.2 s for 360,000 poses with their covariances, against 10 s by the library.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...array_types import IntArray
from .protobuf_decode import walk
from .schemas import message_class

#: A stamp whose varints are as wide as they get: any 64-bit number, any 32-bit number.
_WIDE = {"seconds": -1, "nanos": 1 << 30}


def encoded(
    schema: str,
    constants: Mapping[str, Any],  # Fields that are the same in all rows, as the library's class takes them
    # By path (`joints.0.position`): stamps (rows,) ns, numbers (rows,), bytes or doubles (rows, n), and
    # vectors and quaternions (rows, n) in the order of their fields
    columns: Mapping[str, NDArray],
) -> NDArray[np.uint8]:  # (rows, size)
    """Wire form of a message a row; enums and whole numbers are below 128."""
    message = message_class(schema)(**constants)
    numbers: dict[str, NDArray] = {}
    for path, values in columns.items():
        numbers |= _placed(message, path, values)
    data = message.SerializeToString(deterministic=True)
    layout = walk(data, type(message))
    rows = len(next(iter(columns.values())))
    block = np.empty((rows, len(data)), np.uint8)
    block[:] = np.frombuffer(data, np.uint8)
    for name, values in numbers.items():
        if name in layout.varints:
            offset, width = layout.varints[name]
            block[:, offset : offset + width] = _padded_varints(values, width)
        else:
            (offset,), dtype, count = layout.fields[name]
            raw = np.ascontiguousarray(values.reshape(rows, count), dtype).view(np.uint8)
            block[:, offset : offset + raw.shape[1]] = raw
    return block


def _placed(message: Any, path: str, values: NDArray) -> dict[str, NDArray]:
    """Columns by the path of each number; these are not zero in the message, which would leave them out."""
    *way, last = path.split(".")
    for step in way:
        message = message[int(step)] if step.isdigit() else getattr(message, step)
    own = message[int(last)] if last.isdigit() else getattr(message, last)
    if not hasattr(own, "DESCRIPTOR"):
        if values.ndim == 1:
            setattr(message, last, 1)
        elif isinstance(own, bytes):
            setattr(message, last, b"\1" * values.shape[1])
        else:
            own[:] = [1.0] * values.shape[1]
        return {path: values}
    if own.DESCRIPTOR.name == "Timestamp":
        for name, value in _WIDE.items():
            setattr(own, name, value)
        seconds, nanos = np.divmod(values, 1_000_000_000)
        return {f"{path}.seconds": seconds, f"{path}.nanos": nanos}
    parts = {}
    for part, column in zip(own.DESCRIPTOR.fields, values.T, strict=False):
        setattr(own, part.name, 1.0)
        parts[f"{path}.{part.name}"] = column
    return parts


def _padded_varints(values: NDArray, width: int) -> NDArray[np.uint8]:
    """Numbers (rows,) as varints of one width, (rows, width): seven bits a byte, all but the last marked."""
    sevens = np.arange(0, 7 * width, 7).astype(np.uint64)[:, None]
    raw = (values.astype(np.int64).view(np.uint64) >> sevens).astype(np.uint8) | np.uint8(0x80)
    raw[-1] &= 0x7F
    return raw.T


def alike(codes: NDArray) -> Iterator[tuple[tuple[int, ...], IntArray]]:
    """Rows (n, k) of codes that are the same: what they are, and their numbers (m,)."""
    if len(codes):
        kinds, kind = np.unique(codes, axis=0, return_inverse=True)
        for number, one in enumerate(kinds.tolist()):
            yield tuple(one), np.flatnonzero(kind.reshape(-1) == number)
