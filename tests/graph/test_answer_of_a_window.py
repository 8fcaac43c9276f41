"""What a solved small window says and draws, against GTSAM's marginals and dense algebra."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from unittest.mock import DEFAULT, Mock

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import B, C, G, L, M, S, U, V, W, X, Y
from scenes import arm, section_windows
from small_window import (
    BIAS_LENGTH_S,
    LEVERS,
    NODES,
    STEP_S,
    UPPER_FIRST,
    UPPER_NODES,
    small_window,
)

import smoother.graph.build
import smoother.graph.optimise
import smoother.graph.sampling
import smoother.graph.solve
from smoother.array_types import FloatArray
from smoother.errors import SolveError
from smoother.graph.build import bias_of_intervals, build
from smoother.graph.columns import constant_error_columns, evidence, stamp_columns
from smoother.graph.linear_system import Jacobian
from smoother.graph.sampling import sample_window
from smoother.graph.shared_prior import gravity_axes, have_turned, shared_jacobian
from smoother.graph.solve import NEAR_S, TIGHTEN, solve
from smoother.graph.solved import SolvedWindow, levers_of
from smoother.linalg import skew, unit
from smoother.recording import JOINTS
from smoother.units import GRAVITY
from smoother.window.draw_plan import DrawPlan, samples_apart
from smoother.window.problem import Window
from smoother.window.shared import JOINT_ERRORS, SIZE, STRAP_ERRORS, STRAP_PLACE, Gaussian
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
        window = replace(small_window(), considered=None)
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


def test_what_joints_err_together_widens_covariances_alone(pair: tuple[Optimum, Solution]) -> None:
    best, found = pair
    noise = replace(best.window.noise, in_common=4.0)
    wide, A = solve(replace(best.window, noise=noise), True, tolerance=1e-13), best.A.copy()
    for group in best.groups:
        A[group.rows] *= 0.5 if group.kind == "camera" else 1.0
    rows = [np.arange(A.shape[1])[best.system.columns(X(i))] for i in range(NODES)]
    covariance = np.linalg.inv(A.T @ A)
    pose = [in_camera(best.R[i], covariance[np.ix_(own, own)]) for i, own in enumerate(rows)]
    like(wide.forearm.pose_covariance, np.array(pose))
    np.testing.assert_allclose(wide.forearm.states.p, found.forearm.states.p, atol=1e-9)


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


def test_gravity_the_shoulder_what_is_shared_and_residuals(pair: tuple[Optimum, Solution]) -> None:
    best, found = pair
    assert found.accepted and found.t is best.window.t
    assert found.error == pytest.approx(best.graph.error(best.values), rel=1e-6)
    np.testing.assert_allclose(found.forearm.gravity, GRAVITY * best.values.atUnit3(G(0)).point3(), atol=1e-3)
    of_knots = np.array([best.of(S(k)) for k in range(6)])
    at = best.window.shoulder.node  # in between it is interpolated
    close(found.shoulder[at], np.array([best.values.atPoint3(S(k)) for k in range(6)]), of_knots)
    like(found.shoulder_covariance[at], of_knots)
    mean, covariance = shared_of(best)
    close(found.shared, mean, covariance)
    layout = best.window.priors.layout
    assert list(found.levers) == ["elbow", "wrist"]
    for joint, lever in found.levers.items():
        np.testing.assert_array_equal(lever, found.shared[layout.lever(joint)])
    states = found.forearm.states
    for measured in best.window.joint_measurements:
        at = states.p[measured.node] + states.R[measured.node] @ found.lever(measured.joint) + measured.shift
        np.testing.assert_allclose(found.residuals[measured.joint], measured.position - at, atol=1e-12)
    three = replace(layout, joints=("elbow", "wrist", "hand"), further=("upper_arm", "hand"))
    levers = levers_of(np.arange(three.size), three)
    assert {joint: int(lever[0]) for joint, lever in levers.items()} == {
        "elbow": three.lever("elbow").start,
        "wrist": three.lever("wrist").start,
        "hand": three.lever("hand", "hand").start,
    }


@pytest.mark.parametrize(
    ("upper", "bias_s"),
    [(True, BIAS_LENGTH_S), (False, BIAS_LENGTH_S), (False, STEP_S)],  # the last: a bias for each interval
)
def test_a_column_is_the_derivative_of_the_data(
    upper: bool, bias_s: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The graph is built anew from data that have the error: how its whitened errors move."""
    monkeypatch.setattr(smoother.graph.build, "BIAS_LENGTH_S", bias_s)
    window = small_window(upper=upper)
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
    forearm = replace(window.forearm, increments=replace(increments, acc=force, gyro=rate))
    return build(replace(changed, bodies=(forearm, *window.further))).graph


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
    prior, size = np.linalg.inv(priors.covariance[6:, 6:]), len(kept)
    information[:size, :size] -= prior
    vector[:size] -= prior @ (priors.mean - mean)[6:]
    vector += information[:, :size] @ mean[6:]
    stated = evidence(best.solved, best.system, priors)
    scale = np.sqrt(np.abs(np.diag(information)))
    scale[scale == 0.0] = 1.0  # joints that nobody saw have none
    information /= scale[:, None] * scale
    np.testing.assert_allclose(stated.information / scale[:, None] / scale, information, atol=1e-6)
    vector /= scale
    np.testing.assert_allclose(stated.vector / scale, vector, atol=1e-6 * np.abs(vector).max())
    np.testing.assert_allclose(found.evidence.information / scale[:, None] / scale, information, atol=1e-2)


@pytest.mark.parametrize("rows", [0, 6])
def test_considered_errors_widen_the_covariance(rows: int) -> None:
    """The data and the prior's mean follow the errors; one without an upper-arm IMU has fewer rows."""
    window = small_window()
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
        for joint, key in (("elbow", L(ELBOW)), ("wrist", L(WRIST))):  # what pose and lever have in common
            slope = np.hstack([-skew(found.levers[joint]), np.eye(3), np.eye(3)])
            own = slope @ np.vstack([follows[best.columns[X(i)]], follows[best.columns[key]]])
            total = slope @ best.of(X(i), key) @ slope.T + own @ window.considered.covariance @ own.T
            like(found.forearm.joint_covariance[joint][i], total, 5e-3)
    own = follows[best.columns[S(2)]]
    total = best.of(S(2)) + own @ window.considered.covariance @ own.T
    like(found.shoulder_covariance[window.shoulder.node[2]], total, 7e-3)


def test_made_up_stamps_widen_the_covariance_by_their_square() -> None:
    window, traces = small_window(upper=False), []
    for sigma_s in (0.0, 0.01, 0.02):
        considered = replace(window.considered, stamp_sigma_s=sigma_s)
        found = solve(replace(window, considered=considered), with_covariance=True)
        traces.append(np.trace(found.forearm.pose_covariance[:, :3, :3], axis1=1, axis2=2))
    assert (traces[1] > traces[0]).all()
    np.testing.assert_allclose(traces[2] - traces[0], 4.0 * (traces[1] - traces[0]), rtol=1e-6)


def test_between_computed_covariances_it_errs_on_the_careful_side(monkeypatch: pytest.MonkeyPatch) -> None:
    window, sigmas = replace(small_window(), considered=None), []
    for apart_s in (0.12, 1e-6):
        for name in ("COVARIANCE_S", "COVARIANCE_NEAR_S", "SHOULDER_COVARIANCE_S", "CHAIN_COVARIANCE_S"):
            monkeypatch.setattr(smoother.graph.solve, name, apart_s)
        bodies = solve(window, with_covariance=True).bodies
        sigmas.append([np.sqrt(np.einsum("nii->ni", body.pose_covariance)) for body in bodies])
    for sparse, every in zip(*sigmas, strict=True):
        ratio = (sparse / every)[np.isfinite(every[:, 0])]
        assert ratio.min() > 0.85 and 1.0 < ratio.mean() < 1.15 and ratio.max() < 1.7
        np.testing.assert_allclose(ratio[[0, -1]], 1.0)


def test_covariances_are_computed_close_together_in_and_near_gaps() -> None:
    t = 0.05 * np.arange(401)
    in_gap = (t[:-1] > 7.99) & (t[1:] < 10.01)
    chosen = t[smoother.graph.solve._spaced(t, in_gap, 1.0, 0.2)]
    assert np.isin([0.0, 20.0], chosen).all() and all(np.abs(chosen - at).min() < 1e-9 for at in (8.0, 10.0))
    apart, middle = np.diff(chosen), 0.5 * (chosen[1:] + chosen[:-1])
    near = (middle > 8.0 - NEAR_S) & (middle < 10.05 + NEAR_S)
    assert apart[near].max() < 0.21 and apart[~near].max() < 1.01
    assert apart[(middle < 7.8 - NEAR_S) | (middle > 11.0 + NEAR_S)].min() > 0.5


def test_a_prior_that_alone_holds_the_orientation_is_tightened(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where the solver calls a direction free; the covariance gets back what that took, and no more."""
    windows: list[Window] = []
    monkeypatch.setattr(smoother.graph.solve, "build", lambda window: build(windows.append(window) or window))
    window = replace(small_window(), considered=None)
    prior = np.diag([1e-6, 2e-6, 4.0])  # about the third axis the data hold it
    forearm = replace(window.forearm, attitude_covariance=prior)
    window = replace(window, bodies=(forearm, *window.further))
    node = window.forearm.attitude_node
    straight = solve(window, with_covariance=True).forearm.pose_covariance[node, 3:, 3:]
    np.testing.assert_allclose(straight[:2, :2], prior[:2, :2], atol=5e-8)
    assert straight[2, 2] < 0.01
    refuse, free = smoother.graph.solve.optimise, np.linalg.LinAlgError
    for refusals, error, tries in (
        ([RuntimeError("Indeterminant linear system detected"), free, DEFAULT], None, 3),
        (free, r"between 20\.0 s and 20\.\d s is not determined", 4),
        (RuntimeError("out of luck"), "out of luck", 1),  # that is no free direction
    ):
        windows.clear()
        monkeypatch.setattr(smoother.graph.solve, "optimise", Mock(wraps=refuse, side_effect=refusals))
        if error is None:
            found = solve(window, with_covariance=True, plan=basis(window))
            rotation = found.forearm.pose_covariance[node, 3:, 3:]
            like(rotation, straight, 0.05)
            same(found.draws.rotation[:, node], rotation)
        else:
            with pytest.raises((SolveError, RuntimeError), match=error):
                solve(window, with_covariance=True)
        assert len(windows) == tries
        for each, share in zip(windows, TIGHTEN, strict=False):
            for body, before in zip(each.bodies, window.bodies, strict=True):
                np.testing.assert_allclose(body.attitude_covariance, before.attitude_covariance * share**2)


def test_the_prior_on_gravity_stays_where_axes_across_it_turn() -> None:
    """GTSAM counts gravity's changes along axes that jump on the way; the prior is anything but round."""
    window = small_window()
    layout, shared = window.priors.layout, window.priors.shared
    mean, covariance = shared.mean.copy(), shared.covariance.copy()
    mean[layout.gravity] = layout.gravity_axes @ unit(np.array([0.2, -0.95, 0.1]))  # x and z exchanged
    covariance[layout.gravity] = covariance[:, layout.gravity] = 0.0
    covariance[layout.gravity, layout.gravity] = np.diag(np.radians([8.0, 1.0]) ** 2)
    across = layout.gravity.start, 0  # tied to the accelerometer's bias
    covariance[across] = covariance[across[::-1]] = 0.8 * np.radians(8.0) * np.sqrt(covariance[0, 0])
    window = replace(window, priors=replace(window.priors, shared=Gaussian(mean, covariance)))
    graph, start, groups = build(window)
    found = smoother.graph.optimise.optimise(graph, start, groups, window, 1e-10)
    assert have_turned(gravity_axes(start), gravity_axes(found.values))

    def cost(move: FloatArray) -> float:
        values = gtsam.Values(found.values)
        values.update(G(0), values.atUnit3(G(0)).retract(move))
        factors = [graph.at(i) for i in range(graph.size())]
        rest = [each for each in factors if not isinstance(each, gtsam.LinearContainerFactor)]
        off = SolvedWindow(window, graph, values, groups).shared - mean
        return sum(each.error(values) for each in rest) + 0.5 * off @ np.linalg.solve(covariance, off)

    for step in 1e-4 * np.eye(2):
        below, here, above = cost(-step), cost(0.0 * step), cost(step)
        curvature = (above - 2 * here + below) / 1e-8
        assert abs(above - below) / 2e-4 < 0.02 * np.sqrt(curvature)  # so far in sigmas


def test_without_a_shoulder_and_with_nothing_asked_for() -> None:
    window = replace(small_window(upper=False), shoulder=None)
    found = solve(window, with_covariance=False)
    assert found.shoulder is found.forearm.pose_covariance is found.evidence is None
    assert solve(window, with_covariance=True).forearm.pose_covariance is not None
    with pytest.raises(SolveError, match=r"between 20\.0 s and 20\.\d s is not determined"):
        solve(replace(window, joint_measurements=()), with_covariance=True)


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


@dataclass(frozen=True)
class BasisPlan(DrawPlan):
    """In place of random numbers: the n-th draw has a one as the n-th number and zeros as all others.

    Sums over draws are then what averages over endless draws would be.
    """

    places: dict[tuple[int, int], slice] = field(default_factory=dict)

    def _normals(self, stream: int, numbers: Sequence[int], width: int) -> FloatArray:
        normals = np.zeros((len(numbers), self.count, width))
        for number, own in zip(numbers, normals, strict=True):
            start = max((place.stop for place in self.places.values()), default=0)
            place = self.places.setdefault((stream, number), slice(start, start + width))
            assert place.stop - place.start == width and place.stop <= self.count
            own[place] = np.eye(width)
        return normals


def basis(window: Window) -> BasisPlan:
    # any covariance will do in place of what all windows say: a window's own is what comes out
    return BasisPlan(700, 0, "right", 4, 0.5 * window.priors.shared.covariance, window.considered)


def same(drawn: FloatArray, stated: FloatArray) -> None:
    scale = np.sqrt(np.diag(stated))
    drawn = drawn.reshape(len(drawn), -1)
    np.testing.assert_allclose(
        drawn.T @ drawn / scale / scale[:, None], stated / scale / scale[:, None], atol=1e-5
    )


def test_draws_have_covariances_within_and_between_times_as_gtsam(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of both IMUs, three biases of each, and of the shoulder, in a gap and outside."""
    monkeypatch.setattr(smoother.graph.build, "BIAS_LENGTH_S", 0.18)
    monkeypatch.setattr(smoother.graph.sampling, "_SLICE_S", 0.05)
    window = replace(small_window(), considered=None)
    graph, values, groups = build(window)
    values = gtsam.LevenbergMarquardtOptimizer(graph, values).optimize()
    solved = SolvedWindow(window, graph, values, groups)
    assert solved.biases[-1] == 2
    draws = sample_window(solved, solved.system(), basis(window), np.zeros((3, 3)))
    upper = np.arange(UPPER_FIRST, UPPER_FIRST + UPPER_NODES)
    nodes, knots = [0, 3, 5, 9], [1, 2, 3]
    keys = [X(i) for i in nodes] + [V(i) for i in nodes] + [S(k) for k in knots] + [Y(i) for i in upper]
    joint = gtsam.Marginals(graph, values).jointMarginalCovariance(keys)
    turns = {key: slice(0, 3) for key in keys[-UPPER_NODES:]}  # of the upper arm turns alone are drawn
    all_of = slice(None)
    expected = np.block(
        [[joint.at(a, b)[turns.get(a, all_of), turns.get(b, all_of)] for b in keys] for a in keys]
    )

    def in_body(turned: FloatArray, key: int) -> FloatArray:
        return np.asarray(turned @ values.atPose3(key).rotation().matrix())

    parts = [
        np.concatenate([in_body(drawn[:, i], X(i)) for drawn in (draws.rotation, draws.position)], axis=1)
        for i in nodes
    ]
    parts += [draws.velocity[:, i] for i in nodes]
    parts += [draws.shoulder[:, window.shoulder.node[k]] for k in knots]
    parts += [in_body(draws.turns["upper_arm"][:, i], Y(i)) for i in upper]
    same(np.concatenate(parts, axis=1), expected)
    assert np.isnan(draws.turns["upper_arm"][:, np.setdiff1d(np.arange(len(window.t)), upper)]).all()


def test_draws_have_the_covariance_that_the_window_states() -> None:
    """Considered errors included, at nodes whose covariance is computed."""
    window = small_window()
    solution = solve(window, with_covariance=True, plan=basis(window))
    draws, forearm = solution.draws, solution.forearm
    for node in range(len(window.t)):
        pose = np.concatenate([draws.position[:, node], draws.rotation[:, node]], axis=1)
        same(pose, forearm.pose_covariance[node])
        same(draws.velocity[:, node], forearm.velocity_covariance[node])
    for node in window.shoulder.node:
        same(draws.shoulder[:, node], solution.shoulder_covariance[node])


def test_neighbouring_sections_draw_the_same_motion(monkeypatch: pytest.MonkeyPatch) -> None:
    """So that their blend keeps its variance: positions nearly, turns for the most part."""
    monkeypatch.undo()  # nodes and biases as they are
    monkeypatch.setattr("smoother.recovery.sections.SECTION_S", 10.0)
    made = arm(3, protocol="random", duration_s=20.0, occlusion_lengths_s=(2.0,), occlusion_every_s=6.0)
    one, two = section_windows(made.recording, made.calibration)
    plan = DrawPlan(100, 5, "right", 4, one.priors.shared.covariance, one.considered)
    first, second = (solve(each, with_covariance=True, plan=plan).draws for each in (one, two))
    there = np.abs(two.t - two.core_start_s) < 0.5
    at = np.searchsorted(one.t, two.t[there] - 1e-6)
    for name, least in (("position", 0.97), ("velocity", 0.93), ("rotation", 0.8)):
        a, b = getattr(first, name)[:, at], getattr(second, name)[:, there]
        correlation = (a * b).sum() / np.sqrt((a * a).sum() * (b * b).sum())
        assert correlation > least, (name, correlation)


@pytest.mark.parametrize(("rate", "every"), [(100.0, 4), (25.0, 1), (60.0, 2), (1000.0, 40), (10.0, 1)])
def test_drawn_times_are_25_a_second_or_more(rate: float, every: int) -> None:
    assert samples_apart(np.arange(300) / rate) == samples_apart(np.arange(500_000) / rate) == every
    assert samples_apart(np.zeros(1)) == 1
