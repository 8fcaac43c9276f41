"""Marker files of motion capture, by the ending of their names; one position a marker of a still object."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from ...array_types import FloatArray
from ...errors import RecordingError
from ...runtime.inputs import check_input
from ..plain.table import read_table
from .c3d import read_c3d
from .trajectories import Markers, told_apart
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


#: A marker that strays farther than this from its mean was not still, m (rms).
STILL_M = 0.003
#: A marker is taken if it was seen in at least this share of the frames.
LEAST_SEEN = 0.3


def read_positions(path: str | os.PathLike[str]) -> dict[str, FloatArray]:
    """Positions (3,) m by marker, in the mocap's frame.

    Parameters
    ----------
    path : path-like
        CSV with the columns `marker`, `x`, `y`, `z` in metres, a row a marker; or `.trc` or `.c3d`, whose
        frames are averaged.

    Returns
    -------
    dict of str to ndarray, shape (3,), m
        By marker.

    Raises
    ------
    RecordingError
        The file cannot be read, holds no marker, or a marker moved.
    """
    path = Path(path)
    if path.suffix.lower() in MARKER_FORMATS:
        return _still(read_markers(path))
    check_input(path, RecordingError)
    if not path.is_file():
        raise RecordingError(f"{path}: there is no such file")
    numbers, words = read_table(path, ["marker", *"xyz"], words=["marker"], empty=[*"xyz"])
    rows = np.column_stack([numbers[axis] for axis in "xyz"])
    names, _ = told_apart(words["marker"])
    known = np.asarray(np.isfinite(rows).all(axis=1), bool)
    if not known.any():
        raise RecordingError(f"{path} holds no marker; give marker,x,y,z in metres, a row a marker.")
    return {name: row for name, row, good in zip(names, rows, known.tolist(), strict=True) if good}


def _still(markers: Markers) -> dict[str, FloatArray]:
    """The mean over time, about the median; refused where a marker moved."""
    means = {}
    for column, name in enumerate(markers.names):
        track = markers.position[:, column]
        track = track[np.isfinite(track).all(axis=1)]
        if len(track) < max(1, LEAST_SEEN * len(markers)):
            continue
        away = np.linalg.norm(track - np.median(track, axis=0), axis=1)
        spread = float(np.sqrt(np.mean(away**2)))
        if spread > STILL_M:
            raise RecordingError(
                f"{markers.source}: marker {name} moved by {1e3 * spread:.0f} mm (rms) and must be still; cut"
                " the file to the moment of the images."
            )
        means[name] = track[away <= max(3 * np.median(away), 1e-6)].mean(axis=0)
    if not means:
        raise RecordingError(f"{markers.source} holds no marker that was seen for long enough.")
    return means
