"""Tables of a Kinect v2's joints with a header: positions in m, x left, y up, z forward."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

from ...recording import CameraFrame
from .joint_columns import find_joint_columns
from .joint_names import words_of
from .protocol import FileHead, SkeletonTable
from .raw_skeleton import Conventions
from .wide_skeleton import header_of, kinect_states, read_wide


@dataclass(frozen=True)
class KinectV2Table:
    """A row a frame and body, with tracking states 0, 1, 2 or in words where there are any.

    Attributes
    ----------
    key, title, kind, recognised_by : str
        See `DeviceFormat`.
    """

    key: str = "kinect-v2"
    title: str = "Kinect v2 joints, table"
    kind: str = "skeleton"
    recognised_by: str = (
        "columns x, y, z of joints by the SDK's names (SpineBase, SpineShoulder, WristRight ..)"
    )

    def recognises(self, head: FileHead) -> bool:
        """Whether the header names joints that only this SDK has."""
        names = header_of(head)
        if not find_joint_columns(names).has_arm():
            return False
        words = [words_of(name) for name in names]
        pairs = {pair for row in words for pair in pairwise(row)}
        return bool(pairs & {("spine", "base"), ("spine", "shoulder"), ("spine", "mid"), ("hand", "tip")})

    def read(self, path: Path) -> list[SkeletonTable]:
        """Read all bodies.

        Raises
        ------
        RecordingError
            The file is no such table, or no arm is in it.
        """
        raw, _ = read_wide(path, kinect_states, "a table of a Kinect's joints")
        return raw.skeletons(Conventions("m", CameraFrame.KINECT))
