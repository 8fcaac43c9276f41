"""A recovery's cameras: where each is, and when it saw the forearm."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..array_types import BoolArray, FloatArray
from ..cameras import CameraRig, RigCamera
from ..linalg import runs
from ..measurements.outliers import noise_key
from ..measurements.visibility import MISSING_FRAMES, MISSING_S, enough_joints, joints_needed
from ..recording import JOINTS, JointTracks
from ..result import CameraEstimate, Estimates, Recovery
from ..result.verdict import finding


def names_of(rig: CameraRig | None, arm: JointTracks) -> tuple[str, ...]:
    """The cameras that are used, in sentences; numbers where their frames came joined already."""
    if arm.camera is None:
        return ("the camera",)
    if rig is None:
        return tuple(f"camera {number}" for number in range(1, len(arm.rows_by_camera) + 1))
    return tuple(row.name for row in rig.used)


def with_cameras(recovery: Recovery, rig: CameraRig | None) -> Recovery:
    """The recovery with the table of its cameras among its estimates."""
    sigma = recovery.estimates.camera_sigma_m or {}
    if rig is None:
        return recovery if recovery.arm.camera is None else replace(recovery, estimates=_of_first(recovery))
    # of an excerpt a camera may have no frame
    seen_s = dict(zip((row.name for row in rig.used), _seen(recovery), strict=False))
    numbers = {row.name: number for number, row in enumerate(rig.used)}
    rows = []
    for row in rig.cameras:
        keys = {joint: noise_key(joint, numbers.get(row.name, -1)) for joint in JOINTS}
        noise = {joint: sigma[key] for joint, key in keys.items() if key in sigma}
        rows.append(_estimate(row, noise, seen_s.get(row.name, ())))
    signs = [finding("cameras-doubtful", sentence) for sentence in rig.cautions]
    # the one that was moved may be the first, on which the answer rests
    signs += [
        finding(
            "camera-moved",
            f"{row.name}: {row.reason}",
            (row.moved_s[0] + recovery.clock_offset_s, row.moved_s[1] + recovery.clock_offset_s),
        )
        for row in rig.cameras
        if row.moved_s is not None
    ]
    estimates = replace(_of_first(recovery), cameras=tuple(rows)).with_findings(signs)
    return replace(recovery, estimates=estimates)


def _of_first(recovery: Recovery) -> Estimates:
    """What was found, the noise of joints as the first camera sees them."""
    found = recovery.estimates
    sigma, effective = found.camera_sigma_m or {}, found.camera_effective_sigma_m or {}
    return replace(
        found,
        camera_sigma_m={key: value for key, value in sigma.items() if key in JOINTS},
        camera_effective_sigma_m={key: value for key, value in effective.items() if key in JOINTS},
    )


def _estimate(
    row: RigCamera, noise: dict[str, float], seen_s: tuple[tuple[float, float], ...]
) -> CameraEstimate:
    pose, is_known = row.pose, row.pose is not None
    return CameraEstimate(
        row.name,
        None if pose is None else tuple(tuple(each) for each in pose.R_K_C.tolist()),
        None if pose is None else tuple(pose.p_K_C_m.tolist()),
        None if pose is None else pose.sigma_m,
        None if pose is None else float(np.degrees(pose.sigma_rad)),
        row.clock.offset_s if is_known else None,
        row.clock.sigma_s if is_known else None,
        row.clock.skew if is_known else None,
        row.misfit_m if np.isfinite(row.misfit_m) else None,
        row.together_s if np.isfinite(row.together_s) else None,
        noise,
        row.reason,
        seen_s,
    )


def _seen(recovery: Recovery) -> list[tuple[tuple[float, float], ...]]:
    """When each camera saw the forearm: from frame to frame that were used and follow each other."""
    rows = recovery.arm.rows_by_camera
    if recovery.residuals is None:
        return [() for _ in rows]
    used, needed = np.asarray(recovery.residuals.used), joints_needed(recovery.arm)
    frame_t = np.asarray(recovery.arm.t_s)
    return [spans(frame_t[own], enough_joints(used[own], needed)) for own in rows]


def spans(frame_t: FloatArray, visible: BoolArray) -> tuple[tuple[float, float], ...]:
    """Times between visible frames (f,) that follow each other, s."""
    if len(frame_t) < 2:
        return ()
    longest_s = max(MISSING_S, MISSING_FRAMES * float(np.median(np.diff(frame_t))))
    whole = visible[1:] & visible[:-1] & (np.diff(frame_t) <= longest_s)
    return tuple((float(frame_t[run.start]), float(frame_t[run.stop])) for run in runs(whole))
