"""Joint angles: their table, how each is computed, and its sigma."""

from __future__ import annotations

from .definitions import JOINT_ANGLES, JointAngle
from .found import ForearmMounting, angles_by_joints, forearm_mounting, shoulder_angles
from .table import AngleTable, joint_angles

__all__ = [
    "JOINT_ANGLES",
    "AngleTable",
    "ForearmMounting",
    "JointAngle",
    "angles_by_joints",
    "forearm_mounting",
    "joint_angles",
    "shoulder_angles",
]
