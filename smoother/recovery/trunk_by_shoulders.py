"""The thorax's orientation by both shoulders as the camera sees them, where no IMU is on the trunk.

The line of shoulders gives the heading. How the trunk leans it does not show: a raised shoulder tilts the
line as a leaning trunk does. Up is where gravity has it, with a sigma for the leaning.
"""

from __future__ import annotations

import numpy as np

from ..array_types import BoolArray, FloatArray
from ..linalg import nearest, unit
from ..recording import JointTracks, Recording
from ..result import Recovery, TrunkMotion
from ..rotation import Rotation
from ..runtime.store import large_array
from ..selfcal.trunk_mount import GIRDLE_M

#: Worked on at a time, s.
SECTION_S = 60.0
#: Frames of both arms within this time are the same one, s; distance between shoulders, m.
SAME_FRAME_S, WIDTH_M = 0.005, (0.15, 0.6)
#: Constant error of a shoulder, m per axis, where the recording does not show how large such errors are.
JOINT_BIAS_M = 0.01
#: A heading is the mean of the frames so near, s (one standard deviation of the weights): errors of skeletons
#: last some tenths of a second. Farther than this from a frame there is none, s.
MEAN_S, REACH_S = 0.25, 1.0
#: How far people lean forwards and sideways as they use an arm, rad (one standard deviation).
LEAN_RAD = (np.radians(5.0), np.radians(8.0))
#: Frames with both shoulders that a recording needs.
FEWEST_FRAMES = 60


def trunk_by_shoulders(recovery: Recovery, recording: Recording) -> TrunkMotion | None:
    """The thorax upright by gravity, its heading by the line of shoulders."""
    other = recording.opposite
    if other is None or recording.side not in ("left", "right") or not len(recovery):
        return None
    if not np.isfinite(recovery.gravity_direction).all():
        return None
    up = -unit(recovery.gravity_direction)
    quaternion, covariance = large_array((len(recovery), 4)), large_array((len(recovery), 3, 3))
    quaternion[:], covariance[:] = np.nan, np.nan
    frames = 0
    bias = recovery.estimates.joint_bias_sigma_m or JOINT_BIAS_M
    for start in np.arange(float(recovery.t_s[0]), float(recovery.t_s[-1]) + 1e-9, SECTION_S):
        rows = slice(*np.searchsorted(recovery.t_s, [start, start + SECTION_S]).tolist())
        lines = shoulder_lines(recovery, recording, other, start - REACH_S, start + SECTION_S + REACH_S)
        frames += int((lines[0] >= start).sum())
        if not len(lines[0]):
            continue
        along, variance = _mean_line(np.array(recovery.t_s[rows]), *lines, up, bias)
        known = np.flatnonzero(np.isfinite(variance))
        if not len(known):
            continue
        ahead = np.cross(up, along[known])
        R_K_T = np.stack([ahead, np.broadcast_to(up, ahead.shape), along[known]], axis=2)
        here = known + rows.start
        quaternion[here] = Rotation.from_matrix(R_K_T).as_quat(scalar_first=True)
        own = np.zeros((len(known), 3, 3))
        own[:, 0, 0], own[:, 1, 1], own[:, 2, 2] = LEAN_RAD[0] ** 2, variance[known], LEAN_RAD[1] ** 2
        covariance[here] = R_K_T @ own @ np.swapaxes(R_K_T, 1, 2)
    if frames < FEWEST_FRAMES:
        return None
    return TrunkMotion(
        quaternion,
        covariance,
        np.eye(3),
        np.zeros(3),
        recovery.clock_offset_s,
        "both shoulders",
        by_imu=False,
    )


def shoulder_lines(
    recovery: Recovery, recording: Recording, other_arm: JointTracks, start_s: float, end_s: float
) -> tuple[FloatArray, FloatArray, FloatArray]:  # t (n,) s, line (n, 3), width (n,) m
    """The line from the left shoulder to the right one where the camera sees both."""
    arm_t = recovery.arm.t_s
    rows = slice(*np.searchsorted(arm_t, [start_s, end_s]).tolist())
    arm, stamp = recording.arm.select(rows), np.array(recording.arm.t_s[rows])
    if not len(stamp):
        return np.zeros(0), np.zeros((0, 3)), np.zeros(0)
    near = np.searchsorted(other_arm.t_s, [stamp[0] - 0.1, stamp[-1] + 0.1])
    other = other_arm.select(slice(*near.tolist()))
    if not len(other):
        return np.zeros(0), np.zeros((0, 3)), np.zeros(0)
    near_rows = nearest(other.t_s, stamp)
    line = np.asarray(arm.joint("shoulder")) - np.asarray(other.joint("shoulder"))[near_rows]
    line = line if recording.side == "right" else -line
    width = np.linalg.norm(line, axis=1)
    with np.errstate(invalid="ignore"):
        good = (width > WIDTH_M[0]) & (width < WIDTH_M[1])
    good &= arm.tracked("shoulder") & other.tracked("shoulder")[near_rows]
    good &= np.abs(other.t_s[near_rows] - stamp) < SAME_FRAME_S
    return np.array(arm_t[rows])[good], unit(line[good]), width[good]


def _mean_line(
    t_s: FloatArray, t: FloatArray, line: FloatArray, width: FloatArray, up: FloatArray, bias_m: float
) -> tuple[FloatArray, FloatArray]:
    """Level unit vectors (n, 3) along the shoulders at times (n,), and the heading's variance (n,), rad^2."""
    level = unit(line - (line @ up)[:, None] * up)
    first, last = np.searchsorted(t, t_s - 3.0 * MEAN_S), np.searchsorted(t, t_s + 3.0 * MEAN_S, side="right")
    most = max(int((last - first).max()), 1)
    index = first[:, None] + np.arange(most)
    inside: BoolArray = np.asarray(index < last[:, None])
    index = np.minimum(index, len(t) - 1)
    weight = np.where(inside, np.exp(-0.5 * ((t[index] - t_s[:, None]) / MEAN_S) ** 2), 0.0)
    total = weight.sum(axis=1)
    mean = np.einsum("nk,nkj->nj", weight, level[index])
    at = nearest(t, t_s)
    lone = total < 0.5  # hardly a frame about: the nearest one, if it is near enough
    mean[lone] = level[at[lone]]
    along = unit(mean)
    spread = np.where(inside, np.einsum("nkj,nj->nk", np.cross(up, level[index]), along) ** 2, 0.0)
    noise = (weight * spread).sum(axis=1) / np.maximum(total, 1e-12)
    away = np.abs(t[at] - t_s)
    constant = 2.0 * (bias_m**2 + GIRDLE_M**2) / float(np.median(width)) ** 2
    # frames within some tenths of a second share their error, so that a mean has a good part of one frame's
    variance = (
        constant + 0.5 * np.where(lone, np.median(noise), noise) + (np.radians(10.0) * away / REACH_S) ** 2
    )
    return along, np.where((away < REACH_S) & np.isfinite(along).all(axis=1), variance, np.nan)
