"""An upper-arm IMU made ready beside the forearm's: nodes, initial values, what a window takes of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..array_types import BoolArray, FloatArray
from ..calibration import ArmCalibration
from ..linalg import interpolate, unit
from ..measurements.alignment import Alignment, VectorPairs, acceleration_pairs, align, direction_pairs
from ..measurements.inertial import InertialSignal, UpperRunSamples
from ..measurements.segment import Segment
from ..measurements.visibility import Gap, occluded_at
from ..recording import JOINTS
from ..units import GRAVITY
from .nodes import CLOSEST_S
from .problem import States

#: Frames with shoulder and elbow that a run of samples needs: without them its heading is not known.
FEWEST_FRAMES = 10
_ELBOW, _SHOULDER = JOINTS.index("elbow"), JOINTS.index("shoulder")


@dataclass(frozen=True)
class PreparedRun:
    """An upper-arm IMU between two of its pauses, at the nodes of a prepared segment.

    Attributes
    ----------
    signal : InertialSignal
        On the forearm IMU's clock.
    first : int
        The segment's node that it begins at; it covers as many as `start` has.
    start : States
        Initial values: `R_K_B`, position and velocity.
    attitude : ndarray, shape (m, 3, 3)
        `R_K_B` from the inertial filter and the alignment: the weak prior.
    attitude_covariance : ndarray, shape (m, 3, 3), rad^2
        Of the attitude, in {K}.
    elbow : ndarray, shape (m, 3), m
        Initial value in {K}.
    """

    signal: InertialSignal
    first: int
    start: States
    attitude: FloatArray
    attitude_covariance: FloatArray
    elbow: FloatArray


def takes_part(segment: Segment, calibration: ArmCalibration) -> bool:
    """Whether an upper-arm IMU has samples in a segment, and is known enough to be used."""
    return bool(segment.upper) and bool(calibration.upper_imu) and "elbow" in calibration.lever_arms


def prepare_upper(
    segment: Segment, frame_t_imu: FloatArray, accepted: BoolArray, calibration: ArmCalibration, t: FloatArray
) -> tuple[PreparedRun, ...]:
    """The runs of an upper-arm IMU at a segment's nodes.

    Orientation comes from its inertial filter and the camera's view of the upper arm (as the forearm's does),
    position from the shoulder, or from the elbow where that alone is visible: neither drifts.

    Parameters
    ----------
    segment : Segment
    frame_t_imu : ndarray, shape (f,), s
        Its frames on the forearm IMU's clock.
    accepted : ndarray of bool, shape (f, 5)
        Samples that may take part.
    calibration : ArmCalibration
        Its `upper_imu` holds elbow and shoulder in {B}.
    t : ndarray, shape (n,), s
        Nodes.

    Returns
    -------
    runs : tuple of PreparedRun
        Those that hold two nodes, and frames with shoulder and elbow.
    """
    prepared = []
    for run in segment.upper:
        rows = np.flatnonzero((t >= run.signal.start_s) & (t <= run.signal.end_s))
        inside = (frame_t_imu >= run.signal.start_s) & (frame_t_imu <= run.signal.end_s)
        used = accepted & inside[:, None]
        if len(rows) >= 2 and (used[:, _ELBOW] & used[:, _SHOULDER]).sum() >= FEWEST_FRAMES:
            prepared.append(_prepared(segment, run, frame_t_imu, used, calibration, t[rows], int(rows[0])))
    return tuple(prepared)


def _prepared(
    segment: Segment,
    run: UpperRunSamples,
    frame_t_imu: FloatArray,
    accepted: BoolArray,
    calibration: ArmCalibration,
    t: FloatArray,
    first: int,
) -> PreparedRun:
    shoulder_B, elbow_B = (calibration.upper_imu[joint].position_m for joint in ("shoulder", "elbow"))
    start_s, end_s = max(run.signal.start_s, segment.start_s), min(run.signal.end_s, segment.end_s)
    pairs = _pairs(segment, run, frame_t_imu, accepted, shoulder_B, elbow_B)
    alignment = align(pairs, start_s, end_s, segment.down)
    shoulder = _shoulder(segment, run, frame_t_imu, accepted, alignment, shoulder_B - elbow_B)
    R = (alignment.at(t) * run.attitude.at(t)).as_matrix()
    p = interpolate(*shoulder, t) - R @ shoulder_B
    v = np.gradient(p, t, axis=0) if len(t) > 2 else np.zeros_like(p)
    nearest = np.clip(np.searchsorted(alignment.t, t), 0, len(alignment.t) - 1)
    return PreparedRun(run.signal, first, States(R, p, v), R, alignment.covariance[nearest], p + R @ elbow_B)


def _pairs(
    segment: Segment,
    run: UpperRunSamples,
    frame_t_imu: FloatArray,
    accepted: BoolArray,
    shoulder_B: FloatArray,
    elbow_B: FloatArray,
) -> list[VectorPairs]:
    """What camera and IMU both measure: the upper arm's direction, and the elbow's acceleration."""
    both = accepted[:, _ELBOW] & accepted[:, _SHOULDER]
    position = segment.position[both]
    pairs = [
        direction_pairs(
            frame_t_imu[both],
            position[:, _SHOULDER],
            position[:, _ELBOW],
            run.attitude,
            unit(elbow_B - shoulder_B),
        )
    ]
    rows = accepted[:, _ELBOW]
    accelerations = acceleration_pairs(
        frame_t_imu[rows], segment.position[rows, _ELBOW], run.attitude, run.signal, GRAVITY
    )
    return [*pairs, accelerations.with_lever(elbow_B)]


def _shoulder(
    segment: Segment,
    run: UpperRunSamples,
    frame_t_imu: FloatArray,
    accepted: BoolArray,
    alignment: Alignment,
    elbow_to_shoulder_B: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Times (k,) and the shoulder there (k, 3) m: as seen, or from the elbow and the upper arm."""
    rows = np.flatnonzero(accepted[:, _SHOULDER] | accepted[:, _ELBOW])
    frame_t = frame_t_imu[rows]
    position = segment.position[rows]
    R = (alignment.at(frame_t) * run.attitude.at(frame_t)).as_matrix()
    by_elbow = position[:, _ELBOW] + R @ elbow_to_shoulder_B
    seen = accepted[rows, _SHOULDER]
    return frame_t, np.where(seen[:, None], position[:, _SHOULDER], by_elbow)


def forearm_in_gaps(
    runs: Sequence[PreparedRun],
    t: FloatArray,
    R: FloatArray,
    gaps: tuple[Gap, ...],
    calibration: ArmCalibration,
    visible: tuple[FloatArray, FloatArray],
) -> tuple[FloatArray, FloatArray]:
    """Forearm IMU positions from the camera, and in gaps by way of the upper arm's elbow.

    Parameters
    ----------
    runs : sequence of PreparedRun
    t : ndarray, shape (n,), s
        Nodes.
    R : ndarray, shape (n, 3, 3)
        Initial `R_K_A` at the nodes.
    gaps : tuple of Gap
    calibration : ArmCalibration
        With the elbow's lever arm.
    visible : ndarray, shape (k,), s, and ndarray, shape (k, 3), m
        Positions at visible frames.

    Returns
    -------
    times : ndarray, shape (m,), s
        Increasing.
    position : ndarray, shape (m, 3), m
        The forearm IMU in {K}.
    """
    times, position = [visible[0]], [visible[1]]
    lever = calibration.lever_arms["elbow"].position_m
    for run in runs:
        nodes = np.arange(run.first, run.first + len(run.elbow))
        hidden = occluded_at(t[nodes], gaps)
        after = np.clip(np.searchsorted(visible[0], t[nodes]), 1, len(visible[0]) - 1)
        apart = np.minimum(np.abs(visible[0][after] - t[nodes]), np.abs(visible[0][after - 1] - t[nodes]))
        hidden &= apart > CLOSEST_S
        times.append(t[nodes[hidden]])
        position.append(run.elbow[hidden] - R[nodes[hidden]] @ lever)
    order = np.argsort(np.concatenate(times), kind="stable")
    return np.concatenate(times)[order], np.concatenate(position)[order]
