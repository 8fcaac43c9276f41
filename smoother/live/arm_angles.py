"""Angles of the arm at a moment with their sigmas, by its joints."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..array_types import FloatArray
from .answers import LiveEstimate

#: Their names, as `angles.definitions` has them where it does, with their joints and titles.
TITLES = {
    "elbow_flexion": "Elbow flexion",
    "shoulder_elevation": "Shoulder elevation",
    "forearm_elevation": "Forearm above level",
}
#: A step for slopes, m.
_STEP_M = 1e-4


def live_angles(
    estimate: LiveEstimate,
    down: FloatArray | None,  # (3,)
) -> dict[str, tuple[float, float]]:
    """Angles and their standard deviations, degrees, by name."""

    def flexion(at: dict[str, FloatArray]) -> float:
        return _between(at["elbow"] - at["shoulder"], at["wrist"] - at["elbow"])

    found: dict[str, tuple[tuple[str, ...], Callable[[dict[str, FloatArray]], float]]] = {
        "elbow_flexion": (("shoulder", "elbow", "wrist"), flexion)
    }
    if down is not None:
        found["shoulder_elevation"] = (
            ("shoulder", "elbow"),
            lambda at: _between(at["elbow"] - at["shoulder"], down),
        )
        found["forearm_elevation"] = (
            ("elbow", "wrist"),
            lambda at: _between(at["wrist"] - at["elbow"], down) - 90.0,
        )
    return {
        name: _with_sigma(estimate, joints, angle)
        for name, (joints, angle) in found.items()
        if all(joint in estimate.joints for joint in joints)
    }


def _between(a: FloatArray, b: FloatArray) -> float:
    """Angle between two vectors (3,), degrees."""
    return float(np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b)))


def _with_sigma(
    estimate: LiveEstimate, joints: tuple[str, ...], angle: Callable[[dict[str, FloatArray]], float]
) -> tuple[float, float]:
    """The angle and its sigma; errors of joints are taken as independent, which is on the safe side."""
    at = {joint: estimate.joints[joint] for joint in joints}
    value, variance = angle(at), 0.0
    for joint in joints:
        slope = np.zeros(3)
        for axis in range(3):
            moved = dict(at)
            moved[joint] = at[joint] + _STEP_M * np.eye(3)[axis]
            slope[axis] = (angle(moved) - value) / _STEP_M
        variance += float(slope @ estimate.joint_covariance[joint] @ slope)
    return value, float(np.sqrt(variance))
