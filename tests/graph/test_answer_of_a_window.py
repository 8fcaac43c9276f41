"""What `solve` reads off a small window, against GTSAM's marginals and dense algebra on the same graph."""

from __future__ import annotations

from dataclasses import replace
from unittest.mock import DEFAULT, Mock

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import B, C, E, G, L, M, S, U, V, W, X, Y
from small_window import (
    BIAS_LENGTH_S,
    LEVERS,
    NODES,
    STEP_S,
    UPPER_FIRST,
    UPPER_NODES,
    small_window,
    with_forearm,
)

import smoother.graph.build
import smoother.graph.optimise
import smoother.graph.solve
from smoother.array_types import FloatArray
from smoother.errors import SolveError
from smoother.graph.build import bias_of_intervals, build
from smoother.graph.columns import constant_error_columns, evidence, stamp_columns
from smoother.graph.linear_system import Jacobian
from smoother.graph.shared_prior import shared_jacobian
from smoother.graph.solve import TIGHTEN, solve
from smoother.graph.solved import SolvedWindow, levers_of
from smoother.recording import JOINTS
from smoother.units import GRAVITY
from smoother.window.problem import Window
from smoother.window.shared import JOINT_ERRORS, SIZE, STRAP_ERRORS, STRAP_PLACE
from smoother.window.solution import Solution

ELBOW, WRIST, SHOULDER = (JOINTS.index(joint) for joint in ("elbow", "wrist", "shoulder"))
#: How far two optimisers may stop from each other, in sigmas.
SIGMAS = 0.03


@pytest.fixture(autouse=True)
def every_node(monkeypatch: pytest.MonkeyPatch) -> None:
    patched(monkeypatch)


def patched(patch: pytest.MonkeyPatch) -> None:
    """Two biases, and covariances computed everywhere."""
    patch.setattr(smoother.graph.build, "BIAS_LENGTH_S", BIAS_LENGTH_S)
    for name in ("COVARIANCE_S", "COVARIANCE_NEAR_S", "SHOULDER_COVARIANCE_S", "CHAIN_COVARIANCE_S"):
        patch.setattr(smoother.graph.solve, name, 1e-6)
    patch.setattr(smoother.graph.optimise, "MAX_ITERATIONS", 300)


class Optimum:
    """A window's graph, its optimum, and the dense inverse of the normal equations there."""

    def __init__(self, window: Window) -> None:
        self.window = window
        self.graph, start, self.groups = build(window)
        params = gtsam.LevenbergMarquardtParams()
        params.setMaxIterations(300)
        params.setRelativeErrorTol(1e-13)
        params.setAbsoluteErrorTol(1e-13)
        self.values = gtsam.LevenbergMarquardtOptimizer(self.graph, start, params).optimize()
        self.R = np.array([self.values.atPose3(X(i)).rotation().matrix() for i in range(NODES)])
        self.biases = bias_of_intervals(window)
        self.solved = SolvedWindow(window, self.graph, self.values, self.groups)
        self.extra = constant_error_columns(self.solved)
        self.system = self.solved.system([self.extra])
        self.A, self.b = self.system.jacobian.toarray(), self.system.jacobian.rhs
        self.covariance = np.linalg.inv(self.A.T @ self.A)

    @property
    def columns(self) -> dict[int, slice]:
        return {key: self.system.columns(key) for key in sorted(self.values.keys())}

    def of(self, *keys: int) -> FloatArray:
        """Joint covariance of variables, and of what the considered errors add."""
        rows = np.concatenate([np.arange(self.A.shape[1])[self.system.columns(key)] for key in keys])
        return np.asarray(self.covariance[np.ix_(rows, rows)])

    def follows(self, pull: FloatArray) -> FloatArray:
        """How all variables follow the constant errors, the prior's mean included (`pull`)."""
        return np.asarray(self.covariance @ (pull - self.A.T @ self.extra))


@pytest.fixture(scope="module")
def pair() -> tuple[Optimum, Solution]:
    with pytest.MonkeyPatch.context() as patch:
        patched(patch)
        window = replace(small_window()[0], considered=None)
        return Optimum(window), solve(window, True, with_offset=True, with_evidence=True, tolerance=1e-13)


def close(found: FloatArray, expected: FloatArray, covariance: FloatArray, sigmas: float = SIGMAS) -> None:
    """Vectors that are the same to a share of their sigma."""
    sigma = np.sqrt(np.einsum("...ii->...i", covariance))
    assert (np.abs(found - expected) < sigmas * sigma).all()


def like(found: FloatArray | None, expected: FloatArray, rtol: float = 0.01) -> None:
    """Covariances, each element to a share of the two standard deviations."""
    assert found is not None
    sigma = np.sqrt(np.einsum("...ii->...i", expected))
    np.testing.assert_allclose(
        found / (sigma[..., :, None] * sigma[..., None, :]),
        expected / (sigma[..., :, None] * sigma[..., None, :]),
        atol=rtol,
    )


def in_camera(R: FloatArray, covariance: FloatArray) -> FloatArray:
    """(rotation, translation) in the body's axes to (position, rotation) in the camera's."""
    turn = np.zeros((6, 6))
    turn[:3, 3:], turn[3:, :3] = R, R
    return np.asarray(turn @ covariance @ turn.T)


#: Keys of pose, velocity and bias of each IMU, and its nodes.
BODIES = [(X, V, B, range(NODES)), (Y, W, C, range(UPPER_FIRST, UPPER_FIRST + UPPER_NODES))]


@pytest.mark.parametrize("number", [0, 1], ids=["forearm", "upper arm"])
def test_states_and_their_covariance(pair: tuple[Optimum, Solution], number: int) -> None:
    best, found = pair
    (pose_key, velocity_key, bias_key, nodes), body = BODIES[number], found.bodies[number]
    rows, biases = np.array(nodes), np.append(best.biases, 1)
    poses = [best.values.atPose3(pose_key(i)) for i in rows]
    R = np.array([pose.rotation().matrix() for pose in poses])
    pose = np.array([in_camera(R[k], best.of(pose_key(i))) for k, i in enumerate(rows)])
    like(body.pose_covariance[rows], pose)
    np.testing.assert_allclose(body.states.R[rows], R, atol=1e-3)
    close(body.states.p[rows], np.array([each.translation() for each in poses]), pose[:, :3, :3])
    velocity = np.array([best.of(velocity_key(i)) for i in rows])
    close(body.states.v[rows], np.array([best.values.atVector(velocity_key(i)) for i in rows]), velocity)
    assert (body.velocity_covariance is None) == (number > 0)
    if number == 0:
        like(body.velocity_covariance, velocity)
    bias = np.array([best.values.atConstantBias(bias_key(k)).vector() for k in biases])
    close(body.bias, bias, np.array([best.of(bias_key(k)) for k in biases]))
    hidden = np.setdiff1d(np.arange(NODES), rows)
    for values in (body.states.p, body.states.v, body.pose_covariance):
        assert np.isnan(values[hidden]).all() and np.isfinite(values[rows]).all()
    np.testing.assert_array_equal(body.states.R[hidden], np.tile(np.eye(3), (len(hidden), 1, 1)))


def test_gravity_and_the_shoulder(pair: tuple[Optimum, Solution]) -> None:
    best, found = pair
    assert found.accepted and found.t is best.window.t
    assert found.error == pytest.approx(best.graph.error(best.values), rel=1e-6)
    np.testing.assert_allclose(found.forearm.gravity, GRAVITY * best.values.atUnit3(G(0)).point3(), atol=1e-3)
    of_knots = np.array([best.of(S(k)) for k in range(6)])
    at = best.window.shoulder.node  # in between it is interpolated
    close(found.shoulder[at], np.array([best.values.atPoint3(S(k)) for k in range(6)]), of_knots)
    like(found.shoulder_covariance[at], of_knots)
    assert found.shoulder.shape == (NODES, 3)


def shared_of(best: Optimum) -> tuple[FloatArray, FloatArray]:
    """The shared vector and its covariance, by differences of the shared vector's definition."""
    keys = [B(1), G(0), U(0), L(ELBOW), L(WRIST), M(ELBOW), M(SHOULDER), C(1)]

    def vector(values: gtsam.Values) -> FloatArray:
        layout, mean = best.window.priors.layout, best.window.priors.shared.mean
        return np.concatenate(
            [
                values.atConstantBias(B(1)).vector(),
                layout.gravity_axes @ values.atUnit3(G(0)).point3(),
                mean[layout.upper_arm] - values.atDouble(U(0)),
                *(values.atPoint3(key) for key in keys[3:7]),
                values.atConstantBias(C(1)).vector(),
            ]
        )

    sizes, slopes, step = [6, 2, 1, 3, 3, 3, 3, 6], [], 1e-6
    for key, size in zip(keys, sizes, strict=True):
        for move in step * np.eye(size):
            delta = gtsam.VectorValues()
            delta.insert(key, move)
            slopes.append((vector(best.values.retract(delta)) - vector(best.values)) / step)
    J = np.array(slopes).T
    assert best.solved.shared_keys == keys
    np.testing.assert_allclose(
        J, shared_jacobian(best.window.priors.layout, best.values.atUnit3(G(0))), atol=1e-5
    )
    return vector(best.values), J @ best.of(*keys) @ J.T


def test_what_is_shared_and_the_lever_arms(pair: tuple[Optimum, Solution]) -> None:
    """A lever arm of each joint in the axes of the IMU that it is tied to: the hand's, where it has one."""
    best, found = pair
    mean, covariance = shared_of(best)
    close(found.shared, mean, covariance)
    layout = best.window.priors.layout
    assert list(found.levers) == ["elbow", "wrist"]
    for joint, lever in found.levers.items():
        np.testing.assert_array_equal(lever, found.shared[layout.lever(joint)])
    np.testing.assert_array_equal(found.lever("strap"), np.zeros(3))
    three = replace(layout, joints=("elbow", "wrist", "hand"), further=("upper_arm", "hand"))
    levers = levers_of(np.arange(three.size), three)
    assert {joint: int(lever[0]) for joint, lever in levers.items()} == {
        "elbow": three.lever("elbow").start,
        "wrist": three.lever("wrist").start,
        "hand": three.lever("hand", "hand").start,
    }


def test_residuals(pair: tuple[Optimum, Solution]) -> None:
    best, found = pair
    assert list(found.residuals) == ["elbow", "wrist", "strap"]
    states = found.forearm.states
    for measured in best.window.joint_measurements:
        at = states.p[measured.node] + states.R[measured.node] @ found.lever(measured.joint) + measured.shift
        np.testing.assert_allclose(found.residuals[measured.joint], measured.position - at, atol=1e-12)


def test_only_what_is_asked_for() -> None:
    window = small_window(upper=False)[0]
    found = solve(window, with_covariance=False)
    forearm = found.forearm
    for absent in (forearm.pose_covariance, forearm.velocity_covariance, found.shoulder_covariance):
        assert absent is None
    assert found.evidence is None and len(found.bodies) == 1 and found.offset_information == 0.0
    assert np.isfinite(found.shared).all()
    found = solve(replace(window, shoulder=None), with_covariance=True)
    assert found.shoulder is found.shoulder_covariance is None and found.forearm.pose_covariance is not None


@pytest.mark.parametrize(
    ("upper", "bias_s"),
    [(True, BIAS_LENGTH_S), (False, BIAS_LENGTH_S), (False, STEP_S)],  # the last: a bias for each interval
)
def test_a_column_is_the_derivative_of_the_data(
    upper: bool, bias_s: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The graph is built anew from data that have the error: how its whitened errors move."""
    monkeypatch.setattr(smoother.graph.build, "BIAS_LENGTH_S", bias_s)
    window = small_window(upper=upper)[0]
    window = replace(window, noise=replace(window.noise, cauchy=1e6))  # weights that stay
    best = Optimum(window)
    rng, step = np.random.default_rng(3), 1e-5
    error = rng.normal(size=SIZE) * np.concatenate([np.full(18, 0.1), np.full(15, 1.0), np.full(9, 1.0)])

    def rhs(scale: float) -> FloatArray:
        return Jacobian.of(_with_errors(best, window, scale * error), best.values).rhs

    moved = -(rhs(step) - rhs(-step)) / (2 * step)  # the graph's right-hand side is minus its error
    stated = best.extra @ error
    rows = 9 * (NODES - 1)
    # the samples' mean stands for them: half an interval's turning
    np.testing.assert_allclose(stated[:rows], moved[:rows], atol=0.06 * np.abs(moved[:rows]).max())
    scale = np.abs(moved[rows:]).max()
    np.testing.assert_allclose(stated[rows : rows + 84], moved[rows : rows + 84], atol=1e-6 * scale)


def _with_errors(best: Optimum, window: Window, error: FloatArray) -> gtsam.NonlinearFactorGraph:
    """The graph of data that read as errors make them: scales of the IMU, joints, the strap's turning."""
    increments, layout, mean = window.forearm.increments, window.priors.layout, window.priors.shared.mean
    of_acc, of_gyro = error[:9].reshape(3, 3), error[9:18].reshape(3, 3)
    force, rate = increments.acc.copy(), increments.gyro.copy()
    for i, (a, b) in enumerate(zip(increments.first[:-1], increments.first[1:], strict=True)):
        force[a:b] -= of_acc @ increments.acc[a:b].mean(axis=(0, 1))
        rate[a:b] -= of_gyro @ increments.gyro[a:b].mean(axis=0)
        assert i < NODES
    measured = []
    for each in window.joint_measurements:
        position = each.position.copy()
        for k, node in enumerate(each.node):
            column = JOINT_ERRORS.start + 3 * JOINTS.index(each.joint)
            own = error[column : column + 3]
            position[k] -= best.R[node] @ own if each.joint == "strap" else own  # a place in {A}
            if each.joint in LEVERS:
                down_A = best.R[node].T @ layout.down(mean)
                turn = error[STRAP_ERRORS].reshape(3, 3) @ down_A
                position[k] -= best.R[node] @ np.cross(turn, mean[layout.lever(each.joint)])
        measured.append(replace(each, position=position))
    column = JOINT_ERRORS.start + 3 * SHOULDER
    shoulder = replace(window.shoulder, position=window.shoulder.position - error[column : column + 3])
    changed = replace(
        window,
        joint_measurements=tuple(measured),
        shoulder=shoulder,
    )
    return build(with_forearm(changed, increments=replace(increments, acc=force, gyro=rate))).graph


def test_the_chain_is_the_dense_system(pair: tuple[Optimum, Solution]) -> None:
    best, _ = pair
    system = best.system
    for key in (X(0), X(5), X(9), V(4), S(0), S(5), Y(2), Y(7), W(3), E(6)):
        like(system.covariances([key])[0], best.of(key), 1e-6)
    shared = [G(0), C(0), L(WRIST), B(1), U(0)]
    like(system.shared_covariance(shared), best.of(*shared), 1e-6)
    follows = best.follows(np.zeros((best.A.shape[1], SIZE)))
    of_border = system.shared_sensitivity(np.zeros((system.extras.start, SIZE)))
    scale = np.abs(follows).max()
    for key in (X(0), X(6), V(9), S(3), E(4), W(7)):
        np.testing.assert_allclose(
            system.sensitivities([key], of_border)[0], follows[system.columns(key)], atol=1e-6 * scale
        )
    np.testing.assert_allclose(
        of_border[system.border_rows(shared)],
        np.concatenate([follows[system.columns(key)] for key in shared]),
        atol=1e-6 * scale,
    )


def test_what_the_window_says_of_constant_errors(pair: tuple[Optimum, Solution]) -> None:
    """All else eliminated from the dense equations, the prior on the constants taken off."""
    best, found = pair
    layout, priors = best.window.priors.layout, best.window.priors.shared
    mean, _ = shared_of(best)
    constants = [G(0), U(0), L(ELBOW), L(WRIST), M(ELBOW), M(SHOULDER), C(1)]
    kept = np.concatenate([np.arange(best.A.shape[1])[best.columns[key]] for key in constants])
    others = np.setdiff1d(np.arange(best.A.shape[1]), kept)
    turn = np.eye(len(kept) + SIZE)
    turn[: len(kept), : len(kept)] = np.linalg.inv(shared_jacobian(layout, best.values.atUnit3(G(0)))[6:, 6:])
    sides = np.column_stack([best.A[:, kept], best.extra])
    P = best.A[:, others]
    project = np.eye(len(P)) - P @ np.linalg.solve(P.T @ P, P.T)
    information = turn.T @ (sides.T @ project @ sides) @ turn
    vector = turn.T @ (sides.T @ project @ best.b)
    prior = np.linalg.inv(priors.covariance[6:, 6:])
    size = len(kept)
    information[:size, :size] -= prior
    vector[:size] -= prior @ (priors.mean - mean)[6:]
    vector += information[:, :size] @ mean[6:]
    stated = evidence(best.solved, best.system, priors)
    close_evidence(stated.information, information, 1e-6)
    close_evidence(np.diag(stated.vector), np.diag(vector), 1e-6)
    close_evidence(found.evidence.information, information, 1e-2)


def close_evidence(found: FloatArray, expected: FloatArray, atol: float) -> None:
    """Informations, each element to a share of its diagonal; joints that nobody saw have none."""
    scale = np.sqrt(np.abs(np.diag(expected)))
    scale[scale == 0.0] = 1.0
    np.testing.assert_allclose(
        found / scale[:, None] / scale, expected / scale[:, None] / scale, rtol=0.0, atol=atol
    )


@pytest.mark.parametrize("rows", [0, 6])
def test_considered_errors_widen_the_covariance(rows: int) -> None:
    """The data and the prior's mean follow the errors; one without an upper-arm IMU has fewer rows."""
    window, _ = small_window()
    if rows:
        window = replace(
            window, considered=replace(window.considered, shared=window.considered.shared[:-rows])
        )
    best, found = Optimum(window), solve(window, with_covariance=True, tolerance=1e-13)
    keys = best.solved.shared_keys
    J = shared_jacobian(window.priors.layout, best.values.atUnit3(G(0)))
    shared = np.zeros((window.priors.layout.size, SIZE))
    shared[: len(window.considered.shared)] = window.considered.shared
    pull = np.zeros((best.A.shape[1], SIZE))
    at = np.concatenate([np.arange(best.A.shape[1])[best.columns[key]] for key in keys])
    pull[at] = J.T @ np.linalg.solve(window.priors.shared.covariance, shared)
    follows = best.follows(pull)
    for i in (0, 4, 9):
        own = follows[best.columns[X(i)]].copy()
        own[3:, STRAP_PLACE] += np.eye(3)  # the answer is where the strap is, not the chip
        total = best.of(X(i)) + own @ window.considered.covariance @ own.T
        like(found.forearm.pose_covariance[i], in_camera(best.R[i], total), 5e-3)
        assert np.trace(total) > 1.01 * np.trace(best.of(X(i)))
    own = follows[best.columns[S(2)]]
    total = best.of(S(2)) + own @ window.considered.covariance @ own.T
    like(found.shoulder_covariance[window.shoulder.node[2]], total, 5e-3)


@pytest.fixture
def built(monkeypatch: pytest.MonkeyPatch) -> list[Window]:
    """The windows that graphs were built of."""
    windows: list[Window] = []
    monkeypatch.setattr(smoother.graph.solve, "build", lambda window: build(windows.append(window) or window))
    return windows


def test_tightening_gives_back_what_it_took(built: list[Window], monkeypatch: pytest.MonkeyPatch) -> None:
    """A window whose first tries are refused: the attitude's prior is tightened, the covariance is not."""
    window = replace(small_window(upper=False)[0], considered=None)
    weak = np.diag([1e-6, 2e-6, 3e-6])  # the prior alone holds the orientation
    window = with_forearm(window, attitude_covariance=weak)
    straight = solve(window, with_covariance=True)
    refusals = [RuntimeError("Indeterminant linear system detected"), np.linalg.LinAlgError(), DEFAULT]
    refusing = Mock(wraps=smoother.graph.solve.optimise, side_effect=refusals)
    monkeypatch.setattr(smoother.graph.solve, "optimise", refusing)
    tightened = solve(window, with_covariance=True)
    assert len(built) == 4
    for each, share in zip(built[1:], TIGHTEN, strict=False):
        np.testing.assert_allclose(each.forearm.attitude_covariance, weak * share**2)
    node = window.forearm.attitude_node
    like(
        tightened.forearm.pose_covariance[node, 3:, 3:], straight.forearm.pose_covariance[node, 3:, 3:], 0.05
    )
    np.testing.assert_allclose(straight.forearm.pose_covariance[node, 3:, 3:], weak, atol=5e-8)


def test_only_what_the_prior_holds_is_given_back() -> None:
    """A direction in which the data hold the orientation lost nothing."""
    rng = np.random.default_rng(4)
    axes, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    window = small_window()[0]
    window = with_forearm(window, attitude_covariance=(axes * [4.0, 9.0, 16.0]) @ axes.T)
    stated = np.zeros((NODES, 3, 3))
    # held by the prior to a hundredth of its variance; half of that; and hardly at all by it
    stated[window.forearm.attitude_node] = (axes * [0.04, 0.046, 0.01]) @ axes.T
    lost = smoother.graph.solve._lost_to_tightening(stated, window, 0.1)
    np.testing.assert_allclose(lost, (axes * [3.96, 8.91, 0.0]) @ axes.T, atol=1e-12)


def test_other_failures_are_no_free_direction(built: list[Window], monkeypatch: pytest.MonkeyPatch) -> None:
    """Where a direction is free, the priors of both IMUs are tightened step by step before it is said."""
    window = small_window()[0]
    monkeypatch.setattr(smoother.graph.solve, "optimise", Mock(side_effect=RuntimeError("out of luck")))
    with pytest.raises(RuntimeError, match="out of luck"):
        solve(window, with_covariance=False)
    monkeypatch.setattr(smoother.graph.solve, "optimise", Mock(side_effect=np.linalg.LinAlgError))
    built.clear()
    with pytest.raises(SolveError, match=r"between 20\.0 s and 20\.\d s is not determined"):
        solve(window, with_covariance=False)
    for each, share in zip(built, TIGHTEN, strict=True):
        for body, before in zip(each.bodies, window.bodies, strict=True):
            np.testing.assert_allclose(body.attitude_covariance, before.attitude_covariance * share**2)


def test_a_stamp_s_column_is_the_derivative_of_the_data() -> None:
    """Frames that are late by a line between two knots show each joint where it was: its own velocity ago."""
    window = replace(small_window(upper=False)[0], considered=None)
    alone = []
    for each in window.joint_measurements:
        _, rows = np.unique(each.node, return_index=True)
        names = ("t_s", "node", "position", "sigma_m", "shift", "velocity")
        alone.append(replace(each, **{name: getattr(each, name)[rows] for name in names}))
    noise = replace(window.noise, cauchy=1e6)  # weights that stay
    window = replace(window, joint_measurements=tuple(alone), noise=noise)
    best = Optimum(window)
    velocity = np.array([best.values.atVector(V(i)) for i in range(NODES)])
    knots = np.linspace(window.t[0] - 0.1, window.t[-1] + 0.1, 4)
    late_s = 1e-4 * np.array([1.0, -2.0, 3.0, 0.5])
    at_node = np.interp(window.t, knots, late_s)
    moved = tuple(
        replace(
            each, position=each.position - at_node[each.node][:, None] * (velocity[each.node] + each.velocity)
        )
        for each in window.joint_measurements
    )
    graph = build(replace(window, joint_measurements=moved)).graph
    after = Jacobian.of(graph, best.values).rhs
    columns = stamp_columns(best.solved, knots)
    change = best.system.jacobian.rhs - after  # the right-hand side is minus the error
    np.testing.assert_allclose(columns @ late_s, change, atol=1e-6 * np.abs(change).max())


def test_what_the_window_says_of_its_clock(pair: tuple[Optimum, Solution]) -> None:
    """All variables eliminated from the dense equations; samples that share a node scatter about its mean."""
    best, found = pair
    column = stamp_columns(best.solved)[:, 0]
    across = best.A.T @ column
    expected = column @ column - across @ best.covariance @ across
    for measured in best.window.joint_measurements:
        velocity = found.forearm.states.v[measured.node] + measured.velocity
        for node in np.unique(measured.node):
            rows = measured.node == node
            off = (velocity[rows] - velocity[rows].mean(axis=0)) / measured.sigma_m[rows, None]
            expected += float(np.sum(off**2))
    assert found.offset_information == pytest.approx(expected, rel=1e-2)


def test_synthetic_stamps_widen_the_covariance() -> None:
    """More the farther the frames may be off, and nothing where they were measured."""
    window = small_window(upper=False)[0]
    assert window.considered is not None

    def spread(stamp_sigma_s: float) -> FloatArray:
        considered = replace(window.considered, stamp_sigma_s=stamp_sigma_s)
        found = solve(replace(window, considered=considered), with_covariance=True)
        return np.asarray(np.trace(found.forearm.pose_covariance[:, :3, :3], axis1=1, axis2=2))

    measured, little, much = (spread(sigma) for sigma in (0.0, 0.01, 0.02))
    assert (little > measured).all()
    # considered errors add to the covariance: four times as much for twice the sigma
    np.testing.assert_allclose(much - measured, 4.0 * (little - measured), rtol=1e-6)
