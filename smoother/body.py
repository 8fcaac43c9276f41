"""The arm as a chain of segments: each may carry an IMU, and meets the one before it in a joint."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from .recording import FOREARM_JOINTS, JOINTS, JointTracks


@dataclass(frozen=True)
class BodySegment:
    """A segment of the arm."""

    name: str
    label: str  # In sentences, after "the"
    prefix: str  # Of the names of columns on its IMU
    sigma_name: str  # Of the columns of its IMU's sigmas
    axes: str  # Letter of its IMU's axes
    joints: tuple[str, ...]  # Those with a lever arm in these axes
    parent: str  # The segment whose chain it continues; "" of the first one
    shared_joint: str  # The joint that it shares with its parent; "" of the first one
    # Joints whose camera samples are tied to it rather than to its parent, where it has an IMU
    camera_joints: tuple[str, ...]
    remedy: str  # What to do where its motion does not show how its IMU sits
    letters: str  # Of its variables in a graph: pose, velocity, bias, lever arm, shared joint's position
    # Its joint by the joint of the forearm that is to the forearm's IMU what this one is to its own
    as_forearm: Mapping[str, str] = field(default_factory=dict)

    @property
    def carries_parent(self) -> bool:
        """It is between its parent and the trunk, as the upper arm does."""
        return bool(self.parent) and self.as_forearm["wrist"] == self.shared_joint

    def seen_as_forearm(self, arm: JointTracks) -> JointTracks:
        """Tracks of this segment in place of the forearm, and of nothing else."""
        position = np.full_like(np.asarray(arm.position), np.nan)
        state = np.zeros_like(np.asarray(arm.state))
        for forearm_joint, joint in self.as_forearm.items():
            position[:, JOINTS.index(forearm_joint)] = arm.joint(joint)
            state[:, JOINTS.index(forearm_joint)] = arm.state[:, JOINTS.index(joint)]
        return replace(arm, position=position, state=state)


FOREARM = BodySegment(
    "forearm",
    "forearm",
    "",
    "sigma",
    "A",
    FOREARM_JOINTS,
    parent="",
    shared_joint="",
    camera_joints=FOREARM_JOINTS,
    remedy="",
    letters="xvbl",
)
UPPER_ARM = BodySegment(
    "upper_arm",
    "upper arm",
    "upper",
    "upper_sigma",
    "B",
    ("elbow", "shoulder"),
    parent="forearm",
    shared_joint="elbow",
    camera_joints=(),
    remedy="raise the arm and turn it about there",
    letters="ywcme",
    as_forearm={"elbow": "shoulder", "wrist": "elbow"},
)
HAND = BodySegment(
    "hand",
    "hand",
    "hand",
    "hand_imu_sigma",  # "hand_sigma" is the joint's
    "H",
    ("wrist", "hand"),
    parent="forearm",
    shared_joint="wrist",
    camera_joints=("hand",),
    remedy="raise the hand, bend the wrist and turn it about there",
    letters="zqdnf",
    as_forearm={"elbow": "wrist", "wrist": "hand"},
)
#: The segments that an IMU may be on in a window's graph, by name; the forearm's is always there. The letters
#: of poses follow each other as the segments do.
SEGMENTS = {segment.name: segment for segment in (FOREARM, UPPER_ARM, HAND)}
#: Those beyond the forearm.
FURTHER = tuple(segment for segment in SEGMENTS.values() if segment.parent)


def segment_of(joint: str, segments: Iterable[str]) -> str:
    """Which of some segments with IMUs a joint's camera samples are tied to: the last that claims it."""
    claims = [name for name in segments if joint in SEGMENTS[name].camera_joints]
    return claims[-1] if claims else FOREARM.name
