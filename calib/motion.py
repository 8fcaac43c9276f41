"""`calibrate motion`: lever arms, lengths and mounting from recordings, and what was found of an arm.

The forearm frame {F}: y from elbow to wrist, x towards the back of the hand, z = x cross y, origin in the
arm's core under the strap. The lever arms give y. The IMU sits on the back of the wrist, so that x points
from the line between elbow and wrist to the IMU.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from smoother.array_types import BoolArray, FloatArray
from smoother.calibration import ArmCalibration
from smoother.config import Config
from smoother.errors import CalibrationError
from smoother.linalg import nearest
from smoother.measurements.outliers import reject_by_camera
from smoother.measurements.segment import Segment, split_into_segments
from smoother.recording import JOINTS, Recording
from smoother.recovery.imu_signs import PLATEAU_SHARE, clipped
from smoother.result import Recovery
from smoother.rotation import Rotation
from smoother.runtime.pool import Pool
from smoother.selfcal.pairing import pair
from smoother.selfcal.rounds import self_calibrate
from smoother.selfcal.session import find_straps
from smoother.window.priors import with_measured_noise

from .file import CalibrationFile, with_sigma_table
from .protocol import Answer, Check
from .sigma_factor import hidden_gap_factors, short_recordings

#: Nearer to the elbow-wrist line than this the IMU does not show which way the back of the hand is, m.
NEAREST_M = 0.015
#: Axes that are known no better than this are not written down, rad: roll, and the forearm's direction.
WORST_ROLL_RAD = np.radians(15.0)
WORST_DIRECTION_RAD = np.radians(6.0)


@dataclass(frozen=True)
class ForearmFrame:
    """The forearm's axes as far as the lever arms give them."""

    direction: FloatArray  # (3,): unit vector elbow to wrist in {A}
    direction_sigma_rad: float  # Its standard deviation
    length_m: float  # Elbow to wrist
    length_sigma_m: float  # Elbow to wrist
    distance_m: float  # Of the IMU from the line between elbow and wrist
    away: FloatArray  # (3,): unit vector from that line to the IMU in {A}
    distance_sigma_m: float  # Its standard deviation
    roll_sigma_rad: float  # Of the angle about the forearm's axis; inf where the IMU is too near to the line
    R_F_A: FloatArray | None  # (3, 3): none where the roll or the direction is not known well enough


def forearm_frame(calibration: ArmCalibration) -> ForearmFrame | None:
    """The forearm's axes from the lever arms of elbow and wrist; None without both."""
    along = calibration.forearm_direction
    if along is None:
        return None
    levers = [calibration.lever_arms[joint] for joint in ("elbow", "wrist")]
    elbow, wrist = (lever.position_m for lever in levers)
    sigma = np.array([lever.sigma_m for lever in levers])
    length = float(np.linalg.norm(wrist - elbow))
    # the point of the line that is nearest to the IMU, the origin of {A}
    part = float(-elbow @ along) / length
    foot = elbow + part * length * along
    distance = float(np.linalg.norm(foot))
    sideways = np.linalg.svd(along[None])[2][1:]  # in the worst direction across
    tilt = float(np.linalg.norm([np.linalg.norm(sideways * each, 2) for each in sigma])) / length
    away = -foot / max(distance, 1e-12)
    across = np.cross(away, along)
    # of a point of the line both ends' errors go together
    off, beside = np.linalg.norm(sigma * away, axis=1), np.linalg.norm(sigma * across, axis=1)
    share = np.abs([1.0 - part, part])
    roll = float(share @ beside) / distance if distance > NEAREST_M else np.inf
    is_known = roll < WORST_ROLL_RAD and tilt < WORST_DIRECTION_RAD
    return ForearmFrame(
        direction=along,
        direction_sigma_rad=tilt,
        length_m=length,
        length_sigma_m=float(np.linalg.norm(sigma * along)),
        distance_m=distance,
        away=away,
        distance_sigma_m=float(share @ off),
        roll_sigma_rad=roll,
        R_F_A=np.stack([away, along, across]) if is_known else None,
    )


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
    offset_s: float = float("nan")  # Mean offset
    sigma_s: float = float("nan")  # Its standard deviation
    drift_s: float = float("nan")  # How far the offset wandered


def gather_from(recovery: Recovery) -> Evidence:
    """The evidence of one recovered recording: how its answer turned while the camera saw the forearm.

    Samples count that were used; those tracked where the method keeps no residuals.
    """
    if recovery.residuals is not None:
        frames = _counted(batch.used for batch in recovery.residuals.batches())
    else:
        frames = _counted(
            np.stack([each.tracked(joint) for joint in JOINTS], axis=1) for each in recovery.frame_batches()
        )
    if len(recovery) < 2:
        return Evidence(0.0, frames, float("nan"), float("nan"))
    turns, seen = zip(*(_turns(batch) for batch in recovery.batches(overlap=1)), strict=True)
    known = recovery.calibration
    pieces = [(recovery.t_s, np.concatenate(turns), np.concatenate(seen))]
    return _evidence(pieces, frames, None if known is None else known.forearm_direction)


def _evidence(
    pieces: Iterable[tuple[FloatArray, FloatArray, BoolArray]],  # times (n + 1,), turns (n, 3), seen (n,)
    frames: dict[str, int],
    direction: FloatArray | None,
) -> Evidence:
    square, time, axial = 0.0, 0.0, 0.0
    for t, turn, seen in pieces:
        dt = np.diff(t)
        square += float(np.sum(turn[seen] ** 2 / dt[seen, None]))
        time += float(dt[seen].sum())
        if direction is not None:
            step = turn @ direction
            axial = max(axial, _axial(t[:-1] + 0.5 * dt, np.cumsum(step) - 0.5 * step, seen))
    return Evidence(
        visible_s=time,
        frames=frames,
        turning_rad_s=float(np.sqrt(square / time)) if time > 0 else float("nan"),
        axial_rad=float("nan") if direction is None else axial,
    )


def _counted(parts: Iterable[BoolArray]) -> dict[str, int]:
    """Samples by joint; `upper_arm` counts frames with shoulder and elbow."""
    both = [JOINTS.index("shoulder"), JOINTS.index("elbow")]
    counts = sum(
        (np.append(np.count_nonzero(used, axis=0), used[:, both].all(axis=1).sum()) for used in parts),
        np.zeros(len(JOINTS) + 1, np.int64),
    )
    return dict(zip((*JOINTS, "upper_arm"), counts.tolist(), strict=True))


def _turns(recovery: Recovery) -> tuple[FloatArray, BoolArray]:
    """Rotation vectors (N - 1, 3) in {A} from sample to sample, zero without an answer; which were seen."""
    good: BoolArray = np.all(np.isfinite(recovery.quaternion), axis=1)
    R = Rotation.from_quat(
        np.where(good[:, None], recovery.quaternion, [1.0, 0.0, 0.0, 0.0]), scalar_first=True
    )
    both = good[1:] & good[:-1] & (np.diff(recovery.t_s) > 0)
    turn = np.where(both[:, None], (R[:-1].inv() * R[1:]).as_rotvec(), 0.0)
    return turn, both & ~(recovery.occluded[1:] | recovery.occluded[:-1])


def _turns_of_segment(segment: Segment) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Edges (n + 1,) every 20 ms or so, turns (n, 3) in {A} between them, and whether the forearm was seen.

    The frame next to each time tells; clock offsets are too small to matter.
    """
    count = max(int((segment.end_s - segment.start_s) / 0.02), 2)
    t, frame_t = np.linspace(segment.start_s, segment.end_s, count + 1), segment.frame_t_camera
    rate = segment.signal.mean(t[:-1], t[1:])[:, 3:] - segment.attitude.gyroscope_bias
    middle = 0.5 * (t[1:] + t[:-1])
    at = nearest(frame_t, middle)
    seen = segment.accepted[at, 1:].sum(axis=1) >= segment.needed
    return t, np.diff(t)[:, None] * rate, seen & (np.abs(frame_t[at] - middle) < 0.1)


def _axial(t: FloatArray, angle: FloatArray, seen: BoolArray) -> float:
    """Largest range of an angle (n,) over visible times within `AXIAL_S`, rad."""
    starts = np.arange(t[0], t[-1], 0.5 * AXIAL_S)
    rows = map(slice, *np.searchsorted(t, [starts, starts + AXIAL_S]).tolist())
    ranges = (np.ptp(angle[near][seen[near]]) for near in rows if seen[near].any())
    return float(max(ranges, default=0.0))


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
) -> Iterator[str]:
    """What the motion left open, one sentence each, the causes first."""
    what = "sensor" if is_point(evidence) else "forearm"
    if evidence.visible_s < LITTLE_VISIBLE_S:
        yield f"the {what} was visible for {evidence.visible_s:.0f} s only"
    if evidence.turning_rad_s < LITTLE_TURNING_RAD_S:
        rate = np.degrees(evidence.turning_rad_s)
        yield f"the {what} hardly moved while it was visible ({rate:.0f} degrees/s on average)"
    if is_point(evidence):
        return
    levers, frames = calibration.lever_arms, evidence.frames
    mounted = {joint for each in calibration.mountings.values() for joint in each.lever_arms}
    for joint in ("elbow", "wrist", "hand"):
        if joint not in mounted | set(levers):
            seen = frames.get(joint, 0)
            yield f"the {joint} was tracked in {seen} frames only: its lever arm is not determined"
    found = {joint: lever for joint, lever in levers.items() if joint not in known.lever_arms}
    if joint_bias_m > JOINT_BIAS_M and found:
        yield (
            f"the camera places joints some {1e3 * joint_bias_m:.0f} mm off (per axis), always in the same"
            " way: this limits the accuracy of lever arms and lengths"
        )
    for joint, lever in found.items():
        own = beyond(lever.sigma_m, joint_bias_m) > LEVER_SIGMA_M
        open_axes = [f"{axis} to {1e3 * lever.sigma_m[k]:.0f} mm" for k, axis in enumerate("xyz") if own[k]]
        if open_axes:
            yield f"the {joint} is known only roughly in the IMU's axes: {', '.join(open_axes)}"
    if known.R_F_A is None and frame is None:
        yield "the forearm's axes in the IMU (R_F_A) need both elbow and wrist"
    elif known.R_F_A is None and frame is not None:
        if frame.direction_sigma_rad > DIRECTION_SIGMA_RAD:
            yield f"the forearm's direction in the IMU is {known_to(frame.direction_sigma_rad)}"
        if frame.roll_sigma_rad > ROLL_SIGMA_RAD:
            turned = np.degrees(np.nan_to_num(evidence.axial_rad))
            yield (
                f"roll is {known_to(frame.roll_sigma_rad)}: the forearm turned by {turned:.0f} degrees about"
                f" its own axis, and the IMU was found {1e3 * frame.distance_m:.0f} mm from the line between"
                " elbow and wrist"
            )
        if frame.R_F_A is None:
            yield "how the IMU is turned on the forearm: R_F_A is left open; recovering does not need it"
    together, upper_arm = frames.get("upper_arm", 0), calibration.upper_arm
    rough_m = np.hypot(UPPER_ARM_SIGMA_M, np.nan_to_num(joint_bias_m))  # beside the camera's constant errors
    if known.upper_arm is None and together < FEW_FRAMES:
        yield f"shoulder and elbow were seen together in {together} frames only: the upper arm needs more"
    elif known.upper_arm is None and upper_arm is not None and upper_arm.sigma_m > rough_m:
        yield f"the upper arm's length is known to {1e3 * upper_arm.sigma_m:.0f} mm only"


def is_point(evidence: Evidence) -> bool:
    """Whether the camera saw the sensor itself and no joint: nothing of an arm can be asked."""
    seen = evidence.frames
    return seen.get("strap", 0) > 0 and not any(seen.get(joint, 0) for joint in ("elbow", "wrist", "hand"))


def beyond(sigma_m: FloatArray, joint_bias_m: float) -> FloatArray:
    """What a standard deviation holds besides the camera's constant errors, m."""
    bias = joint_bias_m if np.isfinite(joint_bias_m) else 0.0
    return np.sqrt(np.maximum(np.square(sigma_m) - bias**2, 0.0))


def known_to(sigma_rad: float) -> str:
    """How well an angle is known, in words: beyond a right angle it is not."""
    degrees = np.degrees(sigma_rad)
    return f"known to {degrees:.0f} degrees only" if degrees < UNKNOWN_DEG else "not known"


def clocks_not_determined(offsets: Sequence[ClockOffset]) -> Iterator[str]:
    """Recordings whose clock offset stayed open, one sentence each."""
    for each in offsets:
        if not np.isfinite(each.offset_s):
            yield f"{each.recording}: IMU and visible forearm never overlap; it was not used"
        elif each.sigma_s > CLOCK_SIGMA_S:
            yield (
                f"{each.recording}: the clock offset is known to {1e3 * each.sigma_s:.0f} ms only; "
                "the arm moved too little or too slowly"
            )


@dataclass(frozen=True)
class ArmEstimates:
    """What one or several recordings showed of the arm, the sensor and the clocks."""

    calibration: ArmCalibration  # Lever arms and lengths with their sigmas; carries over to other recordings
    # The forearm's axes in the IMU with their sigmas, None without elbow and wrist
    frame: ForearmFrame | None
    offsets: tuple[ClockOffset, ...]  # One per recording; never carried over
    evidence: Evidence  # How long the forearm was seen, and how it moved
    not_determined: tuple[str, ...]  # What the motion left open, one sentence each
    # Standard deviation of the camera's samples of a joint, m per axis
    camera_sigma_m: dict[str, float] = field(default_factory=dict)
    joint_bias_sigma_m: float = float("nan")  # How large a joint's constant error is, per axis
    given: tuple[str, ...] = ()  # What was given beforehand: lever arms by joint, `upper_arm`, `R_F_A`

    @property
    def lengths(self) -> dict[str, tuple[float, float]]:
        """Upper arm, forearm and the IMU's distance from the forearm's axis with their sigmas, m."""
        arm, frame, table = self.calibration, self.frame, {}
        if arm.upper_arm is not None:
            table["upper_arm"] = (arm.upper_arm.value_m, arm.upper_arm.sigma_m)
        if frame is not None:
            table["forearm"] = (frame.length_m, frame.length_sigma_m)
            table["imu_to_forearm_axis"] = (frame.distance_m, frame.distance_sigma_m)
        return table

    @property
    def figures(self) -> dict[str, Any]:
        """Plain values for `--json`."""
        arm, frame, evidence = self.calibration, self.frame, self.evidence
        values: dict[str, Any] = {
            "side": arm.side,
            "lever_arms": {joint: asdict(lever) for joint, lever in arm.lever_arms.items()},
            "lengths": {
                name: {"value_m": value, "sigma_m": sigma} for name, (value, sigma) in self.lengths.items()
            },
            "R_F_A": arm.R_F_A,
            "given": list(self.given),
            "clock_offsets": [asdict(offset) for offset in self.offsets],
            "camera_sigma_m": self.camera_sigma_m,
            "joint_bias_sigma_m": self.joint_bias_sigma_m,
            "visible_s": evidence.visible_s,
            "frames": evidence.frames,
            "turning_rms_deg_s": np.degrees(evidence.turning_rad_s),
            "turned_about_forearm_deg": np.degrees(evidence.axial_rad),
            "not_determined": list(self.not_determined),
        }
        if frame is not None:
            values |= {
                "forearm_direction": frame.direction,
                "forearm_direction_sigma_deg": np.degrees(frame.direction_sigma_rad),
                "roll_sigma_deg": np.degrees(frame.roll_sigma_rad),
            }
        return values

    @property
    def all_given(self) -> bool:
        """Whether nothing of the arm had to be found: lever arms and upper arm were given."""
        levers = set(self.calibration.lever_arms) - set(self.given)
        return not levers and (self.calibration.upper_arm is None or "upper_arm" in self.given)


def motion_answer(estimates: ArmEstimates) -> Answer:
    """How well the arm is known now, and what belongs into the file: the arm, and sigma's factors in gaps."""
    arm, open_questions = estimates.calibration, estimates.not_determined
    file = CalibrationFile().with_arm(arm)
    if arm.sigma_factors is not None:
        rows = [
            {"length_s": row.length_s, "factor": round(row.factor, 4), "count": row.gaps}
            for row in arm.sigma_factors.by_length
        ]
        file = with_sigma_table(file, rows, "the camera's joints", [])
    worst_m = max((float(np.max(lever.sigma_m)) for lever in arm.lever_arms.values()), default=np.nan)
    grade = "not good enough" if not arm.lever_arms else "usable" if open_questions else "good"
    sentence = f"lever arms are known to {1e3 * worst_m:.0f} mm per axis at worst (one sigma)"
    checks = [Check(each, remedy=MOVE, is_open=True) for each in open_questions]
    return Answer(
        grade, sentence if arm.lever_arms else "no lever arm was found", checks, file, estimates.figures
    )


def names_given(known: ArmCalibration | None) -> tuple[str, ...]:
    """What a calibration gives, by name: lever arms by joint, `upper_arm`, `R_F_A`."""
    if known is None:
        return ()
    parts = {"upper_arm": known.upper_arm, "R_F_A": known.R_F_A}
    return (*known.lever_arms, *(name for name, value in parts.items() if value is not None))


def with_given(recovery: Recovery, calibration: ArmCalibration | None) -> Recovery:
    """The recovery with the names of what was given for it, so that only the rest is called found."""
    given = names_given(calibration)
    return replace(recovery, estimates=replace(recovery.estimates, given=given)) if given else recovery


def found_in(recovery: Recovery, recording: Recording | None = None) -> ArmEstimates | None:
    """What a recovery found; None for methods that need no calibration, or that find no orientation."""
    arm = recovery.calibration
    if arm is None or not any(np.isfinite(batch.quaternion).any() for batch in recovery.batches()):
        return None
    given = recovery.estimates.given
    known = ArmCalibration(
        arm.side,
        {joint: lever for joint, lever in arm.lever_arms.items() if joint in given},
        arm.upper_arm if "upper_arm" in given else None,
        arm.R_F_A,
    )
    offsets: tuple[ClockOffset, ...] = ()
    if np.isfinite(recovery.clock_offset_s):
        drift_s = float("nan")  # how far the offset wandered is seen where the frames' own stamps are known
        if recording is not None and 0 < len(recording.arm) == len(recovery.arm):
            drift_s = float(np.ptp(recovery.arm.t_s - recording.arm.t_s))
        sigma_s = recovery.clock_offset_sigma_s
        offsets = (ClockOffset(recovery.name, recovery.clock_offset_s, sigma_s, drift_s),)
    stated = recovery.estimates
    bias_m = float("nan") if stated.joint_bias_sigma_m is None else stated.joint_bias_sigma_m
    noise = {joint: float(sigma) for joint, sigma in (stated.camera_sigma_m or {}).items()}
    return _estimates(arm, offsets, gather_from(recovery), known, noise, bias_m, given)


def _estimates(
    calibration: ArmCalibration,
    offsets: Sequence[ClockOffset],
    evidence: Evidence,
    known: ArmCalibration,
    noise_m: dict[str, float],
    bias_m: float,
    given: tuple[str, ...],
    left_out: tuple[str, ...] = (),
) -> ArmEstimates:
    """With what is still to be said of them."""
    frame = forearm_frame(calibration)
    rest = (*not_determined(calibration, frame, evidence, known, bias_m), *clocks_not_determined(offsets))
    whole = (calibration, frame, tuple(offsets), evidence, (*rest, *left_out), noise_m, bias_m, given)
    return ArmEstimates(*whole)


#: Lever arms of two recordings that differ by more than this on any axis, m and sigmas, are of two mountings.
APART_M, APART_SIGMAS = 0.04, 4.0
#: A shorter recording, s, says too little alone to contradict another.
ALONE_S = 10.0


def calibrate_motion(
    recordings: Sequence[Recording], known: ArmCalibration | None = None, config: Config | None = None
) -> ArmEstimates:
    """Calibrate one mounting of the IMU on one arm from visible motion, over all recordings together."""
    config = config or Config()
    if recordings:  # of one mounting: one sensor
        config = with_measured_noise(config, recordings[0].imu)
    sides = sorted({recording.side for recording in recordings if recording.side})
    if len(sides) > 1:
        raise CalibrationError("the recordings are of both arms; calibrate the left and the right apart")
    known = known or ArmCalibration(side=sides[0] if sides else "")
    recordings, along, left_out = _of_one_strap(recordings)
    moved = [pair(recording, along=along)[:2] for recording in recordings]
    segments = [
        reject_by_camera(segment)
        for number, (recording, _) in enumerate(moved)
        for segment in split_into_segments(recording, number)
    ]
    if not segments:
        raise CalibrationError("the IMU and a visible forearm overlap in none of the recordings")
    with Pool(config.windows.processes, sum(len(segment.frame_t_camera) for segment in segments)) as pool:
        if len(recordings) > 1 and along is None:
            _require_one_mounting(recordings, segments, known, config, pool)
        solved = self_calibrate(segments, known, config, pool)
    calibration = solved.estimate
    frame = forearm_frame(calibration)
    if calibration.R_F_A is None and frame is not None:
        calibration = replace(calibration, R_F_A=frame.R_F_A)
    if calibration.sigma_factors is None and (short := short_recordings(recordings)):
        calibration = replace(calibration, sigma_factors=hidden_gap_factors(short, calibration, config))
    accepted = _counted(segment.accepted for segment in segments)
    evidence = _evidence(map(_turns_of_segment, segments), accepted, calibration.forearm_direction)
    used, offsets = {segment.recording for segment in segments}, []
    for number, (recording, (_, coarse)) in enumerate(zip(recordings, moved, strict=True)):
        offset = ClockOffset(recording.name)
        if number in used and number < len(solved.clocks):
            clock = solved.clocks[number].after(coarse)
            offset = ClockOffset(recording.name, clock.mean_s, clock.sigma_s, clock.drift_s)
        offsets.append(offset)
    noise = {joint: own.sample_m for joint, own in solved.joint_noise.items()}
    bias_m, given = solved.joint_bias.sigma_m, names_given(known)
    return _estimates(calibration, offsets, evidence, known, noise, bias_m, given, left_out)


def _of_one_strap(
    recordings: Sequence[Recording],
) -> tuple[Sequence[Recording], FloatArray | None, tuple[str, ...]]:
    """Recordings whose clocks show together, the forearm's direction in the sensor, and what was left out.

    All of them, and None, where their clocks are known without.
    """
    if sum(recording.clocks_unrelated for recording in recordings) < len(recordings) or len(recordings) < 2:
        return recordings, None, ()
    straps = find_straps(recordings)
    if not straps:
        return recordings, None, ()
    if len(straps) > 1:
        listed = "; ".join(", ".join(recordings[number].name for number in strap.members) for strap in straps)
        raise CalibrationError(
            f"the IMU sat on the forearm in {len(straps)} ways: the strap was put on anew, or there are"
            f" several persons; calibrate each group by itself: {listed}"
        )
    members = straps[0].members
    foreign = [number for number in range(len(recordings)) if number not in members]
    damaged = [number for number in members if any(clipped(recordings[number].imu, PLATEAU_SHARE))]
    if len(damaged) == len(members):  # there are no better ones
        damaged = []
    left_out = tuple(
        f"{', '.join(recordings[number].name for number in numbers)}: {why}; left out"
        for numbers, why in (
            (foreign, "the motion does not show the clock there"),
            (damaged, "the sensor was clipped"),
        )
        if numbers
    )
    used = [recordings[number] for number in members if number not in damaged]
    return used, straps[0].along, left_out


def _require_one_mounting(
    recordings: Sequence[Recording],
    segments: Sequence[Segment],
    known: ArmCalibration,
    config: Config,
    pool: Pool,
) -> None:
    """Solve every recording alone, and refuse those whose lever arms are not the others'."""
    alone: dict[str, ArmCalibration] = {}
    names = [recording.name for recording in recordings]
    for number, name in enumerate(names):
        own = [replace(segment, recording=0) for segment in segments if segment.recording == number]
        if sum(segment.end_s - segment.start_s for segment in own) >= ALONE_S:
            with suppress(CalibrationError):  # one that shows nothing alone contradicts no other
                label = name if names.count(name) == 1 else f"{name} ({number + 1})"
                alone[label] = self_calibrate(own, known, config, pool).estimate
    groups = mountings(alone)
    if len(groups) > 1:
        listed = "; ".join(", ".join(group) for group in groups)
        raise CalibrationError(
            f"the recordings are of {len(groups)} mountings or persons: their lever arms disagree by more"
            f" than their sigmas allow; calibrate each group by itself: {listed}"
        )


def mountings(alone: dict[str, ArmCalibration]) -> list[list[str]]:
    """Recordings whose lever arms agree, as groups: none is elsewhere by centimetres and by sigmas."""

    def worst_m(name: str) -> float:
        levers = alone[name].lever_arms.values()
        return max((float(np.max(lever.sigma_m)) for lever in levers), default=np.inf)

    def agree(one: ArmCalibration, other: ArmCalibration) -> bool:
        for joint in set(one.lever_arms) & set(other.lever_arms):
            a, b = one.lever_arms[joint], other.lever_arms[joint]
            most = np.maximum(APART_M, APART_SIGMAS * np.hypot(a.sigma_m, b.sigma_m))
            if (np.abs(a.position_m - b.position_m) > most).any():
                return False
        return True

    groups: list[list[str]] = []
    for name in sorted(alone, key=worst_m):
        own = next((group for group in groups if agree(alone[group[0]], alone[name])), [])
        if not own:
            groups.append(own)
        own.append(name)
    in_order = [[name for name in alone if name in group] for group in groups]
    return sorted(in_order, key=lambda group: list(alone).index(group[0]))
