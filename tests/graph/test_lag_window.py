"""The window of the last moments: Gauss-Newton, what left it counts on, a second IMU comes and goes."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import gtsam
import numpy as np
import pytest
from gtsam import Rot3
from gtsam.symbol_shorthand import B, L, X

from smoother.array_types import FloatArray
from smoother.graph import lag_window as lag_window_module
from smoother.graph.lag_window import LagWindow, iterate
from smoother.measurements.inertial import Preintegration, equivalent_samples
from smoother.recording import JOINTS
from smoother.units import GRAVITY
from smoother.window.problem import ImuIncrements, NoiseModel, Priors
from smoother.window.shared import Gaussian, SharedLayout, axes_across
from smoother.window.solution import LagSolution, NodeState

UPPER = "upper_arm"
#: Cauchy's loss so wide that it is none.
NOISE = NoiseModel(0.02, 0.003, 0.0, 0.0, 1e3, 0.01, 0.3, tissue_m=((UPPER, 0.005),))
#: Down of a camera that is tilted, and of one that stands level: GTSAM's axes across gravity turn there.
DOWN = {"tilted": np.array([0.1, -0.4, -0.9]) / np.linalg.norm([0.1, -0.4, -0.9]), "level": -np.eye(3)[2]}
LEVERS = {"elbow": np.array([-0.12, 0.01, 0.02]), "wrist": np.array([0.1, 0.0, -0.01])}
UPPER_LEVERS = {"elbow": np.array([0.0, -0.14, 0.03]), "shoulder": np.array([0.01, 0.16, 0.03])}
SIGMA_M, DT = 0.01, 1 / 30
SHORT_S, WHOLE_S = 0.7, 100.0


def intervals(
    t: FloatArray, R: list[Rot3], place: list[FloatArray], down: FloatArray, rng: np.random.Generator
) -> tuple[list[NodeState], list[ImuIncrements]]:
    """States that go through places, and noisy samples of the intervals: exact but for the noise."""
    R, p, g = np.array([each.matrix() for each in R]), np.array(place), GRAVITY * down
    v, back = np.gradient(p, DT, axis=0), np.swapaxes(R[:-1], 1, 2)
    delta_v, delta_p = v[1:] - v[:-1] - g * DT, p[1:] - p[:-1] - v[:-1] * DT - 0.5 * g * DT**2
    in_body = (np.einsum("nij,nj->ni", back, each) for each in (delta_v, delta_p))
    acc, gyro, h = equivalent_samples(Preintegration(back @ R[1:], *in_body, np.full(len(t) - 1, DT)))
    acc += rng.normal(0.0, NOISE.accelerometer_density / np.sqrt(DT), (len(acc), 1, 3))
    gyro += rng.normal(0.0, NOISE.gyroscope_density / np.sqrt(DT), gyro.shape)
    states = [NodeState(*state) for state in zip(t.tolist(), R, p, v, strict=True)]
    one = np.array([0, 1]), np.zeros(6), np.zeros(1)
    return states, [ImuIncrements(*(x[k : k + 1] for x in (acc, gyro, h)), *one) for k in range(len(h))]


def lag_window(
    down: FloatArray, length_s: float = SHORT_S, has_upper_arm: bool = False, further: tuple[str, ...] = ()
) -> LagWindow:
    """Lever arms known to 5 mm, gravity to a degree."""
    layout = SharedLayout(tuple(LEVERS), has_upper_arm, axes_across(down), further)
    mean, sigma = np.zeros(layout.size), np.full(layout.size, 0.005)
    sigma[:3], sigma[3:6], sigma[layout.gravity] = 0.05, 0.005, 0.02
    for joint, lever in LEVERS.items():
        mean[layout.lever(joint)] = lever
    for segment in further:
        bias = layout.bias_of(segment)
        sigma[bias.start : bias.start + 3] = 0.05
        for joint, lever in UPPER_LEVERS.items():
            mean[layout.lever(joint, segment)] = lever
    mean[layout.upper_arm], sigma[layout.upper_arm] = 0.3, 0.3
    priors = Priors(layout, Gaussian(mean, np.diag(sigma**2)), np.repeat([1e-3, 1e-4], 3))
    return LagWindow(priors, NOISE, np.full(len(JOINTS), SIGMA_M), length_s)


@dataclass(frozen=True)
class Motion:
    """True states of the IMUs, the intervals between them, noisy joints; the gap outlasts a short window."""

    down: FloatArray
    states: dict[str, list[NodeState]]
    increments: dict[str, list[ImuIncrements]]
    joints: list[dict[str, FloatArray]]
    gap: range

    def add(self, lag: LagWindow, k: int, seen: tuple[str, ...], off_m: float = 0.003) -> None:
        """The k-th node of the forearm, begun near the truth, with what is seen of it."""
        state = self.states["forearm"][k]
        begin = NodeState(state.t, state.R, state.p + off_m, state.v)
        lag.add(begin, self.increments["forearm"][k - 1] if k else None)
        self.see(lag, -1, k, seen)

    def see(self, lag: LagWindow, index: int, k: int, joints: tuple[str, ...]) -> None:
        for joint in joints:
            lag.measure(index, joint, self.joints[k][joint])

    def attach(self, lag: LagWindow, k: int, index: int = -1) -> None:
        """The upper arm at the k-th node, which is `index` in the window; it begins where it has none yet."""
        state, begins = self.states[UPPER][k], not lag.nodes_of(UPPER)
        start = NodeState(state.t, state.R, state.p + 0.003, state.v)
        lag.attach(index % len(lag.t), UPPER, start, None if begins else self.increments[UPPER][k - 1])

    def errors(self, solutions: list[LagSolution]) -> tuple[FloatArray, FloatArray]:
        """How far off each newest node is, m, and its sigma, m, both of three axes."""
        pairs = zip(self.states["forearm"], solutions, strict=True)
        off = [float(np.linalg.norm(solution.newest.p - state.p)) for state, solution in pairs]
        sigma = [float(np.sqrt(np.trace(solution.block("position")))) for solution in solutions]
        return np.array(off), np.array(sigma)


def turns(t: FloatArray, size: list[float], rate: list[float], phase: float = 0.0) -> list[Rot3]:
    return [Rot3.Expmap(np.array(size) * np.sin(np.array(rate) * s + [0.0, phase, 0.0])) for s in t]


@cache
def motion_of(kind: str) -> Motion:
    """A forearm that turns and moves, its shoulder going along; a `chain` has an IMU on the upper arm."""
    rng, down = np.random.default_rng(4), DOWN["level" if kind == "level" else "tilted"]
    t = np.arange(75 if kind == "chain" else 90) * DT
    states, increments = {}, {}
    if kind == "chain":
        upper = turns(t, [0.6, 0.3, 0.5], [1.9, 1.3, 2.2])
        fore = turns(t, [0.5, 0.6, 0.7], [2.0, 2.6, 1.7], 1.0)
        places = [np.array([0.3, 0.2, 0.1]) - R.rotate(UPPER_LEVERS["shoulder"]) for R in upper]
        states[UPPER], increments[UPPER] = intervals(t, upper, places, down, rng)
        elbows = [state.p + state.R @ UPPER_LEVERS["elbow"] for state in states[UPPER]]
        places = [elbow - R.rotate(LEVERS["elbow"]) for elbow, R in zip(elbows, fore, strict=True)]
    else:
        fore = turns(t, [0.5, 0.6, 0.7], [2.0, 2.6, 1.7], 1.0)
        places = [np.array([0.3, 0.0, 0.1]) + 0.2 * np.sin([1.9 * s, 2.3 * s, 1.4 * s]) for s in t]
    states["forearm"], increments["forearm"] = intervals(t, fore, places, down, rng)
    joints = []
    for k, state in enumerate(states["forearm"]):
        seen = {joint: state.p + state.R @ lever for joint, lever in LEVERS.items()}
        if kind == "chain":
            seen["shoulder"] = states[UPPER][k].p + states[UPPER][k].R @ UPPER_LEVERS["shoulder"]
        else:
            seen["shoulder"] = seen["elbow"] + np.array([0.05, -0.25, 0.1])
        joints.append({joint: point + rng.normal(0.0, SIGMA_M, 3) for joint, point in seen.items()})
    return Motion(down, states, increments, joints, range(35, 65) if kind == "chain" else range(45, 75))


@pytest.fixture(params=["tilted", "level"])
def motion(request: pytest.FixtureRequest) -> Motion:
    return motion_of(request.param)


@pytest.fixture
def chain() -> Motion:
    return motion_of("chain")


def followed(
    motion: Motion,
    length_s: float = SHORT_S,
    hidden: range = range(0),
    late: int | None = None,
    shoulder: bool = False,
    upper: int | None = None,
    away: range = range(0),
    wrong: int | None = None,
) -> tuple[LagWindow, list[LagSolution]]:
    """A window fed node by node; nothing is seen while hidden, but for a chain's shoulder.

    One frame comes five nodes late, so do the right samples of a wrong interval; a second IMU's samples come
    `upper` nodes late, and it is left out while away.
    """
    lag, solutions = lag_window(motion.down, length_s, shoulder, () if upper is None else (UPPER,)), []
    for k, state in enumerate(motion.states["forearm"]):
        seen = () if k in hidden or k == late else tuple(LEVERS)
        if shoulder and (seen or UPPER in motion.states):
            seen = (*seen, "shoulder")
        motion.add(lag, k, seen)
        if late is not None and k == late + 5:
            motion.see(lag, len(lag.t) - 6, late, tuple(LEVERS))
        if wrong is not None and k in (wrong, wrong + 5):
            exact = motion.increments["forearm"][wrong - 1]
            off = replace(exact, acc=exact.acc + 30.0) if k == wrong else exact
            lag.set_increments(len(lag.t) - 1 - (k - wrong), off)
        if k in away:
            lag.detach(UPPER, -np.inf)
        elif upper is not None and k >= upper:
            motion.attach(lag, k - upper, -1 - upper)
        solutions.append(lag.solve(state.t - 0.2))
    return lag, solutions


@pytest.mark.slow
@pytest.mark.parametrize("kind", [*DOWN, "chain"])
def test_what_left_the_window_counts_as_if_it_were_there(kind: str) -> None:
    """The gap begins inside the short window: all that is known of the joints' places is in what left."""
    # linearised at different moments (seen 0.03 sigma, 1 % of a variance; of the chain twice that)
    motion, sigmas, share = motion_of(kind), *((0.08, 0.04) if kind == "chain" else (0.03, 0.02))
    names = ("turn", "position") if kind == "chain" else ("turn", "position", "velocity", "settled_position")
    for shoulder in (True,) if kind == "chain" else (True, False):
        (_, short), (_, whole) = (
            followed(motion, length, motion.gap, None, shoulder, 0 if kind == "chain" else None)
            for length in (SHORT_S, WHOLE_S)
        )
        for a, b in zip(short[15:], whole[15:], strict=True):
            sigma = np.sqrt(np.diag(b.covariance)[b.rows["position"]])
            assert (np.abs(a.newest.p - b.newest.p) < sigmas * sigma).all()
            ratio = np.diag(a.covariance) / np.diag(b.covariance)
            assert all((np.abs(ratio[a.rows[name]] - 1.0) < share).all() for name in names)


def test_what_comes_late_counts_as_in_time() -> None:
    """A frame, and samples of an interval in the place of wrong ones."""
    events = ({"late": 60}, {}, {"hidden": range(60, 61)}, {"wrong": 70})
    late, in_time, never, mended = (
        [each.newest.p for each in followed(motion_of("tilted"), **how)[1]] for how in events
    )
    # iterations stop at a millimetre, and windows without the frame were solved in between
    np.testing.assert_allclose(late[-1], in_time[-1], atol=2e-5)
    np.testing.assert_allclose(late[63], never[63], atol=1e-12)
    assert np.linalg.norm(late[65] - never[65]) > 1e-4
    assert np.linalg.norm(mended[71] - in_time[71]) > 5e-3  # 1 m/s too much
    # what left in between was linearised elsewhere (seen 0.14 mm)
    assert np.linalg.norm(mended[79] - in_time[79]) < 5e-4


@pytest.mark.parametrize("shoulder", [False, True])
def test_sigma_covers_the_error_and_grows_in_a_gap(motion: Motion, shoulder: bool) -> None:
    lag, solutions = followed(motion, hidden=motion.gap, shoulder=shoulder)
    assert lag.t[-1] - lag.t[0] == pytest.approx(SHORT_S, abs=DT), "nodes leave"
    nees = []
    for state, solution in zip(motion.states["forearm"], solutions, strict=True):
        block, off = solution.block("position"), solution.newest.p - state.p
        nees.append(off @ np.linalg.solve(block, off) / 3.0)
        # the whole covariance is one: symmetric, and no direction is negative
        np.testing.assert_allclose(solution.covariance, solution.covariance.T, atol=1e-12)
        assert np.linalg.eigvalsh(block).min() > 0
        if state.t > 0.3:
            assert -1e-9 <= solution.newest.t - 0.2 - solution.settled.t <= DT + 1e-9
            assert np.trace(solution.block("settled_position")) < np.trace(block)
    _, sigma_m = motion.errors(solutions)
    assert sigma_m[74] > 3.0 * sigma_m[44] and sigma_m[80] < 0.5 * sigma_m[74]
    # one motion, errors of neighbours alike: a wide band (seen 0.5 and 0.6)
    assert 0.05 < np.mean(nees[15:]) < 3.0


def test_the_wrist_alone_leaves_its_place_open_at_first_and_says_so(motion: Motion) -> None:
    lag = lag_window(motion.down)
    motion.add(lag, 0, (), 0.0)
    unseen = lag.solve(0.0)
    motion.see(lag, -1, 0, ("wrist",))
    once_seen = lag.solve(0.0)
    # half a metre, and half a radian at the wrist's lever arm of 10 cm
    assert np.sqrt(np.diag(unseen.block("position"))) == pytest.approx(np.full(3, 0.5), rel=0.02)
    assert np.sqrt(np.diag(once_seen.block("position"))).max() == pytest.approx(0.05, rel=0.2)
    assert once_seen.shoulder is None and "shoulder" not in once_seen.rows


@pytest.mark.slow
def test_a_second_imu_holds_the_forearm_in_a_gap_also_where_its_samples_come_late(chain: Motion) -> None:
    (_, two), (_, one), (lag, late) = (
        followed(chain, hidden=chain.gap, shoulder=True, upper=upper) for upper in (0, None, 4)
    )
    _, alone = chain.errors(one)
    for solutions, share in ((two, 0.6), (late, 0.7)):
        off, sigma = chain.errors(solutions)
        assert sigma[chain.gap[-1]] < share * alone[chain.gap[-1]]
        assert (off < 3.0 * sigma).all()
    count = len(chain.joints)
    for k in range(count - 4, count):
        chain.attach(lag, k, k - count)
    a, b = lag.solve(0.0), two[-1]
    apart = np.abs(a.newest.p - b.newest.p) / np.sqrt(np.diag(b.block("position")))
    assert (apart < 0.08).all()  # some left before they came, linearised elsewhere


def test_left_out_the_rest_goes_on_and_it_may_begin_again(chain: Motion) -> None:
    """Before it left it is as if it had never been there; after that as good as it says."""
    lags = [lag_window(chain.down, WHOLE_S, True, (UPPER,)) for _ in range(2)]
    for k in range(20):
        for lag in lags:
            chain.add(lag, k, ("shoulder", *LEVERS), 0.0)
        chain.attach(lags[0], k)
    lags[0].detach(UPPER, lags[0].t[3])
    assert len(lags[0].nodes_of(UPPER)) == 3
    lags[0].detach(UPPER, -np.inf)
    a, b = (lag.solve(0.0) for lag in lags)
    np.testing.assert_allclose(a.newest.p, b.newest.p, atol=1e-12)
    np.testing.assert_allclose(a.covariance, b.covariance, rtol=1e-9, atol=1e-15)
    lag, solutions = followed(chain, 0.5, chain.gap, shoulder=True, upper=0, away=range(25, 30))
    off, sigma = chain.errors(solutions)
    assert (off < 3.0 * sigma).all()
    assert lag.nodes_of(UPPER) == list(range(len(lag.t)))


def test_an_imu_that_rests_beside_a_moving_arm_does_not_fit(chain: Motion) -> None:
    lag, _ = followed(chain, WHOLE_S, chain.gap, shoulder=True, upper=0)
    sound = lag.misfit(UPPER, -np.inf)
    # 12 rows a node, three of them taken up by the shared joint's place and nine by the state
    assert sound < 0.7
    assert np.isnan(lag_window(chain.down, 1.0, True, (UPPER,)).misfit(UPPER, -np.inf))
    moving, force = chain.increments[UPPER][0], -GRAVITY * chain.states[UPPER][0].R.T @ chain.down
    rest = replace(moving, acc=np.tile(force, (1, 2, 1)), gyro=np.zeros((1, 3)))
    for index in lag.nodes_of(UPPER)[30:]:
        lag.set_increments(index, rest, UPPER)
    lag.solve(0.0)
    assert lag.misfit(UPPER, -np.inf) > 20.0 * sound


@pytest.mark.parametrize(("length_s", "epoch_s"), [(WHOLE_S, 0.5), (SHORT_S, 0.5), (SHORT_S, 1.0)])
def test_a_bias_walks_from_epoch_to_epoch(
    length_s: float, epoch_s: float, motion: Motion, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where nothing is seen of it: its prior's variance and what it walked since the first node."""
    monkeypatch.setattr(lag_window_module, "BIAS_EPOCH_S", epoch_s)
    lag, walk = lag_window(motion.down, length_s), np.repeat([0.1, 0.01], 3)
    lag._walk = walk
    before = np.repeat([0.05, 0.005], 3) ** 2
    began_s = motion.states["forearm"][0].t
    for k, state in enumerate(motion.states["forearm"]):
        motion.add(lag, k, ())
        if state.t - began_s >= epoch_s:
            before, began_s = before + walk**2 * (state.t - began_s), state.t
        found = np.diag(lag.solve(0.0).block("bias"))
        np.testing.assert_allclose(found, before, rtol=1e-5)
    assert began_s >= 2.0 and lag._values.exists(B(0)) == (length_s == WHOLE_S)


def test_what_is_taken_back_was_never_seen_and_an_imu_is_due_where_the_camera_shows_its_segment(
    chain: Motion,
) -> None:
    lags = [lag_window(chain.down, WHOLE_S, True, (UPPER,)) for _ in range(2)]
    for k, seen in enumerate((("shoulder", *LEVERS), (), (), (), tuple(LEVERS))):
        for lag in lags:
            chain.add(lag, k, seen if lag is lags[0] or k < 4 else ())
    lags[0].retract(lags[0].t[3])
    a, b = (lag.solve(0.0) for lag in lags)
    np.testing.assert_allclose(a.newest.p, b.newest.p, atol=1e-12)
    lag, t = lags[0], lags[0].t
    # at a knot of the shoulder; else where the last node is a knot's time ago, 0.09 s
    assert [lag.is_due(k, UPPER, t[k] - 0.08) for k in range(5)] == [True, False, False, True, False]
    assert lag.is_due(1, UPPER, t[1] - 0.1)


def test_step_and_covariance_are_those_of_gtsam() -> None:
    """Three poses that turn, a point seen from each by a lever arm, wrong values at first."""
    graph, values, unit = gtsam.NonlinearFactorGraph(), gtsam.Values(), gtsam.noiseModel.Isotropic.Sigma
    lever, rng, asked = np.array([0.1, 0.02, 0.0]), np.random.default_rng(1), [X(2), L(0), X(0)]
    poses = [gtsam.Pose3(Rot3.Expmap([0.3 * k, 0.1, 0.2]), np.array([0.2 * k, 0.1, 1.0])) for k in range(3)]
    for k, pose in enumerate(poses):
        values.insert(X(k), pose.retract(rng.normal(0.0, 0.05, 6)))
        graph.add(gtsam.GPSFactorArmCalib(X(k), L(0), pose.transformFrom(lever), unit(3, 0.01)))
        if k:
            graph.add(gtsam.BetweenFactorPose3(X(k - 1), X(k), poses[k - 1].between(pose), unit(6, 0.02)))
    values.insert(L(0), lever + 0.03)
    graph.add(gtsam.PriorFactorPose3(X(0), poses[0], unit(6, 0.1)))
    graph.add(gtsam.PriorFactorPoint3(L(0), lever, unit(3, 0.02)))
    found = iterate(graph, values, asked)
    assert found.values.equals(values.retract(graph.linearize(values).optimize()), 1e-9)
    joint = gtsam.Marginals(graph, values).jointMarginalCovariance(asked)
    expected = np.block([[joint.at(one, other) for other in asked] for one in asked])
    np.testing.assert_allclose(found.covariance, expected, rtol=1e-6, atol=1e-10)
    lone = gtsam.NonlinearFactorGraph()
    lone.add(gtsam.GPSFactor(X(0), np.ones(3), unit(3, 0.01)))  # its turn is free
    only = gtsam.Values()
    only.insert(X(0), poses[0])
    with pytest.raises(np.linalg.LinAlgError, match="free"):
        iterate(lone, only, [X(0)])
