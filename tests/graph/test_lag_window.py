"""The window of the last moments: an iteration is Gauss-Newton's, what left it counts on."""

from __future__ import annotations

from dataclasses import dataclass

import gtsam
import numpy as np
import pytest
from gtsam import Rot3
from gtsam.symbol_shorthand import L, X
from lag_arms import DT, LEVERS, SIGMA_M, TILTED, intervals, lag_window

from smoother.array_types import FloatArray
from smoother.graph.lag_window import LagWindow, iterate
from smoother.window.problem import ImuIncrements
from smoother.window.solution import LagSolution, NodeState

#: Of a camera that stands level: GTSAM's axes across gravity then turn on the way.
LEVEL = np.array([0.0, 0.0, -1.0])
#: From the elbow: the upper arm is carried along.
UPPER_ARM = np.array([0.05, -0.25, 0.1])
COUNT = 90


@dataclass(frozen=True)
class Motion:
    """A turning arm: true states, the intervals between them, noisy joints."""

    down: FloatArray
    states: list[NodeState]
    increments: list[ImuIncrements]
    joints: list[dict[str, FloatArray]]


@pytest.fixture(scope="module", params=[TILTED, LEVEL], ids=["tilted", "level"])
def motion(request: pytest.FixtureRequest) -> Motion:
    """Specific force and rate constant in each interval; the shoulder goes along with the elbow."""
    rng, down = np.random.default_rng(4), request.param
    t = np.arange(COUNT) * DT
    turn = np.column_stack([0.5 * np.sin(2.0 * t), 0.6 * np.sin(2.6 * t + 1.0), 0.7 * np.sin(1.7 * t)])
    R = [Rot3.Expmap(each) for each in turn]
    p = [np.array([0.3, 0.0, 0.1]) + 0.2 * np.sin([1.9 * s, 2.3 * s, 1.4 * s]) for s in t]
    states, increments = intervals(t, R, p, down, rng)
    joints = []
    for state in states:
        seen = {joint: state.p + state.R @ lever for joint, lever in LEVERS.items()}
        seen["shoulder"] = seen["elbow"] + UPPER_ARM
        joints.append({joint: point + rng.normal(0.0, SIGMA_M, 3) for joint, point in seen.items()})
    return Motion(down, states, increments, joints)


def followed(
    motion: Motion, length_s: float, gap: range = range(0), late: int | None = None, shoulder: bool = False
) -> tuple[LagWindow, list[LagSolution]]:
    """A window fed node by node, begun near the truth; nothing is seen in the gap; a frame comes late."""
    lag, solutions = lag_window(motion.down, length_s, shoulder), []
    joints = [*LEVERS, *(["shoulder"] if shoulder else [])]
    for k, state in enumerate(motion.states):
        begin = NodeState(state.t, state.R, state.p + 0.003, state.v)
        lag.add(begin, motion.increments[k - 1] if k else None)
        if late is not None and k == late + 5:
            for joint in joints:
                lag.measure(len(lag.t) - 6, joint, motion.joints[late][joint])
        if k not in gap and k != late:
            for joint in joints:
                lag.measure(-1, joint, motion.joints[k][joint])
        solutions.append(lag.solve(state.t - 0.2))
    return lag, solutions


@pytest.mark.slow
@pytest.mark.parametrize("shoulder", [False, True])
def test_what_left_the_window_counts_as_if_it_were_there(motion: Motion, shoulder: bool) -> None:
    # the gap begins inside the short window and is longer than it: all that is known of the joints' places
    # is in what left
    gap = range(45, 75)
    (_, short), (_, whole) = (followed(motion, length, gap, shoulder=shoulder) for length in (0.7, 100.0))
    for a, b in zip(short[15:], whole[15:], strict=True):
        sigma = np.sqrt(np.diag(b.covariance)[b.rows["position"]])
        # both are linearised at different moments (seen 0.011 sigma, and 0.6 % of a variance)
        assert (np.abs(a.newest.p - b.newest.p) < 0.03 * sigma).all()
        ratio = np.diag(a.covariance) / np.diag(b.covariance)
        names = ("turn", "position", "velocity", "settled_position")
        assert all((np.abs(ratio[a.rows[name]] - 1.0) < 0.02).all() for name in names)


@pytest.mark.parametrize("shoulder", [False, True])
def test_sigma_covers_the_error_and_grows_in_a_gap(motion: Motion, shoulder: bool) -> None:
    gap = range(45, 75)
    lag, solutions = followed(motion, 0.7, gap, shoulder=shoulder)
    assert lag.t[-1] - lag.t[0] == pytest.approx(0.7, abs=DT), "nodes leave"
    sigma_m, nees = [], []
    for state, solution in zip(motion.states, solutions, strict=True):
        block = solution.block("position")
        off = solution.newest.p - state.p
        sigma_m.append(np.sqrt(np.trace(block)))
        nees.append(off @ np.linalg.solve(block, off) / 3.0)
        # the whole covariance is one: symmetric, and no direction is negative
        np.testing.assert_allclose(solution.covariance, solution.covariance.T, atol=1e-12)
        assert np.linalg.eigvalsh(block).min() > 0
        if state.t > 0.3:
            assert -1e-9 <= solution.newest.t - 0.2 - solution.settled.t <= DT + 1e-9
            assert np.trace(solution.block("settled_position")) < np.trace(block)
    assert sigma_m[74] > 3.0 * sigma_m[44] and sigma_m[80] < 0.5 * sigma_m[74]
    # one motion, errors of neighbours alike: a wide band (seen 0.5 and 0.6)
    assert 0.05 < np.mean(nees[15:]) < 3.0


@pytest.mark.slow
def test_a_late_frame_counts_as_one_in_time(motion: Motion) -> None:
    (_, late), (_, in_time), (_, never) = (
        followed(motion, 0.7, late=60), followed(motion, 0.7), followed(motion, 0.7, range(60, 61))
    )  # fmt: skip
    # iterations stop at a millimetre, and windows without the frame were solved in between
    np.testing.assert_allclose(late[-1].newest.p, in_time[-1].newest.p, atol=2e-5)
    np.testing.assert_allclose(late[63].newest.p, never[63].newest.p, atol=1e-12)
    assert np.linalg.norm(late[65].newest.p - never[65].newest.p) > 1e-4


def test_samples_that_come_late_replace_an_interval(motion: Motion) -> None:
    lag, right = lag_window(motion.down, 0.7, False), lag_window(motion.down, 0.7, False)
    wrong = motion.increments[19]
    wrong = ImuIncrements(
        wrong.acc + 30.0, wrong.gyro, wrong.h, wrong.first, wrong.bias, wrong.velocity_error
    )
    for k, state in enumerate(motion.states[:30]):
        for one in (lag, right):
            of_k = wrong if one is lag and k == 20 else motion.increments[k - 1]
            one.add(state, of_k if k else None)
            if one is lag and k == 25:
                one.set_increments(len(one.t) - 6, motion.increments[19])
            for joint in LEVERS:
                one.measure(-1, joint, motion.joints[k][joint])
        solutions = lag.solve(0.0), right.solve(0.0)
        apart_m = np.linalg.norm(solutions[0].newest.p - solutions[1].newest.p)
        if k == 21:
            assert apart_m > 5e-3  # 1 m/s too much
    assert apart_m < 5e-4  # what left in between was linearised elsewhere (seen 0.14 mm)


def test_the_wrist_alone_leaves_its_place_open_at_first_and_says_so(motion: Motion) -> None:
    lag = lag_window(motion.down, 0.7, False)
    lag.add(motion.states[0], None)
    unseen = lag.solve(0.0)
    lag.measure(-1, "wrist", motion.joints[0]["wrist"])
    once_seen = lag.solve(0.0)
    # half a metre, and half a radian at the wrist's lever arm of 10 cm
    assert np.sqrt(np.diag(unseen.block("position"))) == pytest.approx(np.full(3, 0.5), rel=0.02)
    assert np.sqrt(np.diag(once_seen.block("position"))).max() == pytest.approx(0.05, rel=0.2)
    assert once_seen.shoulder is None and "shoulder" not in once_seen.rows


UNIT = gtsam.noiseModel.Isotropic.Sigma


def chain() -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
    """Three poses that turn, a point seen from each by a lever arm, wrong values at first."""
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    lever, rng = np.array([0.1, 0.02, 0.0]), np.random.default_rng(1)
    poses = [
        gtsam.Pose3(gtsam.Rot3.Expmap([0.3 * k, 0.1, 0.2]), np.array([0.2 * k, 0.1, 1.0])) for k in range(3)
    ]
    for k, pose in enumerate(poses):
        values.insert(X(k), pose.retract(rng.normal(0.0, 0.05, 6)))
        graph.add(gtsam.GPSFactorArmCalib(X(k), L(0), pose.transformFrom(lever), UNIT(3, 0.01)))
        if k:
            graph.add(gtsam.BetweenFactorPose3(X(k - 1), X(k), poses[k - 1].between(pose), UNIT(6, 0.02)))
    graph.add(gtsam.PriorFactorPose3(X(0), poses[0], UNIT(6, 0.1)))
    graph.add(gtsam.PriorFactorPoint3(L(0), lever, UNIT(3, 0.02)))
    values.insert(L(0), lever + 0.03)
    return graph, values


@pytest.mark.parametrize("asked", [[X(2)], [X(2), L(0), X(0)], [X(0), X(1), X(2), L(0)]])
def test_step_and_covariance_are_those_of_gtsam(asked: list[int]) -> None:
    graph, values = chain()
    iteration = iterate(graph, values, asked)
    expected = values.retract(graph.linearize(values).optimize())
    for k in range(3):
        assert iteration.values.atPose3(X(k)).equals(expected.atPose3(X(k)), 1e-9)
    np.testing.assert_allclose(iteration.values.atPoint3(L(0)), expected.atPoint3(L(0)), atol=1e-9)
    marginals = gtsam.Marginals(graph, values)
    for key in asked:
        rows = iteration.columns[key]
        np.testing.assert_allclose(
            iteration.covariance[rows, rows], marginals.marginalCovariance(key), rtol=1e-6, atol=1e-10
        )
    if len(asked) > 1:
        first, second = iteration.columns[asked[0]], iteration.columns[asked[1]]
        joint = marginals.jointMarginalCovariance(gtsam.KeyVector(asked[:2]))
        np.testing.assert_allclose(
            iteration.covariance[first, second], joint.at(asked[0], asked[1]), rtol=1e-6, atol=1e-10
        )


def test_what_nothing_holds_is_refused() -> None:
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    values.insert(X(0), gtsam.Pose3())
    graph.add(gtsam.GPSFactor(X(0), np.ones(3), UNIT(3, 0.01)))
    with pytest.raises(np.linalg.LinAlgError, match="free"):
        iterate(graph, values, [X(0)])
