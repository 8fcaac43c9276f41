"""The arm drawn for Foxglove and Rerun, its cloud of points, and the level frame that it is in."""

from __future__ import annotations

import struct
from collections.abc import Iterable, Iterator
from functools import lru_cache
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ...array_types import FloatArray, IntArray
from ...joint_angles import torso_axes
from ...recording import JOINTS
from ...result import Recovery
from ...rotation import Rotation
from ..wire import protobuf_encode as wire

Color = tuple[float, float, float, float]
VISIBLE: Color = (0.10, 0.45, 0.75, 1.0)
RECOVERED: Color = (0.90, 0.45, 0.05, 1.0)
UNTRUSTED: Color = (0.72, 0.0, 0.16, 1.0)
#: Colours of the answer: where the camera saw the arm, where it was recovered, where it is not to be trusted.
ANSWER = (VISIBLE, RECOVERED, UNTRUSTED)
#: Place of the last.
DISTRUST = 2
CAMERA: Color = (0.45, 0.45, 0.45, 1.0)
GUESSED: Color = (0.75, 0.75, 0.75, 0.6)

#: Joints that bones link, by number.
CHAIN = [JOINTS.index(joint) for joint in ("shoulder", "elbow", "wrist", "hand")]
_RADIUS_M = {"shoulder": 0.05, "elbow": 0.04, "wrist": 0.035, "hand": 0.035, "strap": 0.025}
_THICKNESS_M = 0.012
_IDENTITY = wire.join(wire.message(1, wire.constants(0, 0, 0)), wire.message(2, wire.constants(0, 0, 0, 1)))


def drawings(
    position: FloatArray, shade: IntArray, colors: tuple[Color, ...], frame_id: str, entity: str
) -> Iterator[wire.AlikeRows]:
    """Rows that are drawn alike, the message that draws them, and its columns."""
    has = np.isfinite(position).all(axis=2)
    for pattern, rows in wire.alike(np.where(has, shade, -1)):

        def columns(chosen: IntArray) -> dict[str, NDArray]:
            return {"position": position[chosen].reshape(len(chosen), -1)}

        yield rows, _template(pattern, colors, frame_id, entity), columns


@lru_cache(256)
def _template(
    pattern: tuple[int, ...], colors: tuple[Color, ...], frame_id: str, entity: str
) -> wire.Template:
    present = [i for i, shade in enumerate(pattern) if shade >= 0]
    if not present:
        return wire.message(1, wire.timestamp(1, "stamp"), wire.text(3, entity))
    parts = [wire.timestamp(1, "stamp"), wire.text(2, frame_id), wire.text(3, entity)]
    for i in present:
        place = wire.message(1, _at(1, i), wire.message(2, wire.constants(0, 0, 0, 1)))
        size = wire.message(2, wire.constants(*[_RADIUS_M[JOINTS[i]]] * 3))
        parts.append(wire.message(9, place, size, wire.message(3, wire.constants(*colors[pattern[i]]))))
    chain = [i for i in CHAIN if i in present]
    if len(chain) > 1:
        points = [_at(5, i) for i in chain]
        shades = [wire.message(7, wire.constants(*colors[pattern[i]])) for i in chain]
        line = [wire.message(2, _IDENTITY), wire.constant(3, _THICKNESS_M), *points, *shades]
        parts.append(wire.message(11, *line))
    return wire.message(2, *parts)


def _at(number: int, joint: int) -> wire.Template:
    return wire.vector(number, "position", (3 * joint, 3 * joint + 1, 3 * joint + 2))


#: Beads between two joints: 5 cm apart on an adult's arm.
BETWEEN = 5
_FIXED32 = 5
_FLOAT32, _UINT8 = 7, 1  # foxglove.PackedElementField.NumericType
#: Bytes of a bead: three single precision coordinates and a colour.
_STRIDE = 16


def arm_point_clouds(
    position: FloatArray,  # (F, 5, 3) m
    kind: IntArray,  # int (F,)
    frame_id: str,
) -> Iterator[wire.AlikeRows]:  # rows int (m,), template, columns
    """Rows that have the same joints, the foxglove.PointCloud that draws them, and its columns."""
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

        yield rows, _cloud_template(len(weights), frame_id), columns


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
def _cloud_template(count: int, frame_id: str) -> wire.Template:
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


#: Name of the level frame: x towards the camera, z up, the origin in the camera.
WORLD = "world"


def common_down(
    recoveries: Iterable[Recovery],
    level_down: FloatArray | None = None,  # (3,)
) -> FloatArray | None:  # (3,)
    """Down in the camera's axes: the first arm's gravity; else of a level camera; else None."""
    for recovery in recoveries:
        if np.isfinite(recovery.gravity_direction).all():
            return recovery.gravity_direction
    return level_down


def world_axes(down: FloatArray) -> FloatArray:  # down (3,) -> (3, 3)
    """`R_W_K` (3, 3): maps a vector from the camera's axes to the level frame's."""
    ahead, up, right = torso_axes(down).T
    return np.stack([ahead, -right, up])


def world_transform(down: FloatArray | None, frame_id: str) -> wire.Template:  # down (3,)
    """The transform from `world` to the camera, an element of FrameTransforms; empty without gravity."""
    if down is None or frame_id == WORLD:
        return wire.Template(b"")
    turn = Rotation.from_matrix(world_axes(down)).as_quat(canonical=True)
    return wire.message(
        1,
        wire.timestamp(1, "stamp"),
        wire.text(2, WORLD),
        wire.text(3, frame_id),
        wire.message(4, wire.constants(0, 0, 0)),
        wire.message(5, wire.constants(*turn.tolist())),
    )
