"""Several cameras that saw one arm: where each stands, its clock, and their frames joined into one stream."""

from __future__ import annotations

from .joining import join_cameras
from .rig import CameraRig, RigCamera

__all__ = ["CameraRig", "RigCamera", "join_cameras"]
