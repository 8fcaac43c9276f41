"""The live smoother on simulated arms, on a simulated clock; the bench of faults."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from live_play import errors, rms, simulated

from smoother.errors import UnoccludeError
from smoother.live.answers import LiveState
from smoother.live.smoother import LiveSmoother
from tools import live_faults as bench
from tools.accuracy.live import play

pytestmark = pytest.mark.slow

SIMULATION = simulated(2, 27.0)  # a second calibration at 23 s


@pytest.fixture(scope="module")
def outputs():
    return play(SIMULATION)


def test_it_says_calibrating_until_it_knows_and_never_guesses(outputs):
    first = next(k for k, output in enumerate(outputs) if output.now is not None)
    early = [output for output in outputs if output.now_s < 8.0]
    assert early and all(output.now is None and output.settled is None for output in early)
    assert all(output.state is LiveState.CALIBRATING and output.calibration for output in outputs[:first])
    assert all(output.state is not LiveState.LOST for output in outputs)
    behind = [output for output in outputs[:first] if "catching up" in output.calibration]
    assert behind[0].calibration == "calibrated from 8 s of motion; catching up with the present"
    # 5 s of frames, ten a step of which one is new, and one step to begin with: 0.6 s
    assert behind[-1].now_s - behind[0].now_s < 0.65
    assert outputs[first].calibration == "calibrated from 8 s of motion"
    assert outputs[first].doubt and not outputs[-1].doubt, "with the second calibration it is trusted"
    # nothing jumps when the camera comes back or a successor takes over: a hand moves 5 cm in a step
    moved = [np.linalg.norm(b.now.position - a.now.position) for a, b in pairwise(outputs[first:])]
    assert max(moved) < 0.08
    # 1.5 ms of the offset's own sigma, and half a frame of jitter
    assert outputs[-1].clock_offset_s == pytest.approx(-0.02, abs=0.006)
    assert outputs[-1].camera_latency_s == pytest.approx(0.1, abs=0.006)


def test_now_is_the_present_and_settled_a_lag_ago_and_as_good_as_they_say(outputs):
    visible = [output for output in outputs if output.state is LiveState.VISIBLE]
    now, settled = (errors(SIMULATION, visible, kind) for kind in ("now", "settled"))
    # seen 1.6 cm; the camera alone has 1.5 cm of noise and bias, 0.1 s ago
    assert rms(settled[:, 0]) < rms(now[:, 0]) < 0.03
    assert 0.2 < now[:, 1].mean() < 3.0
    # the last is after the last sample
    assert max(o.now_s - o.now.t_s for o in outputs[:-1] if o.now is not None) < 0.01
    assert all(abs(o.now_s - 0.2 - o.settled.t_s) < 0.02 for o in outputs if o.settled is not None)
    gaps = [o for o in outputs if o.state is LiveState.GAP and o.now is not None]
    assert len(gaps) > 30
    since = np.array([o.now.t_s - o.now.since_s for o in gaps])
    sigma = np.array([o.now.sigma_m for o in gaps])
    assert np.median(sigma[since > 0.8]) > 1.5 * np.median(sigma[since < 0.4])
    # errors in one gap are one draw: a wide band
    assert 0.1 < errors(SIMULATION, gaps)[:, 1].mean() < 4.0


def test_a_lag_that_is_no_lag_is_refused():
    with pytest.raises(UnoccludeError, match="from 0 to 2 s"):
        LiveSmoother(lag_s=2.5)


@pytest.fixture(scope="module")
def sound() -> bench.Sound:
    bench.sound = bench.Sound()
    return bench.sound


@pytest.mark.slow
@pytest.mark.parametrize("kind", bench.KINDS)
def test_no_fault_makes_it_wrong_for_long(sound: bench.Sound, kind: str):
    (wrong_s, *_), _ = bench.verdict(kind)
    assert wrong_s <= bench.MOST_S
