"""Skeletons in TRC files: OpenCap, Pose2Sim, Theia, and Azure Kinect by some exporters."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from ..markers.trc import read_trc
from .marker_joints import skeleton_of
from .protocol import FileHead, SkeletonTable


@dataclass(frozen=True)
class TrcSkeleton:
    """TRC files whose markers are named as joints; y is up as OpenSim has it, where the body agrees.

    Attributes
    ----------
    key, title, kind, recognised_by : str
        See `DeviceFormat`.
    """

    key: str = "trc"
    title: str = "TRC (OpenCap, Pose2Sim, Theia)"
    kind: str = "skeleton"
    recognised_by: str = "a line that begins with Frame#, above the names of markers"

    def recognises(self, head: FileHead) -> bool:
        """Whether a line of markers' names is among the first ones."""
        first = [line.strip(' \t,;"').lower() for line in head.lines[:12]]
        return any(line.startswith("frame#") for line in first)

    def read(self, path: Path) -> list[SkeletonTable]:
        """Read the skeleton.

        Raises
        ------
        RecordingError
            The file is damaged, or none of its markers is an arm's joint.
        """
        return [skeleton_of(read_trc(path), path, y_up=True)]
