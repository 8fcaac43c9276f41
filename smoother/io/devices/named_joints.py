"""Any table with x, y, z of joints by name: FreeMoCap, Pose2Sim, Nuitrack and programs of one's own."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from .joint_columns import find_joint_columns
from .protocol import FileHead, SkeletonTable
from .raw_skeleton import Conventions
from .wide_skeleton import header_of, kinect_states, read_wide


@dataclass(frozen=True)
class NamedJoints:
    """A row a frame and body; the unit is found by the arms' lengths, up by how the body stands.

    Attributes
    ----------
    key, title, kind, recognised_by : str
        See `DeviceFormat`.
    """

    key: str = "joint-table"
    title: str = "table of joints by name (FreeMoCap, Pose2Sim and others)"
    kind: str = "skeleton"
    recognised_by: str = (
        "columns x, y, z of an elbow and a wrist of one side, such as right_wrist_x or RWrist_X"
    )

    def recognises(self, head: FileHead) -> bool:
        """Whether the header names an elbow and a wrist of one side."""
        return find_joint_columns(header_of(head)).has_arm()

    def read(self, path: Path) -> list[SkeletonTable]:
        """Read all bodies.

        Raises
        ------
        RecordingError
            The file is no such table, or its positions are in no unit of length.
        """
        raw, _ = read_wide(path, kinect_states, "a table of joints")
        return raw.skeletons(Conventions())
