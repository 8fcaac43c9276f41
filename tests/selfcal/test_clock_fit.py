"""The camera's clock against the IMU's: its score, its fit against dense Gaussians, whole recordings."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scenes import ALONE, answer, moving
from scipy.stats import multivariate_normal
from small_window import NODES, small_window

from smoother import Recovery
from smoother.array_types import FloatArray
from smoother.body import FOREARM
from smoother.calibration import ArmCalibration
from smoother.evaluation.validate import validate
from smoother.measurements.clock import LARGEST_OFFSET_S, Clock, constant_clock
from smoother.measurements.outliers import reject_by_camera
from smoother.measurements.segment import split_into_segments
from smoother.measurements.timestamps import synthetic_stamps
from smoother.recording import Recording
from smoother.runtime.pool import Pool
from smoother.selfcal import clock_fit
from smoother.selfcal.clock_fit import (
    SYNTHETIC_SIGMA_S,
    ClockScore,
    clock_score,
    joined_scores,
    refined_clock,
)
from smoother.selfcal.pairing import coarse_offset, find_pairing, pair
from smoother.selfcal.rounds import self_calibrate
from smoother.simulation import SimulatedArm
from smoother.window.problem import States, Window
from smoother.window.solution import SegmentSolution, Solution

PRIOR_S = 0.07
NOTHING = ClockScore(np.zeros(0), np.zeros(0), np.zeros(0))
START = Clock(np.array([0.0, 100.0]), np.array([0.01, 0.03]), 0.02, prior_sigma_s=PRIOR_S)


def solution(window: Window, seed: int, information: float) -> Solution:
    rng = np.random.default_rng(seed)
    states = States(window.forearm.start.R, window.forearm.start.p, rng.normal(size=(NODES, 3)))
    residuals = {
        each.joint: each.sigma_m[:, None] * 2.0 * rng.normal(size=each.position.shape)
        for each in window.joint_measurements
    }
    forearm = SegmentSolution(FOREARM.name, window.t, states, np.zeros((NODES, 6)), np.zeros(3))
    return Solution((forearm,), None, None, np.zeros(0), {}, residuals, 1, 0.0, information)


def by_hand(window: Window, answer: Solution) -> tuple[list[tuple[float, float, float]], float]:
    """(t, slope, bound) of each sample in the core, and the bound of all."""
    rows, total = [], 0.0
    for each in window.joint_measurements:
        for k, node in enumerate(each.node):
            velocity = answer.forearm.states.v[node] + each.velocity[k]
            residual = answer.residuals[each.joint][k]
            off = np.linalg.norm(residual) / each.sigma_m[k] / window.noise.cauchy
            weight = 1.0 / (1.0 + off**2) / each.sigma_m[k] ** 2
            total += weight * float(velocity @ velocity)
            if window.core_start_s <= each.t_s[k] <= window.core_end_s:
                rows.append(
                    (each.t_s[k], weight * float(residual @ velocity), weight * float(velocity @ velocity))
                )
    return rows, total


@pytest.mark.parametrize(("share", "used"), [(0.4, 0.4), (0.001, 0.02), (3.0, 1.0)])
def test_the_score_of_samples_in_the_core(share: float, used: float) -> None:
    """Slope and information sample by sample; of the bound the share that the window states."""
    window = small_window(upper=False)
    first = window.joint_measurements[1]
    window = replace(window, core_start_s=float(first.t_s[1]), core_end_s=float(first.t_s[-2]))
    empty = replace(window, joint_measurements=())
    other = small_window(1, upper=False)
    windows, answers = (
        [window, empty, other],
        [solution(each, k, 0.0) for k, each in enumerate((window, window, other))],
    )
    expected = []
    for number in (0, 2):
        rows, total = by_hand(windows[number], answers[number])
        answers[number] = replace(answers[number], offset_information=share * total)
        expected += [(t, slope, used * bound) for t, slope, bound in rows]
    score = clock_score(zip(windows, answers, strict=True))
    found = np.column_stack([score.t, score.slope, score.information])
    np.testing.assert_allclose(found, expected, rtol=1e-10)


def test_no_samples_no_score() -> None:
    window = small_window(upper=False)
    for score in (clock_score([(replace(window, joint_measurements=()), solution(window, 0, 1.0))]), NOTHING):
        assert len(score.t) == len(score.slope) == len(score.information) == 0
    still = replace(
        window,
        joint_measurements=tuple(
            replace(each, velocity=0 * each.velocity) for each in window.joint_measurements
        ),
    )
    answer = solution(still, 0, 1.0)
    resting = replace(answer.forearm.states, v=0 * answer.forearm.states.v)
    answer = replace(answer, bodies=(replace(answer.forearm, states=resting),))
    assert (clock_score([(still, answer)]).information == 0).all()  # and no division by zero


def test_scores_half_a_second_at_a_time_and_as_one() -> None:
    t = np.array([10.1, 10.4, 10.49, 10.5, 11.2, 11.4, 9.9])
    short = ClockScore(t, np.arange(7.0), 10.0 + np.arange(7.0)).condensed()
    np.testing.assert_allclose(short.t, [9.9, (10.1 + 10.4 + 10.49) / 3, 10.5, 11.3])
    np.testing.assert_allclose(short.slope, [6, 0 + 1 + 2, 3, 4 + 5])
    np.testing.assert_allclose(short.information, [16, 33, 13, 29])
    nothing = NOTHING.condensed()
    assert len(nothing.t) == 0 and nothing.slope.dtype == float
    one, two = ClockScore(t[:2], t[2:4], t[4:6]), ClockScore(t[6:], t[:1], t[1:2])
    both = joined_scores([one, NOTHING, two])
    for name in ("t", "slope", "information"):
        np.testing.assert_array_equal(getattr(both, name), [*getattr(one, name), *getattr(two, name)])


def made_score(offset: FloatArray, clock: Clock, middle: FloatArray, information: FloatArray) -> ClockScore:
    """A score that says these offsets at these camera times, four samples each."""
    t_camera = (middle[:, None] + np.linspace(-0.15, 0.15, 4)).ravel()
    share = np.tile(np.arange(1.0, 5.0) / 10.0, len(middle))
    own = np.repeat(information, 4) * share
    slope = np.repeat((offset - clock.at(middle)) * information, 4) * share
    return ClockScore(t_camera + clock.mean_s, slope, own)


@pytest.fixture
def near(monkeypatch: pytest.MonkeyPatch) -> None:
    """Measured stamps taken half a second at a time too."""
    monkeypatch.setattr(clock_fit, "SPACING_S", clock_fit.SYNTHETIC_SPACING_S)


def evidence(x: FloatArray, prior: FloatArray, variance: FloatArray) -> float:
    """Log-likelihood of values with a Gaussian prior and noise, without the constant of pi."""
    logpdf = multivariate_normal(np.zeros(len(x)), prior + np.diag(variance)).logpdf(x)
    return float(logpdf) + 0.5 * len(x) * np.log(2 * np.pi)


Answer = tuple[float, FloatArray, float]


def level(t: FloatArray, x: FloatArray, variance: FloatArray, walk: float) -> Answer:
    """Log-likelihood and mean of an offset that wanders, and how far it wanders about its own mean."""
    prior = PRIOR_S**2 + walk**2 * np.minimum(t[:, None] - t[0], t - t[0])
    gain = prior @ np.linalg.inv(prior + np.diag(variance))
    spread = np.diag(prior - gain @ prior).mean() - sigma_of(variance) ** 2
    return evidence(x, prior, variance), gain @ x, np.sqrt(max(spread, 0.0))


def sigma_of(variance: FloatArray) -> float:
    return float((PRIOR_S**-2 + np.sum(1 / variance)) ** -0.5)


def likeliest(t: FloatArray, x: FloatArray, variance: FloatArray, synthetic: bool) -> tuple[Answer, float]:
    """Of all walks; for measured stamps only where six in the log-likelihood speak for it."""
    walks = (0.0, 0.001, 0.003, 0.01, 0.02, 0.04) if synthetic else (0.0, 0.0003, 0.001)
    tries = [level(t, x, variance, walk) for walk in walks]
    gains = [each[0] - (6.0 if k and not synthetic else 0.0) for k, each in enumerate(tries)]
    return tries[int(np.argmax(gains))], walks[int(np.argmax(gains))]


def line(t: FloatArray, x: FloatArray, variance: FloatArray) -> tuple[Answer, float]:
    """A steady drift, by dense regression: its answer and its slope."""
    centre = np.sum(t / variance) / np.sum(1 / variance)
    H = np.column_stack([np.ones(len(t)), t - centre])
    P = np.diag([PRIOR_S**2, 5e-4**2])
    gain = P @ H.T @ np.linalg.inv(H @ P @ H.T + np.diag(variance))
    spread = (P - gain @ H @ P)[1, 1] * np.mean((t - centre) ** 2)
    return (evidence(x, H @ P @ H.T, variance), H @ gain @ x, np.sqrt(spread)), float((gain @ x)[1])


def assert_dense(t: FloatArray, x: FloatArray, variance: FloatArray, synthetic: bool) -> Clock:
    """The clock that is found is that of the likeliest of all models, each a dense Gaussian."""
    (loglik, offset, local), walk = likeliest(t, x, variance, synthetic)
    skew = 0.0
    if len(t) >= 5 and np.ptp(t) >= 30.0:
        (of_line, drift, spread), slope = line(t, x, variance)
        if of_line > loglik + 3.0:
            (_, about, wanders), walk = likeliest(t, x - drift, variance, synthetic)
            skew, offset, local = slope, drift + (about if walk else 0.0), wanders if walk else spread
    start = Clock(t, x + 0.02 * np.cos(t), 0.02, prior_sigma_s=PRIOR_S)
    found = refined_clock(start, made_score(x, start, t, 1 / variance), synthetic)
    np.testing.assert_allclose(found.t, t, atol=1e-9)
    np.testing.assert_allclose(found.offset, np.clip(offset, -LARGEST_OFFSET_S, LARGEST_OFFSET_S), atol=1e-9)
    assert (found.walk, found.skew, found.prior_sigma_s) == (walk, pytest.approx(skew, rel=1e-9), PRIOR_S)
    assert found.sigma_s == pytest.approx(sigma_of(variance), rel=1e-9)
    synthetic_s = 0.06 if synthetic else 0.0
    expected_s = np.sqrt(found.sigma_s**2 + local**2 + synthetic_s**2)
    assert found.local_sigma_s == pytest.approx(expected_s, rel=1e-7)
    return found


@pytest.mark.usefixtures("near")
@pytest.mark.parametrize("synthetic", [False, True])
@pytest.mark.parametrize(
    ("walk", "skew", "count"),
    [(0.0, 0.0, 1), (0.004, 0.0, 2), (0.0, 3e-4, 30)]
    + [(walk, 0.0, 60) for walk in (0.0, 0.0003, 0.001, 0.003, 0.01, 0.02, 0.04)],
)
def test_the_clock_of_offsets_that_wander(synthetic: bool, walk: float, skew: float, count: int) -> None:
    """Uneven times, noise from 2 to 20 ms; with the last seed a walk is likelier, and not clearly enough."""
    for seed in (0, 1, 2, 9):
        rng = np.random.default_rng(seed)
        # far from the borders of half seconds, which begin at the first sample
        t = np.round(3.0 + np.cumsum(rng.uniform(1.1, 4.0, count)))
        t[0] -= 0.1
        variance = rng.uniform(0.002, 0.02, count) ** 2
        wanders = 0.03 + np.cumsum(walk * np.sqrt(np.diff(t, prepend=t[0])) * rng.normal(size=count))
        x = wanders + skew * (t - t[0]) + np.sqrt(variance) * rng.normal(size=count)
        assert_dense(t, x, variance, synthetic)


#: Knots of a clock that may drift: five over half a minute are needed to tell.
KNOTS = np.array([0.0, 1.0, 2.0, 3.0, 30.0])


@pytest.mark.usefixtures("near")
@pytest.mark.parametrize(
    ("synthetic", "skew", "t", "noise_s", "walk", "is_line"),
    [
        (False, 8e-4, 4.0 * np.arange(40), 0.003, 0.0, True),
        (True, 8e-4, 4.0 * np.arange(40), 0.003, 0.0, True),
        (False, 8e-4, 2.0 * np.arange(150), 0.001, 0.0003, True),
        (True, 8e-4, 2.0 * np.arange(150), 0.001, 0.001, True),
        # likelier by 2.5 in the log-likelihood: not clear enough
        (False, 4e-4, 2.0 * np.arange(150), 0.001, 0.001, False),
        (False, 8e-4, KNOTS, 0.001, None, True),
        (False, 8e-4, KNOTS * 0.999, 0.001, None, False),
        (False, 8e-4, KNOTS[1:] * 2, 0.001, None, False),
    ],
)
def test_a_clock_that_drifts(
    synthetic: bool, skew: float, t: FloatArray, noise_s: float, walk: float | None, is_line: bool
) -> None:
    """A line, with what wanders about it where there is enough of it to see; or a walk alone."""
    t, rng = t + 5.25, np.random.default_rng(0)
    t[0] -= 0.1 if walk is not None else 0.0
    wanders = 0.0 if walk is None else 0.0003 * np.sqrt(t[2] - t[1]) * rng.normal(size=len(t))
    x = skew * (t - t.mean()) + np.cumsum(wanders + 0.0 * t)
    found = assert_dense(t, x, np.full(len(t), noise_s**2), synthetic)
    assert (found.skew != 0.0) is is_line and (walk is None or found.walk == walk)


def test_synthetic_stamps_are_taken_half_a_second_at_a_time() -> None:
    """Stamps that were measured, 15 s at a time."""
    t = 20.25 + 0.5 * np.arange(48)
    t[0] -= 0.1
    score = made_score(np.full(48, 0.02), START, t, np.full(48, 1e4))
    assert len(refined_clock(START, score, True).t) == 48
    (one, two) = refined_clock(START, score, False).t
    assert (one, two) == (pytest.approx(t[:30].mean()), pytest.approx(t[30:].mean()))


@pytest.mark.usefixtures("near")
def test_steps_and_offsets_are_limited() -> None:
    """No more than 60 ms at a time, no farther than a clock is looked for."""
    t = np.array([10.15, 12.25, 14.25])
    close = Clock(np.zeros(1), np.zeros(1), 0.02, prior_sigma_s=10.0)
    for sign in (1.0, -1.0):
        found = refined_clock(close, made_score(np.full(3, sign * 0.2), close, t, np.full(3, 1e8)), False)
        np.testing.assert_allclose(found.offset, sign * 0.06, atol=1e-6)
        far = replace(close, offset=np.full(1, sign * 0.39))
        found = refined_clock(far, made_score(np.full(3, sign * 0.5), far, t, np.full(3, 1e8)), False)
        np.testing.assert_allclose(found.offset, sign * LARGEST_OFFSET_S)


@pytest.mark.usefixtures("near")
def test_what_says_nothing_makes_no_knot() -> None:
    t, information = np.array([10.15, 12.25, 14.25]), np.array([1e4, 0.9e-2, 1e4])
    score = made_score(np.full(3, 0.02), START, t, information)
    np.testing.assert_allclose(refined_clock(START, score, False).t, t[[0, 2]])
    score = made_score(np.full(3, 0.02), START, t, np.array([1e4, 1.1e-2, 1e4]))
    np.testing.assert_allclose(refined_clock(START, score, False).t, t)
    nothing = replace(score, information=0 * score.information)
    assert refined_clock(START, nothing, False) is START
    weak = replace(score, information=score.information * 1e-5, slope=score.slope * 1e-5)
    assert refined_clock(START, weak, False) is not START


def test_a_clock_is_linear_between_knots_and_held_beyond_and_one_goes_after_another() -> None:
    clock = Clock(np.array([1.0, 3.0]), np.array([0.01, 0.03]), 0.001)
    np.testing.assert_allclose(clock.at(np.array([0.0, 1.0, 2.0, 5.0])), [0.01, 0.01, 0.02, 0.03])
    assert (clock.mean_s, clock.drift_s) == (pytest.approx(0.02), pytest.approx(0.02))
    coarse = Clock(np.array([0.0, 100.0]), np.array([1.0, 1.5]), 0.1, skew=0.005)
    fine = Clock(np.array([20.0, 80.0]), np.array([0.01, 0.02]), 0.001, skew=1e-4)
    t = np.linspace(0.0, 100.0, 11)
    two_steps = t + coarse.at(t) + fine.at(t + coarse.at(t))
    np.testing.assert_allclose(t + fine.after(coarse).at(t), two_steps, atol=1e-4)
    assert fine.after(None) is fine


def even(rate_hz: float) -> FloatArray:
    return 5.0 + np.arange(100) / rate_hz


@pytest.mark.parametrize(
    ("stamps", "made_up"),
    [
        (even(30.0), False),  # a camera may well be that even
        (even(29.97), False),
        (even(26.3), True),  # no camera runs at that rate
        (np.round(even(26.3), 3), False),  # real stamps in whole milliseconds are not even
        (even(26.3) + 0.001 * np.random.default_rng(0).normal(size=100), False),
        (np.delete(even(30.0), [20, 50, 51]), False),
        (even(26.3)[:8], False),  # too few to tell
    ],
    ids=["30", "29.97", "26.3", "ms", "jitter", "dropped", "few"],
)
def test_stamps_that_somebody_made_up(stamps: FloatArray, made_up: bool) -> None:
    assert synthetic_stamps(stamps) is made_up


def found_clock(recording: Recording) -> Clock:
    """The clock of a recording's excerpts."""
    recording, coarse, _ = pair(recording)
    segments = [reject_by_camera(segment) for segment in split_into_segments(recording, 0)]
    (clock,) = self_calibrate(segments, ArmCalibration(), ALONE, Pool(1, 0)).clocks
    return clock.after(coarse)


def test_made_up_stamps_are_as_uncertain_as_a_dropped_frame() -> None:
    """Frames lost and the rest spread evenly, as a published data set has it: the sigma says so."""
    made = moving(2, "white", 40.0, dropped_frames=0.1)
    t = made.recording.arm.t_s
    spread = np.linspace(t[0], t[-1], len(t))
    assert synthetic_stamps(spread)
    clock = found_clock(later(made, t - spread))
    left, unmended = (float(np.sqrt(np.mean(x**2))) for x in (spread + clock.at(spread) - t, spread - t))
    assert clock.local_sigma_s >= SYNTHETIC_SIGMA_S
    assert left < 0.7 * unmended and left < 3 * clock.local_sigma_s


@pytest.fixture
def long() -> SimulatedArm:
    often = {"occlusion_lengths_s": (2.0,), "occlusion_every_s": 10.0}
    return moving(4, "white", 330.0, imu_rate_hz=80.0, **often)


def later(made: SimulatedArm, offset_s: FloatArray | float) -> Recording:
    """The camera's stamps are early by so much, (F,)."""
    arm = made.recording.arm
    return replace(made.recording, arm=replace(arm, t_s=arm.t_s - offset_s))


def rms_in_gaps_m(made: SimulatedArm, recovery: Recovery) -> float:
    return validate(recovery, made.recording.truth).occluded.position_rms_m


@pytest.mark.slow
def test_minutes_apart_more_is_looked_at(long: SimulatedArm) -> None:
    _, coarse = find_pairing(later(long, 75.0))  # farther than the context of the blocks
    assert coarse.mean_s == pytest.approx(75.0, abs=0.1)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("offset", "most_s"),
    [
        # 1200 ppm over 330 s: 0.4 s, as 20 of them are in 6 hours; and 1 s to begin with
        (lambda t: 1.0 + 1.2e-3 * t, 0.003),
        # ten milliseconds to and fro, which the few blocks cannot see: a line leaves 4.5 ms rms
        (lambda t: 0.02 + 0.01 * np.sin(2 * np.pi * t / 330.0), 0.003),
    ],
    ids=["drifts far", "wanders between the blocks"],
)
def test_clocks_that_drift_and_wander(
    long: SimulatedArm, offset: Callable[[FloatArray], FloatArray], most_s: float
) -> None:
    offset_s = offset(long.recording.arm.t_s)
    recording = later(long, offset_s)
    if np.ptp(offset_s) > 0.1:
        assert find_pairing(recording)[1].skew == pytest.approx(1.2e-3, abs=2e-4)
    recovery = answer(recording)
    error = recovery.arm.t_s - recording.arm.t_s - offset_s
    assert np.sqrt(np.mean(error**2)) < most_s
    assert np.ptp(offset_s) < 0.1 or np.abs(error).max() < most_s
    assert any("apart" in note for note in recovery.notes) == (np.ptp(offset_s) > 0.1)
    assert rms_in_gaps_m(long, recovery) < 0.01


def apart(preset: str, duration_s: float, seed: int, offset_s: float) -> tuple[Recording, float]:
    """A recording whose camera is early by so much more, and its true offset."""
    made = moving(seed, preset, duration_s)
    return later(made, offset_s), offset_s + made.parameters["clock_offset_s"]


def test_a_measured_clock_is_not_looked_for() -> None:
    recording, true_s = apart("realistic", 24.0, 2, 3.0)
    measured = Clock(np.array([10.0]), np.array([true_s]), 0.001, skew=1e-4)
    moved, clock, _ = pair(recording, None, measured)
    assert clock is measured
    t = recording.arm.t_s
    np.testing.assert_allclose(moved.arm.t_s, t + true_s + 1e-4 * (t - 10.0), atol=1e-12)


@pytest.mark.slow
def test_a_measured_clock_is_a_prior() -> None:
    recording, true_s = apart("realistic", 24.0, 2, 3.0)
    free = answer(recording)
    given = answer(recording, clock=constant_clock(true_s, 0.001))
    assert abs(given.clock_offset_s - true_s) < 0.002  # the joints' lag is a ms or two
    assert given.clock_offset_sigma_s < min(0.001, free.clock_offset_sigma_s)
    weak = answer(recording, clock=constant_clock(true_s + 0.05, 0.15))
    assert weak.clock_offset_s == pytest.approx(free.clock_offset_s, abs=0.003)


@pytest.mark.parametrize(("seconds", "seed"), [(12.0, 31), (20.0, 1)])
def test_speeds_that_agree_by_chance(seconds: float, seed: int) -> None:
    """A second off the two speeds agree clearly, but not the directions in which the forearm turns."""
    made = moving(seed, "realistic", seconds, occlusion_lengths_s=(1.0,), occlusion_every_s=6.0)
    assert coarse_offset(made.recording, LARGEST_OFFSET_S) == 0.0
    assert coarse_offset(later(made, 2.0), LARGEST_OFFSET_S) == pytest.approx(2.0, abs=0.1)
