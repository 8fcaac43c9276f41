"""Elbow, shoulder, forearm and wrist from joints and IMUs, each angle with its sigma.

Sigma is by first-order propagation: how the angles change with a small shift or turn of what they are
computed from (`slopes`), times what that is off by. The shoulder's errors are treated as independent of the
IMU's, as a recovery keeps no covariance between them; of what both add up to, a measured part counts
(`UPPER_ARM_SHARE`). With an IMU on the upper arm the humerus turns with it, so that its rotation is there for
a straight elbow as well: the axis of elbow flexion is then the mean over the recording, seen from the IMU
(`ArmCalibration.R_U_B`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ..array_types import FloatArray
from ..body import HAND
from ..calibration import LeverArm
from ..linalg import rotate_covariance, skew, unit
from ..result import Recovery, TrunkMotion
from .definitions import (
    ELBOW_FLEXION,
    PRONATION,
    SHOULDER,
    SHOULDER_ELEVATION,
    SHOULDER_PLANE,
    WRIST,
    arm_angles,
    forearm_axes,
    wrapped_deg,
)

Angles = dict[str, FloatArray]
#: Values and sigmas (N,), degrees, by the angles' names; nan where not known.
Found = tuple[Angles, Angles]

#: How far skin and strap turn the IMU on the forearm, rad per axis (2.3 degrees rms about all three on
#: realistic simulated arms; real straps turn by 1 to 3).
STRAP_RAD = np.radians(1.1)
#: What an upper arm's direction is off by, as a part of the variance that shoulder and elbow state together.
#: What all of a camera's joints are off by turns no arm, and slow noise is stated as white noise of the
#: same long-run size; no covariance between joints is kept that would determine it. On simulated arms it is
#: 0.28 (`azure`), 0.46 (`realistic`) and 0.5 (`white`).
UPPER_ARM_SHARE = 0.5
#: A forearm's length where the lever arms do not give it, m.
FOREARM_M = 0.25
#: An angle that may be anything is off by this at most, degrees.
MOST_SIGMA_DEG = 180.0
#: Step of the differences that slopes are, rad or m: errors of rounding and of the curvature are alike there.
STEP = 1e-7
#: A hand that points along the thumb's axis has no flexion (cosine).
STEEP = 0.05
#: The thorax's own axes: down, and where it faces (ISB).
DOWN_T, FORWARD_T = np.array([0.0, -1.0, 0.0]), np.array([1.0, 0.0, 0.0])
SHOULDER_NAMES = tuple(angle.name for angle in SHOULDER)
NAMES = (ELBOW_FLEXION.name, *SHOULDER_NAMES, PRONATION.name)


def slopes(angles_of: Callable[[FloatArray], FloatArray], at: FloatArray) -> FloatArray:
    """Derivatives (m, N, 3) of angles (m, N), degrees, by a shift or turn (3,) that `angles_of` applies."""
    return np.stack([wrapped_deg(angles_of(STEP * axis) - at) / STEP for axis in np.eye(3)], axis=2)


def variances(slope: FloatArray, covariance: FloatArray) -> FloatArray:
    """Variances (m, N) of angles by their slopes (m, N, k) and covariances (N, k, k)."""
    return np.asarray(((slope[:, :, None] @ covariance)[:, :, 0] * slope).sum(axis=2))


def _found(names: Sequence[str], values: FloatArray, variance: FloatArray) -> Found:
    """By names; sigmas of half a turn at most, and none without a value."""
    sigma = np.where(
        np.isfinite(values), np.minimum(np.sqrt(np.maximum(variance, 0.0)), MOST_SIGMA_DEG), np.nan
    )
    return dict(zip(names, values, strict=True)), dict(zip(names, sigma, strict=True))


def _nothing(names: Sequence[str], count: int) -> Found:
    nothing = {name: np.full(count, np.nan) for name in names}
    return nothing, dict(nothing)


def angles_by_joints(
    arm: Recovery,
    mounting: ForearmMounting,
    names: Sequence[str] = NAMES,
    trunk: TrunkMotion | None = None,
) -> Found:
    """As the joints and the forearm's IMU have them, the thorax upright or as it was found."""
    if not {"shoulder", "elbow"} <= set(arm.joints):
        return _nothing(names, len(arm))
    elbow = np.asarray(arm.joints["elbow"])
    upper = np.asarray(arm.joints["shoulder"]) - elbow
    fore = arm.joints["wrist"] - elbow if "wrist" in arm.joints else np.full_like(elbow, np.nan)
    R_K_F = None if mounting.R_F_A is None else forearm_axes(np.asarray(arm.quaternion), mounting.R_F_A)
    thorax = None if trunk is None else forearm_axes(np.asarray(trunk.quaternion), np.eye(3))

    def moved(apart: FloatArray, turn: FloatArray) -> FloatArray:
        turned = np.eye(3) + skew(turn)
        bones = {"shoulder": upper + apart, "elbow": np.zeros_like(upper), "wrist": fore @ turned.T}
        if thorax is None:
            axes = None if R_K_F is None else turned @ R_K_F
            angles = arm_angles(bones, len(upper), axes, arm.side, arm.gravity_direction)
        else:
            bones = {joint: np.einsum("nji,nj->ni", thorax, bone) for joint, bone in bones.items()}
            angles = arm_angles(bones, len(upper), None, arm.side, DOWN_T, forward=FORWARD_T)
        return np.stack([angles[name] for name in names])

    none = np.zeros(3)
    values = moved(none, none)
    if "shoulder" not in arm.joint_covariance:
        return _found(names, values, np.full_like(values, np.nan))
    apart, turn = slopes(lambda by: moved(by, none), values), slopes(lambda by: moved(none, by), values)
    # flexion keeps what is common to its bones: all that they state counts, and the strap turns neither
    of_elbow = np.array([name == ELBOW_FLEXION.name for name in names])
    share = np.where(of_elbow, 1.0, UPPER_ARM_SHARE)[:, None]
    # The pose moves the elbow, whose error counts in part as the shoulder's does, and turns the forearm.
    turned = np.cross(apart, elbow - arm.position)
    by_pose = np.sqrt(share)[:, :, None] * np.concatenate([-apart, turned], axis=2)
    by_pose[:, :, 3:] += turn
    variance = variances(by_pose, np.asarray(arm.pose_covariance))
    variance += share * variances(apart, np.asarray(arm.joint_covariance["shoulder"]))
    variance += np.where(of_elbow, 0.0, direction_variance(arm))[:, None] * (turn**2).sum(axis=2)
    if trunk is not None and thorax is not None:  # its turn is one of the whole arm the other way round
        of_trunk = trunk.covariance + rotate_covariance(thorax, np.diag(trunk.mount_sigma_rad**2))
        variance += variances(np.cross(upper, apart) + turn, of_trunk)
    if PRONATION.name in names:
        variance[names.index(PRONATION.name)] += mounting.roll_sigma_deg**2
    if SHOULDER_ELEVATION.name in names:  # what it has of the error across it, by the sigma of the plane
        row = names.index(SHOULDER_ELEVATION.name)
        sine = np.maximum(np.abs(np.sin(np.radians(values[row]))), 1e-9)
        across = np.minimum(np.radians(np.sqrt(variance[names.index(SHOULDER_PLANE.name)])) * sine, 1.0)
        variance[row] += np.degrees(np.minimum(0.5 * across**2 / sine, across)) ** 2
    return _found(names, values, variance)


def direction_variance(arm: Recovery) -> float:
    """How far the forearm's direction may be off in the IMU's axes, rad^2 per axis."""
    levers = {} if arm.calibration is None else arm.calibration.lever_arms
    if "elbow" not in levers or "wrist" not in levers:
        return float(STRAP_RAD**2)
    elbow, wrist = levers["elbow"], levers["wrist"]
    own = [float(np.mean(lever.sigma_m**2)) for lever in (elbow, wrist)]
    common = min((arm.estimates.joint_bias_sigma_m or 0.0) ** 2, *own)
    length = float(np.linalg.norm(wrist.position_m - elbow.position_m)) or FOREARM_M
    return float((sum(own) - 2.0 * common) / length**2 + STRAP_RAD**2)


def shoulder_angles(arm: Recovery, trunk: TrunkMotion | None = None) -> Found:
    """The shoulder's angles by an IMU on the upper arm, the thorax upright or as it was found."""
    upper, calibration = arm.upper, arm.calibration
    has_down = trunk is not None or bool(np.isfinite(arm.gravity_direction).all())
    if upper is None or calibration is None or calibration.R_U_B is None or not has_down:
        return _nothing(SHOULDER_NAMES, len(arm))
    R_K_U = forearm_axes(np.asarray(upper.quaternion), calibration.R_U_B)
    covariance = upper.pose_covariance[:, 3:, 3:] + rotate_covariance(
        R_K_U, np.diag(upper.mount_sigma_rad**2)
    )
    thorax = None
    if trunk is not None:
        thorax = forearm_axes(np.asarray(trunk.quaternion), np.eye(3))
        covariance = covariance + trunk.covariance
        covariance = covariance + rotate_covariance(thorax, np.diag(trunk.mount_sigma_rad**2))

    def turned(by: FloatArray) -> FloatArray:
        axes = (np.eye(3) + skew(by)) @ R_K_U
        if thorax is None:
            return humerus_angles(axes, arm.side, arm.gravity_direction)
        return humerus_angles(np.swapaxes(thorax, 1, 2) @ axes, arm.side)

    values = turned(np.zeros(3))
    return _found(SHOULDER_NAMES, values, variances(slopes(turned, values), covariance))


def humerus_angles(axes: FloatArray, side: str, down: FloatArray | None = None) -> FloatArray:
    """The shoulder's angles (3, n), degrees, of humeri with axes (n, 3, 3) in {K}, or {T} without down."""
    up, lateral = axes[:, :, 1], axes[:, :, 2]
    joints = {"shoulder": up, "elbow": np.zeros_like(up), "wrist": -up}
    forward = FORWARD_T if down is None else None
    down = DOWN_T if down is None else down
    angles = arm_angles(joints, len(up), None, side, down, forward=forward, flexion_axis=lateral)
    return np.stack([angles[name] for name in SHOULDER_NAMES])


def wrist_angles(samples: Recovery, mounting: ForearmMounting) -> Found:
    """Flexion and deviation of the wrist: where an IMU on the hand points, seen from the forearm."""
    names = [angle.name for angle in WRIST]
    motion, calibration = samples.segments.get(HAND.name), samples.calibration
    if motion is None or calibration is None or mounting.R_F_A is None:
        return _nothing(names, len(samples))
    mounted = calibration.mountings[HAND.name]
    along = mounted.lever_arms["hand"].position_m - mounted.lever_arms["wrist"].position_m
    length_m = float(np.linalg.norm(along))
    R_K_H = forearm_axes(np.asarray(motion.quaternion), np.eye(3))
    R_K_F = forearm_axes(np.asarray(samples.quaternion), mounting.R_F_A)
    d_K = R_K_H @ (along / length_m)
    thumb = -1.0 if samples.side == "left" else 1.0

    def moved(by: FloatArray) -> FloatArray:
        x, y, z = np.einsum("nji,nj->in", R_K_F, d_K + by)
        level = np.hypot(x, y)
        angles = np.degrees([np.arctan2(-x, y), thumb * np.arctan2(z, level)])
        return np.where(level > STEEP, angles, np.nan)

    # turns of the hand and of the forearm in {K} move the direction against each other
    turns = rotate_covariance(R_K_F, _forearm_covariance(samples, mounting))
    for poses in (motion.pose_covariance, samples.pose_covariance):
        turns = turns + np.asarray(poses)[:, 3:, 3:]
    between = between_joints(mounted.lever_arms["wrist"], mounted.lever_arms["hand"], samples)
    between = np.diag((between + 2.0 * mounted.tissue_m**2) / length_m**2)  # tissue_m is of either joint
    covariance = rotate_covariance(skew(d_K), turns) + rotate_covariance(R_K_H, between)
    values = moved(np.zeros(3))
    return _found(names, values, variances(slopes(moved, values), covariance))


def between_joints(first: LeverArm, second: LeverArm, samples: Recovery) -> FloatArray:
    """Variance (3,), m^2, of the vector between two joints: an error that all joints share is in it once."""
    bias_m = samples.estimates.joint_bias_sigma_m
    common = bias_m**2 if bias_m is not None and np.isfinite(bias_m) else 0.0
    either = first.sigma_m**2 + second.sigma_m**2
    return np.asarray(np.maximum(either - common, 0.5 * either))


def _forearm_covariance(samples: Recovery, mounting: ForearmMounting) -> FloatArray:
    """How far the forearm's axes are turned, (3, 3) rad^2 in {F}: about y by the roll, across by levers."""
    tilt_rad, calibration = 0.0, samples.calibration
    if calibration is not None and calibration.forearm_direction is not None:
        elbow, wrist = (calibration.lever_arms[joint] for joint in ("elbow", "wrist"))
        length_m = float(np.linalg.norm(wrist.position_m - elbow.position_m))
        tilt_rad = float(np.sqrt(between_joints(elbow, wrist, samples).max())) / length_m
    return np.asarray(np.diag([tilt_rad, np.radians(mounting.roll_sigma_deg), tilt_rad]) ** 2)


#: Roll of a calibrated mounting, degrees: a palm that faces the camera does not determine it better.
CALIBRATED_DEG = 15.0
#: A healthy forearm turns between these, ISB's pronation in degrees, each of which differs by this much from
#: person to person: supination 82 +- 4, pronation 76 +- 5 from the thumb-up posture (Boone and Azen, J Bone
#: Joint Surg Am 61:756-759, 1979), with some degrees for how a skeleton places elbow and wrist.
LEAST_DEG, MOST_DEG, LIMIT_SIGMA_DEG = 8.0, 166.0, 7.0
#: The turn is read between these percentiles, where the elbow is bent by this much, degrees.
PERCENTILES, BENT_DEG = (1.0, 99.0), (30.0, 150.0)
#: A roll that is less certain is not stated, degrees; no fewer samples are asked.
WORST_SIGMA_DEG, FEWEST = 20.0, 200
#: Widest gap between neighbouring values in which the circle is cut, degrees.
_EMPTY_ARC_DEG = 20.0
_CALIBRATE = "`unocclude calibrate forearm` measures it, `smooth --calibration` takes it"


@dataclass(frozen=True)
class ForearmMounting:
    """The forearm's anatomical axes in the IMU's."""

    # (3, 3): Maps IMU axes to forearm axes (y elbow to wrist, x to the back of the hand)
    R_F_A: FloatArray | None
    roll_sigma_deg: float = float("nan")  # About the forearm, constant over the recording
    reason: str = ""  # Why it is not known, a sentence; "" where it is
    estimated: bool = False  # From the motion, not from a calibration


def forearm_mounting(arm: Recovery) -> ForearmMounting:
    """The mounting as it was calibrated, else from the motion where that shows it."""
    calibration = arm.calibration
    if calibration is not None and calibration.R_F_A is not None:
        return ForearmMounting(calibration.R_F_A, CALIBRATED_DEG)
    along = None if calibration is None else calibration.forearm_direction
    unknown = "How the IMU is turned on the forearm (R_F_A) is not known"
    if along is None:
        return ForearmMounting(None, reason=f"{unknown}: {_CALIBRATE}.")
    start = _axes_about(along)
    turns = _turns(arm, start)
    if len(turns) < FEWEST:
        return ForearmMounting(None, reason=f"{unknown}, and the elbow was hardly ever bent: {_CALIBRATE}.")
    low, high = _range(turns)
    turned = high - low
    space = max(MOST_DEG - LEAST_DEG - turned, 0.0)
    sigma = float(np.hypot(space / np.sqrt(12.0), LIMIT_SIGMA_DEG))
    if sigma > WORST_SIGMA_DEG or turned > MOST_DEG - LEAST_DEG + 4.0 * LIMIT_SIGMA_DEG:
        seen = (
            f"the forearm turned by {turned:.0f} degrees only, too little to find it by a forearm's limits"
            if space
            else f"the forearm seems to have turned by {turned:.0f} degrees, which no forearm does"
        )
        return ForearmMounting(
            None,
            reason=f"{unknown}, and {seen}: turn the palm fully up and fully down once, elbow bent, or"
            f" calibrate: {_CALIBRATE}.",
        )
    constant = 0.5 * (LEAST_DEG + MOST_DEG) - 0.5 * (low + high)
    return ForearmMounting(_rolled(start, constant, arm.side), sigma, estimated=True)


def _axes_about(along: FloatArray) -> FloatArray:
    """Axes `R_F_A` (3, 3) with y along the forearm (3,) in {A}, rolled anyhow."""
    across = unit(np.cross(along, np.eye(3)[int(np.argmin(np.abs(along)))]))
    return np.stack([np.cross(along, across), along, across])


def _rolled(R_F_A: FloatArray, more_deg: float, side: str) -> FloatArray:
    """The mounting whose pronation is larger by `more_deg`."""
    angle = np.radians(more_deg) * (-1.0 if side == "left" else 1.0)
    cos, sin = np.cos(angle), np.sin(angle)
    return np.array([[cos, 0.0, sin], [0.0, 1.0, 0.0], [-sin, 0.0, cos]]) @ R_F_A


def _turns(arm: Recovery, R_F_A: FloatArray) -> FloatArray:
    """Pronation (m,) by a mounting where the elbow is well bent, degrees."""
    parts = []
    for batch in arm.batches():
        R_K_F = forearm_axes(np.asarray(batch.quaternion), R_F_A)
        angles = arm_angles(batch.joints, len(batch), R_K_F, batch.side)
        with np.errstate(invalid="ignore"):
            bent = (angles["elbow_flexion"] > BENT_DEG[0]) & (angles["elbow_flexion"] < BENT_DEG[1])
        parts.append(angles["pronation"][bent & np.isfinite(angles["pronation"])].astype(np.float32))
    return np.concatenate(parts).astype(float) if parts else np.empty(0)


def _range(turns: FloatArray) -> tuple[float, float]:
    """Between which values angles (m,) lie that are cut in their widest empty arc, degrees."""
    kept = np.sort(wrapped_deg(turns))
    arcs = np.diff(kept, append=kept[0] + 360.0)
    # single samples may lie anywhere: the cut is opposite the mean where no arc is empty
    widest = int(np.argmax(arcs))
    middle = np.degrees(np.angle(np.exp(1j * np.radians(turns)).mean()))
    centre = kept[widest] + 0.5 * arcs[widest] + 180.0 if arcs[widest] > _EMPTY_ARC_DEG else middle
    low, high = np.percentile(wrapped_deg(turns - centre), PERCENTILES)
    return float(low + centre), float(high + centre)
