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

from ..forearm.forearm_frame import ForearmFrame, forearm_frame
from .estimates import ArmEstimates, JointError, names_given
from .evidence import ClockOffset, Evidence, gather
from .motion_summary import clocks_not_determined, not_determined


@dataclass(frozen=True)
class MotionCalibration:
    """What the recordings told.

    Attributes
    ----------
    calibration : lever arms, lengths and mounting with sigmas; carries over to other recordings.
    knowledge : all that was found, clock offsets (one a recording, never carried over) included.
    recordings : names in the order of the offsets.
    offsets : clock offset of each recording.
    frame : the forearm's axes in the IMU with their sigmas, None without elbow and wrist.
    evidence : how long the forearm was seen, and how it moved.
    not_determined : what the motion left open, one sentence each.
    given : what was given beforehand, by name.
    """

    calibration: ArmCalibration
    knowledge: SelfCalibration
    recordings: tuple[str, ...]
    offsets: tuple[ClockOffset, ...]
    frame: ForearmFrame | None
    evidence: Evidence
    not_determined: tuple[str, ...]
    given: tuple[str, ...] = ()

    @property
    def found(self) -> ArmEstimates:
        """The same in the form that recoveries share."""
        bias = self.knowledge.joint_bias
        return ArmEstimates(
            calibration=self.calibration,
            frame=self.frame,
            offsets=self.offsets,
            evidence=self.evidence,
            not_determined=self.not_determined,
            camera={
                joint: JointError(noise.sample_m, float(np.linalg.norm(bias.error_m[JOINTS.index(joint)])))
                for joint, noise in self.knowledge.joint_noise.items()
            },
            joint_bias_sigma_m=bias.sigma_m,
            given=self.given,
        )


def calibrate_motion(
    recordings: Sequence[Recording], known: ArmCalibration | None = None, config: Config | None = None
) -> MotionCalibration:
    """Calibrate one mounting of the IMU on one arm from visible motion, over all recordings together.

    Parameters
    ----------
    recordings : of one person, arm and mounting; each keeps a clock offset and gravity of its own.
    known : what is measured already; it is believed to its sigmas.
    config : settings; the defaults where None.

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
        knowledge = self_calibrate(segments, known, config, pool)
    calibration = knowledge.estimate
    frame = forearm_frame(calibration)
    if calibration.R_F_A is None and frame is not None:
        calibration = replace(calibration, R_F_A=frame.R_F_A)
    evidence = gather(segments, calibration.forearm_direction)
    offsets = _offsets(
        recordings, [coarse for _, coarse in moved], {p.recording for p in segments}, knowledge
    )
    left_open = [
        *not_determined(calibration, frame, evidence, known, knowledge.joint_bias.sigma_m),
        *clocks_not_determined(offsets),
    ]
    return MotionCalibration(
        calibration=calibration,
        knowledge=knowledge,
        recordings=tuple(recording.name for recording in recordings),
        offsets=offsets,
        frame=frame,
        evidence=evidence,
        not_determined=tuple(left_open),
        given=names_given(known),
    )


def _offsets(
    recordings: Sequence[Recording],
    coarse: Sequence[Clock | None],
    used: set[int],
    knowledge: SelfCalibration,
) -> tuple[ClockOffset, ...]:
    offsets = []
    for number, recording in enumerate(recordings):
        if number not in used:
            offsets.append(ClockOffset(recording.name))
            continue
        clock = knowledge.clocks[number].after(coarse[number])
        offsets.append(ClockOffset(recording.name, clock.mean_s, clock.sigma_s, clock.drift_s))
    return tuple(offsets)
