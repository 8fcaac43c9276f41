"""A stretch of the recording made ready: clocks joined, nodes, start values from visible data."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from .calibration import ArmCalibration, LeverArm
from .inertial import InertialSignal
from .occlusion import find_gaps
from .plan import Stretch
from .recording import FOREARM_JOINTS, JOINTS, BoolArray, FloatArray, ImuStream, Recording
from .start import (
    Alignment,
    InertialAttitude,
    VectorPairs,
    acceleration_pairs,
    align,
    direction_pairs,
    inertial_attitude,
    states_from_camera,
)
from .timing import fill, thin

#: Beyond so much time from the last visible frame there is no answer, s.
REACH_S = 10.0
GRAVITY = 9.81
#: The inertial filter runs no faster than this, Hz.
FILTER_RATE_HZ = 120.0


def prepare(
    recording: Recording,
    imu: ImuStream,
    frame_t: FloatArray,
    accepted: BoolArray,
    visible: BoolArray,
    calibration: ArmCalibration,
    sigma_m: FloatArray,
) -> tuple[Stretch, InertialAttitude, Alignment] | None:
    """Nodes and start values of one stretch of the IMU stream.

    Parameters
    ----------
    imu : the stretch, without a pause.
    frame_t : (F,) camera frames on the IMU's clock, s.
    accepted, visible : (F, 5) and (F,), see `occlusion`.
    sigma_m : (F, 5) noise of the camera's samples, m an axis.

    Returns
    -------
    The stretch, the inertial filter's answer and its alignment to the camera; None where the camera
    saw nothing of the forearm during the stretch.
    """
    forearm = [JOINTS.index(joint) for joint in FOREARM_JOINTS]
    if len(imu) < 4:
        return None
    inside = (frame_t >= imu.t_s[0]) & (frame_t <= imu.t_s[-1])
    measured = inside & accepted[:, forearm].any(axis=1)
    if measured.sum() < 2:
        return None
    signal = InertialSignal(imu)
    seen = frame_t[measured]
    start_s, end_s = max(imu.t_s[0], seen[0] - REACH_S), min(imu.t_s[-1], seen[-1] + REACH_S)
    if end_s - start_s < 0.1:
        return None
    kept = seen[thin(seen)]
    t = fill(kept, start_s, end_s)
    attitude = inertial_attitude(signal, min(imu.rate_hz, FILTER_RATE_HZ))
    alignment = align(
        _pairs(recording, signal, attitude, frame_t, accepted & inside[:, None], calibration),
        start_s,
        end_s,
        _down(recording),
    )
    R = (alignment.at(t) * attitude.at(t)).as_matrix()
    rows = np.flatnonzero(inside)
    node = np.searchsorted(t, frame_t[rows])
    node = np.clip(node, 0, len(t) - 1)
    exact = np.abs(t[node] - frame_t[rows]) < 1e-9
    position = recording.arm.position[rows]
    imu_t, imu_position = _imu_positions(frame_t[rows], position, accepted[rows], alignment, attitude, calibration)
    start = states_from_camera(t, R, imu_t, imu_position)
    nearest = np.clip(np.searchsorted(alignment.t, t), 0, len(alignment.t) - 1)
    stretch = Stretch(
        signal=signal,
        t=t,
        start=start,
        frame_t=frame_t[rows],
        frame_node=np.where(exact, node, -1),
        position=position,
        accepted=accepted[rows],
        sigma_m=sigma_m[rows],
        gaps=find_gaps(frame_t[rows], visible[rows], start_s, end_s),
        attitude_covariance=alignment.covariance[nearest],
    )
    return stretch, attitude, alignment


def _down(recording: Recording) -> FloatArray:
    """Rough direction of gravity in {K}: the hint, or a camera that stands level."""
    if recording.gravity_hint is not None:
        return recording.gravity_hint / np.linalg.norm(recording.gravity_hint)
    if recording.camera_frame is not None:
        return recording.camera_frame.down
    return np.zeros(3)


def lever_of(calibration: ArmCalibration, joint: str) -> FloatArray | None:
    """A joint's lever arm (3,) m in {A}; zero for the strap, None where unknown."""
    if joint == "strap" and joint not in calibration.lever_arms:
        return np.zeros(3)
    lever = calibration.lever_arms.get(joint)
    return None if lever is None else lever.position_m


def _pairs(
    recording: Recording,
    signal: InertialSignal,
    attitude: InertialAttitude,
    frame_t: FloatArray,
    accepted: BoolArray,
    calibration: ArmCalibration,
) -> list[VectorPairs]:
    arm, pairs = recording.arm, []
    along_A = calibration.forearm_direction
    both = accepted[:, JOINTS.index("elbow")] & accepted[:, JOINTS.index("wrist")]
    if along_A is not None and both.any():
        pairs.append(
            direction_pairs(frame_t[both], arm.joint("elbow")[both], arm.joint("wrist")[both], attitude, along_A)
        )
    for joint in ("strap", "wrist", "hand", "elbow"):  # the first that is known: nearest to the IMU
        lever, column = lever_of(calibration, joint), JOINTS.index(joint)
        rows = accepted[:, column]
        if lever is not None and rows.sum() >= 8:
            point = arm.joint(joint)[rows]
            pairs.append(acceleration_pairs(frame_t[rows], point, attitude, signal, lever, GRAVITY))
            break
    return pairs


def _imu_positions(
    frame_t: FloatArray,
    position: FloatArray,
    accepted: BoolArray,
    alignment: Alignment,
    attitude: InertialAttitude,
    calibration: ArmCalibration,
) -> tuple[FloatArray, FloatArray]:
    """The IMU's position at frames where a joint with a known lever arm is seen: mean over joints."""
    R = (alignment.at(frame_t) * attitude.at(frame_t)).as_matrix()
    total, count = np.zeros((len(frame_t), 3)), np.zeros(len(frame_t))
    for joint in FOREARM_JOINTS:
        lever, column = lever_of(calibration, joint), JOINTS.index(joint)
        if lever is None:
            continue
        rows = accepted[:, column]
        total[rows] += position[rows, column] - R[rows] @ lever
        count[rows] += 1.0
    seen = count > 0
    return frame_t[seen], total[seen] / count[seen, None]
