"""`calibrate forearm`: lever arms, lengths and mounting from a held pose (Jatesiktat & Ang, II-H)."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.spatial.transform import Rotation

from smoother.array_types import BoolArray, FloatArray
from smoother.calibration import ArmCalibration, Length, LeverArm
from smoother.config import Config
from smoother.errors import CalibrationError, UnoccludeError
from smoother.linalg import robust_sigma, unit
from smoother.recording import JOINTS, CameraFrame, Recording
from smoother.result import Recovery
from smoother.smoothing import smooth

from .file import CalibrationFile
from .motion import forearm_frame
from .protocol import Answer, Check

#: The pose is held at least this long, and looked at for no longer than that, s.
SHORTEST_S, LONGEST_S = 0.8, 5.0
#: The sensor turns no faster than this while a pose is held, rad/s, averaged over this time, s.
STILL_RAD_S = 0.2
STILL_S = 0.25
#: A pose that was named is refused above this, rad/s (rms): simulated poses that are held reach 0.13.
MOVING_RAD_S = np.radians(30.0)
#: The gyroscope's bias is its median over this share of the recording, the quietest; what is larger than the
#: second is not a bias, rad/s.
QUIET_SHARE, LARGEST_BIAS_RAD_S = 0.3, np.radians(30.0)
#: The forearm points up within this angle; neither part of the arm points this near to the camera.
UPRIGHT_RAD = np.radians(45.0)
NEAR_RAY_RAD = np.radians(50.0)
#: The wrist is not lower than this against the shoulder, m: about head level.
LOWEST_WRIST_M = -0.10
#: Single frames that are missing do not end the pose, s.
BRIDGE_S = 0.12
_NEEDED = ("shoulder", "elbow", "wrist")


@dataclass(frozen=True)
class HeldPose:
    """A stretch in which the pose is held, on the camera's clock."""

    start_s: float
    end_s: float
    joints: dict[str, FloatArray]  # (3,) m: median of the joints that are tracked in {K}
    sigma_m: dict[str, float]  # Of the median, per axis: noise that lasts some tenths of a second
    turning_rad_s: float  # Rms of the sensor's angular velocity
    chosen: str  # "found" or "given"


#: Noise of the camera's joints has a memory of about this, s.
MEMORY_S = 0.5
FEWEST_FRAMES = 8


def find_held_pose(
    recording: Recording, from_s: float | None = None, to_s: float | None = None, offset_s: float = 0.0
) -> HeldPose:
    """The first held pose of a recording, or what is between two given times."""
    t = recording.arm.t_s
    seen = np.all([recording.arm.tracked(joint) for joint in _NEEDED], axis=0)
    if from_s is not None and to_s is not None:
        inside = seen & (t >= from_s) & (t <= to_s)
        if inside.sum() < FEWEST_FRAMES:
            raise CalibrationError(
                f"{recording.name}: between {from_s:g} and {to_s:g} s shoulder, elbow and wrist are tracked"
                f" together in {int(inside.sum())} frames; {FEWEST_FRAMES} are needed"
            )
        pose = _pose(recording, inside, offset_s, "given")
        if pose.turning_rad_s > MOVING_RAD_S:
            raise CalibrationError(
                f"{recording.name}: between {from_s:g} and {to_s:g} s the sensor turns by"
                f" {np.degrees(pose.turning_rad_s):.0f} degrees/s, so no pose is held there; name times in"
                " which the arm is still, with --from and --to, or leave them out to have the pose found"
            )
        return pose
    good = seen & _held(recording, offset_s)
    rows = np.flatnonzero(good)
    parts = np.split(rows, np.flatnonzero(np.diff(t[rows]) > BRIDGE_S) + 1)
    held = [part for part in parts if len(part) and t[part[-1]] - t[part[0]] >= SHORTEST_S]
    if not held:
        raise CalibrationError(
            f"{recording.name}: no held pose was found (forearm raised beside the head, palm to the camera,"
            f" still for {SHORTEST_S:g} s, shoulder, elbow and wrist tracked); hold it at the start, or name"
            " its times with --from and --to"
        )
    start_s, end_s = t[held[0][0]], t[held[0][-1]]
    chosen = good & (t >= start_s) & (t <= min(end_s, start_s + LONGEST_S))
    return _pose(recording, chosen, offset_s, "found")


def _held(recording: Recording, offset_s: float) -> BoolArray:
    """(F,) frames in which the arm is raised as asked for and the sensor is still."""
    arm, imu = recording.arm, recording.imu
    shoulder, elbow, wrist = (arm.joint(joint) for joint in _NEEDED)
    with np.errstate(invalid="ignore", divide="ignore"):
        along, upper, ray = unit(wrist - elbow), unit(elbow - shoulder), unit(elbow)
        good = _turning(recording, arm.t_s + offset_s) < STILL_RAD_S
        down = recording.gravity_hint
        if down is None and recording.camera_frame is not None:
            down = recording.camera_frame.down
        if down is not None:
            good &= along @ -down > np.cos(UPRIGHT_RAD)
            good &= (wrist - shoulder) @ -down > LOWEST_WRIST_M
        if recording.camera_frame is not CameraFrame.ZUP:  # there the camera is not known to be the origin
            for part in (along, upper):
                good &= np.abs(np.einsum("ni,ni->n", part, ray)) < np.cos(NEAR_RAY_RAD)
    return np.asarray(good & (arm.t_s + offset_s >= imu.t_s[0]) & (arm.t_s + offset_s <= imu.t_s[-1]))


def _turning(recording: Recording, t: FloatArray) -> FloatArray:
    """(F,) rms angular velocity of the sensor about each time, rad/s, less the gyroscope's bias.

    The bias is what the gyroscope shows in the recording's quietest part; zero if no bias is so large.
    """
    imu, gyro = recording.imu, np.asarray(recording.imu.gyro)
    width = max(int(SHORTEST_S * imu.rate_hz), 1)
    if len(gyro) >= width:
        mean = uniform_filter1d(gyro, width, axis=0, mode="nearest")
        varies = uniform_filter1d(np.sum((gyro - mean) ** 2, axis=1), width, mode="nearest")
        bias = np.median(gyro[varies <= np.quantile(varies, QUIET_SHARE)], axis=0)
        gyro = gyro - bias * (np.linalg.norm(bias) < LARGEST_BIAS_RAD_S)
    square = uniform_filter1d(np.sum(gyro**2, axis=1), max(int(STILL_S * imu.rate_hz), 1), mode="nearest")
    return np.sqrt(np.interp(t, imu.t_s, square))


def _pose(recording: Recording, frames: BoolArray, offset_s: float, chosen: str) -> HeldPose:
    arm, joints, sigma = recording.arm, dict[str, FloatArray](), dict[str, float]()
    t = arm.t_s[frames]
    for joint in JOINTS:
        rows = arm.joint(joint)[frames & arm.tracked(joint)]
        if len(rows) >= FEWEST_FRAMES:
            joints[joint] = np.median(rows, axis=0)
            spread = robust_sigma(rows - joints[joint], axis=0)
            worth = max(float(np.ptp(t)) / MEMORY_S, 1.0)
            sigma[joint] = float(np.sqrt(np.mean(spread**2) / min(worth, len(rows)))) * 1.25  # of a median
    turning = float(np.sqrt(np.mean(_turning(recording, t + offset_s) ** 2)))
    return HeldPose(float(t[0]), float(t[-1]), joints, sigma, turning, chosen)


#: How well a palm that faces the camera does, and a sensor that is put on the back of the wrist, rad.
PALM_SIGMA_RAD = np.radians(15.0)
PLACED_SIGMA_RAD = np.radians(15.0)
#: A strap that was neither seen nor measured, m: to the wrist, to the forearm's core.
USUAL_STRAP_TO_WRIST = Length(0.05, 0.020)
USUAL_RADIUS = Length(0.035, 0.008)
#: A length by ruler, m.
RULER_SIGMA_M = 0.004
#: Constant error of a camera's joint where the recording does not show it, m per axis.
USUAL_JOINT_BIAS_M = 0.008
#: A sensor whose orientation in the pose is not known better than this gives no lever arms, rad.
LARGEST_ATTITUDE_SIGMA_RAD = np.radians(12.0)
_STILL = (
    "the arm hardly moves in the recording, so the sensor's heading relative to the camera is not determined"
)
#: The recording is solved over this much time about the pose, s.
SOLVED_S = 90.0


@dataclass(frozen=True)
class ForearmCalibration:
    """What the held pose showed."""

    calibration: ArmCalibration  # Lever arms, upper arm and R_F_A
    pose: HeldPose  # When the pose was held, and where the joints were
    # r (core to sensor), d_se and d_sw (along the forearm, from the strap), d_ul, and elbow to wrist, m
    measured: dict[str, Length]  # by the names that the calibration file has for them
    strap_from: str  # "seen", "ruler" or "usual": where the strap's place comes from
    R_K_F: FloatArray  # (3, 3): the forearm in the pose
    direction_sigma_rad: float = float("nan")  # Of R_F_A; nan without it
    roll_sigma_rad: float = float("nan")  # Of R_F_A; nan without it
    motion: ArmCalibration | None = None  # What the recording's motion gave; None where it gave nothing
    why_not: str = ""  # Why there is no R_F_A, "" where there is


def calibrate_forearm(
    recording: Recording,
    from_s: float | None = None,
    to_s: float | None = None,
    radius_m: float | None = None,
    strap_to_wrist_m: float | None = None,
    config: Config | None = None,
) -> ForearmCalibration:
    """Calibrate one mounting of the IMU from a held pose, and solve the same recording's motion beside it."""
    pose = find_held_pose(recording, from_s, to_s)
    recovery, why_not = _solve(recording, pose, config)
    if recovery is not None and from_s is None:
        pose = find_held_pose(recording, from_s, to_s, recovery.clock_offset_s)
    bias = USUAL_JOINT_BIAS_M
    if recovery is not None:
        stated = recovery.estimates.joint_bias_sigma_m
        bias = stated if stated is not None and np.isfinite(stated) else bias
    joints, sigma = pose.joints, {joint: float(np.hypot(own, bias)) for joint, own in pose.sigma_m.items()}
    R_K_F = forearm_axes(joints["elbow"], joints["wrist"])
    measured, strap_from = _measure(joints, sigma, R_K_F, radius_m, strap_to_wrist_m)
    arm = ArmCalibration(recording.side, upper_arm=measured["d_ul"])
    found = ForearmCalibration(arm, pose, measured, strap_from, R_K_F, why_not=why_not)
    if recovery is None:
        return found
    # `R_K_A` in the middle of the pose, and its covariance, rad^2 in {K}
    t = recovery.t_s - recovery.clock_offset_s
    rows = (t >= pose.start_s) & (t <= pose.end_s) & np.isfinite(recovery.quaternion).all(axis=1)
    R_K_A = Rotation.from_quat(recovery.quaternion[rows], scalar_first=True).mean().as_matrix()
    attitude = recovery.pose_covariance[rows][:, 3:, 3:].mean(axis=0)
    tilt = float(np.sqrt(np.linalg.eigvalsh(attitude)[-1]))
    if not tilt < LARGEST_ATTITUDE_SIGMA_RAD:
        return replace(found, why_not=_STILL)
    levers = _levers(joints, sigma, found, R_K_A, attitude)
    ends = np.hypot(sigma["elbow"], sigma["wrist"]) / measured["forearm"].value_m
    return replace(
        found,
        calibration=replace(arm, lever_arms=levers, R_F_A=R_K_F.T @ R_K_A),
        direction_sigma_rad=float(np.hypot(tilt, ends)),
        roll_sigma_rad=float(np.hypot(tilt, PALM_SIGMA_RAD)),
        motion=recovery.calibration,
    )


def forearm_axes(elbow: FloatArray, wrist: FloatArray) -> FloatArray:
    """`R_K_F` (3, 3) of a forearm whose palm faces the camera, the origin of {K}."""
    y = unit(wrist - elbow)
    ray = 0.5 * (elbow + wrist)
    x = unit(ray - (ray @ y) * y)
    return np.column_stack([x, y, np.cross(x, y)])


def _solve(recording: Recording, pose: HeldPose, config: Config | None) -> tuple[Recovery | None, str]:
    """The recording about the pose, solved from its motion alone."""
    middle = 0.5 * (pose.start_s + pose.end_s)
    near = np.abs(recording.arm.t_s - middle) < SOLVED_S
    inside = np.abs(recording.imu.t_s - middle) < SOLVED_S
    part = replace(recording, arm=recording.arm.select(near), imu=recording.imu.select(inside), truth=None)
    try:
        recovery = smooth(part, None, config)
    except UnoccludeError as error:
        return None, str(error)
    arm = recovery.calibration
    if arm is None or arm.forearm_direction is None:
        return None, "the motion does not show how the sensor sits on the forearm"
    return recovery, ""


def _measure(
    joints: dict[str, FloatArray],
    sigma: dict[str, float],
    R_K_F: FloatArray,
    radius_m: float | None,
    strap_to_wrist_m: float | None,
) -> tuple[dict[str, Length], str]:
    forearm, upper = (
        Length(float(np.linalg.norm(joints[a] - joints[b])), float(np.hypot(sigma[a], sigma[b])))
        for a, b in (("wrist", "elbow"), ("elbow", "shoulder"))
    )
    radius = USUAL_RADIUS if radius_m is None else Length(radius_m, RULER_SIGMA_M)
    to_wrist = USUAL_STRAP_TO_WRIST if strap_to_wrist_m is None else Length(strap_to_wrist_m, RULER_SIGMA_M)
    where = "usual" if radius_m is None or strap_to_wrist_m is None else "ruler"
    if "strap" in joints:
        y = R_K_F[:, 1]
        from_wrist = joints["wrist"] - joints["strap"]
        off = from_wrist - (from_wrist @ y) * y
        where = "seen"
        if strap_to_wrist_m is None:
            to_wrist = Length(float(from_wrist @ y), float(np.hypot(sigma["wrist"], sigma["strap"])))
        if radius_m is None:
            part = float(np.clip(to_wrist.value_m / forearm.value_m, 0, 1))
            line = np.hypot((1 - part) * sigma["wrist"], part * sigma["elbow"])
            radius = Length(float(np.linalg.norm(off)), float(np.hypot(line, sigma["strap"])))
    to_elbow = Length(forearm.value_m - to_wrist.value_m, float(np.hypot(to_wrist.sigma_m, sigma["elbow"])))
    return {"r": radius, "d_se": to_elbow, "d_sw": to_wrist, "d_ul": upper, "forearm": forearm}, where


def _levers(
    joints: dict[str, FloatArray],
    sigma: dict[str, float],
    found: ForearmCalibration,
    R_K_A: FloatArray,
    attitude: FloatArray,
) -> dict[str, LeverArm]:
    """Lever arms in {A} with sigmas: of the joints' places, the strap's place and the orientation."""
    x, y, z = found.R_K_F.T
    r, to_wrist, levers = found.measured["r"], found.measured["d_sw"], dict[str, LeverArm]()
    for joint in [name for name in ("elbow", "wrist", "hand") if name in joints]:
        if found.strap_from == "seen":
            lever = joints[joint] - joints["strap"]
            spread = (sigma[joint] ** 2 + sigma["strap"] ** 2) * np.eye(3)
        else:
            lever = joints[joint] - joints["wrist"] + to_wrist.value_m * y - r.value_m * x
            roll = np.hypot(PALM_SIGMA_RAD, PLACED_SIGMA_RAD)
            spread = to_wrist.sigma_m**2 * np.outer(y, y) + r.sigma_m**2 * np.outer(x, x)
            spread = spread + (r.value_m * roll) ** 2 * np.outer(z, z)
            own = sigma[joint] ** 2 + sigma["wrist"] ** 2 if joint != "wrist" else 0.0
            # the line that the strap's place is counted along turns with both ends
            turn = (sigma["elbow"] ** 2 + sigma["wrist"] ** 2) / found.measured["forearm"].value_m ** 2
            spread = spread + own * np.eye(3) + to_wrist.value_m**2 * turn * (np.eye(3) - np.outer(y, y))
        cross = np.cross(np.eye(3), lever)
        spread = R_K_A.T @ (spread + cross @ attitude @ cross.T) @ R_K_A
        levers[joint] = LeverArm(R_K_A.T @ lever, np.sqrt(np.diag(spread)))
    return levers


#: Farther apart than this many sigmas is treated as disagreement.
AGREE = 2.5
#: The pose asked for: arms about across the camera's ray, the sensor still, rad and rad/s.
CORONAL_RAD = np.radians(35.0)
RESTLESS_RAD_S = 0.12

_STRAP = "the strap slid between pose and motion, or its place was measured wrongly"
#: What to look at when a measure of the pose and of the motion contradict each other.
_BROKEN = {
    "upper arm": "shoulder or elbow is placed differently in the pose (a sleeve, a shrugged shoulder)",
    "forearm": "elbow or wrist is placed differently in the pose (the arm pointed to the camera)",
    "strap to wrist": _STRAP,
    "strap to elbow": _STRAP,
    "radius": "the forearm is not straight, or the strap was found beside the arm",
    "direction": "the sensor turned on the arm since the pose, or the arm was not still in it",
    "roll": "hold the palm square to the camera, and put the sensor on the back of the wrist",
}


class Compared(NamedTuple):
    """One measure by the pose and by the motion, each with its standard deviation."""

    measure: str
    unit: str
    pose: float
    pose_sigma: float
    motion: float
    motion_sigma: float

    @property
    def apart(self) -> float:
        """Difference in sigmas of both."""
        return abs(self.pose - self.motion) / float(np.hypot(self.pose_sigma, self.motion_sigma))

    @property
    def agrees(self) -> bool:
        """Whether the two can both be right."""
        return self.apart < AGREE


def compare(calibration: ForearmCalibration) -> list[Compared]:
    """Every measure that both the pose and the motion showed; empty where the motion showed nothing."""
    motion, m, rows = calibration.motion, calibration.measured, []
    if motion is None:
        return []
    frame, upper = forearm_frame(motion), motion.upper_arm
    pairs = [] if upper is None else [("upper arm", "d_ul", upper.value_m, upper.sigma_m)]
    if frame is not None:
        pairs.append(("forearm", "forearm", frame.length_m, frame.length_sigma_m))
        for joint, name, sign in (("wrist", "d_sw", 1.0), ("elbow", "d_se", -1.0)):
            lever = motion.lever_arms[joint]
            along = sign * float(lever.position_m @ frame.direction)
            sigma = float(np.linalg.norm(lever.sigma_m * frame.direction))
            pairs.append((f"strap to {joint}", name, along, sigma))
        pairs.append(("radius", "r", frame.distance_m, frame.distance_sigma_m))
    for measure, name, *by_motion in pairs:
        values = (m[name].value_m, m[name].sigma_m, *by_motion)
        rows.append(Compared(measure, "mm", *(1e3 * value for value in values)))
    R_F_A = calibration.calibration.R_F_A
    if frame is None or R_F_A is None:
        return rows
    tilt = np.arccos(np.clip(R_F_A[1] @ frame.direction, -1, 1))
    # an angle between two directions that are each uncertain about two axes
    both = np.hypot(calibration.direction_sigma_rad, frame.direction_sigma_rad)
    angles = [("direction", tilt, both, 0.0, 0.0)]
    if frame.R_F_A is not None:
        x = R_F_A @ frame.R_F_A[0]  # the motion's x in the pose's {F}
        own = np.hypot(frame.roll_sigma_rad, PLACED_SIGMA_RAD)
        angles.append(("roll", 0.0, calibration.roll_sigma_rad, np.arctan2(-x[2], x[0]), own))
    return rows + [Compared(name, "degrees", *map(float, np.degrees(values))) for name, *values in angles]


def forearm_answer(calibration: ForearmCalibration) -> Answer:
    """What the pose gave, whether the motion agrees and which assumption broke, and what to record next."""
    rows, pose, arm = compare(calibration), calibration.pose, calibration.calibration
    broken = [row.measure for row in rows if not row.agrees]
    contradicts = bool({"direction", "roll"} & set(broken))
    if contradicts:  # one of the two is wrong
        arm = replace(arm, R_F_A=None)
    sentence = (
        f"the pose was held from {pose.start_s:.1f} to {pose.end_s:.1f} s; pose and motion agree in"
        f" {len(rows) - len(broken)} of {len(rows)} measures within their sigmas"
    )
    y, middle = calibration.R_K_F[:, 1], pose.joints["elbow"]
    towards = float(np.degrees(np.arcsin(np.abs(y @ middle) / np.linalg.norm(middle))))
    checks = [
        *(
            Check(f"{row.measure}, {row.pose:.0f} {row.unit} in the pose and {row.motion:.0f} in motion",
                    row.apart, AGREE, "sigmas apart", _BROKEN[row.measure])
            for row in rows
        ),
        Check("length of the pose", pose.end_s - pose.start_s, 2.0, "s", "hold it for three seconds", True),
        Check("turning of the sensor in the pose", float(np.degrees(pose.turning_rad_s)),
                float(np.degrees(RESTLESS_RAD_S)), "degrees/s", "keep the arm still", is_open=True),
        Check("forearm towards or away from the camera, where depth errors are in its length", towards,
                float(np.degrees(CORONAL_RAD)), "degrees", "hold the arm across", is_open=True),
    ]  # fmt: skip
    if not rows:
        why = calibration.why_not or "the motion did not show the forearm"
        checks.insert(0, Check(f"there is no motion to compare the pose with: {why}"))
    if calibration.calibration.R_F_A is None:
        text = (
            f"lever arms and R_F_A: the sensor's orientation in the pose is not known ({calibration.why_not})"
        )
        checks.append(Check(text, remedy=THEN_MOVE, is_open=True))
    elif contradicts:
        checks.append(Check("R_F_A is not written: pose and motion contradict each other", is_open=True))
    if calibration.strap_from == "usual":
        text = "the strap's place was neither seen nor measured: usual values are used"
        checks.append(Check(text, remedy=BY_RULER, is_open=True))
    sigma_deg = {
        "direction": float(np.degrees(calibration.direction_sigma_rad)),
        "roll": float(np.degrees(calibration.roll_sigma_rad)),
    }
    measures = calibration.measured
    table: dict[str, Any] = {"strap_from": calibration.strap_from}
    for name, length in measures.items():
        table |= {f"{name}_m": float(length.value_m), f"{name}_sigma_m": float(length.sigma_m)}
    if arm.R_F_A is not None:
        table |= {f"R_F_A_{name}_sigma_deg": value for name, value in sigma_deg.items()}
    figures = {
        "side": arm.side,
        "pose": {"from_s": pose.start_s, "to_s": pose.end_s, "chosen": pose.chosen},
        "measures": {name: asdict(length) for name, length in measures.items()},
        "strap_from": calibration.strap_from,
        "lever_arms": {joint: asdict(lever) for joint, lever in arm.lever_arms.items()},
        "R_F_A": arm.R_F_A,
        "R_F_A_sigma_deg": sigma_deg,
        "against_motion": [row._asdict() | {"sigmas_apart": row.apart, "agrees": row.agrees} for row in rows],
    }
    file = CalibrationFile().with_arm(arm).with_table("forearm", {arm.side or "any": table})
    grade = "not good enough" if arm.R_F_A is None else "good" if rows and not broken else "usable"
    return Answer(grade, sentence, checks, file, figures)


#: What to record next.
THEN_MOVE = "after the pose, move for 20 s in view: bend and stretch the elbow, turn the palm up and down"
BY_RULER = (
    "measure by ruler from the middle of the strap to the wrist's crease and half the wrist's thickness"
    " (--strap-to-wrist-m, --radius-m), or record the camera's images and use `unocclude import strap`"
)
