"""The level frame `world`: its place against the camera, by gravity."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from ...array_types import FloatArray
from ...joint_angles import torso_axes
from ...result import Recovery
from ...rotation import Rotation
from ..wire import protobuf_encode as wire

#: Name of the level frame: x towards the camera, z up, the origin in the camera.
WORLD = "world"


def common_down(recoveries: Iterable[Recovery], level_down: FloatArray | None = None) -> FloatArray | None:
    """Down in the camera's axes: the first arm's gravity; else of a camera that stands level; else None.

    Parameters
    ----------
    recoveries : iterable of Recovery
        The arms that one camera saw.
    level_down : ndarray, shape (3,), optional
        Down in the camera's axes if it stands level, where a file says how they lie.

    Returns
    -------
    down : ndarray, shape (3,), or None
    """
    for recovery in recoveries:
        if np.isfinite(recovery.gravity_direction).all():
            return recovery.gravity_direction
    return level_down


def world_axes(down: FloatArray) -> FloatArray:
    """`R_W_K` (3, 3): maps a vector from the camera's axes to the level frame's.

    Parameters
    ----------
    down : ndarray, shape (3,)
        Direction of gravity in {K}.

    Returns
    -------
    R_W_K : ndarray, shape (3, 3)
        x level, against the camera's view: forward for a person who faces it; z up; y = z cross x.
    """
    ahead, up, right = torso_axes(down).T
    return np.stack([ahead, -right, up])


def world_transform(down: FloatArray | None, frame_id: str) -> wire.Template:
    """The transform from `world` to the camera, an element of FrameTransforms; empty without gravity.

    Parameters
    ----------
    down : ndarray, shape (3,), optional
        Direction of gravity in {K}.
    frame_id : str
        Of the camera.

    Returns
    -------
    Template
        With the column `stamp`.
    """
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
