"""C3D files (c3d.org), by the library ezc3d."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ...errors import RecordingError
from ...runtime.inputs import check_input, crashes_in_subprocess
from .trajectories import Markers, metres_in, told_apart, without_origin


def read_c3d(path: Path) -> Markers:
    """Read the points of a C3D file.

    Missing is what has a negative residual, and what lies at (0, 0, 0). Names go on in `POINT:LABELS2`,
    `LABELS3` .. where there are more than 255. Time zero is the trial's frame zero: a file that was cut
    out of a trial begins later.

    Parameters
    ----------
    path : Path
        The file.

    Returns
    -------
    Markers
        All points.

    Raises
    ------
    RecordingError
        It is no C3D file, is damaged, or holds no point.
    """
    check_input(path, RecordingError)
    with open(path, "rb") as file:
        start = file.read(2)
    if len(start) < 2 or start[1] != 0x50:
        raise RecordingError(f"{path}: not a C3D file (its second byte is not 0x50); export it again")
    data, parameters = _load(path)
    point = parameters.get("POINT", {})
    _whole(path, point)
    position = np.moveaxis(np.asarray(data["points"], dtype=np.float64)[:3], (0, 1, 2), (2, 1, 0))
    if not position.shape[0] or not position.shape[1]:
        what = "no frame" if position.shape[1] else "no point"
        raise RecordingError(f"{path}: the C3D file holds {what}; export the markers with it")
    unit = _first(point, "UNITS", "")
    if not str(unit).strip():
        raise RecordingError(f"{path}: the parameter POINT:UNITS is missing; export the file in mm or m")
    scale = metres_in(str(unit), path)
    residual = _residuals(data, position.shape[:2])
    position = without_origin(position)
    position[(residual < 0) | ~np.isfinite(position).all(axis=2)] = np.nan
    rate = float(_first(point, "RATE", np.nan))
    if not (np.isfinite(rate) and rate > 0):
        raise RecordingError(f"{path}: the parameter POINT:RATE is missing, so the frames have no times")
    names, notes = _names(point, position.shape[1], path)
    first = int(data["first_frame"])
    return Markers(
        names,
        (first + np.arange(len(position))) / rate,
        position * scale,
        rate,
        str(unit).strip(),
        np.where(np.isfinite(position[..., 0]), residual, np.nan) * scale,
        str(path),
        tuple(notes),
    )


def _load(path: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """Points, residuals and first frame; and the parameters by group and name."""
    import ezc3d

    if would_crash(path):
        raise RecordingError(f"{path}: a damaged C3D file; export it again")
    try:
        file = ezc3d.c3d(str(path))
        data = {
            "points": file["data"]["points"],
            "residuals": file["data"]["meta_points"]["residuals"],
            "first_frame": file["header"]["points"]["first_frame"],
        }
    except Exception as error:  # whatever the library throws at a damaged file
        reason = " ".join(str(error).split()) or type(error).__name__
        raise RecordingError(f"{path}: a damaged C3D file ({reason}); export it again") from error
    return data, {group: dict(file["parameters"][group]) for group in file["parameters"]}


def would_crash(path: Path) -> bool:
    """Whether the library would end the process on this file, or never end itself.

    Its C++ reads past the end of parameters whose lengths are damaged, and takes memory for as many frames as
    a damaged header counts.
    """
    import ezc3d

    return crashes_in_subprocess(path, lambda file: ezc3d.c3d(str(file)))


def _whole(path: Path, point: dict[str, Any]) -> None:
    """Refuse a file that ends before the last frame that its header counts; the library makes frames up.

    Words of the header (c3d.org): 2 points, 3 analog samples a frame, 4 and 5 first and last frame, 9 the
    first block of 512 bytes that holds data. A scale below zero says that numbers have four bytes, else two.
    """
    with open(path, "rb") as file:
        header = file.read(512)
        file.seek(512 * (header[0] - 1) + 3)
        big_endian = file.read(1) == b"\x56"
    words = np.frombuffer(header[:24], dtype=">u2" if big_endian else "<u2")
    points, analogs, first, last, start = (int(words[k]) for k in (1, 2, 3, 4, 8))
    size = 4 if float(_first(point, "SCALE", -1.0)) < 0 else 2
    needed = (last - first + 1) * (4 * points + analogs) * size
    held = path.stat().st_size - 512 * (start - 1)
    if last >= first and held < needed:
        share = max(held, 0) / max(needed, 1)  # a header may count no points
        raise RecordingError(
            f"{path}: the C3D file is cut off: it holds {100 * share:.0f} % of the frames"
            " that its header counts; copy or export it again"
        )


def _first(group: dict[str, Any], name: str, default: Any) -> Any:
    value = group.get(name, {}).get("value", [])
    return value[0] if len(value) else default


def _residuals(data: dict[str, Any], shape: tuple[int, ...]) -> np.ndarray:
    residual = np.asarray(data["residuals"], dtype=np.float64)
    if residual.size != shape[0] * shape[1]:
        return np.zeros(shape)
    residual = residual.reshape(shape[1], shape[0]).T
    return np.where(np.isfinite(residual), residual, -1.0)


def _names(point: dict[str, Any], count: int, path: Path) -> tuple[tuple[str, ...], list[str]]:
    """A name for every point; labels go on in LABELS2, LABELS3 .."""
    labels: list[str] = [str(name) for name in point.get("LABELS", {}).get("value", [])]
    number = 2
    while len(labels) < count and f"LABELS{number}" in point:
        labels += [str(name) for name in point[f"LABELS{number}"]["value"]]
        number += 1
    notes = []
    if len(labels) < count:
        notes.append(f"{path.name}: {count - len(labels)} of {count} points have no name.")
        labels += [""] * (count - len(labels))
    names, twice = told_apart(labels[:count])
    if twice:
        notes.append(f"{path.name}: several points are called {', '.join(dict.fromkeys(twice))}; numbered.")
    return names, notes
