"""What the camera alone says of the joints' names: a bone keeps its length, whatever the arm does."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ..linalg import robust_sigma
from ..recording import JointTracks

#: A bone's length varies less than this, m, and less than this part of what is no bone: upper arms vary by
#: 0.01 to 0.03, shoulder to wrist by 0.06 to 0.12 as the elbow bends.
BONE_SIGMA_M, BONE_PART = 0.05, 0.4
FEWEST_FRAMES, MOST_FRAMES = 50, 20_000

SWAPPED = (
    "elbow and wrist seem swapped: from the shoulder the wrist keeps its distance, and the elbow does not"
)


def swapped_joints(arm: JointTracks) -> Iterator[str]:
    """A sentence where the joint called wrist is as far from the shoulder as only an elbow is.

    Parameters
    ----------
    arm : JointTracks
    """
    step = max(len(arm) // MOST_FRAMES, 1)
    arm = arm.select(slice(None, None, step))
    elbow_m, wrist_m = (_variation(arm, joint) for joint in ("elbow", "wrist"))
    if elbow_m > BONE_SIGMA_M and wrist_m < BONE_PART * elbow_m:
        yield SWAPPED


def _variation(arm: JointTracks, joint: str) -> float:
    """How much a joint's distance from the shoulder varies, m; nan where both were hardly visible."""
    both = arm.tracked("shoulder") & arm.tracked(joint)
    if np.count_nonzero(both) < FEWEST_FRAMES:
        return float("nan")
    length = np.linalg.norm((arm.joint(joint) - arm.joint("shoulder"))[both], axis=1)
    return float(robust_sigma(length - np.median(length)))
