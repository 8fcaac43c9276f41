"""MediaPipe's 33 landmarks of the body (BlazePose), world landmarks: metres about the hips."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...array_types import FloatArray
from ...errors import RecordingError
from ...recording import CameraFrame
from .arm_lengths import unit_by_arm
from .joint_columns import find_joint_columns
from .joint_names import words_of
from .protocol import FileHead, SkeletonTable
from .raw_skeleton import Conventions, RawSkeleton
from .wide_skeleton import header_of, read_wide, share_states

#: World landmarks have the middle of the hips within this of their origin, m.
_ABOUT_HIPS_M = 0.06
RELATIVE_NOTE = (
    "World landmarks of MediaPipe are about the middle of the hips: motion is relative to the hips, the place"
    " in the room is not known, and a step or a bow of the trunk looks like a motion of the arm."
)


@dataclass(frozen=True)
class MediapipeTable:
    """A row a frame: x, y, z (and visibility) of landmarks by number or name.

    Attributes
    ----------
    key, title, kind, recognised_by : str
        See `DeviceFormat`.
    """

    key: str = "mediapipe"
    title: str = "MediaPipe world landmarks, table"
    kind: str = "skeleton"
    recognised_by: str = (
        "columns x, y, z of 33 numbered landmarks, or of landmarks such as right_pinky, mouth_left"
    )

    def recognises(self, head: FileHead) -> bool:
        """Whether the header numbers landmarks, or names some that only BlazePose has."""
        names = header_of(head)
        columns = find_joint_columns(names)
        if not columns.has_arm():
            return False
        words = {word for name in names for word in words_of(name)}
        return columns.numbered or columns.world or bool(words & {"pinky", "mouth", "visibility"})

    def read(self, path: Path) -> list[SkeletonTable]:
        """Read the skeleton.

        Raises
        ------
        RecordingError
            The landmarks are parts of the image, or no arm is in the table.
        """
        raw, columns = read_wide(path, share_states, "a table of MediaPipe's landmarks")
        return landmarks_in_metres(raw, columns.world, columns.normalised)


def landmarks_in_metres(raw: RawSkeleton, world: bool, normalised: bool = False) -> list[SkeletonTable]:
    """Skeletons of BlazePose's landmarks: about the hips in metres, or a room's (FreeMoCap).

    Parameters
    ----------
    raw : RawSkeleton
        As written.
    world : bool
        The file calls them world landmarks.
    normalised : bool
        The file calls them normalised.

    Returns
    -------
    list of SkeletonTable
        With `relative` where they are about the hips.

    Raises
    ------
    RecordingError
        They are normalised image coordinates.
    """
    fits = unit_by_arm(raw.position)
    is_about_hips = about_hips(raw)
    if not world and fits is not None and fits[0] in ("mm", "cm") and not normalised:
        return raw.skeletons(Conventions())
    if normalised or (not is_about_hips and (_in_image(raw) or (fits is None and not world))):
        raise RecordingError(
            f"{raw.path} holds landmarks as parts of the image's width and height (pose_landmarks), which are"
            " no metres; export pose_world_landmarks of the same video."
        )
    if is_about_hips or world or _middle_of_hips(raw) is None:
        raw.notes.append(RELATIVE_NOTE)
        return raw.skeletons(Conventions("m", CameraFrame.OPTICAL, relative=True))
    return raw.skeletons(Conventions())


def about_hips(raw: RawSkeleton) -> bool:
    """Whether the middle of the hips is the origin."""
    middle = _middle_of_hips(raw)
    return middle is not None and bool(np.abs(middle).max() < _ABOUT_HIPS_M)


def _middle_of_hips(raw: RawSkeleton) -> FloatArray | None:
    """Median middle of the hips (3,), None where the file has none."""
    hips = {name.side: rows for name, rows in raw.rest if name.part == "hip" and name.side}
    if len(hips) < 2:
        return None
    middle = 0.5 * (hips["left"] + hips["right"])
    middle = middle[np.isfinite(middle).all(axis=1)]
    return np.median(middle, axis=0) if len(middle) else None


def _in_image(raw: RawSkeleton) -> bool:
    """Whether shoulders and elbows lie between 0 and 1 in x and y, y down, as in an image."""
    hips = [rows[:, 1] for name, rows in raw.rest if name.part == "hip"]
    shoulders = [rows[:, 1] for joint, rows in raw.position.items() if joint.startswith("shoulder")]
    if hips and shoulders and np.nanmedian(np.concatenate(shoulders)) > np.nanmedian(np.concatenate(hips)):
        return False
    rows = [rows[:, :2] for joint, rows in raw.position.items() if joint.startswith(("shoulder", "elbow"))]
    if not rows:
        return False
    points = np.concatenate(rows)
    points = points[np.isfinite(points).all(axis=1) & (points != 0).any(axis=1)]
    inside = ((points > -0.05) & (points < 1.05)).all(axis=1)
    return bool(len(points) and inside.mean() > 0.9)
