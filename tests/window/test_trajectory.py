"""Windows joined to one motion, and that motion between its nodes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from curve import Curve, G, angle_rad
from scenes import arm, last_pass
from scipy.spatial.transform import Rotation

from smoother.array_types import FloatArray
from smoother.measurements.inertial import InertialSignal, integrate
from smoother.window.problem import States, Window
from smoother.window.solution import Solution
from smoother.window.trajectory import (
    BLEND_HALF_S,
    SegmentTrajectory,
    at_times,
    joint_from_pose,
    merge_windows,
)


class Joined:
    """The windows of a simulated arm, and the motion joined from them."""

    def __init__(self) -> None:
        self.made = arm(2)
        jobs = last_pass(self.made.recording, self.made.calibration)
        self.windows: list[Window] = [job.window for job in jobs]
        self.solutions: list[Solution] = [job.solution for job in jobs]
        self.t = np.unique(np.concatenate([window.t for window in self.windows]))
        self.motion = merge_windows(self.t, self.windows, self.solutions)
        self.signal = InertialSignal(self.made.recording.imu)
        self.borders = [window.core_start_s for window in self.windows[1:]]


@pytest.fixture(scope="module")
def joined() -> Joined:
    return Joined()


def analytic(spacing_s: float) -> tuple[SegmentTrajectory, InertialSignal, Curve]:
    """Nodes exactly on an analytic motion, its exact IMU."""
    curve = Curve(8)
    t = np.arange(0.5, 5.5, spacing_s)
    n = len(t)
    states = States(curve.rotation(t).as_matrix(), curve.position(t), curve.velocity(t))
    zero, gravity = np.zeros((n, 6)), np.tile(G * curve.down, (n, 1))
    motion = SegmentTrajectory(t, states, np.zeros((n, 6, 6)), np.zeros((n, 3, 3)), zero, gravity)
    return motion, InertialSignal(curve.imu(100.0, 6.0)), curve


def test_one_window_is_taken_as_it_is(joined: Joined) -> None:
    window, solution = joined.windows[0], joined.solutions[0]
    alone = merge_windows(window.t, [window], [solution])
    np.testing.assert_array_equal(alone.forearm.states.p, solution.forearm.states.p)
    np.testing.assert_allclose(alone.forearm.states.R, solution.forearm.states.R, atol=1e-12)
    np.testing.assert_array_equal(alone.forearm.pose_covariance, solution.forearm.pose_covariance)
    np.testing.assert_array_equal(alone.forearm.bias, solution.forearm.bias)


def test_lever_arms_go_with_the_poses_of_their_window(joined: Joined) -> None:
    """The joint is where its own window has it, not where another window's lever arm would put it."""
    for window, solution in zip(joined.windows, joined.solutions, strict=True):
        own = (window.t > window.core_start_s + BLEND_HALF_S) & (window.t < window.core_end_s - BLEND_HALF_S)
        for joint in ("elbow", "wrist", "hand"):
            lever = solution.message.shared.mean[window.priors.layout.lever(joint)]
            lever_at = joined.motion.lever_at(joint, window.t[own])
            np.testing.assert_allclose(lever_at, np.tile(lever, (own.sum(), 1)), atol=1e-12)
    assert not joined.motion.lever_at("strap", joined.t).any()


def test_far_from_borders_each_window_rules(joined: Joined) -> None:
    for window, solution in zip(joined.windows, joined.solutions, strict=True):
        own = (window.t > window.core_start_s + BLEND_HALF_S) & (window.t < window.core_end_s - BLEND_HALF_S)
        rows = np.searchsorted(joined.t, window.t[own])
        np.testing.assert_array_equal(joined.motion.forearm.states.p[rows], solution.forearm.states.p[own])
        np.testing.assert_allclose(
            joined.motion.forearm.states.R[rows], solution.forearm.states.R[own], atol=1e-12
        )


def test_the_blend_lies_between_the_two(joined: Joined) -> None:
    """Near a border the motion is a weighted mean: nowhere farther from either than they are apart."""
    at = dict(zip(joined.t.tolist(), joined.motion.forearm.states.p, strict=True))
    pairs = zip(zip(joined.windows[:-1], joined.solutions[:-1], strict=True), joined.borders, strict=True)
    for (window, solution), border in pairs:
        index = window.index + 1
        after, later = joined.windows[index], joined.solutions[index]
        for k in np.flatnonzero(np.abs(window.t - border) < BLEND_HALF_S):
            row = int(np.searchsorted(after.t, window.t[k]))
            a, b, p = solution.forearm.states.p[k], later.forearm.states.p[row], at[float(window.t[k])]
            assert np.linalg.norm(p - a) + np.linalg.norm(p - b) <= np.linalg.norm(a - b) + 1e-12


def test_no_jump_at_the_borders(joined: Joined) -> None:
    """Step from sample to sample less its velocity: at borders as elsewhere, position and orientation."""
    t = np.arange(joined.t[0], joined.t[-1], 0.005)
    states = at_times(joined.motion.forearm, joined.signal, t)
    step = np.diff(states.p, axis=0) - 0.005 * 0.5 * (states.v[1:] + states.v[:-1])
    jump = np.linalg.norm(step, axis=1)
    turn = angle_rad(states.R[:-1], states.R[1:])
    middle = 0.5 * (t[1:] + t[:-1])
    near = np.min([np.abs(middle - border) for border in joined.borders], axis=0) < BLEND_HALF_S + 0.1
    # a hard switch between windows would be a jump of a millimetre in one step
    assert jump[near].max() < 1.5 * jump[~near].max()
    assert jump.max() < 2e-4
    assert turn[near].max() < 1.1 * max(turn[~near].max(), 0.01)
    # the blend is worth testing: a step this size would be seen
    apart = [
        np.abs(a.forearm.states.p[np.isin(u.t, w.t)] - b.forearm.states.p[np.isin(w.t, u.t)]).max()
        for (u, a), (w, b) in zip(
            zip(joined.windows[:-1], joined.solutions[:-1], strict=True),
            zip(joined.windows[1:], joined.solutions[1:], strict=True),
            strict=True,
        )
    ]
    assert max(apart) > 5e-4


def test_covariances_stay_positive(joined: Joined) -> None:
    assert np.linalg.eigvalsh(joined.motion.forearm.pose_covariance).min() > 0
    assert np.linalg.eigvalsh(joined.motion.forearm.velocity_covariance).min() > 0


def test_gravity_keeps_its_length(joined: Joined) -> None:
    """A mean of two directions is shorter by the square of their angle: under a thousandth here."""
    np.testing.assert_allclose(np.linalg.norm(joined.motion.forearm.gravity, axis=1), 9.81, rtol=1e-3)


def test_at_times_arrives_at_the_nodes_from_before(joined: Joined) -> None:
    """A microsecond before a node the answer is the node's, whatever the IMU missed in between."""
    at = joined.t[1:] - 1e-6
    states = at_times(joined.motion.forearm, joined.signal, at)
    before = joined.motion.forearm.states.p[1:] - 1e-6 * joined.motion.forearm.states.v[1:]
    np.testing.assert_allclose(states.p, before, atol=1e-8)
    np.testing.assert_allclose(states.v, joined.motion.forearm.states.v[1:], atol=1e-3)
    assert angle_rad(states.R, joined.motion.forearm.states.R[1:]).max() < 1e-4


def test_velocity_is_the_derivative_of_position(joined: Joined) -> None:
    """Central differences of 1 ms, off the nodes, where the second derivative may jump."""
    at = 0.5 * (joined.t[1:] + joined.t[:-1])
    h = 0.0005
    grid = np.sort(np.concatenate([at - h, at, at + h]))
    states = at_times(joined.motion.forearm, joined.signal, grid)
    slope = (states.p[2::3] - states.p[::3]) / (2 * h)
    # h^2 / 6 of a jerk of 1000 m/s^3 is 4e-5; the fine steps' midpoint rule adds as much
    np.testing.assert_allclose(slope, states.v[1::3], atol=2e-4)


def test_the_answer_does_not_depend_on_the_other_query_times(joined: Joined) -> None:
    """Steps of the integration follow the query times, so equal to its own second-order error only."""
    coarse = np.linspace(joined.t[5], joined.t[-5], 301)
    fine = np.union1d(coarse, np.linspace(joined.t[5], joined.t[-5], 7777))
    a, b = (at_times(joined.motion.forearm, joined.signal, t) for t in (coarse, fine))
    row = np.searchsorted(fine, coarse)
    np.testing.assert_allclose(a.p, b.p[row], atol=2e-6)
    np.testing.assert_allclose(a.v, b.v[row], atol=2e-4)
    assert angle_rad(a.R, b.R[row]).max() < 1e-4


@pytest.mark.parametrize("spacing_s", [1 / 30, 0.1])
def test_between_exact_nodes_the_imu_draws_the_exact_path(spacing_s: float) -> None:
    motion, signal, curve = analytic(spacing_s)
    t = np.linspace(motion.t[0], motion.t[-1], 1501)
    states = at_times(motion, signal, t)
    # one interval of the integration: see test_inertial; a spline through the nodes is 100 times worse
    assert np.abs(states.p - curve.position(t)).max() < 5e-6
    assert np.abs(states.v - curve.velocity(t)).max() < 3e-4
    assert angle_rad(states.R, curve.rotation(t).as_matrix()).max() < 1e-4


def test_a_wrong_node_is_approached_smoothly() -> None:
    """What the IMU misses at the next node is spread over the interval: no step anywhere."""
    motion, signal, _ = analytic(0.1)
    p = motion.states.p.copy()
    p[20] += [0.005, 0.0, 0.0]
    wrong = replace(motion, states=States(motion.states.R, p, motion.states.v))
    t = np.arange(motion.t[18], motion.t[22], 0.001)
    move = at_times(wrong, signal, t).p - at_times(motion, signal, t).p
    assert np.abs(np.diff(move, axis=0)).max() < 0.001 * 1.6 * 0.005 / 0.1  # 1.5 is the cubic's steepest
    row = int(np.argmin(np.abs(t - motion.t[20])))
    assert move[row, 0] == pytest.approx(0.005, abs=1e-5)
    assert np.abs(move[t <= motion.t[19]]).max() < 1e-12
    assert np.abs(move[t >= motion.t[21]]).max() < 1e-12


def test_the_bias_of_each_interval_is_taken_off() -> None:
    """A biased IMU with the bias stated at the nodes draws the same path."""
    motion, signal, curve = analytic(0.1)
    bias = np.array([0.3, -0.2, 0.1, 0.05, -0.02, 0.03])
    imu = curve.imu(100.0, 6.0)
    biased = InertialSignal(replace(imu, acc=imu.acc + bias[:3], gyro=imu.gyro + bias[3:]))
    stated = replace(motion, bias=np.tile(bias, (len(motion.t), 1)))
    t = np.linspace(motion.t[0], motion.t[-1], 777)
    a, b = at_times(motion, signal, t), at_times(stated, biased, t)
    np.testing.assert_allclose(a.p, b.p, atol=1e-9)
    np.testing.assert_allclose(a.R, b.R, atol=1e-9)


def propagated(motion: SegmentTrajectory, signal: InertialSignal, k: int, t: float) -> FloatArray:
    """A node's state propagated to a time by one integration, written out."""
    step = integrate(signal, np.array([motion.t[k], t]), motion.bias[k])
    h = t - motion.t[k]
    states = motion.states
    turned = Rotation.from_matrix(states.R[k]).apply(step.delta_p[0])
    return np.asarray(states.p[k] + states.v[k] * h + 0.5 * motion.gravity[k] * h**2 + turned)


def test_beyond_a_node_the_imu_leads(joined: Joined) -> None:
    """Early in an interval the answer is the node propagated; the rest comes in with the square of time."""
    k = len(joined.t) // 2
    length = joined.t[k + 1] - joined.t[k]
    t = float(joined.t[k] + 0.02 * length)
    position = at_times(joined.motion.forearm, joined.signal, np.array([t])).p[0]
    np.testing.assert_allclose(position, propagated(joined.motion.forearm, joined.signal, k, t), atol=2e-5)


def test_a_joint_follows_from_the_pose_and_its_lever_arm() -> None:
    """Position exactly; covariance as scattered poses and lever arms have it, cross terms included."""
    rng = np.random.default_rng(3)
    R = Rotation.random(random_state=3).as_matrix()
    p, lever = np.array([0.1, -0.2, 2.0]), np.array([0.02, 0.18, -0.01])
    root = rng.normal(size=(6, 6)) * np.repeat([0.004, 0.01], 3)[:, None]
    lever_covariance = np.diag(np.square([0.002, 0.006, 0.004]))
    position, covariance = joint_from_pose(R[None], p[None], (root @ root.T)[None], lever, lever_covariance)
    np.testing.assert_allclose(position[0], p + R @ lever, atol=1e-15)
    error = rng.normal(size=(200_000, 6)) @ root.T
    levers = lever + rng.normal(size=(200_000, 3)) * np.sqrt(np.diag(lever_covariance))
    scattered = p + error[:, :3] + Rotation.from_rotvec(error[:, 3:]).apply(levers @ R.T)
    scale = np.sqrt(np.diag(covariance[0]))
    np.testing.assert_allclose(
        np.cov(scattered.T) / np.outer(scale, scale), covariance[0] / np.outer(scale, scale), atol=0.02
    )


def test_a_joint_without_a_lever_arm_is_the_imu_and_an_unknown_pose_leaves_it_unknown() -> None:
    R, p = np.tile(np.eye(3), (2, 1, 1)), np.array([[0.0, 0.0, 2.0], [0.1, 0.0, 2.0]])
    pose_covariance = np.tile(np.diag([1e-4] * 3 + [1e-2] * 3), (2, 1, 1))
    pose_covariance[1] = np.nan
    position, covariance = joint_from_pose(R, p, pose_covariance, np.zeros(3))
    np.testing.assert_array_equal(position, p)
    np.testing.assert_allclose(covariance[0], 1e-4 * np.eye(3))
    assert np.isnan(covariance[1]).all()
