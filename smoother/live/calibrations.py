"""The self-calibrations of a session: when one is asked for, and what the last one says."""

from __future__ import annotations

import numpy as np

from ..array_types import FloatArray
from ..calibration import ArmCalibration
from ..config import Config
from ..measurements.visibility import joints_needed
from ..recording import CameraFrame, Recording
from .calibration_job import CalibrationJob, LiveCalibration
from .calibrator import Calibrator
from .camera_clock import USUAL_LATENCY_S, CameraClock
from .frame_buffer import FrameBuffer
from .imu_buffer import ImuBuffer

#: Self-calibrations begin with so much and are tried so often until one works; then at these lengths, and
#: as often as the last says, s.
FIRST_S, RETRY_S = 8.0, 2.0
AGAIN_S = (15.0, 30.0, 60.0, 120.0)
#: What a jump of the camera's clock leaves open, s.
JUMP_SIGMA_S = 0.02


class Calibrations:
    """Asks for a self-calibration when it is time, and holds the last one that worked.

    Parameters
    ----------
    calibrator : Calibrator
        Who works it out.
    side : {"left", "right", ""}
    given : ArmCalibration
        What is known beforehand.
    config : Config
    gravity_hint : ndarray, shape (3,), or None
        Direction of down in {K}.
    camera_frame : CameraFrame or None

    Attributes
    ----------
    last : LiveCalibration or None
        The last that worked.
    offset_s, clock_sigma_s : float, s
        t_imu = t_camera + offset, and its standard deviation; nan before the first.
    needed : int
        Joints of the forearm that make a frame visible.
    reason : str
        How the self-calibration stands, in words.
    """

    def __init__(
        self,
        calibrator: Calibrator,
        side: str,
        given: ArmCalibration,
        config: Config,
        gravity_hint: FloatArray | None,
        camera_frame: CameraFrame | None,
    ) -> None:
        self._calibrator, self._side, self._given, self._config = calibrator, side, given, config
        self._gravity_hint, self._camera_frame = gravity_hint, camera_frame
        self._asked_s: float | None = None
        self._count = 0
        self.last: LiveCalibration | None = None
        self.offset_s = self.clock_sigma_s = float("nan")
        self.needed = 1
        self.reason = "waiting for the first seconds of both streams"

    def fetch(self) -> bool:
        """Fetch an answer; True where there is a new calibration."""
        answer = self._calibrator.answer()
        if answer is None:
            return False
        if answer.model is None or answer.clock is None:
            self.reason = answer.reason
            return False
        self._count += 1
        self.last = answer
        self.reason = f"calibrated from {answer.until_s - answer.from_s:.0f} s of motion"
        at = np.array([answer.until_s - answer.clock.mean_s])
        self.offset_s, self.clock_sigma_s = float(answer.clock.at(at)[0]), answer.clock.sigma_s
        return True

    def ask(self, imu: ImuBuffer, frames: FrameBuffer, camera: CameraClock) -> None:
        """Ask for the next one when it is time."""
        if self._calibrator.busy or not len(imu) or not len(frames):
            return
        arrival_offset_s = camera.delay_s - USUAL_LATENCY_S
        if not self._is_due(imu, frames, arrival_offset_s):
            return
        self._asked_s = imu.end_s
        arm = frames.tracks(-np.inf)
        self.needed = joints_needed(arm)
        recording = Recording(
            imu=imu.stream(-np.inf),
            arm=arm,
            side=self._side,
            camera_frame=self._camera_frame,
            gravity_hint=self._gravity_hint,
            name="live",
        )
        offset_s = arrival_offset_s if np.isnan(self.offset_s) else self.offset_s
        self._calibrator.submit(CalibrationJob(recording, self._given, self._config, offset_s))

    def clock_jumped(self) -> None:
        """The camera's clock jumped: it is less certain, and the next calibration is due."""
        self.clock_sigma_s = float(np.hypot(self.clock_sigma_s, JUMP_SIGMA_S))
        self._asked_s = None if self.last is None else -np.inf

    def close(self) -> None:
        """End the background's work."""
        self._calibrator.close()

    def _is_due(self, imu: ImuBuffer, frames: FrameBuffer, arrival_offset_s: float) -> bool:
        if self._asked_s is None:
            start_s = max(float(imu.t[0]), frames.since(-np.inf)[0].t_s + arrival_offset_s)
            return imu.end_s - start_s >= FIRST_S
        wait_s = RETRY_S if self.last is None else AGAIN_S[min(self._count, len(AGAIN_S)) - 1]
        return imu.end_s - self._asked_s >= wait_s
