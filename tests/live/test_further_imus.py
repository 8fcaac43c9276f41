"""An IMU on the upper arm beside the forearm's, live: what it gives, and what becomes of a wrong one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from live_play import errors, rms, simulated

from smoother.array_types import BoolArray, FloatArray
from smoother.body import SEGMENTS
from smoother.live.answers import LiveOutput, LiveState
from smoother.live.imu import LiveImu
from smoother.recording import ImuStream
from smoother.simulation import SimulatedArm
from tools.accuracy.live import play

SIMULATION = simulated(4, 21.0, imus="wrist,upper-arm")
#: The second IMU repeats a value; lies on a table; stops: from when to when, s.
REPEATS, RESTS, STOPS = (10.0, 11.0), (13.0, 14.5), (18.0, 19.5)


def wrong() -> SimulatedArm:
    """The same arm; the second IMU fails three times."""
    imu = SIMULATION.recording.further_imus["upper_arm"]
    t, acc, gyro = imu.t_s, imu.acc.copy(), imu.gyro.copy()

    def during(when: tuple[float, float]) -> BoolArray:
        return np.asarray((t > when[0]) & (t < when[1]))

    repeats, rests = during(REPEATS), during(RESTS)
    acc[repeats], gyro[repeats] = acc[repeats][0], gyro[repeats][0]
    noise, shape = np.random.default_rng(0), (int(rests.sum()), 3)
    acc[rests] = noise.normal([0.0, 0.0, 9.81], 0.03, shape)
    gyro[rests] = noise.normal(0.0, 0.003, shape)
    faulty = replace(imu, acc=acc, gyro=gyro).select(~during(STOPS))
    return replace(SIMULATION, recording=replace(SIMULATION.recording, further_imus={"upper_arm": faulty}))


@pytest.fixture(scope="module")
def one() -> list[LiveOutput]:
    return play(replace(SIMULATION, recording=replace(SIMULATION.recording, further_imus={})))


def off(outputs: list[LiveOutput], state: LiveState) -> FloatArray:
    return errors(SIMULATION, outputs, "now", lambda output: output.state is state)


@pytest.mark.slow
def test_in_gaps_it_is_better_and_says_so(one: list[LiveOutput]) -> None:
    two = play(SIMULATION)
    assert not [note for output in two for note in output.notes]
    in_gaps, alone = off(two, LiveState.GAP), off(one, LiveState.GAP)
    # a second into a gap, where the elbow is held (five seeds: 0.6 to 0.9 of the error, 0.6 to 0.8 of sigma)
    assert rms(in_gaps[:, 0]) < 0.95 * rms(alone[:, 0])
    assert in_gaps[:, 1].mean() < 2.5
    last = [max(each.now.sigma_m for each in outputs if each.now) for outputs in (two, one)]
    assert last[0] < 0.85 * last[1]
    # where the camera sees the arm it says nearly all by itself
    seen = [rms(off(outputs, LiveState.VISIBLE)[:, 0]) for outputs in (two, one)]
    assert seen[0] < 1.05 * seen[1]


@pytest.mark.slow
def test_where_it_is_wrong_it_is_left_out_and_the_forearm_goes_on_alone(one: list[LiveOutput]) -> None:
    outputs = play(wrong())
    said = [(output.now_s, note) for output in outputs for note in output.notes]
    notes = [note for _, note in said]
    assert notes == [
        "the IMU on the upper arm is left out: the accelerometer repeats a value;"
        " the gyroscope repeats a value",
        "the IMU on the upper arm is plausible again",
        "the IMU on the upper arm is left out: it contradicts the rest of the arm",
        "the IMU on the upper arm is plausible again",
        "the IMU on the upper arm is left out: it has stopped",
        "the IMU on the upper arm is back",
    ]
    for (at, _), since_s in zip(said[::2], (REPEATS[0], RESTS[0], STOPS[0]), strict=True):
        assert 0.0 < at - since_s < 1.0
    for when in (REPEATS, RESTS, STOPS):

        def during(output: LiveOutput, when: tuple[float, float] = when) -> bool:
            return when[0] < output.now_s < when[1] + 0.5

        faulty, alone = errors(SIMULATION, outputs, "now", during), errors(SIMULATION, one, "now", during)
        assert rms(faulty[:, 0]) < 1.1 * rms(alone[:, 0]) + 0.003
        assert faulty[:, 1].max() < 9.0


def test_a_pause_is_said_once_and_a_contradiction_lasts_longer_each_time() -> None:
    worn, step_s = LiveImu(SEGMENTS["upper_arm"], 10.0), 0.01

    def sends(start_s: float, end_s: float) -> None:
        t = np.arange(start_s, end_s, step_s)
        shaken = np.column_stack([np.sin(7.0 * t), np.cos(5.0 * t), 9.81 + 0.2 * np.sin(11.0 * t)])
        for first in range(0, len(t), 10):  # of what comes together, only the last 0.5 s are taken
            rows = slice(first, first + 10)
            worn.add(ImuStream("", t[rows], shaken[rows], 0.5 * shaken[rows]))

    assert worn.check(0.0) == []
    sends(0.0, 2.0)
    assert worn.check(2.0) == [] and worn.check(2.4) == []
    assert worn.check(2.6) == ["the IMU on the upper arm is left out: it has stopped"]
    assert worn.check(2.7) == []
    sends(3.0, 4.0)
    assert worn.check(4.0) == ["the IMU on the upper arm is back"]
    assert worn.since_pause_s(3.0) == pytest.approx(3.0)
    left_out_s = []
    for _ in range(5):
        end_s = worn.end_s
        worn.contradicted_by_arm(end_s - 1.0)
        left_out_s.append(worn.usable_s - end_s)
        assert worn.doubted_s <= end_s - 1.0
        sends(end_s + step_s, worn.usable_s + 0.5)
        worn.check(worn.end_s)
    assert left_out_s == pytest.approx([1.0, 2.0, 4.0, 8.0, 8.0])
    sends(worn.end_s + step_s, worn.end_s + 5.0)
    assert worn.check(worn.end_s) == ["the IMU on the upper arm is plausible again"]
