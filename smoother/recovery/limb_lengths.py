"""Whether joints go by their own names: a bone keeps its length, and the sensor sits near the wrist."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from ..array_types import FloatArray
from ..calibration import ArmCalibration
from ..linalg import robust_sigma
from ..recording import JointTracks

#: A bone's length varies less than this, m, and less than this part of what is no bone: upper arms vary by
#: 0.01 to 0.03, shoulder to wrist by 0.06 to 0.12 as the elbow bends.
BONE_SIGMA_M, BONE_PART = 0.05, 0.4
FEWEST_FRAMES, MOST_FRAMES = 50, 20_000
#: A hand is some 0.08 m from the wrist and 0.3 m from the elbow.
NEARER = 0.6
#: From the elbow the hand is 1.24 times as far as the wrist in the median of 670 arms of a Kinect v1, 1.02
#: times at least.
HAND_NEARER = 0.93
#: A sensor nearer to the joint called elbow than to the wrist by this, m, and by so many sigmas, is on
#: a forearm whose joints are exchanged; unless the camera shows the names to be right: the wrist's distance
#: from the shoulder varies by this, m, and the elbow's by less than this part of it.
NEARER_M, NEARER_SIGMAS = 0.05, 4.0
BENT_M, STEADY_PART = 0.025, 0.7


class SwappedJoints(NamedTuple):
    """Two joints whose names seem exchanged, and what shows it, in words."""

    joints: tuple[str, str]
    sentence: str


SWAPPED = SwappedJoints(
    ("elbow", "wrist"),
    "elbow and wrist seem swapped: from the shoulder the wrist keeps its distance, and the elbow does not",
)
HAND_AT_ELBOW = SwappedJoints(
    ("elbow", "wrist"), "elbow and wrist seem swapped: the hand is nearer to the elbow than to the wrist"
)
SENSOR_AT_ELBOW = SwappedJoints(
    ("elbow", "wrist"),
    "elbow and wrist seem swapped: the sensor moves as if it sat near the joint called elbow",
)
HAND_BEFORE_WRIST = SwappedJoints(
    ("wrist", "hand"), "wrist and hand seem swapped: the hand is nearer to the elbow than the wrist is"
)


def swapped_joints(arm: JointTracks) -> Iterator[SwappedJoints]:
    """Where the joint called wrist is as far from the shoulder as only an elbow is, or the hand at the one
    called elbow, or between elbow and wrist.

    Parameters
    ----------
    arm : JointTracks
    """
    step = max(len(arm) // MOST_FRAMES, 1)
    arm = arm.select(slice(None, None, step))
    elbow_m, wrist_m = (_distances(arm, "shoulder", joint) for joint in ("elbow", "wrist"))
    to_elbow_m, to_wrist_m = (_distances(arm, "hand", joint) for joint in ("elbow", "wrist"))
    if _variation(elbow_m) > BONE_SIGMA_M and _variation(wrist_m) < BONE_PART * _variation(elbow_m):
        yield SWAPPED
    elif _middle(to_elbow_m) < NEARER * _middle(to_wrist_m):
        yield HAND_AT_ELBOW
    elif _middle(to_elbow_m) < HAND_NEARER * _middle(_distances(arm, "elbow", "wrist")):
        yield HAND_BEFORE_WRIST


def sensor_at_elbow(arm: JointTracks, found: ArmCalibration | None) -> Iterator[SwappedJoints]:
    """Where the sensor sits at the joint called elbow, and the camera does not show that it is one.

    Parameters
    ----------
    arm : JointTracks
    found : ArmCalibration, optional
        With lever arms that the motion gave.
    """
    levers = {} if found is None else found.lever_arms
    if not {"elbow", "wrist"} <= set(levers):
        return
    elbow, wrist = levers["elbow"], levers["wrist"]
    nearer_m = float(np.linalg.norm(wrist.position_m) - np.linalg.norm(elbow.position_m))
    sigma_m = float(np.hypot(elbow.sigma_m, wrist.sigma_m).max())
    if not nearer_m > max(NEARER_M, NEARER_SIGMAS * sigma_m):
        return
    arm = arm.select(slice(None, None, max(len(arm) // MOST_FRAMES, 1)))
    steady_m, bent_m = (_variation(_distances(arm, "shoulder", joint)) for joint in ("elbow", "wrist"))
    to_elbow_m, to_wrist_m = (_middle(_distances(arm, "hand", joint)) for joint in ("elbow", "wrist"))
    names_are_right = (bent_m > BENT_M and steady_m < STEADY_PART * bent_m) or (
        to_wrist_m < NEARER * to_elbow_m
    )
    if not names_are_right:
        yield SENSOR_AT_ELBOW


def _distances(arm: JointTracks, first: str, second: str) -> FloatArray:
    """Between two joints where both are tracked, m; none where that was hardly the case."""
    both = arm.tracked(first) & arm.tracked(second)
    if np.count_nonzero(both) < FEWEST_FRAMES:
        return np.zeros(0)
    return np.linalg.norm((arm.joint(second) - arm.joint(first))[both], axis=1)


def _middle(distances_m: FloatArray) -> float:
    return float(np.median(distances_m)) if len(distances_m) else float("nan")


def _variation(distances_m: FloatArray) -> float:
    """How much a distance varies, m; nan where it is not known."""
    return float(robust_sigma(distances_m - _middle(distances_m))) if len(distances_m) else float("nan")
