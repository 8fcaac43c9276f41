"""A window's motion between its nodes, and as start values of another."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from curve import Curve, G, angle_rad
from scenes import arm, first_window
from scipy.spatial.transform import Rotation

from smoother.array_types import FloatArray
from smoother.body import FOREARM, UPPER_ARM
from smoother.graph.solve import solve
from smoother.measurements.inertial import InertialSignal
from smoother.window.prepare import PreparedRun, PreparedSegment
from smoother.window.problem import States
from smoother.window.solution import SegmentSolution, Solution
from smoother.window.trajectory import at_times, joint_from_pose, share_after, started_from


@dataclass(frozen=True)
class Solved:
    """The answer of a simulated arm's window, and its signal."""

    motion: SegmentSolution
    signal: InertialSignal


@pytest.fixture(scope="module")
def solved() -> Solved:
    made = arm(2, duration_s=15.0)
    answer = solve(first_window(made.recording, made.calibration), with_covariance=False)
    return Solved(answer.forearm, InertialSignal(made.recording.imu))


def analytic(spacing_s: float) -> tuple[SegmentSolution, InertialSignal, Curve]:
    """Nodes exactly on an analytic motion, its exact IMU."""
    curve = Curve(8)
    t = np.arange(0.5, 5.5, spacing_s)
    n = len(t)
    states = States(curve.rotation(t).as_matrix(), curve.position(t), curve.velocity(t))
    motion = SegmentSolution(FOREARM.name, t, states, np.zeros((n, 6)), G * curve.down)
    return motion, InertialSignal(curve.imu(100.0, 6.0)), curve


def test_at_times_arrives_at_the_nodes_from_before(solved: Solved) -> None:
    """A microsecond before a node the answer is the node's, whatever the IMU missed in between."""
    at = solved.motion.t[1:] - 1e-6
    states = at_times(solved.motion, solved.signal, at)
    before = solved.motion.states.p[1:] - 1e-6 * solved.motion.states.v[1:]
    np.testing.assert_allclose(states.p, before, atol=1e-8)
    np.testing.assert_allclose(states.v, solved.motion.states.v[1:], atol=1e-3)
    assert angle_rad(states.R, solved.motion.states.R[1:]).max() < 1e-4


def test_velocity_is_the_derivative_of_position(solved: Solved) -> None:
    """Central differences of 1 ms, off the nodes, where the second derivative may jump."""
    at = 0.5 * (solved.motion.t[1:] + solved.motion.t[:-1])
    h = 0.0005
    grid = np.sort(np.concatenate([at - h, at, at + h]))
    states = at_times(solved.motion, solved.signal, grid)
    slope = (states.p[2::3] - states.p[::3]) / (2 * h)
    # h^2 / 6 of a jerk of 1000 m/s^3 is 4e-5; the fine steps' midpoint rule adds as much
    np.testing.assert_allclose(slope, states.v[1::3], atol=2e-4)


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
    p, pose_covariance = np.array([[0.0, 0.0, 2.0], [0.1, 0.0, 2.0]]), np.zeros((2, 6, 6))
    pose_covariance[0], pose_covariance[1] = np.diag([1e-4] * 3 + [1e-2] * 3), np.nan
    position, covariance = joint_from_pose(np.tile(np.eye(3), (2, 1, 1)), p, pose_covariance, np.zeros(3))
    np.testing.assert_array_equal(position, p)
    np.testing.assert_allclose(covariance[0], 1e-4 * np.eye(3))
    assert np.isnan(covariance[1]).all()


def test_the_share_of_what_comes_after_a_border() -> None:
    t = 7.0 + np.array([-9.0, -0.5, -0.25, 0.0, 0.25, 0.5, 9.0])
    np.testing.assert_allclose(share_after(t, 7.0), [0.0, 0.0, 5 / 32, 0.5, 27 / 32, 1.0, 1.0])


def prepared(signal: InertialSignal, curve: Curve, t: FloatArray, upper: slice) -> PreparedSegment:
    """Nodes with start values that are 1 m off, of a forearm and for some nodes of an upper arm."""
    off = States(curve.rotation(t).as_matrix(), curve.position(t) + 1.0, curve.velocity(t))
    nothing, covariance = np.zeros(0), np.tile(np.eye(3), (len(t), 1, 1))
    own = States(off.R[upper], off.p[upper], off.v[upper])
    return PreparedSegment(
        t=t,
        bodies=(
            PreparedRun(FOREARM.name, signal, 0, off, off.R, covariance),
            PreparedRun(UPPER_ARM.name, signal, upper.start, own, own.R, covariance[upper]),
        ),
        frame_t_imu=nothing,
        frame_node=np.zeros(0, int),
        position=np.zeros((0, 5, 3)),
        accepted=np.zeros((0, 5), bool),
        sigma_m=np.zeros((0, 5)),
        gaps=(),
        acceleration_std=np.zeros(len(t)),
        still=np.zeros(len(t), bool),
        start_s=float(t[0]),
        end_s=float(t[-1]),
    )


def test_a_segment_starts_from_an_earlier_answer() -> None:
    """At nodes of its own; beyond the answer from its end, and of a further IMU where there is an answer."""
    motion, signal, curve = analytic(0.1)
    before = prepared(signal, curve, motion.t, slice(10, 40))
    p = motion.states.p.copy()
    p[:10] = p[40:] = np.nan
    upper = replace(motion, segment=UPPER_ARM.name, states=replace(motion.states, p=p))
    answer = Solution((motion, upper), None, None, np.zeros(0), {}, {}, 1, 0.0)
    later = prepared(signal, curve, np.arange(0.53, 5.8, 0.07), slice(5, 70))
    started = started_from(later, answer, before)
    assert started.is_started and not later.is_started
    assert [run.first for run in started.bodies] == [0, 5]
    at = np.minimum(later.t, motion.t[-1])
    start = started.forearm.start
    assert np.abs(start.p - curve.position(at)).max() < 5e-6
    assert np.abs(start.v - curve.velocity(at)).max() < 3e-4
    assert angle_rad(start.R, curve.rotation(at).as_matrix()).max() < 1e-4
    of_upper, t = started.bodies[1].start, later.t[5:70]
    known = (t >= motion.t[10]) & (t <= motion.t[39])
    assert 0 < known.sum() < len(t)
    np.testing.assert_allclose(of_upper.p[known], curve.position(t[known]), atol=5e-6)
    np.testing.assert_array_equal(of_upper.p[~known], later.bodies[1].start.p[~known])
    alone = started_from(later, replace(answer, bodies=(motion,)), before)
    assert alone.bodies[1].start is later.bodies[1].start
