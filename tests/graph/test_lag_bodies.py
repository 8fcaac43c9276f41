"""A lag window with a second IMU: two bodies share the elbow; samples come late, or are left out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from gtsam import Rot3
from lag_arms import DT, LEVERS, SIGMA_M, TILTED, UPPER, UPPER_LEVERS, intervals, lag_window

from smoother.array_types import FloatArray
from smoother.graph.lag_window import LagWindow
from smoother.units import GRAVITY
from smoother.window.problem import ImuIncrements
from smoother.window.solution import LagSolution, NodeState

SHOULDER = np.array([0.3, 0.2, 0.1])
COUNT = 75
#: Nothing of the forearm is seen in these; the gap is longer than the short window.
GAP = range(35, 65)


@dataclass(frozen=True)
class Chain:
    """True states of both IMUs, the intervals between them, noisy joints."""

    states: dict[str, list[NodeState]]
    increments: dict[str, list[ImuIncrements]]
    joints: list[dict[str, FloatArray]]


@pytest.fixture(scope="module")
def chain() -> Chain:
    """An upper arm that turns about a still shoulder, and a forearm that turns about its elbow."""
    rng, t = np.random.default_rng(4), np.arange(COUNT) * DT
    upper = [
        Rot3.Expmap(np.array([0.6 * np.sin(1.9 * s), 0.3 * np.sin(1.3 * s), 0.5 * np.sin(2.2 * s)]))
        for s in t
    ]
    fore = [
        Rot3.Expmap(np.array([0.5 * np.sin(2.0 * s), 0.6 * np.sin(2.6 * s + 1.0), 0.7 * np.sin(1.7 * s)]))
        for s in t
    ]
    places = [SHOULDER - R.rotate(UPPER_LEVERS["shoulder"]) for R in upper]
    states, increments = {}, {}
    states[UPPER], increments[UPPER] = intervals(t, upper, places, TILTED, rng)
    elbows = [state.p + state.R @ UPPER_LEVERS["elbow"] for state in states[UPPER]]
    places = [elbow - R.rotate(LEVERS["elbow"]) for elbow, R in zip(elbows, fore, strict=True)]
    states["forearm"], increments["forearm"] = intervals(t, fore, places, TILTED, rng)
    joints = []
    for state, own in zip(states["forearm"], states[UPPER], strict=True):
        seen = {joint: state.p + state.R @ lever for joint, lever in LEVERS.items()}
        seen["shoulder"] = own.p + own.R @ UPPER_LEVERS["shoulder"]
        joints.append({joint: point + rng.normal(0.0, SIGMA_M, 3) for joint, point in seen.items()})
    return Chain(states, increments, joints)


def attach(lag: LagWindow, chain: Chain, k: int, index: int = -1) -> None:
    """The upper arm at the k-th node, which is `index` in the window; it begins where it has none yet."""
    index %= len(lag.t)
    begins = not lag.nodes_of(UPPER)
    state = chain.states[UPPER][k]
    start = NodeState(state.t, state.R, state.p + 0.003, state.v)
    lag.attach(index, UPPER, start, None if begins else chain.increments[UPPER][k - 1])


def window(length_s: float, further: tuple[str, ...] = (UPPER,)) -> LagWindow:
    return lag_window(TILTED, length_s, further=further)


def followed(
    chain: Chain, length_s: float, late: int = 0, joins: bool = True, further: tuple[str, ...] = (UPPER,)
) -> tuple[LagWindow, list[LagSolution]]:
    """A window fed node by node; the second IMU's samples come so many nodes late."""
    lag, solutions = window(length_s, further), []
    for k, state in enumerate(chain.states["forearm"]):
        begin = NodeState(state.t, state.R, state.p + 0.003, state.v)
        lag.add(begin, chain.increments["forearm"][k - 1] if k else None)
        for joint in ("shoulder", *(() if k in GAP else LEVERS)):
            lag.measure(-1, joint, chain.joints[k][joint])
        if joins and k >= late:
            attach(lag, chain, k - late, -1 - late)
        solutions.append(lag.solve(state.t - 0.2))
    return lag, solutions


def errors(chain: Chain, solutions: list[LagSolution]) -> tuple[FloatArray, FloatArray]:
    """How far off each newest node is, m, and its sigma, m, both of three axes."""
    pairs = zip(chain.states["forearm"], solutions, strict=True)
    off = [float(np.linalg.norm(solution.newest.p - state.p)) for state, solution in pairs]
    sigma = [float(np.sqrt(np.trace(solution.block("position")))) for solution in solutions]
    return np.array(off), np.array(sigma)


@pytest.mark.slow
def test_what_left_the_window_counts_as_if_it_were_there(chain: Chain) -> None:
    (lag, short), (_, whole) = (followed(chain, length) for length in (0.7, 100.0))
    assert len(lag.t) == len(lag.nodes_of(UPPER)) == 21
    for a, b in zip(short[15:], whole[15:], strict=True):
        sigma = np.sqrt(np.diag(b.covariance)[b.rows["position"]])
        # linearised at different moments (seen 0.03 sigma, and 1 % of a variance)
        assert (np.abs(a.newest.p - b.newest.p) < 0.08 * sigma).all()
        ratio = np.diag(a.covariance) / np.diag(b.covariance)
        assert all((np.abs(ratio[a.rows[name]] - 1.0) < 0.04).all() for name in ("turn", "position"))


@pytest.mark.slow
def test_it_holds_the_forearm_in_a_gap_and_says_how_well(chain: Chain) -> None:
    (_, two), (_, one) = followed(chain, 0.7), followed(chain, 0.7, further=(), joins=False)
    (off, sigma), (_, alone) = errors(chain, two), errors(chain, one)
    end = GAP[-1]
    assert sigma[end] < 0.6 * alone[end]
    assert (off < 3.0 * sigma).all()


@pytest.mark.slow
def test_samples_that_come_late_count_like_those_in_time(chain: Chain) -> None:
    (lag, late), (_, prompt) = followed(chain, 0.7, late=4), followed(chain, 0.7)
    assert len(lag.nodes_of(UPPER)) == len(lag.t) - 4
    for k in range(COUNT - 4, COUNT):
        attach(lag, chain, k, k - COUNT)
    a, b = lag.solve(0.0), prompt[-1]
    apart = np.abs(a.newest.p - b.newest.p) / np.sqrt(np.diag(b.block("position")))
    assert (apart < 0.08).all()  # some left before they came, linearised elsewhere
    off, sigma = errors(chain, late)
    assert (off < 3.0 * sigma).all()
    _, alone = errors(chain, followed(chain, 0.7, further=(), joins=False)[1])
    assert sigma[GAP[-1]] < 0.7 * alone[GAP[-1]]


def test_left_out_before_it_left_it_is_as_if_it_had_never_been_there(chain: Chain) -> None:
    lags = [window(100.0), window(100.0)]
    for k, state in enumerate(chain.states["forearm"][:20]):
        for lag in lags:
            lag.add(state, chain.increments["forearm"][k - 1] if k else None)
            for joint in ("shoulder", *LEVERS):
                lag.measure(-1, joint, chain.joints[k][joint])
        attach(lags[0], chain, k)
    lags[0].detach(UPPER, -np.inf)
    assert not lags[0].nodes_of(UPPER)
    a, b = (lag.solve(0.0) for lag in lags)
    np.testing.assert_allclose(a.newest.p, b.newest.p, atol=1e-12)
    np.testing.assert_allclose(a.covariance, b.covariance, rtol=1e-9, atol=1e-15)


def test_left_out_after_it_left_the_rest_goes_on_and_it_may_begin_again(chain: Chain) -> None:
    lag, solutions = window(0.5), []
    for k, state in enumerate(chain.states["forearm"]):
        lag.add(state, chain.increments["forearm"][k - 1] if k else None)
        for joint in ("shoulder", *(() if k in GAP else LEVERS)):
            lag.measure(-1, joint, chain.joints[k][joint])
        if k == 25:
            lag.detach(UPPER, lag.t[3])
            assert len(lag.nodes_of(UPPER)) == 3
            lag.detach(UPPER, -np.inf)
            assert not lag.nodes_of(UPPER)
        if k < 25 or k >= 30:
            attach(lag, chain, k)
        solutions.append(lag.solve(state.t - 0.2))
    off, sigma = errors(chain, solutions)
    assert (off < 3.0 * sigma).all()
    assert lag.nodes_of(UPPER) == list(range(len(lag.t)))


def test_an_imu_that_rests_beside_a_moving_arm_does_not_fit(chain: Chain) -> None:
    lag, _ = followed(chain, 100.0)
    sound = lag.misfit(UPPER, -np.inf)
    # 12 rows a node, three of them taken up by the shared joint's place and nine by the state
    assert sound < 0.7
    assert np.isnan(window(1.0).misfit(UPPER, -np.inf))
    still = -GRAVITY * chain.states[UPPER][0].R.T @ TILTED
    force, half_s, first = np.tile(still, (1, 2, 1)), np.array([0.5 * DT]), np.array([0, 1])
    rest = ImuIncrements(force, np.zeros((1, 3)), half_s, first, np.zeros(6), np.zeros(1))
    for index in lag.nodes_of(UPPER)[30:]:
        lag.set_increments(index, rest, UPPER)
    lag.solve(0.0)
    assert lag.misfit(UPPER, -np.inf) > 20.0 * sound
