"""The arm as beads along its bones: a PointCloud, which programs draw that know no SceneUpdate (Rerun)."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from functools import lru_cache
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ...array_types import FloatArray, IntArray
from ...recording import JOINTS
from ..wire import protobuf_encode as wire
from .drawing import ANSWER, CHAIN

#: Beads between two joints: 5 cm apart on an adult's arm.
BETWEEN = 5
_FIXED32 = 5
_FLOAT32, _UINT8 = 7, 1  # foxglove.PackedElementField.NumericType
#: Bytes of a bead: three single precision coordinates and a colour.
_STRIDE = 16


def arm_point_clouds(position: FloatArray, kind: IntArray, frame_id: str) -> Iterator[wire.AlikeRows]:
    """Rows that have the same joints, the foxglove.PointCloud that draws them, and its columns.

    Parameters
    ----------
    position : ndarray, shape (F, 5, 3), m
        Joints in the order of `JOINTS`, in the camera's frame; nan where there is none.
    kind : ndarray of int, shape (F,)
        Which of the colours `drawing.ANSWER`.
    frame_id : str
        Of the camera. A frame without any joint has a cloud without beads, which clears the one before.

    Yields
    ------
    rows : ndarray of int, shape (m,)
        Frames with the same joints.
    template : Template
        Their message.
    columns : callable
        The template's columns of some of the frames.
    """
    has = np.isfinite(position).all(axis=2)
    for pattern, rows in wire.alike(np.where(has, 0, -1)):
        present = tuple(i for i, shade in enumerate(pattern) if shade >= 0)
        weights = _weights(present)

        def columns(chosen: IntArray, weights: FloatArray = weights) -> dict[str, NDArray]:
            beads = np.empty((len(chosen), len(weights), _STRIDE), np.uint8)
            places = weights @ np.nan_to_num(position[chosen])
            beads[:, :, :12] = np.ascontiguousarray(places, "<f4").view(np.uint8)
            beads[:, :, 12:] = _colors()[kind[chosen]][:, None]
            return {"beads": beads.view("<f8").reshape(len(chosen), -1)}  # slots copy eight bytes at a time

        yield rows, _template(len(weights), frame_id), columns


@lru_cache(32)
def _weights(present: tuple[int, ...]) -> FloatArray:
    """Beads (B, 5) as sums of joints: one on every joint, and some between joints that a bone links."""
    joints = np.eye(len(JOINTS))
    chain = [i for i in CHAIN if i in present]
    beads = [joints[i] for i in present]
    for one, other in pairwise(chain):
        shares = np.arange(1, BETWEEN + 1)[:, None] / (BETWEEN + 1)
        beads += list((1 - shares) * joints[one] + shares * joints[other])
    return np.array(beads).reshape(-1, len(JOINTS))


@lru_cache(1)
def _colors() -> NDArray[np.uint8]:
    return np.round(255 * np.array(ANSWER)).astype(np.uint8)


@lru_cache(32)
def _template(count: int, frame_id: str) -> wire.Template:
    names = ("x", "y", "z", "red", "green", "blue", "alpha")
    kinds = (*[_FLOAT32] * 3, *[_UINT8] * 4)
    offsets = (0, 4, 8, 12, 13, 14, 15)
    fields = [
        wire.message(5, wire.text(1, name), _fixed32(2, offset), wire.number(3, kind))
        for name, offset, kind in zip(names, offsets, kinds, strict=True)
    ]
    return wire.join(
        wire.timestamp(1, "stamp"),
        wire.text(2, frame_id),
        wire.message(
            3, wire.message(1, wire.constants(0, 0, 0)), wire.message(2, wire.constants(0, 0, 0, 1))
        ),
        _fixed32(4, _STRIDE),
        *fields,
        wire.packed(6, "beads", count * _STRIDE // 8),
    )


def _fixed32(number: int, value: int) -> wire.Template:
    return wire.Template(wire.tag(number, _FIXED32) + struct.pack("<I", value))
