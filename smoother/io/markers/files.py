"""Marker files of motion capture, by the ending of their names."""

from __future__ import annotations

import os
from pathlib import Path

from ...errors import RecordingError
from ...runtime.inputs import check_input
from .c3d import read_c3d
from .trajectories import Markers
from .trc import read_trc

#: Files of marker trajectories that can be read.
MARKER_FORMATS = (".c3d", ".trc")


def read_markers(path: str | os.PathLike[str]) -> Markers:
    """Read a `.c3d` or `.trc` file.

    Parameters
    ----------
    path : path-like
        The file.

    Returns
    -------
    Markers
        In the mocap's frame, on its clock.

    Raises
    ------
    RecordingError
        The file is missing, of another kind, damaged, or holds no marker.
    """
    path = Path(path)
    if path.suffix.lower() not in MARKER_FORMATS:
        raise RecordingError(f"{path}: markers are read from {' or '.join(MARKER_FORMATS)}")
    check_input(path, RecordingError)
    if not path.is_file():
        raise RecordingError(f"{path}: there is no such file")
    return read_trc(path) if path.suffix.lower() == ".trc" else read_c3d(path)
