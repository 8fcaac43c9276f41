"""Joint angles: their table, how each is computed, and its sigma."""

from __future__ import annotations

from .definitions import JOINT_ANGLES, JointAngle
from .table import AngleTable, JointAngles, joint_angles

__all__ = ["JOINT_ANGLES", "AngleTable", "JointAngle", "JointAngles", "joint_angles"]
