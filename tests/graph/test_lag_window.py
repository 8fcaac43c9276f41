"""The window of the last moments: what left it still counts, and what comes late; sigma covers the error."""

from __future__ import annotations

from dataclasses import dataclass

import gtsam
import numpy as np
import pytest
from gtsam import Rot3

from smoother.array_types import FloatArray
from smoother.graph.lag_window import LagWindow
from smoother.recording import JOINTS
from smoother.units import GRAVITY
from smoother.window.problem import ImuIncrements, NoiseModel, Priors
from smoother.window.shared import Gaussian, SharedLayout, axes_across
from smoother.window.solution import LagSolution, NodeState

NOISE = NoiseModel(0.02, 0.003, 0.0, 0.0, 1e3, 0.01, 0.3)  # Cauchy's loss so wide that it is none
#: Of a camera that is tilted, and of one that stands level: GTSAM's axes across gravity then turn on the way.
TILTED = np.array([0.1, -0.4, -0.9]) / np.linalg.norm([0.1, -0.4, -0.9])
LEVEL = np.array([0.0, 0.0, -1.0])
LEVERS = {"elbow": np.array([-0.12, 0.01, 0.02]), "wrist": np.array([0.1, 0.0, -0.01])}
#: From the elbow: the upper arm is carried along.
UPPER_ARM = np.array([0.05, -0.25, 0.1])
SIGMA_M, DT, COUNT = 0.01, 1 / 30, 90


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
    v = [0.2 * np.array([1.9 * np.cos(1.9 * s), 2.3 * np.cos(2.3 * s), 1.4 * np.cos(1.4 * s)]) for s in t]
    states, increments = [NodeState(t[0], R[0].matrix(), p[0], v[0])], []
    for k in range(1, COUNT):
        gyro = Rot3.Logmap(R[k - 1].between(R[k])) / DT
        acc = R[k - 1].unrotate((v[k] - v[k - 1]) / DT - GRAVITY * down)
        params = gtsam.PreintegrationParams(GRAVITY * down)
        pim = gtsam.PreintegratedImuMeasurements(params, gtsam.imuBias.ConstantBias())
        pim.integrateMeasurement(acc, gyro, 0.5 * DT)
        pim.integrateMeasurement(acc, gyro, 0.5 * DT)
        before = states[-1]
        nav = pim.predict(gtsam.NavState(Rot3(before.R), before.p, before.v), gtsam.imuBias.ConstantBias())
        states.append(NodeState(t[k], nav.attitude().matrix(), nav.position(), nav.velocity()))
        acc = acc + rng.normal(0.0, NOISE.accelerometer_density / np.sqrt(DT), 3)
        gyro = gyro + rng.normal(0.0, NOISE.gyroscope_density / np.sqrt(DT), 3)
        two = np.stack([acc, acc])[None]
        increments.append(
            ImuIncrements(two, gyro[None], np.array([0.5 * DT]), np.array([0, 1]), np.zeros(6), np.zeros(1))
        )
    joints = []
    for state in states:
        seen = {joint: state.p + state.R @ lever for joint, lever in LEVERS.items()}
        seen["shoulder"] = seen["elbow"] + UPPER_ARM
        joints.append({joint: point + rng.normal(0.0, SIGMA_M, 3) for joint, point in seen.items()})
    return Motion(down, states, increments, joints)


def window(down: FloatArray, length_s: float, has_upper_arm: bool = False) -> LagWindow:
    """Lever arms known to 5 mm, gravity to a degree."""
    layout = SharedLayout(
        tuple(joint for joint in JOINTS if joint in LEVERS), has_upper_arm, axes_across(down)
    )
    mean, sigma = np.zeros(layout.size), np.full(layout.size, 0.005)
    sigma[:3], sigma[3:6], sigma[layout.gravity] = 0.05, 0.005, 0.02
    for joint, lever in LEVERS.items():
        mean[layout.lever(joint)] = lever
    mean[layout.upper_arm], sigma[layout.upper_arm] = 0.3, 0.3
    priors = Priors(layout, Gaussian(mean, np.diag(sigma**2)), np.repeat([1e-3, 1e-4], 3))
    return LagWindow(priors, NOISE, np.full(len(JOINTS), SIGMA_M), GRAVITY, length_s)


def followed(
    motion: Motion, length_s: float, gap: range = range(0), late: int | None = None, shoulder: bool = False
) -> tuple[LagWindow, list[LagSolution]]:
    """A window fed node by node, begun near the truth; nothing is seen in the gap; a frame comes late."""
    lag, solutions = window(motion.down, length_s, shoulder), []
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


def test_nodes_leave(motion: Motion) -> None:
    lag, _ = followed(motion, 0.7)
    assert lag.t[-1] - lag.t[0] == pytest.approx(0.7, abs=DT)
    assert lag.state(0).t == lag.t[0] and lag.state(-1).t == lag.t[-1]
    # two stay however short the window is
    lag, _ = followed(motion, 0.0)
    assert len(lag.t) == 2


@pytest.mark.parametrize("shoulder", [False, True])
def test_sigma_covers_the_error_and_grows_in_a_gap(motion: Motion, shoulder: bool) -> None:
    gap = range(45, 75)
    _, solutions = followed(motion, 0.7, gap, shoulder=shoulder)
    sigma_m, nees = [], []
    for state, solution in zip(motion.states, solutions, strict=True):
        block = solution.block("position")
        off = solution.newest.p - state.p
        sigma_m.append(np.sqrt(np.trace(block)))
        nees.append(off @ np.linalg.solve(block, off) / 3.0)
        # the whole covariance is one: symmetric, and no direction is negative
        np.testing.assert_allclose(solution.covariance, solution.covariance.T, atol=1e-12)
        assert np.linalg.eigvalsh(block).min() > 0
    assert sigma_m[74] > 3.0 * sigma_m[44] and sigma_m[80] < 0.5 * sigma_m[74]
    # one motion, errors of neighbours alike: a wide band (seen 0.5 and 0.6)
    assert 0.05 < np.mean(nees[15:]) < 3.0


def test_the_settled_node_is_a_lag_ago_and_better_known(motion: Motion) -> None:
    _, solutions = followed(motion, 0.7)
    for solution in solutions[15:]:
        assert -1e-9 <= solution.newest.t - 0.2 - solution.settled.t <= DT + 1e-9
        settled, newest = solution.block("settled_position"), solution.block("position")
        assert np.trace(settled) < np.trace(newest)


def test_a_late_frame_counts_as_one_in_time(motion: Motion) -> None:
    (_, late), (_, in_time), (_, never) = (
        followed(motion, 0.7, late=60), followed(motion, 0.7), followed(motion, 0.7, range(60, 61))
    )  # fmt: skip
    # iterations stop at a millimetre, and windows without the frame were solved in between
    np.testing.assert_allclose(late[-1].newest.p, in_time[-1].newest.p, atol=2e-5)
    np.testing.assert_allclose(late[63].newest.p, never[63].newest.p, atol=1e-12)
    assert np.linalg.norm(late[65].newest.p - never[65].newest.p) > 1e-4


def test_samples_that_come_late_replace_an_interval(motion: Motion) -> None:
    lag, right = window(motion.down, 0.7), window(motion.down, 0.7)
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
    lag = window(motion.down, 0.7)
    lag.add(motion.states[0], None)
    unseen = lag.solve(0.0)
    lag.measure(-1, "wrist", motion.joints[0]["wrist"])
    once_seen = lag.solve(0.0)
    # half a metre, and half a radian at the wrist's lever arm of 10 cm
    assert np.sqrt(np.diag(unseen.block("position"))) == pytest.approx(np.full(3, 0.5), rel=0.02)
    assert np.sqrt(np.diag(once_seen.block("position"))).max() == pytest.approx(0.05, rel=0.2)
    assert once_seen.shoulder is None and "shoulder" not in once_seen.rows
