"""Tables of the Azure Kinect's body tracking with a header, as the mkv extractor and others write them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from ...recording import CameraFrame
from .joint_columns import find_joint_columns
from .joint_names import words_of
from .protocol import FileHead, SkeletonTable
from .raw_skeleton import Conventions
from .wide_skeleton import azure_states, header_of, inferred_throughout, read_wide


@dataclass(frozen=True)
class AzureKinectTable:
    """A row a frame and body: positions in mm in the depth camera's axes, confidences 0 to 3, times in us.

    Confidence 2 and 3 is tracked, 1 (occluded, guessed) inferred, 0 (out of range) not tracked. Orbbec's
    wrapper of the same SDK writes the same joints.

    Attributes
    ----------
    key, title, kind, recognised_by : str
        See `DeviceFormat`.
    """

    key: str = "azure-kinect"
    title: str = "Azure Kinect or Orbbec body tracking, table"
    kind: str = "skeleton"
    recognised_by: str = (
        "columns x, y, z of joints by the SDK's names (SPINE_NAVEL, CLAVICLE_LEFT, WRIST_RIGHT ..)"
    )

    def recognises(self, head: FileHead) -> bool:
        """Whether the header names joints that only this SDK has."""
        names = header_of(head)
        if not find_joint_columns(names).has_arm():
            return False
        words = {word for name in names for word in words_of(name)}
        return bool(words & {"navel", "naval", "clavicle", "k4abt"}) or "WRIST_RIGHT (c)" in names

    def read(self, path: Path) -> list[SkeletonTable]:
        """Read all bodies.

        Raises
        ------
        RecordingError
            The file is no such table, or no arm is in it.
        """
        raw, _ = read_wide(path, azure_states, "a table of an Azure Kinect's joints")
        inferred_throughout(raw)
        return raw.skeletons(Conventions("mm", CameraFrame.OPTICAL))
