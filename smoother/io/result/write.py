"""A recovery to an MCAP file that Foxglove and Rerun show as it is; what it has besides its time series."""

from __future__ import annotations

import dataclasses
import json
import os
import tempfile
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ... import __version__
from ...errors import UnoccludeError
from ...result import Recovery, arm_tags
from ...runtime.outputs import check_output, writing
from ..mcap.container import Container
from ..mcap.merge import Output, OutputStream
from ..mcap.messages import damage
from ..recording.read import METADATA, open_recording
from ..recording.streams import RecordingFile
from ..recording.write import CAMERA
from .drawing import common_down
from .streams import recovery_streams
from .tables import SEGMENT, TRUNK, tables_of, write_table

RESULT = "unocclude.result"
PARQUET = "application/vnd.apache.parquet"


def write_recovery(
    recoveries: Recovery | Sequence[Recovery],
    path: str | os.PathLike[str],
    *,
    source: str | os.PathLike[str] | None = None,
    force: bool = False,
) -> None:
    """Write the recovered motion of one arm, or of several, to an MCAP file.

    Attachments are Parquet tables with every column: `unocclude.result/samples.parquet` (the IMU's
    samples), and `frames`, `residuals` and `draws`. The metadata record `unocclude.result` contains all
    else as JSON; `read_recovery` gives everything back. Topics are for viewers, at the camera's rate:
    `/unocclude/forearm` (Odometry: pose of the IMU in the camera frame, velocity in its own axes; an
    answer without orientation has body_frame_id = frame_id), `/unocclude/skeleton` (joints with
    covariance), `/unocclude/arm` and `/unocclude/arm_camera` (drawn after and before, orange where
    occluded, dark red where the answer is not to be trusted), `/unocclude/beads` (PointCloud along the
    bones), `/unocclude/gaps` (Event, with `trusted` and `reasons` in its metadata), `/unocclude/log`
    (Log: the gaps), `/unocclude/joints` (JointStates: elbow_flexion, rad, 0 = straight), `/unocclude/tf`
    (FrameTransforms: camera to forearm IMU, and the level `world` to the camera), `/unocclude/camera`
    (the camera's joints on the IMU's clock). With several arms each name ends in the arm's side, with
    several people in `body_N/SIDE` (`result.arm_tags`). The same input gives the same bytes.

    Parameters
    ----------
    recoveries : Recovery or sequence of Recovery
        One arm's recovery, or several of one recording.
    path : path-like
        The file to write.
    source : path-like, optional
        The recording: frames are called as there, and its camera's axes are kept.
    force : bool
        Overwrite a file that exists.

    Raises
    ------
    UnoccludeError
        The file exists and `force` is not given, it is the recording itself, or it cannot be written.
    """
    results = [recoveries] if isinstance(recoveries, Recovery) else list(recoveries)
    check_output(path, force)
    if source is not None and os.path.exists(path) and os.path.samefile(source, path):
        raise UnoccludeError(f"{path} is the recording itself; give another name to write to.")
    frames: dict[str, str] = {}
    about: dict[str, str] = {}
    shift = 0
    level_down = None
    if source is not None:
        recorded = open_recording(source, only={recovery.arm.name for recovery in results})
        about = _about(recorded)
        frames = {arm.topic: arm.frame_id for arm in recorded.arms if arm.frame_id}
        level_down = recorded.level_down
        shift = recorded.imus[0].log_shift_ns if recorded.imus else 0
        # A recorder's delay is not a reason to move; a sensor that counts from its own start is.
        shift = shift if abs(shift) > 1_000_000_000 else 0
    down = common_down(results, level_down)
    with writing(path, force) as temporary, Output(temporary) as output:
        streams: list[OutputStream] = []
        for tag, recovery in zip(arm_tags(results), results, strict=True):
            suffix = "" if len(results) == 1 else f"/{tag}"
            output.metadata(RESULT + suffix, recovery_values(recovery, __version__))
            for table, columns in tables_of(recovery).items():  # through a file, not through the memory
                with tempfile.TemporaryFile(dir=temporary.parent) as file:
                    write_table(columns, file)
                    output.attachment(f"{RESULT}{suffix}/{table}.parquet", file, PARQUET)
            frame_id = frames.get(recovery.arm.name, CAMERA)
            streams += recovery_streams(output, recovery, suffix, frame_id, shift, down)
        if about:
            output.metadata(METADATA, about)
        output.write(streams)


def _about(file: RecordingFile) -> dict[str, str]:
    """The recording's metadata, wherever in the file it stands, and the camera's axes."""
    implied = next((arm.camera_frame for arm in file.arms if arm.camera_frame is not None), None)
    axes = {} if implied is None else {"camera_frame": str(implied)}
    return axes | Container(file.path).skimmed().metadata.get(METADATA, {})


def to_json(value: object) -> str:
    """JSON of plain values, arrays (as lists) and dataclasses; nan stays nan, as Python reads it."""
    text = json.dumps(value, default=_plain, ensure_ascii=False)
    return text.encode("utf-8", "backslashreplace").decode("utf-8")  # a file's name may be no UTF-8: \\udcff


def _plain(value: object) -> object:
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, np.generic):
        return value.item()
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return vars(value)
    if isinstance(value, Mapping):
        return dict(value)
    if isinstance(value, set | frozenset):
        return sorted(value)
    return str(value)


#: What a result's metadata states by the names of the attributes.
STATED = (
    *("method", "name", "side", "body", "origin_ns", "gaps", "calibration", "gravity_direction"),
    *("clock_offset_s", "clock_offset_sigma_s", "notes"),
)


def recovery_values(recovery: Recovery, version: str) -> dict[str, str]:
    """The metadata record of a result: JSON by key."""
    trunk, draws, residuals = recovery.trunk, recovery.draws, recovery.residuals
    values = {name: getattr(recovery, name) for name in STATED}
    values |= {
        "version": version,
        "camera": recovery.arm.name,
        "config": _lasting(recovery.config),
        "figures": recovery.estimates.plain(),
        "joints": list(recovery.joints),
        "segments": {name: _without(motion, SEGMENT) for name, motion in recovery.segments.items()},
        "trunk": None if trunk is None else _without(trunk, TRUNK),
        "draws": None if draws is None else {"count": len(draws), "seed": draws.seed},
        "damage": damage(recovery.notes),
        "rejected_for": None if residuals is None else [reason.sentence for reason in residuals.reasons],
    }
    return {key: to_json(value) for key, value in values.items()}


def _without(value: object, columns: Sequence[str]) -> dict[str, object]:
    return {name: each for name, each in vars(value).items() if name not in columns}


def _lasting(config: Mapping[str, Any]) -> dict[str, Any]:
    """The configuration without the number of processes: it does not affect the result."""
    return {
        section: {key: value for key, value in settings.items() if (section, key) != ("windows", "processes")}
        if isinstance(settings, Mapping)
        else settings
        for section, settings in config.items()
    }
