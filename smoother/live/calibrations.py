"""The self-calibrations of a session, worked out in the background while the arm is followed."""

from __future__ import annotations

import math
import multiprocessing
import os
from collections.abc import Callable, Mapping
from concurrent.futures import Future, ProcessPoolExecutor, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..calibration import ArmCalibration
from ..config import Config
from ..errors import UnoccludeError
from ..measurements.clock import OFFSET_SIGMA_S, Clock, constant_clock
from ..measurements.outliers import reject_by_camera
from ..measurements.segment import Timeline
from ..measurements.visibility import joints_needed
from ..recording import Recording
from ..runtime.pool import Pool, end_if_one_died, end_workers, prepare_worker, starting_processes
from ..selfcal.excerpts import informative_excerpts
from ..selfcal.further_imu import calibrate_further_imus, without_joints_of
from ..selfcal.pairing import find_pairing
from ..selfcal.rounds import self_calibrate
from ..selfcal.self_calibration import SelfCalibration
from ..window.priors import with_measured_noise
from .buffers import USUAL_LATENCY_S, CameraClock, FrameBuffer
from .further_imus import FEWEST_SAMPLES, FurtherPlace
from .imu import LiveImu

#: Joints that fit no better than this to any mounting and clock are not calibrated, m per axis.
LARGEST_SIGMA_M = 0.10


@dataclass(frozen=True)
class LiveCalibration:
    """What a self-calibration answered."""

    # The first and the last IMU sample that it read, on the IMU's clock
    from_s: float = math.nan
    until_s: float = math.nan
    model: SelfCalibration | None = None  # None where the motion did not suffice
    clock: Clock | None = None  # t_imu = t_camera + offset, of the camera's own stamps; None without a model
    reason: str = ""  # Why there is no model, one sentence; "" where there is one
    further: tuple[FurtherPlace, ...] = ()  # The IMUs beyond the forearm that the model contains
    left_out: tuple[str, ...] = ()  # Why it does not contain the others, a sentence each


def calibrate_excerpts(
    recording: Recording,  # The last minutes
    given: ArmCalibration,  # What is known beforehand
    config: Config,
    offset_s: float = 0.0,  # t_imu = t_camera + offset, to some tenths of a second
) -> LiveCalibration:
    """Work a self-calibration out, as `smooth` begins with it; what fails is answered, not raised."""
    answer = _calibrated(recording, given, config, constant_clock(offset_s))
    if answer.model is None:  # the clocks may be farther apart than the frames' arrival says
        with suppress(UnoccludeError):
            _, coarse = find_pairing(recording)
            answer = answer if coarse is None else _calibrated(recording, given, config, coarse)
    t = recording.imu.t_s
    return replace(answer, from_s=float(t[0]), until_s=float(t[-1]))


def _calibrated(
    recording: Recording, given: ArmCalibration, config: Config, before: Clock
) -> LiveCalibration:
    """A self-calibration with the camera's stamps moved beforehand."""
    arm = recording.arm
    recording = replace(recording, arm=replace(arm, t_s=before.to_imu(arm.t_s)))
    config = with_measured_noise(config, recording.imu)
    try:
        excerpts = [
            reject_by_camera(each) for each in informative_excerpts(recording, Timeline.of(recording))
        ]
        if not excerpts:
            return LiveCalibration(reason="the IMU and a visible forearm do not overlap yet")
        with Pool(1, 0) as here:
            further, left_out = calibrate_further_imus(recording, given, config, here)
            own = [without_joints_of(excerpt, further) for excerpt in excerpts]
            model = self_calibrate(own, given, config, here, OFFSET_SIGMA_S)
    except (UnoccludeError, ValueError, ArithmeticError) as error:
        return LiveCalibration(reason=str(error))
    if model.mounting_unknown:
        return LiveCalibration(reason="the arm has to move more: the IMU's mounting is not determined yet")
    if not model.joint_sigma_m.max() < LARGEST_SIGMA_M:
        return LiveCalibration(reason="camera and IMU do not fit each other yet: move the arm in view")
    places, end_s = [], recording.arm.t_s[-1:]
    for imu in further:
        shift_s = float((model.clock.at(end_s) - imu.clock.at(end_s))[0])
        places.append(FurtherPlace(imu.segment.name, imu.model.errors.imu, shift_s))
        model = imu.joined(model)
    # without those that were given of IMUs that are not there
    there = {each.segment: model.estimate.mountings[each.segment] for each in places}
    model = replace(model, estimate=replace(model.estimate, mountings=there))
    clock = model.clock.after(before)
    return LiveCalibration(model=model, clock=clock, further=tuple(places), left_out=tuple(left_out))


#: The background leaves the processor to what is live (`os.nice`).
NICE = 10


class InlineCalibrator:
    """Works self-calibrations out at once, in this process: for recordings played as fast as possible."""

    def __init__(self, delay: int = 0) -> None:
        self._delay, self._asked = delay, 0
        self._future: Future[LiveCalibration] | None = None

    @property
    def busy(self) -> bool:
        """It works, or its answer was not fetched yet."""
        return self._future is not None

    def submit(self, *job: Any) -> None:
        """Begin with what `calibrate_excerpts` reads; not while busy."""
        with ThreadPoolExecutor(1) as aside:  # its processor time is not the live thread's
            self._future, self._asked = aside.submit(calibrate_excerpts, *job), 0

    def answer(self) -> LiveCalibration | None:
        """The answer, once; None while there is none."""
        self._asked += 1
        if self._future is None or self._asked <= self._delay or not self._future.done():
            return None
        future, self._future = self._future, None
        return future.result()

    def close(self) -> None:
        """End what it works at."""


class BackgroundCalibrator(InlineCalibrator):
    """Does the same in a process of its own, which ends with this one."""

    _executor: ProcessPoolExecutor | None = None

    def submit(self, *job: Any) -> None:
        """As of `InlineCalibrator`."""
        # spawn: GTSAM's threads do not survive a fork, and macOS and Windows have no other way
        with starting_processes(), suppress(BrokenProcessPool):
            if self._executor is None:
                context = multiprocessing.get_context("spawn")
                self._executor = ProcessPoolExecutor(1, mp_context=context, initializer=_prepare)
            self._future = self._executor.submit(calibrate_excerpts, *job)

    def answer(self) -> LiveCalibration | None:
        """As of `InlineCalibrator`; a process that was killed is started again with the next job."""
        if self._executor is not None and self.busy:
            end_if_one_died(self._executor)
        try:
            return super().answer()
        except BrokenProcessPool:
            self.close()
            return LiveCalibration(reason="the background process was ended; it is started again")

    def close(self) -> None:
        """As of `InlineCalibrator`."""
        if self._executor is not None:
            end_workers(self._executor)
            self._executor.shutdown(wait=True, cancel_futures=True)
            self._executor, self._future = None, None


def _prepare() -> None:
    prepare_worker()
    with suppress(OSError, AttributeError):
        os.nice(NICE)


#: Self-calibrations begin at this length and are tried at this interval until one works; then at these
#: lengths, and at the interval of the last, s.
FIRST_S, RETRY_S = 8.0, 2.0
RENEWED_S = (15.0, 30.0, 60.0, 120.0)
#: Squared errors are up to 2.5 times what the first of them says.
FIRST_FACTOR = 1.25
#: What a jump of the camera's clock leaves open where the motion shows it, s.
JUMP_SIGMA_S = 0.02
#: .. and a contradiction that lasts, s.
DOUBTED_SIGMA_S = 0.05


class Calibrations:
    """Starts a self-calibration when it is due, and keeps the last one that worked."""

    def __init__(
        self,
        calibrator: InlineCalibrator,
        given: ArmCalibration,
        config: Config,
        recording: Callable[..., Recording],  # Of streams, with what is known of the session
    ) -> None:
        self._calibrator, self._given, self._config, self._recording = calibrator, given, config, recording
        self._asked_s: float | None = None
        self._count, self._left_out = 0, tuple[str, ...]()
        self.last: LiveCalibration | None = None
        self.offset_s = self.clock_sigma_s = float("nan")
        self.needed = 1
        self.reason = "the first 8 s of both streams are collected"

    def fetch(self) -> bool:
        """Fetch an answer; True where there is a new calibration."""
        answer = self._calibrator.answer()
        if answer is None or answer.model is None or answer.clock is None:
            self.reason = self.reason if answer is None else answer.reason
            return False
        self._count += 1
        self.last = answer
        self.reason = f"calibrated from {answer.until_s - answer.from_s:.0f} s of motion"
        at = np.array([answer.until_s - answer.clock.mean_s])
        self.offset_s, self.clock_sigma_s = float(answer.clock.at(at)[0]), answer.clock.sigma_s
        return True

    def ask(
        self,
        imus: Mapping[str, LiveImu],  # By segment, the forearm's first
        frames: FrameBuffer,
        camera: CameraClock,
    ) -> None:
        """Ask for the next one when it is time."""
        imu, *further = imus.values()
        if self._calibrator.busy or not len(imu) or not len(frames):
            return
        arrival_offset_s = camera.delay_s - USUAL_LATENCY_S
        if self._asked_s is None:
            start_s = max(float(imu.t[0]), frames.since(-np.inf)[0].t_s + arrival_offset_s)
            wait_s = FIRST_S
        else:
            start_s = self._asked_s
            wait_s = RETRY_S if self.last is None else RENEWED_S[min(self._count, len(RENEWED_S)) - 1]
        if imu.end_s - start_s < wait_s:
            return
        self._asked_s, arm = imu.end_s, frames.tracks(-np.inf)
        self.needed = joints_needed(arm)
        worn = {each.segment.name: each.sound_stream() for each in further if len(each) >= FEWEST_SAMPLES}
        recording = self._recording(imu=imu.sound_stream(), arm=arm, further_imus=worn)
        offset_s = arrival_offset_s if np.isnan(self.offset_s) else self.offset_s
        self._calibrator.submit(recording, self._given, self._config, offset_s)

    def left_out(self) -> list[str]:
        """Why the last one does without some of the IMUs beyond the forearm, where that is new."""
        now, self._left_out = self._left_out, () if self.last is None else self.last.left_out
        return [sentence for sentence in self._left_out if sentence not in now]

    def clock_jumped(self, sigma_s: float) -> None:
        """The camera's clock jumped: it is less certain by the step, and the next calibration is due."""
        self.clock_sigma_s = float(np.hypot(self.clock_sigma_s, sigma_s))
        self._asked_s = None if self.last is None else -np.inf

    def clock_doubted(self) -> None:
        """The clocks may be apart by more than is known, as long as no new calibration says otherwise."""
        self.clock_sigma_s = max(self.clock_sigma_s, DOUBTED_SIGMA_S)

    @property
    def sigma_factor(self) -> float:
        """What sigma is multiplied by: the first calibration, of some seconds, knows less than it says."""
        return FIRST_FACTOR if self._count == 1 else 1.0
