"""The arm as a chain of segments: each may carry an IMU, and meets the one before it in a joint."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from .recording import FOREARM_JOINTS, JOINTS, JointTracks


@dataclass(frozen=True)
class BodySegment:
    """A segment of the arm.

    Attributes
    ----------
    name : str
    axes : str
        Letter of its IMU's axes.
    joints : tuple of str
        Those with a lever arm in these axes.
    parent : str
        The segment whose chain it continues; "" of the first one, which the camera's joints are tied to.
    shared_joint : str
        The joint that it has in common with its parent; "" of the first one.
    letters : str
        Of its variables in a graph: pose, velocity, bias, lever arm, and the shared joint's position.
    as_forearm : mapping of str to str
        Its joint by the joint of the forearm that is to the forearm's IMU what this one is to its own.
    """

    name: str
    axes: str
    joints: tuple[str, ...]
    parent: str
    shared_joint: str
    letters: str
    as_forearm: Mapping[str, str] = field(default_factory=dict)

    def seen_as_forearm(self, arm: JointTracks) -> JointTracks:
        """Tracks of this segment in place of the forearm, and of nothing else."""
        position = np.full_like(np.asarray(arm.position), np.nan)
        state = np.zeros_like(np.asarray(arm.state))
        for forearm_joint, joint in self.as_forearm.items():
            position[:, JOINTS.index(forearm_joint)] = arm.joint(joint)
            state[:, JOINTS.index(forearm_joint)] = arm.state[:, JOINTS.index(joint)]
        return replace(arm, position=position, state=state)


FOREARM = BodySegment("forearm", "A", FOREARM_JOINTS, parent="", shared_joint="", letters="xvbl")
UPPER_ARM = BodySegment(
    "upper_arm",
    "B",
    ("elbow", "shoulder"),
    parent="forearm",
    shared_joint="elbow",
    letters="ywcme",
    as_forearm={"elbow": "shoulder", "wrist": "elbow"},
)
#: The segments that an IMU may be on in a window's graph, by name; the forearm's is always there.
SEGMENTS = {segment.name: segment for segment in (FOREARM, UPPER_ARM)}
