"""`calibrate motion`: lever arms, lengths and mounting from recordings, and what was found of an arm."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from smoother.array_types import FloatArray
from smoother.calibration import ArmCalibration
from smoother.config import Config
from smoother.errors import CalibrationError
from smoother.measurements.clock import LARGEST_OFFSET_S, Clock
from smoother.measurements.outliers import reject_by_camera
from smoother.measurements.segment import Segment, split_into_segments
from smoother.recording import JOINTS, Recording
from smoother.recovery.imu_signs import PLATEAU_SHARE, clipped
from smoother.result import Recovery
from smoother.runtime.pool import Pool
from smoother.selfcal.pairing import synchronise_coarsely
from smoother.selfcal.rounds import self_calibrate
from smoother.selfcal.self_calibration import SelfCalibration
from smoother.selfcal.session import find_straps
from smoother.window.priors import with_measured_noise

from ..file import CalibrationFile, with_sigma_table
from ..forearm.forearm_frame import ForearmFrame, forearm_frame
from ..protocol import Answer
from .motion_summary import (
    ClockOffset,
    Evidence,
    clocks_not_determined,
    gather,
    gather_from,
    motion_verdict,
    not_determined,
)


@dataclass(frozen=True)
class JointError:
    """Errors of the camera's samples of one joint, m per axis."""

    sample_m: float  # Standard deviation of one sample
    # Length of the constant error against the other joints, nan where it was not looked for
    bias_m: float = float("nan")


@dataclass(frozen=True)
class ArmEstimates:
    """What one or several recordings showed of the arm, the sensor and the clocks."""

    calibration: ArmCalibration  # Lever arms and lengths with their sigmas; carries over to other recordings
    # The forearm's axes in the IMU with their sigmas, None without elbow and wrist
    frame: ForearmFrame | None
    offsets: tuple[ClockOffset, ...]  # One per recording; never carried over
    evidence: Evidence  # How long the forearm was seen, and how it moved
    not_determined: tuple[str, ...]  # What the motion left open, one sentence each
    camera: dict[str, JointError] = field(default_factory=dict)  # Errors of the camera's joints, by name
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
            "camera_sigma_m": {joint: error.sample_m for joint, error in self.camera.items()},
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
    """Lever arms, lengths and mounting in the form that every calibration answers in."""
    arm, left_open = estimates.calibration, estimates.not_determined
    return Answer(motion_verdict(arm, left_open), left_open, _file_of(arm), estimates.figures)


def _file_of(arm: ArmCalibration) -> CalibrationFile:
    """The arm, and how much wider sigma must be in gaps where hidden ones have shown that."""
    file = CalibrationFile().with_arm(arm)
    if arm.sigma_factors is None:
        return file
    rows = [
        {"length_s": row.length_s, "factor": round(row.factor, 4), "count": row.gaps}
        for row in arm.sigma_factors.by_length
    ]
    return with_sigma_table(file, rows, "the camera's joints", [])


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
    frame, evidence = forearm_frame(arm), gather_from(recovery)
    offsets: tuple[ClockOffset, ...] = ()
    if np.isfinite(recovery.clock_offset_s):
        offset_s, sigma_s = recovery.clock_offset_s, recovery.clock_offset_sigma_s
        offsets = (ClockOffset(recovery.name, offset_s, sigma_s, _drift(recovery, recording)),)
    stated = recovery.estimates
    bias_sigma_m = float("nan") if stated.joint_bias_sigma_m is None else stated.joint_bias_sigma_m
    noise, bias = stated.camera_sigma_m or {}, stated.joint_bias_m or {}
    return ArmEstimates(
        calibration=arm,
        frame=frame,
        offsets=offsets,
        evidence=evidence,
        not_determined=(
            *not_determined(arm, frame, evidence, known, bias_sigma_m),
            *clocks_not_determined(offsets),
        ),
        camera={
            joint: JointError(
                float(sigma), float(np.linalg.norm(bias[joint])) if joint in bias else float("nan")
            )
            for joint, sigma in noise.items()
        },
        joint_bias_sigma_m=bias_sigma_m,
        given=given,
    )


def _drift(recovery: Recovery, recording: Recording | None) -> float:
    """How far the offset wandered, s; nan where that cannot be determined."""
    if recording is None or not 0 < len(recording.arm) == len(recovery.arm):
        return float("nan")
    return float(np.ptp(recovery.arm.t_s - recording.arm.t_s))


#: Lever arms of two recordings that differ by more than this on any axis, m and sigmas, are of two mountings.
APART_M, APART_SIGMAS = 0.04, 4.0
#: A shorter recording, s, says too little alone to contradict another.
ALONE_S = 10.0


@dataclass(frozen=True, kw_only=True)
class MotionCalibration(ArmEstimates):
    """What the recordings showed, and what it was solved from."""

    self_calibration: SelfCalibration  # All that was solved for together, clocks included


def calibrate_motion(
    recordings: Sequence[Recording], known: ArmCalibration | None = None, config: Config | None = None
) -> MotionCalibration:
    """Calibrate one mounting of the IMU on one arm from visible motion, over all recordings together."""
    from ..sigma_factor import (  # with SciPy, which `smooth` does not need
        hidden_gap_factors,
        short_recordings,
    )

    config = config or Config()
    if recordings:  # of one mounting: one sensor
        config = with_measured_noise(config, recordings[0].imu)
    sides = sorted({recording.side for recording in recordings if recording.side})
    if len(sides) > 1:
        raise CalibrationError("the recordings are of both arms; calibrate the left and the right apart")
    known = known or ArmCalibration(side=sides[0] if sides else "")
    recordings, along, left_out = _of_one_strap(recordings)
    moved = [synchronise_coarsely(recording, along=along) for recording in recordings]
    segments = [
        reject_by_camera(segment)
        for number, (recording, _) in enumerate(moved)
        for segment in split_into_segments(recording, LARGEST_OFFSET_S, number)
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
    evidence = gather(segments, calibration.forearm_direction)
    coarse = [clock for _, clock in moved]
    offsets = _offsets(recordings, coarse, {segment.recording for segment in segments}, solved)
    left_open = not_determined(calibration, frame, evidence, known, solved.joint_bias.sigma_m)
    shifts_m = np.linalg.norm(solved.joint_bias.error_m, axis=1)
    return MotionCalibration(
        calibration=calibration,
        frame=frame,
        offsets=offsets,
        evidence=evidence,
        not_determined=(*left_open, *clocks_not_determined(offsets), *left_out),
        camera={
            joint: JointError(noise.sample_m, float(shifts_m[JOINTS.index(joint)]))
            for joint, noise in solved.joint_noise.items()
        },
        joint_bias_sigma_m=solved.joint_bias.sigma_m,
        given=names_given(known),
        self_calibration=solved,
    )


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
    """Recordings whose lever arms agree, as groups."""
    groups: list[list[str]] = []
    for name in sorted(alone, key=lambda name: _worst_sigma_m(alone[name])):
        for group in groups:
            if not _disagree(alone[group[0]], alone[name]):
                group.append(name)
                break
        else:
            groups.append([name])
    order = list(alone)
    return sorted((sorted(group, key=order.index) for group in groups), key=lambda g: order.index(g[0]))


def _worst_sigma_m(arm: ArmCalibration) -> float:
    return max((float(np.max(lever.sigma_m)) for lever in arm.lever_arms.values()), default=np.inf)


def _disagree(one: ArmCalibration, other: ArmCalibration) -> bool:
    """Whether a lever arm is elsewhere on some axis, by centimetres and by sigmas."""
    for joint in set(one.lever_arms) & set(other.lever_arms):
        a, b = one.lever_arms[joint], other.lever_arms[joint]
        apart = np.abs(a.position_m - b.position_m)
        if (apart > np.maximum(APART_M, APART_SIGMAS * np.hypot(a.sigma_m, b.sigma_m))).any():
            return True
    return False


def _offsets(
    recordings: Sequence[Recording],
    coarse: Sequence[Clock | None],
    used: set[int],
    solved: SelfCalibration,
) -> tuple[ClockOffset, ...]:
    offsets = []
    for number, recording in enumerate(recordings):
        if number not in used or number >= len(solved.clocks):
            offsets.append(ClockOffset(recording.name))
            continue
        clock = solved.clocks[number].after(coarse[number])
        offsets.append(ClockOffset(recording.name, clock.mean_s, clock.sigma_s, clock.drift_s))
    return tuple(offsets)
