"""`calibrate motion`: lever arms, limb lengths and mounting from one or several recordings of a person."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from smoother.calibration import ArmCalibration
from smoother.config import Config
from smoother.errors import CalibrationError
from smoother.measurements.clock import LARGEST_OFFSET_S, Clock
from smoother.measurements.outliers import reject_by_camera
from smoother.measurements.segment import split_into_segments
from smoother.recording import JOINTS, Recording
from smoother.runtime.pool import Pool
from smoother.selfcal.coarse_clock import synchronise_coarsely
from smoother.selfcal.rounds import SelfCalibration, self_calibrate
from smoother.window.priors import with_measured_noise

from ..forearm.forearm_frame import forearm_frame
from .estimates import ArmEstimates, JointError, names_given
from .evidence import ClockOffset, gather
from .motion_summary import clocks_not_determined, not_determined


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
        No recording shows the forearm together with the IMU, or they are of different arms.
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
