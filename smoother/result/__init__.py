"""The recovered motion: what `smooth` and every baseline return."""

from __future__ import annotations

from .draws import Draws
from .estimates import CameraEstimate, Estimates
from .recovery import (
    FrameResiduals,
    Recoveries,
    Recovery,
    SegmentMotion,
    TrunkMotion,
    arm_tags,
    is_of_arm,
)
from .verdict import GapVerdict, Pairing, SelfCheck, UntrustedInterval

__all__ = [
    "CameraEstimate",
    "Draws",
    "Estimates",
    "FrameResiduals",
    "GapVerdict",
    "Pairing",
    "Recoveries",
    "Recovery",
    "SegmentMotion",
    "SelfCheck",
    "TrunkMotion",
    "UntrustedInterval",
    "arm_tags",
    "is_of_arm",
]
