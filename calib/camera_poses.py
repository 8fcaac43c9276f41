"""Poses of further cameras from recordings of one set-up, and their table of a calibration file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from smoother.cameras.joining import placed_camera
from smoother.cameras.rig import RigCamera
from smoother.errors import CalibrationError
from smoother.recording import FIRST_CAMERA, CameraPose, Recording

from .file import CalibrationFile
from .protocol import Answer, Check

#: The top-level table of a calibration file, one table per camera.
TABLE = "cameras"
#: A pose is good for the answer where its sigmas, per axis, are below these, degrees and m.
GOOD_DEG, GOOD_M = 0.5, 0.01
FAR = "record a minute in which both cameras see the arm reach far to all sides"
#: A rotation matrix may be off by this.
ROUNDING = 1e-4


@dataclass(frozen=True)
class CameraSetUp:
    """The further cameras of a set-up."""

    recordings: tuple[str, ...]  # Their names
    cameras: dict[str, RigCamera]  # As all recordings together place them, by name
    # Each camera's offset to the first one's clock, one number per recording that it is used in
    clocks_s: dict[str, tuple[float, ...]]
    left_out: tuple[str, ...] = ()  # A sentence for each camera that a recording shows to be wrong


def calibrate_cameras(recordings: Sequence[Recording]) -> CameraSetUp:
    """Place the further cameras of a set-up by the joints that they and the first one see."""
    if not any(recording.cameras for recording in recordings):
        all_names = ", ".join(recording.name for recording in recordings)
        raise CalibrationError(f"{all_names}: there is only one camera, so there is no pose to find.")
    cameras: dict[str, RigCamera] = {}
    clocks: dict[str, tuple[float, ...]] = {}
    left_out: list[str] = []
    for recording in recordings:
        for camera in recording.cameras:
            known = cameras[camera.name].pose if camera.name in cameras else camera.pose
            row = placed_camera(replace(camera, pose=known), recording.arm)
            if row.reason or row.pose is None:
                left_out.append(f"{recording.name}: {camera.name} was left out: {row.reason}")
                continue
            if known is not None and row.note:
                left_out.append(f"{recording.name}: {camera.name} {row.note}")
                continue
            if camera.name in cameras and known is not None:
                row = replace(row, pose=replace(row.pose, sigma_m=min(row.pose.sigma_m, known.sigma_m)))
            cameras[camera.name] = row
            clocks[camera.name] = (*clocks.get(camera.name, ()), row.clock.offset_s)
    if not cameras:
        raise CalibrationError(f"No camera could be placed. {' '.join(left_out)}")
    names = tuple(recording.name for recording in recordings)
    return CameraSetUp(names, cameras, clocks, tuple(left_out))


def cameras_answer(set_up: CameraSetUp) -> Answer:
    """The set-up in the form that every calibration answers in; clocks are of a recording and not kept."""
    table: dict[str, Any] = {}
    is_good = True
    sentences = []
    for name, row in set_up.cameras.items():
        pose = row.pose
        assert pose is not None
        sigma_deg = float(np.degrees(pose.sigma_rad))
        table[name] = {
            "R_K_C": [[float(x) for x in each] for each in pose.R_K_C],
            "p_K_C_m": [float(x) for x in pose.p_K_C_m],
            "sigma_deg": sigma_deg,
            "sigma_m": float(pose.sigma_m),
        }
        is_good &= sigma_deg < GOOD_DEG and pose.sigma_m < GOOD_M
        cosine = 0.5 * (float(np.trace(pose.R_K_C)) - 1.0)
        sentences.append(
            f"{name} is {np.linalg.norm(pose.p_K_C_m):.2f} m from {FIRST_CAMERA}, turned by"
            f" {np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))):.0f} degrees; sigma {sigma_deg:.2f} degrees"
            f" and {100 * pose.sigma_m:.1f} cm per axis where the arm is"
        )
    grade = "not good enough" if set_up.left_out else "good" if is_good else "usable"
    figures = {
        "recordings": list(set_up.recordings),
        "cameras": {
            name: each
            | {
                "offset_s": list(set_up.clocks_s[name]),
                "misfit_m": set_up.cameras[name].misfit_m,
                "together_s": set_up.cameras[name].together_s,
            }
            for name, each in table.items()
        },
        "left_out": list(set_up.left_out),
    }
    checks = [Check(text) for text in set_up.left_out]
    for name, each in table.items():
        checks += [
            Check(f"{name}: sigma of the turn", each["sigma_deg"], GOOD_DEG, "degrees", FAR),
            Check(f"{name}: sigma of the place", each["sigma_m"], GOOD_M, "m", FAR),
        ]
    file = CalibrationFile().with_table(TABLE, table)
    return Answer(grade, "; ".join(sentences), checks, file, figures)


def camera_poses(file: CalibrationFile) -> dict[str, CameraPose]:
    """The poses that a calibration file contains, by camera."""
    table = file.tables.get(TABLE, {})
    if not isinstance(table, Mapping):
        raise CalibrationError(f"{file.source}: {TABLE} is not a table; make it with `calibrate cameras`.")
    return {str(name): _pose(f"{file.source}: [{TABLE}.{name}]", each) for name, each in table.items()}


def _pose(where: str, values: Any) -> CameraPose:
    try:
        R = np.array(values["R_K_C"], float).reshape(3, 3)
        p = np.array(values["p_K_C_m"], float).reshape(3)
        sigma_deg, sigma_m = float(values["sigma_deg"]), float(values["sigma_m"])
    except (KeyError, TypeError, ValueError) as error:
        raise CalibrationError(
            f"{where} needs R_K_C (3 x 3), p_K_C_m (3), sigma_deg and sigma_m; make it with"
            " `calibrate cameras`."
        ) from error
    proper = np.abs(R @ R.T - np.eye(3)).max() < ROUNDING and np.linalg.det(R) > 0
    if not (proper and np.isfinite(p).all() and sigma_deg > 0 and sigma_m > 0):
        raise CalibrationError(f"{where}: R_K_C is not a rotation, or a sigma is not above zero; correct it.")
    return CameraPose(R, p, float(np.radians(sigma_deg)), sigma_m)


def with_camera_poses(recording: Recording, poses: Mapping[str, CameraPose]) -> Recording:
    """The recording with what is known of where its further cameras stand."""
    cameras = tuple(replace(camera, pose=poses.get(camera.name, camera.pose)) for camera in recording.cameras)
    return replace(recording, cameras=cameras) if cameras else recording
