"""Samples that were lost behind even stamps: the step of the clock is found, with its time and size."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from smoother.config import Config
from smoother.recording import Recording
from smoother.recovery import imu_signs as module
from smoother.recovery.imu_signs import clock_steps, lost_samples
from smoother.result import Recovery
from smoother.simulation import ArmSimulation, simulate_arm
from smoother.smoothing import smooth

ONE_PROCESS = Config.model_validate({"windows": {"processes": 1}})


def recorded(seed: int, duration_s: float = 40.0) -> Recording:
    config = ArmSimulation.preset("realistic", protocol="random", duration_s=duration_s)
    return replace(simulate_arm(config, seed).recording, truth=None)


@pytest.fixture(scope="module")
def sound() -> tuple[Recovery, Recording]:
    recording = recorded(3)
    return smooth(recording, config=ONE_PROCESS), recording


def kept(count: int, first: int, lost: int) -> np.ndarray:
    return np.r_[0:first, first + lost : count]


def without(recording: Recording, at_s: float, lost_s: float) -> Recording:
    """Samples taken out, and the rest stamped as if nothing were missing."""
    imu = recording.imu
    rows = kept(len(imu), int(np.searchsorted(imu.t_s, at_s)), round(lost_s * imu.rate_hz))
    return replace(
        recording, imu=replace(imu, t_s=imu.t_s[: len(rows)], acc=imu.acc[rows], gyro=imu.gyro[rows])
    )


def test_a_sound_recording_has_no_step(sound: tuple[Recovery, Recording]) -> None:
    assert all(step.gain < 1.5 for step in clock_steps(*sound))
    assert lost_samples(*sound) == module.LostSamples()
    assert sound[0].estimates.untrusted == () and sound[0].estimates.trusted


@pytest.mark.parametrize("at_s", [12.0, 22.5, 33.0])
@pytest.mark.parametrize("lost_s", [0.075, 0.15, 0.3])
def test_time_and_size(sound: tuple[Recovery, Recording], at_s: float, lost_s: float) -> None:
    """What was recovered, stamped as the recording: only the comparison is looked at."""
    recovery, recording = sound
    short = without(recording, at_s, lost_s)
    first, lost = int(np.searchsorted(recovery.t_s, at_s)), round(lost_s * recording.imu.rate_hz)
    rows = kept(len(recovery), first, lost)
    stamped = replace(recovery.rows(rows), t_s=short.imu.t_s, residuals=recovery.residuals)
    (step,) = clock_steps(stamped, short)
    assert step.gain > module.STEP_GAIN
    assert abs(step.step_s + lost_s) < 2.0 * module.GRID_S  # each side to half a step, and noise
    assert abs(step.at_s - at_s) < 2.5
    verdict = lost_samples(stamped, short)
    sentences = verdict.reasons or verdict.untrusted[0].reasons
    assert "samples of the IMU were lost there, and the stamps hide it" in sentences[0]
    assert bool(verdict.reasons) == (abs(step.step_s) >= module.LARGE_STEP_S)


def test_frames_that_were_lost(sound: tuple[Recovery, Recording]) -> None:
    recovery, recording = sound
    assert recovery.residuals is not None
    late = recovery.residuals.t_s > 20.0
    moved = replace(recovery.residuals, t_s=recovery.residuals.t_s - np.where(late, 0.2, 0.0))
    order = np.argsort(moved.t_s, kind="stable")
    moved = replace(moved, t_s=moved.t_s[order])
    verdict = lost_samples(replace(recovery, residuals=moved), recording)
    assert "frames of the camera were lost there" in verdict.reasons[0] and " by 200 ms" in verdict.reasons[0]


def test_a_long_recording_is_looked_at_in_parts(
    sound: tuple[Recovery, Recording], monkeypatch: pytest.MonkeyPatch
) -> None:
    recovery, recording = sound
    monkeypatch.setattr(module, "PART_S", 20.0)
    monkeypatch.setattr(module, "SHARED_S", 12.0)
    short = without(recording, 22.5, 0.1)
    rows = kept(len(recovery), int(np.searchsorted(recovery.t_s, 22.5)), 8)
    stamped = replace(recovery.rows(rows), t_s=short.imu.t_s, residuals=recovery.residuals)
    steps = clock_steps(stamped, short)
    assert len(steps) > 2 and all(step.gain < 1.5 for step in steps if abs(step.at_s - 22.5) > 5.0)
    assert max(steps, key=lambda step: step.gain).step_s == pytest.approx(-0.1, abs=0.021)


def test_smooth_does_not_trust_the_gap_of_the_loss() -> None:
    """0.1 s lost in a gap: 23 cm at a sigma of 2, with other gaps as good as ever."""
    recovery = smooth(without(recorded(3), 20.4, 0.1), config=ONE_PROCESS)
    said = [
        *recovery.estimates.reasons,
        *(why for each in recovery.estimates.untrusted for why in each.reasons),
    ]
    assert any("the stamps hide it" in why for why in said)
    hidden = next(gap for gap in recovery.gap_verdicts if gap.start_s < 20.4 < gap.end_s)
    assert not hidden.trusted
