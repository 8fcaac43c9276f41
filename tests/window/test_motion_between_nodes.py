"""Between a window's nodes: frames that share one, the motion there, and start values of another window."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from curve import Curve, G, angle_rad
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from smoother.array_types import FloatArray
from smoother.body import FOREARM, UPPER_ARM
from smoother.measurements.inertial import InertialSignal
from smoother.recording import ImuStream
from smoother.window.nodes import FINE_S, GROUPED_S, group_frames, near_impacts, propagate
from smoother.window.prepare import PreparedRun, PreparedSegment
from smoother.window.problem import States
from smoother.window.solution import SegmentSolution, Solution
from smoother.window.trajectory import at_times, joint_from_pose, share_after, started_from

LEVER = np.array([0.03, -0.2, 0.01])


def states_of(curve: Curve, t: FloatArray) -> States:
    return States(curve.rotation(t).as_matrix(), curve.position(t), curve.velocity(t))


def joint(curve: Curve, t: FloatArray) -> FloatArray:
    return curve.position(t) + curve.rotation(t).apply(LEVER)


@pytest.mark.parametrize("seed", range(3))
def test_frames_before_and_after_a_node_are_where_the_curve_is(seed: int) -> None:
    curve, node_t, node = Curve(seed), np.array([0.5, 1.5, 2.5]), np.tile(np.arange(3), 3)
    frame_t = np.concatenate([node_t - GROUPED_S, node_t, node_t + GROUPED_S])
    signal, states = InertialSignal(curve.imu(100.0, 3.0)), states_of(curve, node_t)
    motion = propagate(signal, node_t, states, frame_t, node, G * curve.down, np.zeros(6))
    true = joint(curve, frame_t) - joint(curve, node_t[node])
    np.testing.assert_allclose(motion.shift(LEVER), true, atol=2e-5)  # 100 Hz samples of 8 m/s^2
    assert angle_rad(motion.R_frame, curve.rotation(frame_t).as_matrix()).max() < 1e-4
    slope = (joint(curve, frame_t + 1e-5) - joint(curve, frame_t - 1e-5)) / 2e-5
    velocity = motion.velocity(LEVER) + curve.velocity(node_t)[node]
    np.testing.assert_allclose(velocity, slope, atol=5e-3)  # the rate is a mean over 20 ms
    assert not motion.shift(LEVER)[3:6].any()
    # half a metre a second wrong moves frames by 3.5 cm, and their mean not at all
    wrong = replace(states, v=states.v + np.array([0.5, 0.0, 0.0]))
    off = propagate(signal, node_t, wrong, frame_t, node, G * curve.down, np.zeros(6)).shift(LEVER)
    off -= motion.shift(LEVER)
    assert np.abs(off).max() == pytest.approx(0.5 * GROUPED_S, rel=1e-6)
    np.testing.assert_allclose(off.reshape(3, 3, 3).mean(axis=0), 0.0, atol=1e-12)


@given(
    seed=st.integers(0, 10_000),
    rate_hz=st.sampled_from([15.0, 19.0, 30.0, 60.0, 120.0]),
    drop=st.floats(0.0, 0.6),
)
def test_groups_keep_near_their_node_and_away_from_gaps(seed: int, rate_hz: float, drop: float) -> None:
    t = np.arange(int(4 * rate_hz)) / rate_hz
    t = t[np.random.default_rng(seed).uniform(size=len(t)) >= drop]
    visible, struck = ~((t > 1.3) & (t < 1.6)), np.abs(t - 3.0) < 0.01
    owner = group_frames(t, visible, struck)
    if not len(t):
        return
    assert (owner[owner] == owner).all() and (np.diff(owner) >= 0).all()  # a node's frame is its own
    assert np.abs(t - t[owner]).max() <= 1.5 * GROUPED_S
    moved = owner != np.arange(len(t))
    near_gap = (t > 1.3 - 0.8 * FINE_S) & (t < 1.6 + 0.8 * FINE_S)
    assert visible[moved].all() and not moved[near_gap].any()
    assert not moved[struck].any() and not np.isin(owner[moved], np.flatnonzero(struck)).any()


def test_frames_at_thirty_hertz_share_a_node_by_sevens_but_near_a_blow() -> None:
    """Of 100 m/s^2 in one sample, in a motion at 1 Hz with 5 m/s^2."""
    t, frames = np.arange(400) / 80.0, np.arange(150) / 30.0
    owner = group_frames(frames[:60], np.ones(60, dtype=bool), np.zeros(60, dtype=bool))
    _, count = np.unique(owner, return_counts=True)
    assert np.bincount(count).tolist() == [0, 11, 0, 0, 0, 0, 0, 7]  # five fine ones at both ends
    acc = np.stack([5.0 * np.sin(2 * np.pi * t), np.zeros(400), np.full(400, 9.81)], axis=1)
    apart = np.abs(frames - t[200])
    for blow in (0.0, 100.0):
        acc[200, 1] = blow
        found = near_impacts(InertialSignal(ImuStream("imu", t, acc, np.zeros((400, 3)))), frames)
        assert (found[apart < GROUPED_S] == bool(blow)).all() and not found[apart > GROUPED_S + 0.03].any()


def analytic(spacing_s: float = 0.1) -> tuple[SegmentSolution, InertialSignal, Curve]:
    """Nodes exactly on an analytic motion, its exact IMU."""
    curve, t = Curve(8), np.arange(0.5, 5.5, spacing_s)
    motion = SegmentSolution(FOREARM.name, t, states_of(curve, t), np.zeros((len(t), 6)), G * curve.down)
    return motion, InertialSignal(curve.imu(100.0, 6.0)), curve


@pytest.mark.parametrize("spacing_s", [1 / 30, 0.1])
def test_between_exact_nodes_the_imu_draws_the_exact_path(spacing_s: float) -> None:
    """So does a biased IMU with the bias stated at the nodes."""
    motion, signal, curve = analytic(spacing_s)
    t = np.linspace(motion.t[0], motion.t[-1], 1501)
    states = at_times(motion, signal, t)
    # one interval of the integration: see test_inertial; a spline through the nodes is 100 times worse
    assert np.abs(states.p - curve.position(t)).max() < 5e-6
    assert np.abs(states.v - curve.velocity(t)).max() < 3e-4
    assert angle_rad(states.R, curve.rotation(t).as_matrix()).max() < 1e-4
    bias, imu = np.array([0.3, -0.2, 0.1, 0.05, -0.02, 0.03]), curve.imu(100.0, 6.0)
    biased = InertialSignal(replace(imu, acc=imu.acc + bias[:3], gyro=imu.gyro + bias[3:]))
    stated = at_times(replace(motion, bias=np.tile(bias, (len(motion.t), 1))), biased, t)
    np.testing.assert_allclose(stated.p, states.p, atol=1e-9)
    np.testing.assert_allclose(stated.R, states.R, atol=1e-9)


def test_a_wrong_node_is_approached_smoothly() -> None:
    """What the IMU misses at the next node is spread over the interval: no step anywhere."""
    motion, signal, _ = analytic()
    R, p, v = motion.states.R.copy(), motion.states.p.copy(), motion.states.v.copy()
    R[20] = R[20] @ Rotation.from_rotvec([0.0, 0.0, 0.02]).as_matrix()
    p[20], v[20] = p[20] + [0.005, 0.0, 0.0], v[20] + [0.0, 0.05, 0.0]
    wrong = replace(motion, states=States(R, p, v))
    t = np.arange(motion.t[18], motion.t[22], 0.001)
    states = at_times(wrong, signal, t)
    move = states.p - at_times(motion, signal, t).p
    assert np.abs(np.diff(move[:, 0])).max() < 0.001 * 1.6 * 0.005 / 0.1  # 1.5 is the cubic's steepest
    assert move[np.argmin(np.abs(t - motion.t[20])), 0] == pytest.approx(0.005, abs=1e-5)
    assert np.abs(move[(t <= motion.t[19]) | (t >= motion.t[21])]).max() < 1e-12
    # a microsecond before the node it is there, and velocity is the derivative
    before = at_times(wrong, signal, motion.t[20:21] - 1e-6)
    np.testing.assert_allclose(before.p[0], p[20] - 1e-6 * v[20], atol=1e-8)
    np.testing.assert_allclose(before.v[0], v[20], atol=1e-4)
    assert angle_rad(before.R, R[20:21])[0] < 1e-4
    inside = np.abs(t[1:-1] - np.round(t[1:-1], 1)) > 0.0015
    slope = (states.p[2:] - states.p[:-2]) / 0.002
    np.testing.assert_allclose(slope[inside], states.v[1:-1][inside], atol=1e-3)


def test_a_joint_follows_from_the_pose_and_its_lever_arm() -> None:
    """Position exactly; covariance as scattered poses and lever arms have it, cross terms included."""
    rng = np.random.default_rng(3)
    R = Rotation.random(random_state=3).as_matrix()
    p, lever = np.array([0.1, -0.2, 2.0]), np.array([0.02, 0.18, -0.01])
    root = rng.normal(size=(6, 6)) * np.repeat([0.004, 0.01], 3)[:, None]
    lever_covariance = np.diag(np.square([0.002, 0.006, 0.004]))
    poses, unknown = np.stack([root @ root.T, np.full((6, 6), np.nan)]), (np.stack([R, R]), np.stack([p, p]))
    position, covariance = joint_from_pose(*unknown, poses, lever, lever_covariance)
    np.testing.assert_allclose(position, np.tile(p + R @ lever, (2, 1)), atol=1e-15)
    assert np.isnan(covariance[1]).all()  # an unknown pose leaves it unknown
    error = rng.normal(size=(200_000, 6)) @ root.T
    levers = lever + rng.normal(size=(200_000, 3)) * np.sqrt(np.diag(lever_covariance))
    scattered = p + error[:, :3] + Rotation.from_rotvec(error[:, 3:]).apply(levers @ R.T)
    scale = np.sqrt(np.outer(np.diag(covariance[0]), np.diag(covariance[0])))
    np.testing.assert_allclose(np.cov(scattered.T) / scale, covariance[0] / scale, atol=0.02)
    position, covariance = joint_from_pose(*unknown, poses, np.zeros(3))  # the IMU itself
    np.testing.assert_array_equal(position, unknown[1])
    np.testing.assert_allclose(covariance[0], poses[0, :3, :3])


def prepared(signal: InertialSignal, curve: Curve, t: FloatArray, upper: slice) -> PreparedSegment:
    """Nodes with start values that are 1 m off, of a forearm and for some nodes of an upper arm."""
    off = replace(states_of(curve, t), p=curve.position(t) + 1.0)
    own, covariance = States(off.R[upper], off.p[upper], off.v[upper]), np.tile(np.eye(3), (len(t), 1, 1))
    return PreparedSegment(
        t=t,
        bodies=(
            PreparedRun(FOREARM.name, signal, 0, off, off.R, covariance),
            PreparedRun(UPPER_ARM.name, signal, upper.start, own, own.R, covariance[upper]),
        ),
        frame_t_imu=np.zeros(0),
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
    motion, signal, curve = analytic()
    before = prepared(signal, curve, motion.t, slice(10, 40))
    p = motion.states.p.copy()
    p[:10] = p[40:] = np.nan
    upper = replace(motion, segment=UPPER_ARM.name, states=replace(motion.states, p=p))
    answer = Solution((motion, upper), None, None, np.zeros(0), {}, {}, 1, 0.0)
    later = prepared(signal, curve, np.arange(0.53, 5.8, 0.07), slice(5, 70))
    started = started_from(later, answer, before)
    assert started.is_started and not later.is_started
    assert [run.first for run in started.bodies] == [0, 5]
    at, start = np.minimum(later.t, motion.t[-1]), started.forearm.start
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
    # the share of what comes after a border
    t = 7.0 + np.array([-9.0, -0.5, -0.25, 0.0, 0.25, 0.5, 9.0])
    np.testing.assert_allclose(share_after(t, 7.0), [0.0, 0.0, 5 / 32, 0.5, 27 / 32, 1.0, 1.0])
