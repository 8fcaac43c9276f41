"""The recovered motion: what `smooth` and every baseline return."""

from __future__ import annotations

from .camera_estimate import CameraEstimate
from .draws import Draws
from .estimates import Estimates
from .frame_residuals import FrameResiduals
from .recoveries import Recoveries, arm_tags, is_of_arm
from .recovery import Recovery
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
    "SelfCheck",
    "UntrustedInterval",
    "arm_tags",
    "is_of_arm",
]
