"""The arm as a chain of segments: each may carry an IMU, and meets the one before it in a joint."""

from __future__ import annotations

from dataclasses import dataclass

from .recording import FOREARM_JOINTS


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
    """

    name: str
    axes: str
    joints: tuple[str, ...]
    parent: str
    shared_joint: str
    letters: str


FOREARM = BodySegment("forearm", "A", FOREARM_JOINTS, parent="", shared_joint="", letters="xvbl")
UPPER_ARM = BodySegment(
    "upper_arm", "B", ("elbow", "shoulder"), parent="forearm", shared_joint="elbow", letters="ywcme"
)
#: The segments that an IMU may be on in a window's graph, by name; the forearm's is always there.
SEGMENTS = {segment.name: segment for segment in (FOREARM, UPPER_ARM)}
