"""The `Recovery` of a recording from the joined motions of its stretches."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from .arrays import interpolate, rotate_covariance, skew
from .calibration import ArmCalibration
from .config import Config
from .join import Motion, at_times
from .notes import notes_on
from .occlusion import occluded_at
from .pieces import Piece
from .plan import Stretch
from .prepare import lever_of
from .recording import JOINTS, FloatArray, Recording
from .result import FrameResiduals, Gap, Recovery
from .screen import REASONS
from .selfcal import Knowledge
from .window import Message

#: Variance of the error that all joints share and that no residual shows, as a part of one joint's.
COMMON_BIAS_SHARE = 1.0
#: What a sensor whose mounting the motion did not show may be off by: on the arm, m, and turned, rad.
UNKNOWN_LEVER_M = 0.08
UNKNOWN_RAD = 1.0
#: Where an angle's sigma reaches this, the linearised problem says half of what is open, rad (seen on arms
#: that hang still: 28 degrees off with 15 stated).
LINEAR_RAD = 0.2


def assemble(
    recording: Recording,
    calibration: ArmCalibration,
    config: Config,
    known: Knowledge,
    pieces: list[Piece],
    stretches: list[Stretch],
    motions: list[Motion],
    messages: list[Message],
) -> Recovery:
    """The answer at every IMU sample; nan where no stretch has one."""
    clock = known.clocks[0]
    frame_t = recording.arm.t_s + clock.at(recording.arm.t_s)
    used = np.zeros((len(recording.arm), len(JOINTS)), dtype=bool)
    reason = np.zeros(used.shape, np.uint8)
    for piece in pieces:
        used[piece.frames], reason[piece.frames] = piece.accepted, piece.reason
    imu_t, count = recording.imu.t_s, len(recording.imu)
    position, velocity = np.full((count, 3), np.nan), np.full((count, 3), np.nan)
    quaternion = np.full((count, 4), np.nan)
    pose, velocity_covariance = np.full((count, 6, 6), np.nan), np.full((count, 3, 3), np.nan)
    occluded = np.ones(count, dtype=bool)
    names = [joint for joint in JOINTS if joint in recording.arm.present and joint != "strap"]
    joints = {joint: np.full((count, 3), np.nan) for joint in names}
    joint_covariance = {joint: np.full((count, 3, 3), np.nan) for joint in names}
    residual = np.full((len(recording.arm), 5, 3), np.nan)
    gaps: list[Gap] = []
    for stretch, motion in zip(stretches, motions, strict=True):
        rows = np.flatnonzero((imu_t >= motion.t[0]) & (imu_t <= motion.t[-1]))
        t = imu_t[rows]
        states = at_times(motion, stretch.signal, t)
        position[rows], velocity[rows] = states.p, states.v
        quaternion[rows] = Rotation.from_matrix(states.R).as_quat()[:, [3, 0, 1, 2]]
        pose[rows] = widen_turns(interpolate(motion.t, motion.pose_covariance, t))
        pose[rows, :3, :3] += np.eye(3) * (COMMON_BIAS_SHARE * known.bias.sigma_m**2)
        # a clock that is off by a moment moves the whole path along itself
        pose[rows, :3, :3] += clock.local_sigma_s**2 * states.v[:, :, None] * states.v[:, None, :]
        velocity_covariance[rows] = interpolate(motion.t, motion.velocity_covariance, t)
        occluded[rows] = occluded_at(t, stretch.gaps)
        gaps.extend(stretch.gaps)
        for joint in names:
            place, covariance = _joint(joint, states.R, states.p, pose[rows], calibration, motion, t)
            joints[joint][rows], joint_covariance[joint][rows] = place, covariance
        if known.mounting_unknown:  # joints that are seen are known all the same
            pose[rows] += np.diag([UNKNOWN_LEVER_M**2] * 3 + [UNKNOWN_RAD**2] * 3)
        own = frame_residuals(recording.arm.position, frame_t, stretch, motion, calibration)
        residual = np.where(np.isfinite(own), own, residual)
    down = np.mean([motion.gravity.mean(axis=0) for motion in motions], axis=0)
    return Recovery(
        method="graph",
        t_s=imu_t,
        occluded=occluded,
        position=position,
        quaternion=quaternion,
        velocity=velocity,
        pose_covariance=pose,
        velocity_covariance=velocity_covariance,
        joints=joints,
        joint_covariance=joint_covariance,
        gaps=tuple(gaps),
        calibration=calibration,
        gravity_direction=down / np.linalg.norm(down),
        clock_offset_s=clock.mean_s,
        clock_offset_sigma_s=clock.sigma_s,
        arm=replace(recording.arm, t_s=frame_t),
        residuals=FrameResiduals(frame_t, residual, used, reason, REASONS),
        origin_ns=recording.origin_ns,
        side=recording.side,
        name=recording.name,
        notes=notes_on(recording, pieces, known, tuple(gaps)),
        config=config.model_dump(exclude={"windows": {"processes"}}),  # the answer is the same on any number
        figures={
            "camera_sigma_m": {joint: noise.sample_m for joint, noise in known.noise.items()},
            "camera_effective_sigma_m": {joint: noise.effective_m for joint, noise in known.noise.items()},
            "joint_bias_m": {
                joint: known.bias.found_m[JOINTS.index(joint)].tolist() for joint in known.bias.joints
            },
            "joint_bias_sigma_m": known.bias.sigma_m,
            "accelerometer_bias": np.mean([m.shared.mean[:3] for m in messages], axis=0).tolist(),
            "gyroscope_bias": np.mean([m.shared.mean[3:6] for m in messages], axis=0).tolist(),
        },
    )


def widen_turns(pose_covariance: FloatArray) -> FloatArray:
    """Pose covariances (n, 6, 6) with large angles widened, and positions by what depends on them.

    A linearised problem overrates what it knows of an angle that is hardly known: an angle's variance v
    becomes v (1 + v / LINEAR_RAD^2)^2. Small angles keep what they have.
    """
    turn = pose_covariance[:, 3:, 3:]
    rows = np.flatnonzero(np.trace(turn, axis1=1, axis2=2) > (0.2 * LINEAR_RAD) ** 2)
    if not len(rows):
        return pose_covariance
    variance, axes = np.linalg.eigh(turn[rows])
    variance = np.maximum(variance, 1e-12)
    added = variance * ((1.0 + variance / LINEAR_RAD**2) ** 2 - 1.0)
    more = rotate_covariance(axes, added[:, :, None] * np.eye(3))
    known = rotate_covariance(axes, (1.0 / variance)[:, :, None] * np.eye(3))
    follows = np.concatenate(
        [pose_covariance[rows, :3, 3:] @ known, np.tile(np.eye(3), (len(rows), 1, 1))], axis=1
    )
    widened = pose_covariance.copy()
    widened[rows] += rotate_covariance(follows, more)
    return widened


def _joint(
    joint: str,
    R: FloatArray,
    p: FloatArray,
    pose_covariance: FloatArray,
    calibration: ArmCalibration,
    motion: Motion,
    t: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """A joint's position and covariance at the samples: a lever arm on the pose, or the shoulder."""
    if joint == "shoulder":
        assert motion.shoulder is not None and motion.shoulder_covariance is not None
        return interpolate(motion.t, motion.shoulder, t), interpolate(motion.t, motion.shoulder_covariance, t)
    if lever_of(calibration, joint) is None:
        return np.full_like(p, np.nan), np.full((len(p), 3, 3), np.nan)
    arm = np.einsum("nij,nj->ni", R, motion.lever_at(joint, t))
    jacobian = np.concatenate([np.tile(np.eye(3), (len(p), 1, 1)), -skew(arm)], axis=2)
    covariance = rotate_covariance(jacobian, pose_covariance)
    if joint in calibration.lever_arms:
        covariance = covariance + rotate_covariance(R, np.diag(calibration.lever_arms[joint].sigma_m ** 2))
    return p + arm, covariance


def frame_residuals(
    position: FloatArray,
    frame_t: FloatArray,
    stretch: Stretch,
    motion: Motion,
    calibration: ArmCalibration,
) -> FloatArray:
    """Camera minus answer (f, 5, 3) m at frames (IMU clock), seen or set aside; nan where there is none."""
    residual = np.full(position.shape, np.nan)
    rows = np.flatnonzero((frame_t >= motion.t[0]) & (frame_t <= motion.t[-1]))
    if not len(rows):
        return residual
    states = at_times(motion, stretch.signal, frame_t[rows])
    for column, joint in enumerate(JOINTS):
        if joint == "shoulder":
            if motion.shoulder is not None:
                answer = interpolate(motion.t, motion.shoulder, frame_t[rows])
                residual[rows, column] = position[rows, column] - answer
            continue
        if lever_of(calibration, joint) is not None:
            lever = motion.lever_at(joint, frame_t[rows])
            arm = np.einsum("nij,nj->ni", states.R, lever)
            residual[rows, column] = position[rows, column] - states.p - arm
    return residual
