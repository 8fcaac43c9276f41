"""A truth beside device files."""

from __future__ import annotations

from pathlib import Path

from ...errors import RecordingError
from ..markers.files import MARKER_FORMATS, read_markers
from ..plain.folder import read_pose_table
from ..recording.read import open_recording
from ..recording.streams import RecordingFile
from .files import FileReport


def add_truth(file: RecordingFile, path: Path) -> FileReport:
    """Put poses of the forearm IMU into a recording; markers stay a file of their own.

    Parameters
    ----------
    file : RecordingFile
        The recording, IMUs on the clock that the poses count on.
    path : Path
        `.csv` with t_s, x, y, z [, qw, qx, qy, qz], `.mcap` with poses, or markers (`.c3d`, `.trc`).

    Returns
    -------
    FileReport
        What is said of it.

    Raises
    ------
    RecordingError
        It cannot be read, or does not overlap with the IMUs in time.
    """
    kind = path.suffix.lower()
    if kind in MARKER_FORMATS:
        markers = read_markers(path)
        sentence = (
            f"{path.name}: {len(markers.names)} markers, {markers.rate_hz:.1f} Hz, {len(markers):,} frames;"
            f" they stay there: unocclude validate RESULT.mcap --truth {path} --markers MAP.toml"
        )
        return FileReport(str(path), kind[1:], sentence, count=len(markers), rate_hz=markers.rate_hz)
    if kind == ".mcap":
        poses = open_recording(path).poses
        if len(poses) != 1:
            raise RecordingError(f"{path} holds {len(poses)} topics of poses; one is needed for --truth.")
        truth = poses[0]
    else:
        truth = read_pose_table(path)
    first, last = int(truth.stamp_ns.min()), int(truth.stamp_ns.max())
    if file.imus and not any(i.stamp_ns[0] < last and first < i.stamp_ns[-1] for i in file.imus):
        raise RecordingError(
            f"{path}: the poses (from {first / 1e9:.3f} s on) do not overlap with the IMU (from"
            f" {file.imus[0].stamp_ns[0] / 1e9:.3f} s on); write their times on the clock that the IMU has in"
            " the recording, or compare afterwards with `unocclude validate --truth --align`."
        )
    file.poses.append(truth)
    sentence = f"{path.name}: poses of the truth, {len(truth.stamp_ns):,} rows"
    return FileReport(str(path), "poses", sentence, [truth.topic], count=len(truth.stamp_ns))
