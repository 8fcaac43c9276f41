"""The arm drawn for Foxglove and Rerun, its cloud of points, and the level frame that it is in."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from functools import lru_cache
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...angles.definitions import torso_axes
from ...array_types import FloatArray, IntArray
from ...recording import JOINTS
from ...result import Recovery
from ...rotation import Rotation
from ..wire.protobuf_encode import alike

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
_IDENTITY = {"position": {}, "orientation": {"w": 1.0}}

#: Rows that are written alike: which, the constants of their message, and its columns by some of them.
AlikeRows = tuple[IntArray, dict[str, Any], Callable[[IntArray], dict[str, NDArray]]]


def drawings(
    position: FloatArray,
    shade: IntArray,
    colors: tuple[Color, ...],
    frame_id: str,
    entity: str,
    stamp: IntArray,  # (F,) ns
) -> Iterator[AlikeRows]:
    """Rows that are drawn alike, and the foxglove.SceneUpdate that draws them."""
    has = np.isfinite(position).all(axis=2)
    for pattern, rows in alike(np.where(has, shade, -1)):
        shown = {i: colors[shade] for i, shade in enumerate(pattern) if shade >= 0}
        chain = [i for i in CHAIN if i in shown] if len(shown.keys() & set(CHAIN)) > 1 else []

        def columns(
            chosen: IntArray, shown: Collection[int] = shown, chain: Sequence[int] = chain
        ) -> dict[str, NDArray]:
            where = "entities.0" if shown else "deletions.0"
            points = [(f"spheres.{k}.pose.position", i) for k, i in enumerate(shown)]
            points += [(f"lines.0.points.{k}", i) for k, i in enumerate(chain)]
            places: dict[str, NDArray] = {f"{where}.{path}": position[chosen, i] for path, i in points}
            return {f"{where}.timestamp": stamp[chosen]} | places

        yield rows, _scene(shown, chain, frame_id, entity), columns


def _scene(
    shown: Mapping[int, Color], chain: Sequence[int], frame_id: str, entity: str
) -> dict[str, list[dict[str, Any]]]:
    """A sphere a joint and a line along the bones; nothing to draw deletes what was drawn before."""
    if not shown:
        return {"deletions": [{"id": entity}]}
    spheres = [
        {
            "pose": _IDENTITY,
            "size": dict.fromkeys("xyz", _RADIUS_M[JOINTS[i]]),
            "color": dict(zip("rgba", color, strict=True)),
        }
        for i, color in shown.items()
    ]
    line = {
        "pose": _IDENTITY,
        "thickness": _THICKNESS_M,
        "points": [{} for _ in chain],
        "colors": [dict(zip("rgba", shown[i], strict=True)) for i in chain],
    }
    drawn = {"frame_id": frame_id, "id": entity, "spheres": spheres, "lines": [line] if chain else []}
    return {"entities": [drawn]}


#: Beads between two joints: 5 cm apart on an adult's arm.
BETWEEN = 5
#: Its fields: offset, and foxglove.PackedElementField.NumericType (FLOAT32, UINT8).
_FIELDS = {
    "x": (0, 7),
    "y": (4, 7),
    "z": (8, 7),
    "red": (12, 1),
    "green": (13, 1),
    "blue": (14, 1),
    "alpha": (15, 1),
}
#: Bytes of a bead: three single precision coordinates and a colour.
_STRIDE = 16


def arm_point_clouds(
    position: FloatArray,  # (F, 5, 3) m
    kind: IntArray,  # int (F,)
    frame_id: str,
    stamp: IntArray,  # (F,) ns
) -> Iterator[AlikeRows]:
    """Rows that have the same joints, and the foxglove.PointCloud that draws them."""
    fields = [{"name": name, "offset": at, "type": kind} for name, (at, kind) in _FIELDS.items()]
    constants = {"frame_id": frame_id, "pose": _IDENTITY, "point_stride": _STRIDE, "fields": fields}
    for pattern, rows in alike(np.asarray(np.isfinite(position).all(axis=2))):
        weights = _weights(tuple(np.flatnonzero(pattern).tolist()))

        def columns(chosen: IntArray, weights: FloatArray = weights) -> dict[str, NDArray]:
            beads = np.empty((len(chosen), len(weights), _STRIDE), np.uint8)
            places = weights @ np.nan_to_num(position[chosen])
            beads[:, :, :12] = np.ascontiguousarray(places, "<f4").view(np.uint8)
            beads[:, :, 12:] = np.round(255 * np.array(ANSWER)).astype(np.uint8)[kind[chosen]][:, None]
            data = {"data": beads.reshape(len(chosen), -1)} if len(weights) else {}
            return {"timestamp": stamp[chosen]} | data

        yield rows, constants, columns


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


def world_transform(down: FloatArray | None, frame_id: str) -> dict[str, Any] | None:  # down (3,)
    """The transform from `world` to the camera; None without gravity."""
    if down is None or frame_id == WORLD:
        return None
    turn = Rotation.from_matrix(world_axes(down)).as_quat(canonical=True)
    rotation = dict(zip("xyzw", turn.tolist(), strict=True))
    return {"parent_frame_id": WORLD, "child_frame_id": frame_id, "translation": {}, "rotation": rotation}
