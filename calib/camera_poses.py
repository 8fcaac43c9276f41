"""Poses of further cameras from recordings of one set-up, and their table of a calibration file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from smoother.cameras.joining import placed_camera
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


def calibrate_cameras(recordings: Sequence[Recording]) -> Answer:
    """Place the further cameras of a set-up by the joints that they and the first one see.

    Clocks are of a recording: they are shown, and not kept in the file.
    """
    names = [recording.name for recording in recordings]
    if not any(recording.cameras for recording in recordings):
        raise CalibrationError(f"{', '.join(names)}: there is only one camera, so there is no pose to find.")
    poses: dict[str, CameraPose] = {}
    offsets: dict[str, list[float]] = {}  # to the first one's clock, of each recording that it is used in
    fits: dict[str, dict[str, float]] = {}
    left_out: list[str] = []
    for recording in recordings:
        for camera in recording.cameras:
            known = poses.get(camera.name, camera.pose)
            row = placed_camera(replace(camera, pose=known), recording.arm)
            if row.reason or row.pose is None:
                left_out.append(f"{recording.name}: {camera.name} was left out: {row.reason}")
                continue
            if known is not None and row.note:
                left_out.append(f"{recording.name}: {camera.name} {row.note}")
                continue
            before_m = poses[camera.name].sigma_m if camera.name in poses else np.inf
            poses[camera.name] = replace(row.pose, sigma_m=min(row.pose.sigma_m, before_m))
            offsets.setdefault(camera.name, []).append(row.clock.offset_s)
            fits[camera.name] = {"misfit_m": row.misfit_m, "together_s": row.together_s}
    if not poses:
        raise CalibrationError(f"No camera could be placed. {' '.join(left_out)}")
    table, sentences, checks = {}, [], [Check(text) for text in left_out]
    for name, pose in poses.items():
        sigma_deg, sigma_m = float(np.degrees(pose.sigma_rad)), float(pose.sigma_m)
        checks += [
            Check(f"{name}: sigma of the turn", sigma_deg, GOOD_DEG, "degrees", FAR),
            Check(f"{name}: sigma of the place", sigma_m, GOOD_M, "m", FAR),
        ]
        place = {"R_K_C": pose.R_K_C.tolist(), "p_K_C_m": pose.p_K_C_m.tolist()}
        table[name] = place | {"sigma_deg": sigma_deg, "sigma_m": sigma_m}
        cosine = 0.5 * (float(np.trace(pose.R_K_C)) - 1.0)
        sentences.append(
            f"{name} is {np.linalg.norm(pose.p_K_C_m):.2f} m from {FIRST_CAMERA}, turned by"
            f" {np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))):.0f} degrees; sigma {sigma_deg:.2f} degrees"
            f" and {100 * sigma_m:.1f} cm per axis where the arm is"
        )
    is_good = all(check.is_good for check in checks)
    figures = {
        "recordings": names,
        "cameras": {name: each | {"offset_s": offsets[name]} | fits[name] for name, each in table.items()},
        "left_out": left_out,
    }
    grade = "not good enough" if left_out else "good" if is_good else "usable"
    return Answer(grade, "; ".join(sentences), checks, CalibrationFile().with_table(TABLE, table), figures)


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
