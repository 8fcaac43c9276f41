"""Arrays of joints in numpy's files: FreeMoCap, and programs of one's own."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...errors import RecordingError
from ...recording import CameraFrame
from .joint_names import AZURE, BLAZEPOSE, POINT_SETS, joint_name
from .mediapipe import landmarks_in_metres
from .protocol import FileHead, SkeletonTable
from .raw_skeleton import Conventions, RawSkeleton
from .wide_skeleton import share_states


@dataclass(frozen=True)
class JointArray:
    """An array of frames, points and x, y, z (and a score); which point is which goes by how many there are.

    Attributes
    ----------
    key, title, kind, recognised_by : str
        See `DeviceFormat`.
    """

    key: str = "joint-array"
    title: str = "array of joints, npy (FreeMoCap)"
    kind: str = "skeleton"
    recognised_by: str = "numpy's npy file of an array of frames x points x 3 (or 4)"

    def recognises(self, head: FileHead) -> bool:
        """Whether the file begins as numpy's do."""
        return head.raw.startswith(b"\x93NUMPY")

    def read(self, path: Path) -> list[SkeletonTable]:
        """Read the skeleton.

        Raises
        ------
        RecordingError
            The file breaks off, or its shape is of no known set of points.
        """
        array = _loaded(path)
        names = POINT_SETS[array.shape[1]]
        raw = RawSkeleton(path, {})
        for at, name in enumerate(names):
            meaning = joint_name(name)
            if meaning is None:
                continue
            position = array[:, at, :3].copy()
            if not meaning.joint:
                raw.rest.append((meaning, position))
                continue
            raw.position[meaning.joint] = position
            if array.shape[2] == 4:
                raw.state[meaning.joint] = share_states(array[:, at, 3])
        first, last = names[0], names[-1]
        raw.notes.append(f"{array.shape[1]} points a frame count in the order {first} .. {last}.")
        if names is BLAZEPOSE:
            return landmarks_in_metres(raw, world=False)
        return raw.skeletons(Conventions("mm", CameraFrame.OPTICAL) if names is AZURE else Conventions())


def _loaded(path: Path) -> NDArray[np.float64]:
    """The array, (frames, points, 3 or 4)."""
    try:
        array = np.load(path, allow_pickle=False)
    except Exception as error:  # whatever a damaged header leads numpy into
        raise RecordingError(
            f"{path} is no array of numbers that numpy can read ({str(error)[:80]}); save it again with"
            " numpy.save."
        ) from error
    if array.dtype.kind not in "fiu":
        raise RecordingError(
            f"{path} holds {array.dtype} and not numbers; save an array of frames x points x 3."
        )
    if array.ndim == 2:
        for width in (3, 4):
            if array.shape[1] % width == 0 and array.shape[1] // width in POINT_SETS:
                array = array.reshape(len(array), -1, width)
                break
    if array.ndim != 3 or array.shape[2] not in (3, 4) or array.shape[1] not in POINT_SETS or not len(array):
        shape = " x ".join(map(str, array.shape))
        known = ", ".join(map(str, sorted(POINT_SETS)))
        raise RecordingError(
            f"{path} is an array of {shape}; joints are frames x points x 3, of {known} points."
        )
    return array.astype(float)
