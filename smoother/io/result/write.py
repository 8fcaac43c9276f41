"""A recovery to an MCAP file that Foxglove and Rerun show as it is; what it has besides its time series."""

from __future__ import annotations

import dataclasses
import json
import os
from collections.abc import Mapping, Sequence
from importlib.metadata import PackageNotFoundError, version
from itertools import chain
from typing import Any

import numpy as np

from ...body import FURTHER, SEGMENTS, UPPER_ARM
from ...calibration import ArmCalibration, Length, LeverArm, SegmentMounting
from ...errors import UnoccludeError
from ...measurements.visibility import Gap
from ...result import Recovery, arm_tags
from ...runtime.outputs import check_output, writing
from ..mcap.container import Container
from ..mcap.merge import Output, time_batches
from ..recording.read import METADATA, open_recording
from ..recording.streams import RecordingFile
from ..recording.write import CAMERA
from .drawing import common_down
from .streams import AXES, RecoveryStreams

RESULT = "unocclude.result"


def write_recovery(
    recoveries: Recovery | Sequence[Recovery],
    path: str | os.PathLike[str],
    *,
    source: str | os.PathLike[str] | None = None,
    force: bool = False,
) -> None:
    """Write the recovered motion of one arm, or of several, to an MCAP file.

    Topics: `/unocclude/forearm` (Odometry: pose of the IMU in the camera frame, velocity in its own
    axes; an answer without orientation has body_frame_id = frame_id, one without position is left out),
    `/unocclude/skeleton` (joints with covariance at every IMU sample), `/unocclude/arm` and
    `/unocclude/arm_camera` (drawn after and before, at the camera's rate, orange where occluded, dark red
    where the answer is not to be trusted), `/unocclude/beads` (PointCloud along the bones),
    `/unocclude/gaps` (Event, with `trusted` and `reasons` in its metadata), `/unocclude/log` (Log: the
    gaps), `/unocclude/joints` (JointStates: elbow_flexion, rad, 0 = straight), `/unocclude/tf`
    (FrameTransforms: camera to forearm IMU, and the level `world` to the camera), `/unocclude/camera`
    (the camera's joints on the IMU's clock), `/unocclude/residuals`, and where motions were drawn
    `/unocclude/draws`. With several arms each topic ends
    in the arm's side, with several people in `body_N/SIDE` (`result.arm_tags`). The metadata record
    `unocclude.result` contains all else as JSON. `read_recovery` gives everything back. The same input
    gives the same bytes.

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
        file = open_recording(source, only={recovery.arm.name for recovery in results})
        about = _about(file)
        frames = {arm.topic: arm.frame_id for arm in file.arms if arm.frame_id}
        level_down = file.level_down
        shift = file.imus[0].log_shift_ns if file.imus else 0
        # A recorder's delay is not a reason to move; a sensor that counts from its own start is.
        shift = shift if abs(shift) > 1_000_000_000 else 0
    with writing(path, force) as temporary, Output(temporary) as output:
        streams = []
        down = common_down(results, level_down)
        for tag, recovery in zip(arm_tags(results), results, strict=True):
            suffix = "" if len(results) == 1 else f"/{tag}"
            output.metadata(RESULT + suffix, recovery_values(recovery, _version()))
            frame_id = frames.get(recovery.arm.name, CAMERA)
            streams.append(RecoveryStreams(output, recovery, suffix, frame_id, shift, down))
        for batch in time_batches([axis for each in streams for axis in each.axes()]):
            rows = [batch.rows[AXES * i : AXES * (i + 1)] for i in range(len(streams))]
            outgoing = [each.batch(*mine) for each, mine in zip(streams, rows, strict=True)]
            output.write(list(chain.from_iterable(outgoing)), batch.until_ns)
        if about:
            output.metadata(METADATA, about)


def _about(file: RecordingFile) -> dict[str, str]:
    """The recording's metadata, wherever in the file it stands, and the camera's axes."""
    container = Container(file.path)
    for _ in container.by_topic(lambda topic: False):
        pass  # metadata is met on the way
    implied = next((arm.camera_frame for arm in file.arms if arm.camera_frame is not None), None)
    axes = {} if implied is None else {"camera_frame": str(implied)}
    return axes | container.metadata.get(METADATA, {})


def _version() -> str:
    try:
        return version("unocclude")
    except PackageNotFoundError:
        return "unknown"


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
        return {field.name: getattr(value, field.name) for field in dataclasses.fields(value)}
    if isinstance(value, Mapping):
        return dict(value)
    if isinstance(value, set | frozenset):
        return sorted(value)
    return str(value)


def recovery_values(recovery: Recovery, version: str) -> dict[str, str]:
    """The metadata record of a result: JSON by key."""
    return {
        key: to_json(value)
        for key, value in {
            "method": recovery.method,
            "version": version,
            "name": recovery.name,
            "side": recovery.side,
            "origin_ns": recovery.origin_ns,
            "camera": recovery.arm.name,
            "joints": list(recovery.joints),
            "gaps": recovery.gaps,
            "calibration": _calibration(recovery.calibration),
            "gravity_direction": recovery.gravity_direction,
            "clock_offset_s": recovery.clock_offset_s,
            "clock_offset_sigma_s": recovery.clock_offset_sigma_s,
            "has_residuals": recovery.residuals is not None,
            "notes": recovery.notes,
            "config": _lasting(recovery.config),
            "figures": recovery.estimates.plain(),
            **_further(recovery),
            **({} if recovery.body is None else {"body": recovery.body}),
            **_trunk(recovery),
            **_draws(recovery),
        }.items()
    }


def _further(recovery: Recovery) -> dict[str, object]:
    """What IMUs on further segments add; nothing without any."""
    names = ("name", "clock_offset_s", "mount_sigma_rad")
    return {
        segment: {name: getattr(motion, name) for name in names}
        for segment, motion in recovery.segments.items()
    }


def _calibration(arm: ArmCalibration | None) -> dict[str, object] | None:
    """A calibration as plain values; the upper arm's IMU has its keys with and without one."""
    if arm is None:
        return None
    plain = {
        each.name: getattr(arm, each.name) for each in dataclasses.fields(arm) if each.name != "mountings"
    }
    plain |= {"upper_imu": arm.upper_imu, "R_U_B": arm.R_U_B}
    others = {name: mounting for name, mounting in arm.mountings.items() if name != UPPER_ARM.name}
    return plain | {_levers_key(name): mounting.lever_arms for name, mounting in others.items()}


def _levers_key(segment: str) -> str:
    return f"{SEGMENTS[segment].prefix}_imu"


def _trunk(recovery: Recovery) -> dict[str, object]:
    """What an IMU on the trunk adds; nothing without one."""
    trunk = recovery.trunk
    if trunk is None:
        return {}
    names = ("name", "clock_offset_s", "mount_sigma_rad", "R_T_D")
    by = {} if trunk.by_imu else {"by_imu": False}
    return {"trunk": {name: getattr(trunk, name) for name in names} | by}


def _draws(recovery: Recovery) -> dict[str, object]:
    """How many motions were drawn, and their seed; nothing where none were."""
    draws = recovery.draws
    return {} if draws is None else {"draws": {"count": len(draws), "seed": draws.seed}}


def _lasting(config: Mapping[str, Any]) -> dict[str, Any]:
    """The configuration without the number of processes: it does not affect the result."""
    return {
        section: {key: value for key, value in settings.items() if (section, key) != ("windows", "processes")}
        if isinstance(settings, Mapping)
        else settings
        for section, settings in config.items()
    }


def gaps_of(values: list[dict[str, Any]]) -> tuple[Gap, ...]:
    """Gaps from their JSON."""
    return tuple(Gap(**value) for value in values)


def calibration_of(value: dict[str, Any] | None) -> ArmCalibration | None:
    """A calibration from its JSON."""
    if value is None:
        return None

    def array(name: str) -> Any:
        return None if value.get(name) is None else np.array(value[name], float)

    def levers(name: str) -> dict[str, LeverArm]:
        return {
            joint: LeverArm(np.array(lever["position_m"], float), np.array(lever["sigma_m"], float))
            for joint, lever in value.get(name, {}).items()
        }

    return ArmCalibration(
        side=value["side"],
        lever_arms=levers("lever_arms"),
        upper_arm=None if value["upper_arm"] is None else Length(**value["upper_arm"]),
        R_F_A=array("R_F_A"),
        accelerometer_bias=array("accelerometer_bias"),
        gyroscope_bias=array("gyroscope_bias"),
        mountings={
            body.name: SegmentMounting(own, R_bone=array("R_U_B") if body.name == UPPER_ARM.name else None)
            for body in FURTHER
            if (own := levers(_levers_key(body.name)))
        },
    )
