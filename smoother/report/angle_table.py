"""The joint angles of a recovery with their sigmas, as the page draws them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..array_types import FloatArray
from ..joint_angles import elbow_flexion_sigma, recovery_angles
from ..result import Recovery
from ..shoulder_angles import SHOULDER_ANGLES, shoulder_angles


@dataclass(frozen=True)
class JointAngle:
    """An angle, its title, and its zero."""

    name: str
    title: str
    meaning: str


@dataclass(frozen=True)
class AngleTable:
    """Angles, their sigmas (N,), degrees, and why one is empty, by name."""

    angles: tuple[JointAngle, ...]
    values: dict[str, FloatArray]
    sigmas: dict[str, FloatArray]
    reasons: dict[str, str]


_ANGLES = (
    JointAngle("elbow_flexion", "elbow flexion", "0 = straight"),
    JointAngle("shoulder_plane", "shoulder plane of elevation", "0 = abduction, 90 = forward flexion"),
    JointAngle("shoulder_elevation", "shoulder elevation", "0 = hanging, 90 = level"),
    JointAngle("shoulder_rotation", "shoulder rotation", "internal positive"),
    JointAngle("pronation", "forearm pronation", "0 = palm forward"),
)


def angle_table(recovery: Recovery) -> AngleTable:
    """The angles of a recovery."""
    values = {n: v for n, v in recovery_angles(recovery).items() if n != "carrying"}
    sigmas = {n: np.full(len(recovery), np.nan) for n in values}
    sigmas["elbow_flexion"] = elbow_flexion_sigma(recovery)
    own, own_sigmas = shoulder_angles(recovery)
    for n in SHOULDER_ANGLES:
        there = np.isfinite(own[n])
        values[n] = np.where(there, own[n], values[n])
        sigmas[n] = np.where(there, own_sigmas[n], sigmas[n])
    reasons = {n: "not determined" for n, v in values.items() if not np.isfinite(v).any()}
    return AngleTable(_ANGLES, values, sigmas, reasons)
