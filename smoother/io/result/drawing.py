"""The arm drawn for Foxglove and Rerun, as SceneUpdate messages."""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ...array_types import FloatArray, IntArray
from ...recording import JOINTS
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
    """Rows that are drawn alike, the message that draws them, and its columns.

    Parameters
    ----------
    position : ndarray, shape (F, 5, 3), m
        Joints in the order of `JOINTS`, in the camera frame; nan where there is none.
    shade : ndarray of int, shape (F, 5)
        Which of the colours a joint has.
    colors : tuple of Color
        By shade.
    frame_id, entity : str
        Of the scene entity; a frame without any joint deletes the entity.
    """
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
