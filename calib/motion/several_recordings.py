"""`calibrate motion`: lever arms, limb lengths and mounting from one or several recordings of a person."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from smoother.calibration import ArmCalibration
from smoother.config import Config
from smoother.errors import CalibrationError
from smoother.measurements.clock import LARGEST_OFFSET_S, Clock
from smoother.measurements.outliers import reject_by_camera
from smoother.measurements.segment import Segment, split_into_segments
from smoother.recording import JOINTS, Recording
from smoother.runtime.pool import Pool
from smoother.selfcal.coarse_clock import synchronise_coarsely
from smoother.selfcal.rounds import self_calibrate
from smoother.selfcal.self_calibration import SelfCalibration
from smoother.window.priors import with_measured_noise

from ..forearm.forearm_frame import forearm_frame
from .estimates import ArmEstimates, JointError, names_given
from .evidence import ClockOffset, gather
from .motion_summary import clocks_not_determined, not_determined

#: Lever arms of two recordings that differ by more than this on an axis, m and sigmas, are of two mountings.
APART_M, APART_SIGMAS = 0.04, 4.0
#: A shorter recording, s, says too little alone to contradict another.
ALONE_S = 10.0


@dataclass(frozen=True, kw_only=True)
class MotionCalibration(ArmEstimates):
    """What the recordings told, and what it was solved from.

    Attributes
    ----------
    self_calibration : SelfCalibration
        All that was solved for together, clocks included.
    """

    self_calibration: SelfCalibration


def calibrate_motion(
    recordings: Sequence[Recording], known: ArmCalibration | None = None, config: Config | None = None
) -> MotionCalibration:
    """Calibrate one mounting of the IMU on one arm from visible motion, over all recordings together.

    Parameters
    ----------
    recordings : sequence of Recording
        Of one person, arm and mounting; each keeps a clock offset and gravity of its own.
    known : ArmCalibration, optional
        What is measured already, a prior with its sigmas.
    config : Config, optional
        Settings; the defaults where None.

    Returns
    -------
    found : MotionCalibration
        See `motion_answer` for what belongs into a file.

    Raises
    ------
    CalibrationError
        No recording shows the forearm together with the IMU, or they are of different arms or mountings.
    """
    config = config or Config()
    if recordings:  # of one mounting: one sensor
        config = with_measured_noise(config, recordings[0].imu)
    sides = sorted({recording.side for recording in recordings if recording.side})
    if len(sides) > 1:
        raise CalibrationError("the recordings are of both arms; calibrate the left and the right apart")
    known = known or ArmCalibration(side=sides[0] if sides else "")
    moved = [synchronise_coarsely(recording) for recording in recordings]
    segments = [
        reject_by_camera(segment)
        for number, (recording, _) in enumerate(moved)
        for segment in split_into_segments(recording, LARGEST_OFFSET_S, number)
    ]
    if not segments:
        raise CalibrationError("in none of the recordings do the IMU and a visible forearm come together")
    with Pool(config.windows.processes, sum(len(segment.frame_t_camera) for segment in segments)) as pool:
        if len(recordings) > 1:
            _require_one_mounting(recordings, segments, known, config, pool)
        solved = self_calibrate(segments, known, config, pool)
    calibration = solved.estimate
    frame = forearm_frame(calibration)
    if calibration.R_F_A is None and frame is not None:
        calibration = replace(calibration, R_F_A=frame.R_F_A)
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
        not_determined=(*left_open, *clocks_not_determined(offsets)),
        camera={
            joint: JointError(noise.sample_m, float(shifts_m[JOINTS.index(joint)]))
            for joint, noise in solved.joint_noise.items()
        },
        joint_bias_sigma_m=solved.joint_bias.sigma_m,
        given=names_given(known),
        self_calibration=solved,
    )


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
            with suppress(CalibrationError):  # one that tells nothing alone contradicts nobody
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
    """Recordings whose lever arms agree, as groups.

    Parameters
    ----------
    alone : dict of str to ArmCalibration
        By recording what it says by itself.

    Returns
    -------
    groups : list of list of str
        The best determined recording of a group leads it; those that fit several are in the first.
    """
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
        if number not in used:
            offsets.append(ClockOffset(recording.name))
            continue
        clock = solved.clocks[number].after(coarse[number])
        offsets.append(ClockOffset(recording.name, clock.mean_s, clock.sigma_s, clock.drift_s))
    return tuple(offsets)
