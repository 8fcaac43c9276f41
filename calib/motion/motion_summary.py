"""What recordings showed that a calibration from motion can rest on, and what they left open, in words."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from smoother.array_types import BoolArray, FloatArray
from smoother.calibration import ArmCalibration
from smoother.measurements.segment import Segment
from smoother.recording import JOINTS
from smoother.result import Recovery

from ..forearm.forearm_frame import ForearmFrame
from ..protocol import Verdict

#: Turning about the forearm's axis is measured within this much time: the gyro's sum drifts, s.
AXIAL_S = 10.0


@dataclass(frozen=True)
class Evidence:
    """What the camera saw, and how the forearm moved meanwhile."""

    visible_s: float  # Time with the forearm visible
    frames: dict[str, int]  # Accepted samples by joint; `upper_arm` counts frames with shoulder and elbow
    turning_rad_s: float  # Rms of the IMU's angular velocity in that time; nan without any
    axial_rad: float  # How far the forearm turned about its own axis within 10 s of it, at best


@dataclass(frozen=True)
class ClockOffset:
    """A recording's clock offset, t_imu = t_camera + offset; it belongs to that recording alone."""

    recording: str
    offset_s: float = float("nan")  # Mean offset and its standard deviation
    sigma_s: float = float("nan")  # Mean offset and its standard deviation
    drift_s: float = float("nan")  # How far the offset wandered


def gather(segments: Sequence[Segment], direction: FloatArray | None) -> Evidence:  # direction (3,)
    """The evidence of the segments of one or several recordings."""
    frames = {joint: sum(_count(segment, joint) for segment in segments) for joint in JOINTS}
    frames["upper_arm"] = sum(_count(segment, "shoulder", "elbow") for segment in segments)
    square, time, axial = 0.0, 0.0, 0.0
    for segment in segments:
        t, rates = _rates(segment)
        dt = np.diff(t)
        seen = _visible(segment, 0.5 * (t[1:] + t[:-1]))
        square += float(np.sum(dt[seen] * np.sum(rates[seen] ** 2, axis=1)))
        time += float(dt[seen].sum())
        if direction is not None:
            axial = max(axial, _axial(t, np.append(0.0, np.cumsum(dt * (rates @ direction))), seen))
    return Evidence(
        visible_s=time,
        frames=frames,
        turning_rad_s=float(np.sqrt(square / time)) if time > 0 else float("nan"),
        axial_rad=float("nan") if direction is None else axial,
    )


def gather_from(recovery: Recovery) -> Evidence:
    """The evidence of one recovered recording: how its answer turned while the camera saw the forearm."""
    known = recovery.calibration
    direction = None if known is None else known.forearm_direction
    frames = _frames_of(recovery)
    if len(recovery) < 2:
        return Evidence(0.0, frames, float("nan"), float("nan"))
    square, time = 0.0, 0.0
    angle, visible = np.zeros(len(recovery)), np.zeros(len(recovery) - 1, bool)
    at = 0
    for batch in recovery.batches(overlap=1):
        turn, seen = _turns(batch)
        dt = np.diff(batch.t_s)
        square += float(np.sum(turn[seen] ** 2 / dt[seen, None]))
        time += float(dt[seen].sum())
        visible[at : at + len(dt)] = seen
        if direction is not None:
            angle[at + 1 : at + 1 + len(dt)] = turn @ direction
        at += len(dt)
    axial = float("nan")
    if direction is not None:
        axial = _axial(recovery.t_s, np.cumsum(angle, out=angle), visible)
    return Evidence(time, frames, float(np.sqrt(square / time)) if time > 0 else float("nan"), axial)


def _turns(recovery: Recovery) -> tuple[FloatArray, BoolArray]:
    """Rotation vectors (N - 1, 3) in {A} from sample to sample, zero without an answer; which were seen."""
    q = recovery.quaternion
    good: BoolArray = np.all(np.isfinite(q), axis=1)
    both = good[1:] & good[:-1] & (np.diff(recovery.t_s) > 0)
    turn = np.zeros((len(both), 3))
    turn[both] = _turn_between(q[:-1][both], q[1:][both])
    return turn, both & ~(recovery.occluded[1:] | recovery.occluded[:-1])


def _turn_between(before: FloatArray, after: FloatArray) -> FloatArray:
    """Rotation vectors (n, 3) of conj(before) * after, quaternions (n, 4) with qw first."""
    w0, w1, v0, v1 = before[:, 0], after[:, 0], before[:, 1:], after[:, 1:]
    w = w0 * w1 + np.einsum("ni,ni->n", v0, v1)
    v = w0[:, None] * v1 - w1[:, None] * v0 - np.cross(v0, v1)
    sine = np.linalg.norm(v, axis=1)
    angle = 2.0 * np.arctan2(sine, np.abs(w)) * np.where(w < 0, -1.0, 1.0)
    return v * np.divide(angle, sine, out=2.0 / w, where=sine > 0)[:, None]


def _frames_of(recovery: Recovery) -> dict[str, int]:
    """Camera samples by joint that were used; those tracked where the method keeps no residuals."""
    if recovery.residuals is not None:
        parts = (batch.used for batch in recovery.residuals.batches())
    else:
        parts = (np.stack([f.tracked(joint) for joint in JOINTS], axis=1) for f in recovery.frame_batches())
    counts, both = np.zeros(len(JOINTS), np.int64), 0
    for used in parts:
        counts += np.count_nonzero(used, axis=0)
        both += int(used[:, [JOINTS.index("shoulder"), JOINTS.index("elbow")]].all(axis=1).sum())
    return dict(zip(JOINTS, counts.tolist(), strict=True)) | {"upper_arm": both}


def _count(segment: Segment, *joints: str) -> int:
    columns = [JOINTS.index(joint) for joint in joints]
    return int(segment.accepted[:, columns].all(axis=1).sum())


def _rates(segment: Segment) -> tuple[FloatArray, FloatArray]:
    """Edges (n + 1,) every 20 ms or so, and the mean angular velocity (n, 3) between them, rad/s in {A}."""
    count = max(int((segment.end_s - segment.start_s) / 0.02), 2)
    t = np.linspace(segment.start_s, segment.end_s, count + 1)
    return t, segment.signal.mean(t[:-1], t[1:])[:, 3:] - segment.attitude.gyroscope_bias


def _visible(segment: Segment, t: FloatArray) -> BoolArray:
    """(n,) whether the frame next to each time shows the forearm; clock offsets are too small to matter."""
    seen = segment.accepted[:, 1:].sum(axis=1) >= segment.needed
    after = np.clip(np.searchsorted(segment.frame_t_camera, t), 1, len(segment.frame_t_camera) - 1)
    before = after - 1
    nearer = t - segment.frame_t_camera[before] < segment.frame_t_camera[after] - t
    nearest = np.where(nearer, before, after)
    return seen[nearest] & (np.abs(segment.frame_t_camera[nearest] - t) < 0.1)


def _axial(t: FloatArray, angle: FloatArray, seen: BoolArray) -> float:
    """Largest range of an angle (n + 1,) over visible intervals (n,) within `AXIAL_S`, rad."""
    best = 0.0
    for start in np.arange(t[0], t[-1], 0.5 * AXIAL_S):
        end = start + AXIAL_S
        first, last = np.searchsorted(t, start) - 1, np.searchsorted(t, end) + 1
        near = slice(max(int(first), 0), int(last))  # an interval more on either side
        when = 0.5 * (t[near][1:] + t[near][:-1])
        middle = 0.5 * (angle[near][1:] + angle[near][:-1])
        inside = seen[near.start : near.start + len(when)] & (when >= start) & (when < end)
        if inside.any():
            best = max(best, float(np.ptp(middle[inside])))
    return best


#: From here on something is treated as not determined.
LEVER_SIGMA_M = 0.010
UPPER_ARM_SIGMA_M = 0.020
DIRECTION_SIGMA_RAD = np.radians(3.0)
ROLL_SIGMA_RAD = np.radians(10.0)
#: A direction that is less certain than this is not known at all, degrees.
UNKNOWN_DEG = 90.0
CLOCK_SIGMA_S = 0.005
JOINT_BIAS_M = 0.005
#: Less than this is hardly any motion.
LITTLE_AXIAL_RAD = np.radians(60.0)
LITTLE_TURNING_RAD_S = 0.2
LITTLE_VISIBLE_S = 10.0
FEW_FRAMES = 30
MOVE = "record 20 s in view: bend and stretch the elbow, raise the arm, turn the palm up and down"


def not_determined(
    calibration: ArmCalibration,
    frame: ForearmFrame | None,
    evidence: Evidence,
    known: ArmCalibration,
    joint_bias_m: float = 0.0,
) -> list[str]:
    """What the motion left open, one sentence each, the causes first."""
    if is_point(evidence):
        return _causes(evidence, "sensor")
    return [
        *_causes(evidence, "forearm"),
        *_missing(calibration, evidence),
        *_bias(calibration, known, joint_bias_m),
        *_levers(calibration, known, joint_bias_m),
        *_roll(calibration, frame, evidence, known, joint_bias_m),
        *_upper_arm(calibration, evidence, known, joint_bias_m),
    ]


def motion_verdict(calibration: ArmCalibration, left_open: Sequence[str]) -> Verdict:
    """How well the arm is known now, and what to record next."""
    if not calibration.lever_arms:
        return Verdict("not good enough", "no lever arm was found", (), (MOVE,))
    worst_m = max(float(np.max(lever.sigma_m)) for lever in calibration.lever_arms.values())
    sentence = f"lever arms are known to {1e3 * worst_m:.0f} mm per axis at worst (one sigma)"
    return Verdict("usable" if left_open else "good", sentence, (), (MOVE,) if left_open else ())


def is_point(evidence: Evidence) -> bool:
    """Whether the camera saw the sensor itself and no joint: nothing of an arm can be asked."""
    seen = evidence.frames
    return seen.get("strap", 0) > 0 and not any(seen.get(joint, 0) for joint in ("elbow", "wrist", "hand"))


def _causes(evidence: Evidence, what: str) -> list[str]:
    sentences = []
    if evidence.visible_s < LITTLE_VISIBLE_S:
        sentences.append(f"the {what} was visible for {evidence.visible_s:.0f} s only")
    if evidence.turning_rad_s < LITTLE_TURNING_RAD_S:
        rate = np.degrees(evidence.turning_rad_s)
        sentences.append(f"the {what} hardly moved while it was visible ({rate:.0f} degrees/s on average)")
    return sentences


def _missing(calibration: ArmCalibration, evidence: Evidence) -> list[str]:
    sentences = []
    known = set(calibration.lever_arms).union(
        *(mounting.lever_arms for mounting in calibration.mountings.values())
    )
    for joint in ("elbow", "wrist", "hand"):
        if joint not in known:
            seen = evidence.frames.get(joint, 0)
            how = "was never tracked" if seen == 0 else f"was tracked in {seen} frames only"
            sentences.append(f"the {joint} {how}: its lever arm is not determined")
    return sentences


def beyond(sigma_m: FloatArray, joint_bias_m: float) -> FloatArray:
    """What a standard deviation holds besides the camera's constant errors, m."""
    bias = joint_bias_m if np.isfinite(joint_bias_m) else 0.0
    return np.sqrt(np.maximum(np.square(sigma_m) - bias**2, 0.0))


def _bias(calibration: ArmCalibration, known: ArmCalibration, joint_bias_m: float) -> list[str]:
    if not joint_bias_m > JOINT_BIAS_M or not set(calibration.lever_arms) - set(known.lever_arms):
        return []
    return [
        f"the camera places joints some {1e3 * joint_bias_m:.0f} mm off (per axis), always in the same"
        " way: this limits the accuracy of lever arms and lengths"
    ]


def _levers(calibration: ArmCalibration, known: ArmCalibration, joint_bias_m: float) -> list[str]:
    sentences = []
    for joint, lever in calibration.lever_arms.items():
        if joint in known.lever_arms:
            continue
        open_axes = [
            f"{axis} to {1e3 * sigma:.0f} mm"
            for axis, sigma, own in zip(
                "xyz", lever.sigma_m, beyond(lever.sigma_m, joint_bias_m), strict=True
            )
            if own > LEVER_SIGMA_M
        ]
        if open_axes:
            sentences.append(f"the {joint} is known only roughly in the IMU's axes: {', '.join(open_axes)}")
    return sentences


def _worst_variance(calibration: ArmCalibration) -> float:
    """Of the lever arms that give the roll, m^2."""
    return max(float(np.max(calibration.lever_arms[joint].sigma_m)) ** 2 for joint in ("elbow", "wrist"))


def _roll(
    calibration: ArmCalibration,
    frame: ForearmFrame | None,
    evidence: Evidence,
    known: ArmCalibration,
    joint_bias_m: float,
) -> list[str]:
    if known.R_F_A is not None:
        return []
    if frame is None:
        return ["the forearm's axes in the IMU (R_F_A) need both elbow and wrist"]
    sentences = []
    if frame.direction_sigma_rad > DIRECTION_SIGMA_RAD:
        sentences.append(f"the forearm's direction in the IMU is {known_to(frame.direction_sigma_rad)}")
    if not np.isfinite(frame.roll_sigma_rad):
        millimetres = 1e3 * frame.distance_m
        sentences.append(
            f"the IMU was found {millimetres:.0f} mm from the line between elbow and wrist, too near to tell "
            "on which side of the forearm it sits: roll is not known"
        )
    elif frame.roll_sigma_rad > ROLL_SIGMA_RAD:
        cause = ""
        if evidence.axial_rad < LITTLE_AXIAL_RAD:
            turned = np.degrees(evidence.axial_rad)
            cause = f"the forearm hardly turned about its own axis ({turned:.0f} degrees): "
        elif joint_bias_m > JOINT_BIAS_M and joint_bias_m**2 > 0.5 * _worst_variance(calibration):
            cause = "with the camera's constant errors "
        sentences.append(f"{cause}roll is {known_to(frame.roll_sigma_rad)}")
    if frame.R_F_A is None:
        sentences.append(
            "how the IMU is turned on the forearm: R_F_A is left open; recovering does not need it"
        )
    return sentences


def known_to(sigma_rad: float) -> str:
    """How well an angle is known, in words: beyond a right angle it is not."""
    degrees = np.degrees(sigma_rad)
    return f"known to {degrees:.0f} degrees only" if degrees < UNKNOWN_DEG else "not known"


def _upper_arm(
    calibration: ArmCalibration, evidence: Evidence, known: ArmCalibration, joint_bias_m: float
) -> list[str]:
    if known.upper_arm is not None:
        return []
    if evidence.frames.get("upper_arm", 0) == 0:
        return ["shoulder and elbow were never seen together: the upper arm's length is not known"]
    if evidence.frames["upper_arm"] < FEW_FRAMES:
        return [f"shoulder and elbow were seen together in {evidence.frames['upper_arm']} frames only"]
    if calibration.upper_arm is not None:
        sigma_m = calibration.upper_arm.sigma_m
        if beyond(np.array(sigma_m), joint_bias_m) > UPPER_ARM_SIGMA_M:
            return [f"the upper arm's length is known to {1e3 * sigma_m:.0f} mm only"]
    return []


def clocks_not_determined(offsets: Sequence[ClockOffset]) -> list[str]:
    """Recordings whose clock offset stayed open, one sentence each."""
    sentences = []
    for each in offsets:
        if not np.isfinite(each.offset_s):
            sentences.append(f"{each.recording}: IMU and visible forearm never overlap; it was not used")
        elif each.sigma_s > CLOCK_SIGMA_S:
            sentences.append(
                f"{each.recording}: the clock offset is known to {1e3 * each.sigma_s:.0f} ms only; "
                "the arm moved too little or too slowly"
            )
    return sentences
