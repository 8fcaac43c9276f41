"""Trials of one strap: what they show together of the sensor, and which of them are foreign."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from calib.motion import calibrate_motion
from smoother.config import Config
from smoother.errors import CalibrationError
from smoother.recording import Recording
from smoother.selfcal.agreement import agreement
from smoother.selfcal.pairing import find_pairing
from smoother.selfcal.session import find_straps
from smoother.simulation import SimulatedArm
from smoother.smoothing import smooth
from tools.accuracy.pairing import FOREIGN, made_session, trials_of

COUNT = 10
ALONE = Config.model_validate({"windows": {"processes": 1}})


@cache
def made(seed: int) -> SimulatedArm:
    return made_session(seed, COUNT)


@cache
def session(seed: int) -> tuple[list[Recording], list[float]]:
    """Trials cut from one recording, the camera's clock up to 10 s off in each; and these offsets, s."""
    trials = trials_of(made(seed), COUNT, seed)
    return [trial for trial, *_ in trials], [offset_s for _, offset_s, _ in trials]


@pytest.mark.slow
def test_trials_show_the_direction_that_they_share_and_their_clocks() -> None:
    trials, offsets = session(3)
    (strap,) = find_straps(trials)
    true = made(3).calibration.forearm_direction
    assert true is not None
    assert np.degrees(np.arccos(strap.along @ true)) < 6.0
    assert len(strap.members) >= 9
    proved = 0
    for number in strap.members:
        found = agreement(trials[number], along=strap.along)
        assert found is not None
        assert found.is_mounted
        assert found.best.offset_s == pytest.approx(offsets[number], abs=0.1)
        pairing, _ = find_pairing(trials[number], along=strap.along)
        alone, _ = find_pairing(trials[number])
        assert pairing is not None
        assert alone is not None
        proved += pairing.proved
        assert pairing.proved or not alone.proved
    assert proved >= 8


def test_a_trial_with_the_sensor_of_another_is_in_no_strap() -> None:
    trials, _ = session(3)
    foreign = [*trials[:4], replace(trials[4], imu=session(503)[0][4].imu), *trials[5:]]
    (strap,) = find_straps(foreign)
    assert 4 not in strap.members


@pytest.mark.slow
def test_a_strap_put_on_anew_is_another_one() -> None:
    mixed = [*session(3)[0][:5], *session(503)[0][5:]]
    straps = find_straps(mixed)
    assert len(straps) == 2
    assert sorted(len({number < 5 for number in strap.members}) for strap in straps) == [1, 1]
    with pytest.raises(CalibrationError, match="in 2 ways"):
        calibrate_motion(mixed, None, ALONE)


@pytest.mark.slow
def test_straps_that_are_much_alike_are_two() -> None:
    """A direction between the two, 8 to 18 degrees apart, fits the trials of both."""
    one, other = (
        [trial for trial, *_ in trials_of(made_session(seed, 20), 20, 13)] for seed in (13, 13 + FOREIGN)
    )
    straps = find_straps([*one[:10], *other[10:]])
    assert [{number < 10 for number in strap.members} for strap in straps] in (
        [{True}, {False}],
        [{False}, {True}],
    )


def test_streams_of_two_trials_are_no_pair_by_the_strap_that_they_share() -> None:
    trials, _ = session(3)
    (strap,) = find_straps(trials)
    for number in range(COUNT - 1):
        pairing, _ = find_pairing(replace(trials[number], imu=trials[number + 1].imu), along=strap.along)
        assert pairing is None or not pairing.proved


@pytest.mark.slow
def test_a_trial_is_recovered_by_what_its_session_shows() -> None:
    trials, _ = session(3)
    found = calibrate_motion(trials, None, ALONE)
    for joint, lever in made(3).calibration.lever_arms.items():
        assert np.linalg.norm(found.calibration.lever_arms[joint].position_m - lever.position_m) < 0.015
    verdicts = [smooth(trial, found.calibration, ALONE).estimates.trusted for trial in trials[:4]]
    assert verdicts.count(True) >= 3
