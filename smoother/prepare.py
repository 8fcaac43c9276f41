"""A piece of the recording made ready to cut: clocks joined, nodes, start values from visible data."""

from __future__ import annotations

import numpy as np

from .calibration import ArmCalibration
from .clock import Clock
from .occlusion import enough_joints, find_gaps
from .pieces import Piece
from .plan import Stretch
from .recording import FOREARM_JOINTS, JOINTS, BoolArray, FloatArray
from .result import Gap
from .start import (
    Alignment,
    VectorPairs,
    acceleration_pairs,
    align,
    direction_pairs,
    liveliness,
    states_from_camera,
)
from .timing import fill, gather, thin

#: Beyond so much time from the last visible frame there is no answer, s.
REACH_S = 10.0
GRAVITY = 9.81


def prepare(
    piece: Piece,
    calibration: ArmCalibration,
    clock: Clock,
    sigma_m: FloatArray,
    margin_s: float,
    alignment: Alignment | None = None,
) -> tuple[Stretch, Alignment] | None:
    """Nodes and start values of a piece.

    Parameters
    ----------
    clock : takes the camera's times to the IMU's.
    sigma_m : (5,) noise of the camera's joints, m an axis.
    margin_s : nodes reach so far beyond the part that is answered for.
    alignment : of the inertial frame to the camera where it is known; found from the samples where None.

    Returns
    -------
    The stretch and the alignment of its inertial frame to the camera; None where the camera saw
    nothing of the forearm near enough.
    """
    forearm = [JOINTS.index(joint) for joint in FOREARM_JOINTS]
    frame_t = piece.frame_t + clock.at(piece.frame_t)
    inside = (frame_t >= piece.start_s) & (frame_t <= piece.end_s)
    accepted = piece.accepted & inside[:, None]
    measured = accepted[:, forearm].any(axis=1)
    if measured.sum() < 2:
        return None
    seen = frame_t[measured]
    start_s, end_s = max(piece.start_s, seen[0] - REACH_S), min(piece.end_s, seen[-1] + REACH_S)
    core_start_s, core_end_s = max(start_s, piece.core_start_s), min(end_s, piece.core_end_s)
    if core_end_s - core_start_s < 0.1:
        return None
    visible = enough_joints(accepted, piece.needed)
    rows = np.flatnonzero(inside)
    gaps = find_gaps(frame_t[rows], visible[rows], start_s, end_s)
    kept = np.flatnonzero(measured)[thin(seen)]
    owner = kept[gather(frame_t[kept], visible[kept])]
    t = fill(frame_t[np.unique(owner)], start_s, end_s)
    first, last = reach(core_start_s, core_end_s, gaps, margin_s)
    t = t[(t >= first) & (t <= last)]
    if alignment is None:
        alignment = align(pairs(piece, frame_t, accepted, calibration), start_s, end_s, piece.down)
    R = (alignment.at(t) * piece.attitude.at(t)).as_matrix()
    frame_node = np.full(len(frame_t), -1)
    node = np.clip(np.searchsorted(t, frame_t[owner] - 1e-9), 0, len(t) - 1)
    frame_node[kept] = np.where(np.abs(t[node] - frame_t[owner]) < 1e-9, node, -1)
    imu_t, imu_position = _imu_positions(piece, frame_t, accepted, alignment, calibration)
    nearest = np.clip(np.searchsorted(alignment.t, t), 0, len(alignment.t) - 1)
    stretch = Stretch(
        signal=piece.signal,
        t=t,
        start=states_from_camera(t, R, imu_t, imu_position),
        frame_t=frame_t[rows],
        frame_node=frame_node[rows],
        position=piece.position[rows],
        accepted=accepted[rows],
        sigma_m=np.tile(sigma_m, (len(rows), 1)),
        gaps=gaps,
        liveliness=liveliness(piece.signal, piece.attitude, t),
        attitude=R,
        attitude_covariance=alignment.covariance[nearest],
        start_s=core_start_s,
        end_s=core_end_s,
    )
    return stretch, alignment


def reach(start_s: float, end_s: float, gaps: tuple[Gap, ...], margin_s: float) -> tuple[float, float]:
    """What has to be solved for a part's sake: its margins, and beyond a gap that an end of it lies in."""
    first, last = start_s - margin_s, end_s + margin_s
    for gap in gaps:
        if gap.start_s <= start_s <= gap.end_s:
            first = min(first, gap.start_s - margin_s)
        if gap.start_s <= end_s <= gap.end_s:
            last = max(last, gap.end_s + margin_s)
    return first, last


def lever_of(calibration: ArmCalibration, joint: str) -> FloatArray | None:
    """A joint's lever arm (3,) m in {A}; zero for the strap, None where unknown."""
    if joint in calibration.lever_arms:
        return calibration.lever_arms[joint].position_m
    return np.zeros(3) if joint == "strap" else None


def pairs(
    piece: Piece, frame_t: FloatArray, accepted: BoolArray, calibration: ArmCalibration
) -> list[VectorPairs]:
    """What camera and IMU both saw: the forearm's direction, and the acceleration of one joint."""
    found: list[VectorPairs] = []
    elbow, wrist = JOINTS.index("elbow"), JOINTS.index("wrist")
    along_A = calibration.forearm_direction
    both = accepted[:, elbow] & accepted[:, wrist]
    if along_A is not None and both.any():
        position = piece.position[both]
        found.append(
            direction_pairs(frame_t[both], position[:, elbow], position[:, wrist], piece.attitude, along_A)
        )
    for joint in ("strap", "wrist", "hand", "elbow"):  # the first that is known: nearest to the IMU
        lever, column = lever_of(calibration, joint), JOINTS.index(joint)
        rows = accepted[:, column]
        if lever is not None and rows.sum() >= 8:
            point = piece.position[rows, column]
            both_saw = acceleration_pairs(frame_t[rows], point, piece.attitude, piece.signal, GRAVITY)
            found.append(both_saw.with_lever(lever))
            break
    return found


def _imu_positions(
    piece: Piece,
    frame_t: FloatArray,
    accepted: BoolArray,
    alignment: Alignment,
    calibration: ArmCalibration,
) -> tuple[FloatArray, FloatArray]:
    """The IMU's position at frames where a joint with a known lever arm is seen: mean over joints."""
    R = (alignment.at(frame_t) * piece.attitude.at(frame_t)).as_matrix()
    total, count = np.zeros((len(frame_t), 3)), np.zeros(len(frame_t))
    for joint in FOREARM_JOINTS:
        lever, column = lever_of(calibration, joint), JOINTS.index(joint)
        if lever is None:
            continue
        rows = accepted[:, column]
        total[rows] += piece.position[rows, column] - R[rows] @ lever
        count[rows] += 1.0
    seen = count > 0
    return frame_t[seen], total[seen] / count[seen, None]
