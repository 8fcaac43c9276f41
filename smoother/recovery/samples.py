"""The answer at the samples of a section, from its solution at the nodes."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ..array_types import BoolArray, FloatArray, IntArray
from ..body import FOREARM, FURTHER, SEGMENTS, segment_of
from ..calibration import ArmCalibration, LeverArm, SegmentMounting
from ..linalg import interpolate, rotate_covariance, skew, unit
from ..measurements.alignment import located
from ..measurements.clock import Clock
from ..measurements.inertial import InertialSignal
from ..measurements.rays import across
from ..measurements.segment import Segment
from ..measurements.visibility import Gap, occluded_at
from ..recording import JOINTS
from ..rotation import Rotation
from ..selfcal.self_calibration import SelfCalibration
from ..window.prepare import PreparedSegment
from ..window.problem import States
from ..window.solution import BlockShift, HiddenStretch, SegmentSolution, Solution, Step
from ..window.trajectory import BLEND_HALF_S, at_times, joint_from_pose, segment_at

#: What a sensor whose mounting the motion did not show may be off by: on the arm, m, and turned, rad.
UNKNOWN_LEVER_M = 0.08
UNKNOWN_RAD = 1.0
#: How late an IMU's samples are by its own filters, which no stamp says, s: a consumer gyroscope's low-pass
#: at 100 Hz takes 2.8 ms (InvenSense, MPU-6000 register map, DLPF_CFG 2); in BROAD it is 4 ms.
IMU_DELAY_S = 0.003
#: Where an angle's sigma reaches this, the linearised problem says half of what is open, rad (seen on arms
#: that hang still: 28 degrees off with 15 stated).
LINEAR_RAD = 0.2


@dataclass(frozen=True)
class SectionAnswer:
    """The answer at the samples of one section, and a little beyond its borders so that neighbours blend."""

    samples: slice
    occluded: BoolArray
    motion: dict[str, FloatArray]  # Columns of the forearm's IMU, as `Recovery` names them
    joints: dict[str, FloatArray]
    joint_covariance: dict[str, FloatArray]
    further: dict[str, dict[str, FloatArray]]  # Of IMUs on further segments; nan where they have no samples
    elbow: dict[str, ElbowAxis]  # For the axes of these segments' bones
    border_s: float
    gaps: tuple[Gap, ...]
    frames: slice
    residual: FloatArray
    used: BoolArray
    reason: NDArray[np.uint8]
    gravity: FloatArray
    bias: FloatArray  # (6,) m/s^2 and rad/s
    drawn: IntArray | None = None  # (m,) samples at which motions were drawn; None where not asked for
    draws: dict[str, NDArray] = field(default_factory=dict)  # (m, k, 3), as `Draws.columns` has them
    unexplained: tuple[Gap, ...] = ()  # Long gaps whose motion the model does not explain
    shifts: tuple[BlockShift, ...] = ()  # Blocks of the camera's samples against the rest
    stretches: tuple[HiddenStretch, ...] = ()  # Hidden, recovered and compared
    steps: tuple[Step, ...] = ()  # What may have changed for good


def sample_section(
    imu_t: FloatArray,  # (n,) s
    first_sample: int,
    segment: Segment,
    prepared: PreparedSegment,
    solution: Solution,
    model: SelfCalibration,
    names: Sequence[str],
) -> SectionAnswer:
    """The answer of a section at its samples, from its solution."""
    clock, calibration = model.clock, model.estimate
    start_s = max(solution.t[0], prepared.start_s - BLEND_HALF_S)
    end_s = min(solution.t[-1], prepared.end_s + BLEND_HALF_S)
    first, last = np.searchsorted(imu_t, start_s), np.searchsorted(imu_t, end_s, side="right")
    t = imu_t[first:last]
    states, pose = poses_at(solution, prepared.forearm.signal, clock, t)
    assert solution.forearm.velocity_covariance is not None
    velocity = interpolate(solution.t, solution.forearm.velocity_covariance, t)
    if len(t) > 1:
        acceleration = IMU_DELAY_S * np.gradient(states.v, t, axis=0)
        velocity += acceleration[:, :, None] * acceleration[:, None, :]
    further = {body.segment: further_poses(body, prepared, clock, t) for body in solution.bodies[1:]}
    poses = {FOREARM.name: (states, pose)} | further
    joints = {joint: _joint(joint, *poses[segment_of(joint, poses)], model, solution, t) for joint in names}
    places = {joint: place for joint, (place, _) in joints.items()}
    place_m, turn_rad = unknown_mounting(model)  # joints that are seen are known all the same
    pose += np.diag([place_m**2] * 3 + [turn_rad**2] * 3)
    frame_t = segment.frame_t_imu(clock)
    own = slice(*np.searchsorted(frame_t, [segment.core_start_s, segment.core_end_s]).tolist())
    position = segment.position[own] + model.joint_bias.error_m  # as the camera said it
    return SectionAnswer(
        samples=slice(first_sample + int(first), first_sample + int(last)),
        occluded=occluded_at(t, prepared.gaps),
        motion={
            "position": states.p,
            "quaternion": Rotation.from_matrix(states.R).as_quat(scalar_first=True),
            "velocity": states.v,
            "pose_covariance": pose,
            "velocity_covariance": velocity,
        },
        joints=places,
        joint_covariance={joint: covariance for joint, (_, covariance) in joints.items()},
        border_s=segment.core_start_s,
        gaps=tuple(
            gap for gap in prepared.gaps if gap.end_s > prepared.start_s and gap.start_s < prepared.end_s
        ),
        frames=slice(segment.frames.start + own.start, segment.frames.start + own.stop),
        residual=across(
            frame_residuals(position, frame_t[own], prepared, solution, calibration),
            position,
            None if (origin := segment.frame_origins) is None else origin[own],
        ),
        used=segment.accepted[own] & located(calibration),
        reason=segment.reason[own],
        gravity=solution.forearm.gravity,
        bias=solution.shared[:6],
        further={name: _columns(*own) for name, own in further.items()},
        elbow={name: ElbowAxis.of(places, own.R, t) for name, (own, _) in further.items()},
    )


def further_poses(
    motion: SegmentSolution, prepared: PreparedSegment, clock: Clock, t: FloatArray
) -> tuple[States, FloatArray]:
    """States of a further IMU at times (n,) on the forearm IMU's clock, and pose covariances (n, 6, 6)."""
    states = segment_at(motion, prepared, t)
    known = np.isfinite(states.p[:, 0])
    pose = np.full((len(t), 6, 6), np.nan)
    if known.any():
        v = states.v[known]
        pose[known] = widen_turns(motion.pose_covariance_at(t)[known])
        pose[known, :3, :3] += clock.local_sigma_s**2 * v[:, :, None] * v[:, None, :]
    return states, pose


def poses_at(
    solution: Solution, signal: InertialSignal, clock: Clock, t: FloatArray
) -> tuple[States, FloatArray]:
    """States at times (n,) on the IMU's clock, and the pose's covariance (n, 6, 6) there."""
    states = at_times(solution.forearm, signal, t)
    pose = widen_turns(solution.forearm.pose_covariance_at(t))
    if (swing := Swing.of(solution, states, t)) is not None:
        pose[:, :3, :3] += swing.variance(pose)
    # a clock that is off by a moment moves the whole path along itself
    pose[:, :3, :3] += clock.local_sigma_s**2 * states.v[:, :, None] * states.v[:, None, :]
    # an IMU that is late shows the pose of a moment ago
    twist = np.concatenate([states.v, turning(t, states.R)], axis=1)
    pose += IMU_DELAY_S**2 * twist[:, :, None] * twist[:, None, :]
    return states, pose


def turning(t: FloatArray, R: FloatArray) -> FloatArray:
    """Angular velocities (n, 3) rad/s in {K} of orientations (n, 3, 3) at times (n,), s."""
    if len(t) < 2:
        return np.zeros((len(t), 3))
    step = R[1:] @ np.swapaxes(R[:-1], 1, 2)  # small: its antisymmetric part is the rotation vector
    rate = 0.5 * (step[:, [2, 0, 1], [1, 2, 0]] - step[:, [1, 2, 0], [2, 0, 1]]) / np.diff(t)[:, None]
    return np.concatenate([rate[:1], 0.5 * (rate[1:] + rate[:-1]), rate[-1:]])


def unknown_mounting(model: SelfCalibration) -> tuple[float, float]:
    """Standard deviations that the mounting adds to the IMU's pose, m and rad per axis; mostly zero."""
    if model.mounting_unknown:
        return UNKNOWN_LEVER_M, UNKNOWN_RAD
    return (0.0 if np.isnan(model.interrupted_s) else UNKNOWN_LEVER_M), 0.0


def widen_turns(pose_covariance: FloatArray) -> FloatArray:
    """Pose covariances (n, 6, 6) with large angles widened, and positions by what depends on them."""
    wide = large_rotation_uncertainty(pose_covariance)
    if wide is None:
        return pose_covariance
    added = wide.variance * ((1.0 + wide.variance / LINEAR_RAD**2) ** 2 - 1.0)
    more = rotate_covariance(wide.axes, added[:, :, None] * np.eye(3))
    follows = np.concatenate([wide.position_follows, np.tile(np.eye(3), (len(wide.rows), 1, 1))], axis=1)
    widened = pose_covariance.copy()
    widened[wide.rows] += rotate_covariance(follows, more)
    return widened


@dataclass(frozen=True)
class Swing:
    """An elbow on the sphere about its shoulder: what a large error across the upper arm adds along it."""

    along: FloatArray  # (n, 3): from shoulder to elbow
    length_m: float
    lever: FloatArray  # (n, 3) m: from the IMU to the elbow, in {K}

    @classmethod
    def of(cls, solution: Solution, states: States, t: FloatArray) -> Swing | None:
        """With the forearm's states at times (n,); None without a shoulder, or if IMUs show the way to it."""
        chain = any(SEGMENTS[body.segment].carries_parent for body in solution.bodies[1:])
        if solution.shoulder is None or "elbow" not in solution.levers or chain or not len(t):
            return None
        lever = states.R @ solution.levers["elbow"]
        arm = states.p + lever - interpolate(solution.t, solution.shoulder, t)
        length_m = float(np.median(np.linalg.norm(arm, axis=1)))
        return cls(unit(arm), length_m, lever)

    def variance(self, pose_covariance: FloatArray) -> FloatArray:
        """What linear covariances (n, 6, 6) of the pose lack along the upper arm, (n, 3, 3) m^2.

        An error t across moves the elbow by L (1 - cos(t / L)) along: t^2 / (2 L) at first, and 4/3 L^2 is
        the mean square over the whole sphere.
        """
        follows = np.concatenate([np.tile(np.eye(3), (len(self.lever), 1, 1)), -skew(self.lever)], axis=2)
        across = np.eye(3) - self.along[:, :, None] * self.along[:, None, :]
        elbow = rotate_covariance(across @ follows, pose_covariance)
        square = 2.0 * np.einsum("nij,nji->n", elbow, elbow) + np.trace(elbow, axis1=1, axis2=2) ** 2
        square /= 4.0 * self.length_m**2
        square /= 1.0 + square / (4.0 / 3.0 * self.length_m**2)
        return np.asarray(square[:, None, None] * self.along[:, :, None] * self.along[:, None, :])

    def moved(self, position: FloatArray, rotation: FloatArray) -> FloatArray:
        """Drawn errors (n, k, 3) m of the position with what they and turns (n, k, 3) add along."""
        along = self.along[:, None]
        elbow = position + np.cross(rotation, self.lever[:, None])
        elbow -= np.sum(elbow * along, axis=2, keepdims=True) * along
        angle = np.minimum(np.linalg.norm(elbow, axis=2, keepdims=True) / self.length_m, np.pi)
        return np.asarray(position - self.length_m * (1.0 - np.cos(angle)) * along)


@dataclass(frozen=True)
class LargeRotationUncertainty:
    """Samples whose orientation is hardly known."""

    rows: IntArray  # int (w,)
    variance: FloatArray  # (w, 3) rad^2: along the principal axes
    axes: FloatArray  # (w, 3, 3): the axes, a column each
    position_follows: FloatArray  # (w, 3, 3) m/rad: how the position follows a turn


def large_rotation_uncertainty(pose_covariance: FloatArray) -> LargeRotationUncertainty | None:
    """Which samples of covariances (n, 6, 6) `widen_turns` widens, and along what; None without any."""
    turn = pose_covariance[:, 3:, 3:]
    rows = np.flatnonzero(np.trace(turn, axis1=1, axis2=2) > (0.2 * LINEAR_RAD) ** 2)
    if not len(rows):
        return None
    variance, axes = np.linalg.eigh(turn[rows])
    variance = np.maximum(variance, 1e-12)
    known = rotate_covariance(axes, (1.0 / variance)[:, :, None] * np.eye(3))
    return LargeRotationUncertainty(rows, variance, axes, pose_covariance[rows, :3, 3:] @ known)


def _joint(
    joint: str,
    states: States,
    pose_covariance: FloatArray,
    model: SelfCalibration,
    motion: Solution,
    t: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """A joint's position and covariance at the samples: a lever arm on the pose, or the shoulder."""
    nothing = np.full((len(t), 3), np.nan), np.full((len(t), 3, 3), np.nan)
    if joint == "shoulder":
        if motion.shoulder is None or motion.shoulder_covariance is None:
            return nothing
        return interpolate(motion.t, motion.shoulder, t), interpolate(motion.t, motion.shoulder_covariance, t)
    lever = lever_on(joint, model.estimate, motion)
    if lever is None and joint != "strap":
        return nothing
    spread_m = moves_by(joint, [body.segment for body in motion.bodies], model)
    lever_covariance = None if lever is None else np.diag(lever.sigma_m**2 + spread_m**2)
    body = motion.of(segment_of(joint, [each.segment for each in motion.bodies]))
    if body is not None and joint in body.joint_covariance:
        # with what pose and lever arm have in common; beside it counts by what the pose's was widened
        in_A = interpolate(motion.t, body.joint_covariance[joint], t)
        lever_covariance = in_A + spread_m**2 * np.eye(3)
        pose_covariance = pose_covariance - body.pose_covariance_at(t)
    return joint_from_pose(states.R, states.p, pose_covariance, motion.lever(joint), lever_covariance)


def moves_by(joint: str, segments: Iterable[str], model: SelfCalibration) -> float:
    """How far a joint is from rigid with the segment that it is tied to, one sigma, m per axis."""
    noise, known = model.joint_noise, set(segments)
    owner = next((body for body in FURTHER if joint in body.camera_joints), None)
    if owner is None or owner.name in known or joint not in noise or owner.shared_joint not in noise:
        return 0.0
    own, shared = noise[joint].sample_m, noise[owner.shared_joint].sample_m
    return float(np.sqrt(max(own**2 - shared**2, 0.0)))


def lever_on(joint: str, calibration: ArmCalibration, motion: Solution) -> LeverArm | None:
    """A joint's lever arm in the axes of the IMU that its camera samples are tied to; None where unknown."""
    segment = segment_of(joint, [body.segment for body in motion.bodies])
    if segment == FOREARM.name:
        return calibration.lever_arms.get(joint)
    return calibration.mountings[segment].lever_arms.get(joint)


def frame_residuals(
    position: FloatArray,
    frame_t: FloatArray,
    prepared: PreparedSegment,
    motion: Solution,
    calibration: ArmCalibration,
) -> FloatArray:
    """Camera minus answer (f, 5, 3) m at frames (IMU clock), used or rejected; nan where there is none."""
    residual = np.full(position.shape, np.nan)
    rows = np.flatnonzero((frame_t >= motion.t[0]) & (frame_t <= motion.t[-1]))
    if not len(rows):
        return residual
    states = {FOREARM.name: at_times(motion.forearm, prepared.forearm.signal, frame_t[rows])}
    for body in motion.bodies[1:]:
        if SEGMENTS[body.segment].camera_joints:
            states[body.segment] = segment_at(body, prepared, frame_t[rows])
    for column, joint in enumerate(JOINTS):
        if joint == "shoulder":
            if motion.shoulder is not None:
                answer = interpolate(motion.t, motion.shoulder, frame_t[rows])
                residual[rows, column] = position[rows, column] - answer
            continue
        if joint == "strap" or lever_on(joint, calibration, motion) is not None:
            own = states[segment_of(joint, states)]
            residual[rows, column] = position[rows, column] - own.p - own.R @ motion.lever(joint)
    return residual


#: An elbow straighter than this (sine of its flexion) does not show its axis.
MIN_ELBOW_SIN = 0.3
#: Samples of the axis that far apart are treated as independent, s.
APART_S = 1.0


@dataclass(frozen=True)
class ElbowAxis:
    """Evidence of samples with a bent elbow on its axis, as a segment's IMU sees it."""

    scatter: FloatArray  # (3, 3): sum of a a', a the normal of the arm's plane in the IMU's axes
    mean: FloatArray  # (3,): sum of a
    weight: float  # Independent samples in both

    @classmethod
    def of(cls, joints: dict[str, FloatArray], R_K_B: FloatArray, t: FloatArray) -> ElbowAxis:
        """Of the joints (n, 3) and the IMU's orientations (n, 3, 3) at times (n,)."""
        axes = _plane_normals(joints, R_K_B)
        weight = len(axes) * float(np.median(np.diff(t))) / APART_S if len(t) > 1 else 0.0
        share = weight / max(len(axes), 1)
        return cls(share * axes.T @ axes, share * axes.sum(axis=0), weight)


def _columns(states: States, pose_covariance: FloatArray) -> dict[str, FloatArray]:
    """Columns of a further IMU, as `SegmentMotion` names them."""
    known = np.isfinite(states.p[:, 0])
    quaternion = np.full((len(states.p), 4), np.nan)
    if known.any():
        quaternion[known] = Rotation.from_matrix(states.R[known]).as_quat(scalar_first=True)
    return {"position": states.p, "quaternion": quaternion, "pose_covariance": pose_covariance}


def _plane_normals(joints: dict[str, FloatArray], R_K_B: FloatArray) -> FloatArray:
    """Normals (m, 3) of the plane of upper arm and forearm in {B}, where the elbow is bent."""
    if not {"shoulder", "elbow", "wrist"} <= joints.keys():
        return np.zeros((0, 3))
    upper, fore = unit(joints["shoulder"] - joints["elbow"]), unit(joints["elbow"] - joints["wrist"])
    normal = np.einsum("nji,nj->ni", R_K_B, np.cross(upper, fore))
    size = np.linalg.norm(normal, axis=1)
    with np.errstate(invalid="ignore"):
        return normal[size > MIN_ELBOW_SIN] / size[size > MIN_ELBOW_SIN, None]


def bone_axes(
    segment: str, elbow_axes: Sequence[ElbowAxis], mounting: SegmentMounting, side: str
) -> tuple[FloatArray | None, FloatArray]:
    """A bone's axes in its IMU's (3, 3), and how far they may be off about each (3,), rad."""
    if SEGMENTS[segment].carries_parent:
        return humerus_axes(elbow_axes, mounting, side)
    near, far = (mounting.lever_arms[SEGMENTS[segment].as_forearm[end]] for end in ("elbow", "wrist"))
    length_m = float(np.linalg.norm(far.position_m - near.position_m))
    lever_rad = float(np.hypot(near.sigma_m.max(), far.sigma_m.max())) / length_m
    return None, np.full(3, np.hypot(lever_rad, mounting.tissue_m / (0.5 * length_m)))


def humerus_axes(
    elbow_axes: Sequence[ElbowAxis], mounting: SegmentMounting, side: str
) -> tuple[FloatArray | None, FloatArray]:  # R_U_B (3, 3), sigma_rad (3,) rad
    """The bone's axes in {B}, and how far they may be off."""
    elbow, shoulder = mounting.lever_arms["elbow"], mounting.lever_arms["shoulder"]
    along = shoulder.position_m - elbow.position_m
    length_m = float(np.linalg.norm(along))
    y = along / length_m
    weight = sum(axis.weight for axis in elbow_axes)
    mean = sum((axis.mean for axis in elbow_axes), np.zeros(3))
    scatter = sum((axis.scatter for axis in elbow_axes), np.zeros((3, 3)))
    across = mean - (mean @ y) * y
    tissue_rad = mounting.tissue_m / (0.5 * length_m)
    lever_rad = float(np.hypot(elbow.sigma_m.max(), shoulder.sigma_m.max())) / length_m
    sigma = np.hypot(np.array([lever_rad, 0.0, lever_rad]), tissue_rad)
    if weight < 1.0 or np.linalg.norm(across) < MIN_ELBOW_SIN * weight:
        return None, sigma
    z = unit(across) * (-1.0 if side == "left" else 1.0)
    x = np.cross(y, z)
    spread = float(x @ scatter @ x) / weight  # of the axis about y, rad^2 for small angles
    sigma[1] = np.sqrt(sigma[1] ** 2 + spread / weight + lever_rad**2)
    return np.stack([x, y, z]), sigma
