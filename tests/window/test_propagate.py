"""Camera frames that share a node: where the IMU has them, what that costs, and the slope of the clock."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from curve import Curve, G, angle_rad
from hypothesis import given
from hypothesis import strategies as st

from smoother.array_types import FloatArray
from smoother.measurements.inertial import InertialSignal
from smoother.recording import ImuStream
from smoother.window.nodes import FINE_S, GROUPED_S, group_frames, near_impacts, propagate
from smoother.window.problem import States

LEVER = np.array([0.03, -0.2, 0.01])


def states_of(curve: Curve, t: FloatArray) -> States:
    return States(curve.rotation(t).as_matrix(), curve.position(t), curve.velocity(t))


def joint(curve: Curve, t: FloatArray) -> FloatArray:
    return curve.position(t) + curve.rotation(t).apply(LEVER)


@pytest.mark.parametrize("seed", range(3))
def test_frames_before_and_after_a_node_are_where_the_curve_is(seed: int) -> None:
    curve = Curve(seed)
    imu = curve.imu(100.0, 3.0)
    node_t = np.array([0.5, 1.5, 2.5])
    frame_t = np.concatenate([node_t - GROUPED_S, node_t, node_t + GROUPED_S])
    node = np.tile(np.arange(3), 3)
    gravity = G * curve.down
    motion = propagate(
        InertialSignal(imu), node_t, states_of(curve, node_t), frame_t, node, gravity, np.zeros(6)
    )
    true = joint(curve, frame_t) - joint(curve, node_t[node])
    np.testing.assert_allclose(motion.shift(LEVER), true, atol=2e-5)  # 100 Hz samples of 8 m/s^2
    assert angle_rad(motion.R_frame, curve.rotation(frame_t).as_matrix()).max() < 1e-4
    slope = (joint(curve, frame_t + 1e-5) - joint(curve, frame_t - 1e-5)) / 2e-5
    velocity = motion.velocity(LEVER) + curve.velocity(node_t)[node]
    np.testing.assert_allclose(velocity, slope, atol=5e-3)  # the rate is a mean over 20 ms
    assert not motion.shift(LEVER)[3:6].any()


def test_a_wrong_velocity_cancels_over_a_group() -> None:
    """Half a metre a second wrong moves frames by 3.5 cm, and their mean not at all."""
    curve = Curve(1)
    signal, gravity = InertialSignal(curve.imu(100.0, 3.0)), G * curve.down
    node_t = np.array([1.5])
    frame_t = 1.5 + np.array([-GROUPED_S, -0.5 * GROUPED_S, 0.0, 0.5 * GROUPED_S, GROUPED_S])
    states = states_of(curve, node_t)
    wrong = replace(states, v=states.v + np.array([0.5, 0.0, 0.0]))
    right, off = (
        propagate(signal, node_t, at_node, frame_t, np.zeros(5, dtype=int), gravity, np.zeros(6)).shift(LEVER)
        for at_node in (states, wrong)
    )
    assert np.abs(off - right).max() == pytest.approx(0.5 * GROUPED_S, rel=1e-6)
    np.testing.assert_allclose((off - right).mean(axis=0), 0.0, atol=1e-12)


@given(
    seed=st.integers(0, 10_000),
    rate_hz=st.sampled_from([15.0, 19.0, 30.0, 60.0, 120.0]),
    drop=st.floats(0.0, 0.6),
)
def test_groups_keep_near_their_node_and_away_from_gaps(seed: int, rate_hz: float, drop: float) -> None:
    rng = np.random.default_rng(seed)
    t = np.arange(int(4 * rate_hz)) / rate_hz
    t = t[rng.uniform(size=len(t)) >= drop]
    visible = np.ones(len(t), dtype=bool)
    visible[(t > 1.3) & (t < 1.6)] = False
    struck = np.abs(t - 3.0) < 0.01
    owner = group_frames(t, visible, struck)
    if not len(t):
        return
    assert (owner[owner] == owner).all()  # a node's frame belongs to itself
    assert (np.diff(owner) >= 0).all()
    assert np.abs(t - t[owner]).max() <= 1.5 * GROUPED_S
    moved = owner != np.arange(len(t))
    assert visible[moved].all()
    near_gap = (t > 1.3 - 0.8 * FINE_S) & (t < 1.6 + 0.8 * FINE_S)
    assert not moved[near_gap].any()
    assert not moved[struck].any() and not np.isin(owner[moved], np.flatnonzero(struck)).any()


def test_frames_at_thirty_hertz_share_a_node_by_sevens() -> None:
    t = np.arange(60) / 30.0
    owner = group_frames(t, np.ones(60, dtype=bool), np.zeros(60, dtype=bool))
    _, count = np.unique(owner, return_counts=True)
    assert np.bincount(count).tolist() == [0, 11, 0, 0, 0, 0, 0, 7]  # five fine ones at both ends


def test_frames_near_a_blow_are_found() -> None:
    """A blow of 100 m/s^2 in one sample, in a motion at 1 Hz with 5 m/s^2."""
    t = np.arange(400) / 80.0
    acc = np.stack([5.0 * np.sin(2 * np.pi * t), np.zeros(400), np.full(400, 9.81)], axis=1)
    gentle = InertialSignal(ImuStream("imu", t, acc, np.zeros((400, 3))))
    struck = acc.copy()
    struck[200, 1] = 100.0
    blow = InertialSignal(ImuStream("imu", t, struck, np.zeros((400, 3))))
    frames = np.arange(0.0, 5.0, 1 / 30)
    assert not near_impacts(gentle, frames).any()
    near = np.abs(frames - t[200]) < GROUPED_S
    found = near_impacts(blow, frames)
    assert found[near].all() and not found[np.abs(frames - t[200]) > GROUPED_S + 0.03].any()
