"""What the body itself says of a skeleton: its unit by the arms' lengths, and which axis is up."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ...array_types import FloatArray
from ...recording import CameraFrame
from .joint_names import JointName

#: Half an arm of a child to a tall adult, shoulder to elbow or elbow to wrist, m.
ARM_M = (0.09, 0.6)
#: What is larger is no position in any unit, but a cell that was damaged.
LARGEST = 1e7
#: An axis is up where the trunk lies so much along it (cosine).
UPRIGHT = 0.75


def half_arm(position: Mapping[str, FloatArray]) -> float:
    """Median length of upper arms and forearms in the unit of the positions; nan where there are none."""
    lengths = []
    for side in ("left", "right"):
        for one, other in (("shoulder", "elbow"), ("elbow", "wrist")):
            a, b = position.get(f"{one}_{side}"), position.get(f"{other}_{side}")
            if a is not None and b is not None:
                near = (np.abs(a) < LARGEST).all(axis=1) & (np.abs(b) < LARGEST).all(axis=1)
                length = np.linalg.norm(a[near] - b[near], axis=1)
                length = length[np.isfinite(length) & (length > 0)]
                if len(length):
                    lengths.append(float(np.median(length)))
    return float(np.median(lengths)) if lengths else float("nan")


def unit_by_arm(position: Mapping[str, FloatArray]) -> tuple[str, float] | None:
    """Unit in which arms have an arm's length.

    Parameters
    ----------
    position : dict of str to ndarray, shape (F, 3)
        In the unit asked for, by joint and side.

    Returns
    -------
    (str, float) or None
        The unit and the metres in it; None where no unit fits, or no two joints are there to tell.
    """
    length = half_arm(position)
    for unit, metres in (("m", 1.0), ("cm", 0.01), ("mm", 0.001)):
        if ARM_M[0] <= length * metres <= ARM_M[1]:
            return unit, metres
    return None


def up_axis(points: list[tuple[JointName, FloatArray]]) -> tuple[int, int] | None:
    """Axis along which the body stands or sits upright most of the time.

    Parameters
    ----------
    points : list of (JointName, ndarray of shape (F, 3))
        What parts of the body they are, and where.

    Returns
    -------
    (int, int) or None
        Axis (0, 1, 2) and sign of up; None where the trunk lies along none of them, or is not to be seen.
    """
    upper = [rows for name, rows in points if name.part in ("top", "shoulder")]
    lower = [rows for name, rows in points if name.part == "hip"]
    lower = lower or [rows for name, rows in points if name.part == "foot"]
    if not upper or not lower:
        return None
    trunk = _middle(upper) - _middle(lower)
    trunk = trunk[np.isfinite(trunk).all(axis=1)]
    if not len(trunk):
        return None
    direction = np.median(trunk, axis=0)
    length = float(np.linalg.norm(direction))
    axis = int(np.abs(direction).argmax())
    if not length > 0 or abs(direction[axis]) < UPRIGHT * length:
        return None
    return axis, 1 if direction[axis] > 0 else -1


def down_of(axis: int, sign: int) -> FloatArray:
    """Unit vector of down where an axis is up."""
    down = np.zeros(3)
    down[axis] = -sign
    return down


def frame_of(axis: int, sign: int, camera: bool) -> CameraFrame | None:
    """The convention of axes of which one is up; a room's y up has none (`camera`: axes of a camera)."""
    if (axis, sign) == (2, 1):
        return CameraFrame.ZUP
    if camera and axis == 1:
        return CameraFrame.KINECT if sign > 0 else CameraFrame.OPTICAL
    return None


def axis_words(axis: int, sign: int) -> str:
    """For sentences: "y up"."""
    return f"{'xyz'[axis]} {'up' if sign > 0 else 'down'}"


def _middle(points: list[FloatArray]) -> FloatArray:
    """Mean (F, 3) of points, each where it is there."""
    stack = np.stack(points)
    there = np.isfinite(stack).all(axis=2, keepdims=True)
    count = there.sum(axis=0)
    total = np.where(there, stack, 0.0).sum(axis=0)
    return np.asarray(np.where(count > 0, total / np.maximum(count, 1), np.nan))
