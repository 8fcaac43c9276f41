"""Sigma for short recordings: gaps hidden in all of them together."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.file import sigma_factors_of
from calib.motion import hidden_gaps
from calib.motion.hidden_gaps import hidden_gap_factors, short_recordings
from calib.motion.motion_calibration import calibrate_motion, motion_answer
from smoother.config import Config
from smoother.recording import JOINTS, Recording
from smoother.simulation import ArmSimulation, simulate_arm

FEW = 4


@pytest.fixture(scope="module")
def trials() -> list[Recording]:
    """Of 6 s each, from one session of one arm."""
    settings = ArmSimulation.preset("realistic", protocol="random", duration_s=25.0, occlusion_every_s=90.0)
    session = replace(simulate_arm(settings, 4).recording, truth=None)
    trials = []
    for k in range(FEW):
        of_arm, of_imu = (
            (t >= 6.0 * k - beside_s) & (t < 6.0 * (k + 1) + beside_s)
            for t, beside_s in ((session.arm.t_s, 0.0), (session.imu.t_s, 0.5))
        )
        arm, imu = session.arm.select(of_arm), session.imu.select(of_imu)
        trials.append(replace(session, name=f"trial {k}", arm=arm, imu=imu))
    return trials


def displaced(recording: Recording, by_m: float) -> Recording:
    """The camera's forearm elsewhere for the 0.5 s in the middle, which the gaps will hide."""
    arm = recording.arm
    middle = np.abs(arm.t_s - 0.5 * (arm.t_s[0] + arm.t_s[-1])) <= 0.25
    position = np.array(arm.position)
    for joint in ("elbow", "wrist", "hand"):
        position[middle, JOINTS.index(joint), 0] += by_m
    return replace(recording, arm=replace(arm, position=position))


def test_only_many_short_recordings_count(trials: list[Recording]) -> None:
    assert short_recordings(trials) == []
    assert len(short_recordings(trials * 5)) == 5 * FEW
    long = replace(trials[0], arm=replace(trials[0].arm, t_s=trials[0].arm.t_s * 10.0))
    assert short_recordings([long] * 30) == []


def test_errors_that_are_larger_than_stated_ask_for_more(
    trials: list[Recording], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(hidden_gaps, "ENOUGH_GAPS", FEW)
    calibration = calibrate_motion(trials).calibration
    sound = calibration.sigma_factors
    assert sound is None or all(row.factor < 2.0 for row in sound.by_length)
    calibration = replace(calibration, sigma_factors=None)
    wrong = hidden_gap_factors([displaced(one, 0.12) for one in trials], calibration, Config())
    assert wrong is not None and [row.length_s for row in wrong.by_length] == [0.5, 1.0]
    assert all(row.factor > 2.0 and row.gaps == FEW for row in wrong.by_length)


def test_the_calibration_keeps_them(trials: list[Recording], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(hidden_gaps, "ENOUGH_GAPS", FEW)
    found = calibrate_motion([displaced(one, 0.12) for one in trials])
    factors = found.calibration.sigma_factors
    assert factors is not None and factors.at(1.0) > 1.2
    kept = sigma_factors_of(motion_answer(found).table)
    assert kept is not None and kept.at(1.0) == pytest.approx(factors.at(1.0), abs=1e-4)
