"""Angles of the arm at a moment with their sigmas, by its joints."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..array_types import FloatArray
from .answers import LiveEstimate

#: Joints by name, and down, to degrees.
_Angle = Callable[[dict[str, FloatArray], FloatArray], float]
#: By name, as `angles.definitions` has them where it does: joints, whether down is needed, the angle.
ANGLES: dict[str, tuple[tuple[str, ...], bool, _Angle]] = {
    "elbow_flexion": (
        ("shoulder", "elbow", "wrist"),
        False,
        lambda at, down: _between(at["elbow"] - at["shoulder"], at["wrist"] - at["elbow"]),
    ),
    "shoulder_elevation": (
        ("shoulder", "elbow"),
        True,
        lambda at, down: _between(at["elbow"] - at["shoulder"], down),
    ),
    "forearm_elevation": (  # above level
        ("elbow", "wrist"),
        True,
        lambda at, down: _between(at["wrist"] - at["elbow"], down) - 90.0,
    ),
}
#: A step for slopes, m.
_STEP_M = 1e-4


def live_angles(estimate: LiveEstimate, down: FloatArray | None) -> dict[str, tuple[float, float]]:
    """Angles and their sigmas, degrees, by name; errors of joints count as independent: the safe side."""
    found, known = {}, np.zeros(3) if down is None else down
    for name, (joints, needs_down, angle) in ANGLES.items():
        if not set(joints) <= estimate.joints.keys() or (needs_down and down is None):
            continue
        at = {joint: estimate.joints[joint] for joint in joints}
        value, variance = angle(at, known), 0.0
        for joint in joints:
            moved = [at | {joint: at[joint] + step} for step in _STEP_M * np.eye(3)]
            slope = np.array([angle(each, known) - value for each in moved]) / _STEP_M
            variance += float(slope @ estimate.joint_covariance[joint] @ slope)
        found[name] = value, float(np.sqrt(variance))
    return found


def _between(a: FloatArray, b: FloatArray) -> float:
    """Angle between two vectors (3,), degrees."""
    return float(np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b)))
