"""Zones about the trunk: whether the hand reached mouth, head and back; how far the elbow is from the trunk.

A skeleton of one arm has neither head nor the other shoulder. They are placed from the shoulder by the
proportions of the body (Drillis and Contini 1966, as in Winter, Biomechanics and Motor Control of Human
Movement, 2009, figure 4.1), the stature by the lengths of upper arm and forearm (0.186 and 0.146 of it).
Lengths as parts of the stature, in the thorax's axes (x forward, y up, z to the right arm's side):
"""

from __future__ import annotations

import numpy as np

from ..array_types import BoolArray, FloatArray
from .figure import UNKNOWN, Figure, share_of
from .motion import Motion
from .settings import Reach

UPPER_ARM, FOREARM = 0.186, 0.146
#: From the shoulder to the midline, and its height below the mouth (between chin 0.870 and eye 0.936 less
#: the acromion's 0.818) and below the head's middle (half way from chin to crown).
HALF_BREADTH, MOUTH_UP, HEAD_UP = 0.129, 0.075, 0.117
#: The mouth before the shoulders; the head's half axes (forward, up, sideways).
MOUTH_AHEAD = 0.06
HEAD_AXES = (0.055, 0.065, 0.044)
#: Behind the back counts from the shoulder down, and this far beyond the midline's other side at most.
KEYS = ("hand_to_mouth", "hand_to_head", "hand_behind_back")


def zone_figures_of(motion: Motion, rows: slice, settings: Reach) -> dict[str, Figure]:
    """Whether the hand reached mouth, head and back, and how near it came; the elbow's distance.

    Parameters
    ----------
    motion : Motion
        With shoulder, elbow and wrist, and the trunk's axes.
    rows : slice
        When.
    settings : Reach
        Sizes of the zones.

    Returns
    -------
    figures : dict of str to Figure
        `.._reached` is 1 or 0, `.._distance_m` how near the hand came (0 = within the zone),
        `elbow_trunk_distance_max_m` and `.._mean_m` from the vertical through the middle of the shoulders.
    """
    figures = {f"{key}_{what}": UNKNOWN for key in KEYS for what in ("reached", "distance_m")}
    figures |= {f"elbow_trunk_distance_{what}_m": UNKNOWN for what in ("max", "mean")}
    stature = stature_of(motion)
    if not np.isfinite(stature) or motion.R_K_T is None:
        return figures
    shoulder, elbow = motion.joints["shoulder"], motion.joints["elbow"]
    hand_T, elbow_T = motion.in_trunk(motion.hand - shoulder), motion.in_trunk(elbow - shoulder)
    assert hand_T is not None and elbow_T is not None
    hand_T, elbow_T, occluded = hand_T[rows], elbow_T[rows], motion.occluded[rows]
    distances = {
        "hand_to_mouth": mouth_distance(hand_T, stature) - settings.mouth_m,
        "hand_to_head": head_distance(hand_T, stature) - settings.head_m,
        "hand_behind_back": back_distance(hand_T, stature, settings.behind_m),
    }
    for key, distance in distances.items():
        figures |= _reached(key, distance, occluded)
    middle = np.array([0.0, -HALF_BREADTH * stature])
    away = np.linalg.norm(elbow_T[:, [0, 2]] - middle, axis=1)
    known = np.isfinite(away)
    if known.any():
        far = known & (np.nan_to_num(away) >= 0.98 * np.nanmax(away))
        figures["elbow_trunk_distance_max_m"] = Figure(float(np.nanmax(away)), share_of(occluded, far))
        figures["elbow_trunk_distance_mean_m"] = Figure(float(np.nanmean(away)), share_of(occluded[known]))
    return figures


def stature_of(motion: Motion) -> float:
    """The person's height by the lengths of upper arm and forearm, m; nan where they are not known."""
    lengths = bone_lengths(motion)
    if not {"upper_arm", "forearm"} <= lengths.keys():
        return float("nan")
    return (lengths["upper_arm"] + lengths["forearm"]) / (UPPER_ARM + FOREARM)


def bone_lengths(motion: Motion) -> dict[str, float]:
    """Median lengths of upper arm, forearm and from wrist to hand, m; what is not known is left out."""
    ends = {"upper_arm": ("shoulder", "elbow"), "forearm": ("elbow", "wrist"), "hand": ("wrist", "hand")}
    return {
        bone: float(np.nanmedian(np.linalg.norm(motion.joints[a] - motion.joints[b], axis=1)))
        for bone, (a, b) in ends.items()
        if a in motion.joints and b in motion.joints
    }


def mouth_distance(hand_T: FloatArray, stature: float) -> FloatArray:
    """From the hand (n, 3) to the mouth, m; places from the shoulder in the thorax's axes."""
    mouth = stature * np.array([MOUTH_AHEAD, MOUTH_UP, -HALF_BREADTH])
    return np.asarray(np.linalg.norm(hand_T - mouth, axis=1))


def head_distance(hand_T: FloatArray, stature: float) -> FloatArray:
    """From the hand (n, 3) to the head's surface, an ellipsoid, m; along the line to its middle."""
    middle = stature * np.array([0.0, HEAD_UP, -HALF_BREADTH])
    away = hand_T - middle
    scaled = np.linalg.norm(away / (stature * np.array(HEAD_AXES)), axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.linalg.norm(away, axis=1) * np.maximum(1.0 - 1.0 / scaled, 0.0))


def back_distance(hand_T: FloatArray, stature: float, behind_m: float) -> FloatArray:
    """How far the hand (n, 3) is from the room behind the back, m; 0 or less inside.

    That room lies behind the shoulders, below them, and between the lines down from both.
    """
    breadth = HALF_BREADTH * stature
    outside = np.stack(
        [
            hand_T[:, 0] + behind_m,
            hand_T[:, 1],
            np.abs(hand_T[:, 2] + breadth) - breadth,
        ],
        axis=1,
    )
    apart = np.linalg.norm(np.maximum(outside, 0.0), axis=1)
    return np.asarray(np.where(apart > 0.0, apart, outside.max(axis=1)))


def _reached(key: str, distance: FloatArray, occluded: BoolArray) -> dict[str, Figure]:
    """Whether a distance (n,) gets to zero, and the least of it."""
    if not np.isfinite(distance).any():
        return {}
    least = float(np.nanmin(distance))
    with np.errstate(invalid="ignore"):
        near = distance <= max(least, 0.0) + 0.01
    share = share_of(occluded, near)
    return {
        f"{key}_reached": Figure(float(least <= 0.0), share),
        f"{key}_distance_m": Figure(max(least, 0.0), share),
    }
