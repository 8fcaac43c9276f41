"""The self-calibration of what was recorded so far, as a job for a process of its own."""

from __future__ import annotations

from dataclasses import dataclass

from ..calibration import ArmCalibration
from ..config import Config
from ..errors import CalibrationError, UnoccludeError
from ..measurements.clock import OFFSET_SIGMA_S, Clock
from ..measurements.outliers import reject_by_camera
from ..measurements.timeline import Timeline
from ..recording import Recording
from ..runtime.pool import Pool
from ..selfcal.coarse_clock import synchronise_coarsely
from ..selfcal.excerpts import informative_excerpts
from ..selfcal.rounds import SelfCalibration, self_calibrate
from ..window.priors import with_measured_noise


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
    """

    recording: Recording
    given: ArmCalibration
    config: Config


@dataclass(frozen=True)
class LiveCalibration:
    """What a self-calibration answered.

    Attributes
    ----------
    until_s : float, s
        The last IMU sample that it read, on the IMU's clock.
    model : SelfCalibration or None
        None where the motion did not suffice.
    clock : Clock or None
        t_imu = t_camera + offset, of the camera's own stamps; None without a model.
    reason : str
        Why there is no model, one sentence; "" where there is one.
    """

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
    until_s = float(job.recording.imu.t_s[-1])
    try:
        timeline = Timeline.of(job.recording)
        recording, coarse = synchronise_coarsely(job.recording, timeline, None)
        excerpts = [reject_by_camera(excerpt) for excerpt in informative_excerpts(recording, timeline)]
        if not excerpts:
            raise CalibrationError("the IMU and a visible forearm have not come together yet")
        config = with_measured_noise(job.config, recording.imu)
        with Pool(1, 0) as here:
            model = self_calibrate(excerpts, job.given, config, here, OFFSET_SIGMA_S)
    except (UnoccludeError, ValueError, ArithmeticError) as error:
        return LiveCalibration(until_s, reason=str(error))
    if model.mounting_unknown:
        return LiveCalibration(until_s, reason="the arm has to move more: how the IMU sits does not show yet")
    return LiveCalibration(until_s, model, model.clock.after(coarse))
