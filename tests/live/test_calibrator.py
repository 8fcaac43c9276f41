"""The self-calibration in the background."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
import pytest
from live_play import simulated

from smoother.calibration import ArmCalibration
from smoother.config import Config
from smoother.live.calibrations import (
    BackgroundCalibrator,
    CalibrationJob,
    Calibrator,
    LiveCalibration,
    calibrate_excerpts,
)

RECORDING = replace(simulated(3, 9.0, ()).recording, truth=None)
JOB = CalibrationJob(RECORDING, ArmCalibration(side="right"), Config())


def wait_for(calibrator: Calibrator) -> LiveCalibration:
    for _ in range(1200):
        answer = calibrator.answer()
        if answer is not None:
            return answer
        time.sleep(0.05)
    pytest.fail("no answer in a minute")


def test_the_background_answers_as_this_process_does():
    calibrator = BackgroundCalibrator()
    try:
        assert not calibrator.busy and calibrator.answer() is None
        calibrator.submit(JOB)
        assert calibrator.busy
        answer, here = wait_for(calibrator), calibrate_excerpts(JOB)
        assert not calibrator.busy
    finally:
        calibrator.close()
    assert answer.model is not None and here.model is not None
    for joint, lever in here.model.estimate.lever_arms.items():
        other = answer.model.estimate.lever_arms[joint]
        np.testing.assert_allclose(other.position_m, lever.position_m, atol=1e-6)
    assert answer.clock.mean_s == pytest.approx(-0.02, abs=0.01)


def test_clocks_far_apart_are_brought_together_by_the_arrival():
    arm = replace(RECORDING.arm, t_s=RECORDING.arm.t_s + 1000.0)
    job = replace(JOB, recording=replace(RECORDING, arm=arm), offset_s=-1000.1)
    answer = calibrate_excerpts(job)
    assert answer.model is not None
    assert answer.clock.mean_s == pytest.approx(-1000.02, abs=0.01)


def test_what_does_not_suffice_is_said():
    hidden = RECORDING.arm.hide(np.ones(len(RECORDING.arm), bool))
    answer = calibrate_excerpts(replace(JOB, recording=replace(RECORDING, arm=hidden)))
    assert answer.model is None and answer.reason
