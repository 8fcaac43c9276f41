"""The self-calibration of what was recorded so far, as a job for a process of its own."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from ..calibration import ArmCalibration
from ..config import Config
from ..errors import UnoccludeError
from ..measurements.clock import OFFSET_SIGMA_S, Clock, constant_clock
from ..measurements.outliers import reject_by_camera
from ..measurements.timeline import Timeline
from ..recording import Recording
from ..runtime.pool import Pool
from ..selfcal.coarse_clock import coarse_clock
from ..selfcal.excerpts import informative_excerpts
from ..selfcal.rounds import self_calibrate
from ..selfcal.self_calibration import SelfCalibration
from ..window.priors import with_measured_noise

#: Joints that fit no better than this to any mounting and clock are not calibrated, m an axis.
LARGEST_SIGMA_M = 0.10


@dataclass(frozen=True)
class CalibrationJob:
    """What a self-calibration reads.

    Attributes
    ----------
    recording : Recording
        The last minutes.
    given : ArmCalibration
        What is known beforehand.
    config : Config
    offset_s : float, s
        t_imu = t_camera + offset, to some tenths of a second: from the frames' arrival, or an earlier answer.
    """

    recording: Recording
    given: ArmCalibration
    config: Config
    offset_s: float = 0.0


@dataclass(frozen=True)
class LiveCalibration:
    """What a self-calibration answered.

    Attributes
    ----------
    from_s, until_s : float, s
        The first and the last IMU sample that it read, on the IMU's clock.
    model : SelfCalibration or None
        None where the motion did not suffice.
    clock : Clock or None
        t_imu = t_camera + offset, of the camera's own stamps; None without a model.
    reason : str
        Why there is no model, one sentence; "" where there is one.
    """

    from_s: float
    until_s: float
    model: SelfCalibration | None = None
    clock: Clock | None = None
    reason: str = ""


def calibrate_excerpts(job: CalibrationJob) -> LiveCalibration:
    """Work a self-calibration out, as `smooth` begins with it; what fails is answered, not raised.

    Parameters
    ----------
    job : CalibrationJob

    Returns
    -------
    calibration : LiveCalibration
    """
    answer = _calibrated(job, constant_clock(job.offset_s))
    if answer.model is None:  # the clocks may be farther apart than the frames' arrival says
        with suppress(UnoccludeError):
            coarse = coarse_clock(job.recording)
            answer = answer if coarse is None else _calibrated(job, coarse)
    t = job.recording.imu.t_s
    return replace(answer, from_s=float(t[0]), until_s=float(t[-1]))


def _calibrated(job: CalibrationJob, before: Clock) -> LiveCalibration:
    """A self-calibration with the camera's stamps moved beforehand."""
    arm = job.recording.arm
    recording = replace(job.recording, arm=replace(arm, t_s=before.to_imu(arm.t_s)))
    try:
        excerpts = [
            reject_by_camera(excerpt) for excerpt in informative_excerpts(recording, Timeline.of(recording))
        ]
        if not excerpts:
            return LiveCalibration(
                np.nan, np.nan, reason="the IMU and a visible forearm have not come together yet"
            )
        config = with_measured_noise(job.config, recording.imu)
        with Pool(1, 0) as here:
            model = self_calibrate(excerpts, job.given, config, here, OFFSET_SIGMA_S)
    except (UnoccludeError, ValueError, ArithmeticError) as error:
        return LiveCalibration(np.nan, np.nan, reason=str(error))
    if model.mounting_unknown:
        return LiveCalibration(
            np.nan, np.nan, reason="the arm has to move more: how the IMU sits does not show yet"
        )
    if not model.joint_sigma_m.max() < LARGEST_SIGMA_M:
        return LiveCalibration(
            np.nan, np.nan, reason="camera and IMU do not fit each other yet: move the arm in view"
        )
    return LiveCalibration(np.nan, np.nan, model, model.clock.after(before))
