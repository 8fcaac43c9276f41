"""When a self-calibration is asked for, in the background or not, and what becomes of its answers."""

from __future__ import annotations

import os
import time
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from live_play import simulated
from pool_jobs import answer_half

from smoother.body import FOREARM
from smoother.calibration import ArmCalibration
from smoother.config import Config
from smoother.live import calibrations
from smoother.live.buffers import USUAL_LATENCY_S, CameraClock, FrameBuffer, SkeletonFrame
from smoother.live.calibrations import (
    FIRST_S,
    JUMP_SIGMA_S,
    RENEWED_S,
    RETRY_S,
    BackgroundCalibrator,
    Calibrations,
    InlineCalibrator,
    LiveCalibration,
    calibrate_excerpts,
)
from smoother.live.imu import LiveImu
from smoother.measurements.clock import constant_clock
from smoother.recording import ImuStream, Recording

WORKED: Any = object()  # a model that nobody looks into


@dataclass
class AtOnce(InlineCalibrator):
    """Answers what it is told to, at the next question."""

    answers: list[LiveCalibration] = field(default_factory=list)
    jobs: list[tuple[Any, ...]] = field(default_factory=list)
    pending: bool = False

    @property
    def busy(self) -> bool:
        return self.pending

    def submit(self, *job: Any) -> None:
        self.jobs.append(job)
        self.pending = True

    def answer(self) -> LiveCalibration | None:
        if not self.pending:
            return None
        self.pending = False
        return self.answers.pop(0)


@dataclass
class Session:
    """Both streams, and what is asked second by second."""

    calibrator: AtOnce
    calibrations: Calibrations
    imu: LiveImu = field(default_factory=lambda: LiveImu(FOREARM, 500.0))
    frames: FrameBuffer = field(default_factory=lambda: FrameBuffer(500.0))
    camera: CameraClock = field(default_factory=CameraClock)
    t_s: float = 0.0

    def until(self, end_s: float) -> list[float]:
        """Go on; the times when a calibration was asked for."""
        asked = []
        while self.t_s < end_s:
            t = self.t_s + np.arange(0.0, 0.5, 0.02)
            self.imu.add(ImuStream("", t, np.ones((25, 3)), np.zeros((25, 3))))
            for t_s in t[::2]:
                frame = SkeletonFrame(t_s, t_s + 0.1, np.ones((5, 3)), np.full(5, 2, np.int8))
                for each in self.camera.take(frame)[0]:
                    self.frames.add(each)
            self.t_s += 0.5
            self.calibrations.fetch()
            count = len(self.calibrator.jobs)
            self.calibrations.ask({"forearm": self.imu}, self.frames, self.camera)
            asked += [self.t_s] * (len(self.calibrator.jobs) - count)
        return asked


def session(*answers: LiveCalibration) -> Session:
    calibrator = AtOnce(list(answers))
    given = ArmCalibration(side="right")
    return Session(calibrator, Calibrations(calibrator, given, Config(), Recording))


def worked(offset_s: float = -0.02) -> LiveCalibration:
    return LiveCalibration(0.0, 10.0, WORKED, constant_clock(offset_s))


def failed() -> LiveCalibration:
    return LiveCalibration(0.0, 10.0, reason="the arm has to move more")


def test_it_is_tried_again_until_it_works_and_then_farther_and_farther_apart() -> None:
    live = session(failed(), failed(), *[worked()] * 6)
    asked = live.until(FIRST_S + 1.0)
    assert live.calibrations.reason == "the arm has to move more" and live.calibrations.last is None
    assert np.isnan(live.calibrations.offset_s)
    asked += live.until(FIRST_S + 2 * RETRY_S + sum(RENEWED_S) + RENEWED_S[-1] + 5.0)
    assert asked[0] == pytest.approx(FIRST_S, abs=0.6)
    assert np.diff(asked) == pytest.approx([RETRY_S, RETRY_S, *RENEWED_S, RENEWED_S[-1]], abs=0.6)
    assert live.calibrations.reason == "calibrated from 10 s of motion"


def test_what_does_not_work_leaves_the_last_one_and_its_clock() -> None:
    """The arrival says how far the clocks are apart until a calibration does."""
    live = session(worked(0.3), failed())
    live.until(FIRST_S + 1.0)
    last = live.calibrations.last
    live.until(FIRST_S + RENEWED_S[0] + 1.5)
    first, second = live.calibrator.jobs
    assert first[-1] == pytest.approx(0.1 - USUAL_LATENCY_S, abs=1e-6)
    assert second[-1] == pytest.approx(0.3) == live.calibrations.offset_s
    assert live.calibrations.last is last


def test_a_clock_that_jumped_is_less_certain_and_asked_for_at_once() -> None:
    live = session(*[worked()] * 3)
    live.until(FIRST_S + 1.0)
    before_s = live.calibrations.clock_sigma_s
    live.calibrations.clock_jumped(JUMP_SIGMA_S)
    assert live.calibrations.clock_sigma_s == pytest.approx(np.hypot(before_s, JUMP_SIGMA_S))
    assert live.until(live.t_s + 0.5) == [live.t_s]


RECORDING = replace(simulated(3, 9.0, ()).recording, truth=None)
JOB = RECORDING, ArmCalibration(side="right"), Config()


def wait_for(calibrator: BackgroundCalibrator) -> LiveCalibration:
    for _ in range(1200):
        answer = calibrator.answer()
        if answer is not None:
            return answer
        time.sleep(0.05)
    pytest.fail("no answer in a minute")


@pytest.mark.slow
def test_the_background_answers_as_this_process_does():
    calibrator = BackgroundCalibrator()
    try:
        assert not calibrator.busy and calibrator.answer() is None
        calibrator.submit(*JOB)
        assert calibrator.busy
        answer, here = wait_for(calibrator), calibrate_excerpts(*JOB)
        assert not calibrator.busy
    finally:
        calibrator.close()
    assert answer.model is not None and here.model is not None
    for joint, lever in here.model.estimate.lever_arms.items():
        other = answer.model.estimate.lever_arms[joint]
        # BLAS may have more threads here, which sum in another order: micrometres
        np.testing.assert_allclose(other.position_m, lever.position_m, atol=1e-5)
    assert answer.clock.mean_s == pytest.approx(-0.02, abs=0.01)


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="kills by signals")
def test_a_background_that_dies_while_it_answers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """The rest of its answer never comes: it was waited for as long as the live run went on."""
    monkeypatch.setattr(calibrations, "calibrate_excerpts", answer_half)
    calibrator = BackgroundCalibrator()
    try:
        calibrator.submit(str(tmp_path / "a"))
        assert "started again" in wait_for(calibrator).reason
        calibrator.submit(str(tmp_path / "a"))
        assert wait_for(calibrator) == "a"
    finally:
        calibrator.close()


def test_clocks_far_apart_are_brought_together_by_the_arrival():
    arm = replace(RECORDING.arm, t_s=RECORDING.arm.t_s + 1000.0)
    answer = calibrate_excerpts(replace(RECORDING, arm=arm), *JOB[1:], -1000.1)
    assert answer.model is not None
    assert answer.clock.mean_s == pytest.approx(-1000.02, abs=0.01)


def test_what_does_not_suffice_is_said():
    hidden = RECORDING.arm.hide(np.ones(len(RECORDING.arm), bool))
    answer = calibrate_excerpts(replace(RECORDING, arm=hidden), *JOB[1:])
    assert answer.model is None and answer.reason
