"""Skeletons in C3D files: model markers, joint centres, and Theia3D's poses of segments."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from ..markers.c3d import read_c3d
from .marker_joints import skeleton_of
from .protocol import FileHead, SkeletonTable
from .segment_origins import read_segment_origins

#: Processor types of a C3D file's parameters: Intel, DEC, SGI.
_PROCESSORS = (84, 85, 86)


@dataclass(frozen=True)
class C3dSkeleton:
    """C3D files whose points are named as joints.

    Attributes
    ----------
    key, title, kind, recognised_by : str
        See `DeviceFormat`.
    """

    key: str = "c3d"
    title: str = "C3D model markers or Theia3D segments"
    kind: str = "skeleton"
    recognised_by: str = "the second byte 0x50, and a block of parameters where the first byte points"

    def recognises(self, head: FileHead) -> bool:
        """Whether the file begins as a C3D file does."""
        if len(head.raw) < 512 or head.raw[1] != 0x50 or head.raw[0] < 2:
            return False
        parameters = head.raw[512 * (head.raw[0] - 1) :][:4]
        return len(parameters) < 4 or parameters[3] in _PROCESSORS

    def read(self, path: Path) -> list[SkeletonTable]:
        """Read the skeleton.

        Raises
        ------
        RecordingError
            The file is damaged, or none of its points is an arm's joint.
        """
        markers = read_segment_origins(path) or read_c3d(path)
        return [skeleton_of(markers, path, y_up=False)]
