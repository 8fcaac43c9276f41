"""A window of a segment: nodes, samples by node, and what it is given of an upper-arm IMU."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from curve import Curve
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import arm, first_window

from smoother.array_types import IntArray
from smoother.body import FOREARM
from smoother.linalg import interpolate
from smoother.measurements.inertial import InertialSignal
from smoother.measurements.visibility import Gap
from smoother.recording import JOINTS
from smoother.simulation import SimulatedArm
from smoother.window.cut import FREE_RAD, KNOT_S, STILL_ACCELERATION, window_between
from smoother.window.nodes import GAP_NODE_CHAIN_S, GAP_NODE_S, GROUPED_S, group_frames, insert_nodes
from smoother.window.prepare import PreparedRun, PreparedSegment
from smoother.window.problem import NoiseModel, Priors, States, Window
from smoother.window.shared import Gaussian, SharedLayout, axes_across

SHOULDER = JOINTS.index("shoulder")
LEVERS = {"elbow": np.array([0.0, -0.2, 0.02]), "wrist": np.array([0.01, 0.05, -0.01])}
#: So many windows share the attitude prior.
SHARING = 3
NOISE = NoiseModel(0.01, 0.0015, 0.006, 0.002, 2.8, 0.005, 0.1)
CURVE = Curve(5)
SIGNAL = InertialSignal(CURVE.imu(100.0, 41.0))
END_S = 40.0

#: Gaps that follow each other: seconds of visible time, seconds of gap.
gap_lengths = st.lists(st.tuples(st.floats(0.3, 12.0), st.floats(0.2, 8.0)), max_size=6)
#: Where windows begin and end: all of the segment, and parts of it.
SPANS = [(-np.inf, np.inf), (0.5, 10.0), (7.0, 18.0), (15.0, 26.0), (23.0, 34.0), (31.0, END_S)]


def gaps_of(steps: list[tuple[float, float]]) -> tuple[Gap, ...]:
    at, gaps = 0.5, []
    for visible_s, gap_s in steps:
        if at + visible_s + gap_s < END_S:
            gaps.append(Gap(at + visible_s, at + visible_s + gap_s))
            at = gaps[-1].end_s
    return tuple(gaps)


def prepared_of(gaps: tuple[Gap, ...]) -> PreparedSegment:
    """An analytic motion seen without noise at 30 Hz; elbow and wrist hidden in the gaps, shoulder never."""
    frame_t = np.arange(0.5, END_S, 1 / 30)
    occluded = np.zeros(len(frame_t), dtype=bool)
    for gap in gaps:
        occluded |= (frame_t > gap.start_s) & (frame_t < gap.end_s)
    visible = np.flatnonzero(~occluded)
    never = np.zeros(len(visible), dtype=bool)
    owner = visible[group_frames(frame_t[visible], ~never, never)]
    t = insert_nodes(frame_t[np.unique(owner)], 0.5, END_S)
    frame_node = np.full(len(frame_t), -1)
    node = np.clip(np.searchsorted(t, frame_t[owner] - 1e-9), 0, len(t) - 1)
    frame_node[visible] = np.where(np.abs(t[node] - frame_t[owner]) < 1e-9, node, -1)
    position = np.full((len(frame_t), len(JOINTS), 3), np.nan)
    for joint, lever in LEVERS.items():
        position[:, JOINTS.index(joint)] = CURVE.position(frame_t) + CURVE.rotation(frame_t).apply(lever)
    position[occluded] = np.nan
    position[:, SHOULDER] = np.array([0.0, 0.3, 2.0]) + 0.01 * frame_t[:, None]
    n = len(t)
    R = CURVE.rotation(t).as_matrix()
    covariance = np.eye(3) * (0.1 + 0.2 * np.random.default_rng(0).uniform(size=n)[:, None, None])
    start = States(R, CURVE.position(t), CURVE.velocity(t))
    forearm = PreparedRun(FOREARM.name, SIGNAL, 0, start, R, covariance)
    return PreparedSegment(
        t=t,
        bodies=(forearm,),
        frame_t_imu=frame_t,
        frame_node=frame_node,
        position=position,
        accepted=np.isfinite(position).all(axis=2),
        sigma_m=np.full((len(frame_t), len(JOINTS)), 0.01),
        gaps=gaps,
        acceleration_std=np.full(n, 0.5),
        still=np.zeros(n, bool),
        start_s=0.5,
        end_s=END_S,
    )


#: Without a gap.
PREPARED = prepared_of(())


def priors() -> Priors:
    layout = SharedLayout(("elbow", "wrist"), True, axes_across(CURVE.down))
    mean = np.zeros(layout.size)
    for joint, lever in LEVERS.items():
        mean[layout.lever(joint)] = lever
    return Priors(layout, Gaussian(mean, np.eye(layout.size)), np.ones(6))


def windows_of(prepared: PreparedSegment) -> list[Window]:
    return [window_between(prepared, priors(), NOISE, SHARING, *span) for span in SPANS]


def rows_of(prepared: PreparedSegment, span: tuple[float, float]) -> IntArray:
    return np.flatnonzero((prepared.t >= span[0]) & (prepared.t <= span[1]))


@given(gap_lengths)
@settings(max_examples=15, deadline=None)
def test_measurements_belong_to_their_nodes(steps: list[tuple[float, float]]) -> None:
    prepared = prepared_of(gaps_of(steps))
    for span, window in zip(SPANS, windows_of(prepared), strict=True):
        rows = rows_of(prepared, span)
        np.testing.assert_array_equal(window.t, prepared.t[rows])
        np.testing.assert_array_equal(window.forearm.start.p, prepared.forearm.start.p[rows])
        inside = np.isin(prepared.frame_node, rows)
        for measured in window.joint_measurements:
            column = JOINTS.index(measured.joint)
            frames = np.flatnonzero(inside & prepared.accepted[:, column])
            np.testing.assert_array_equal(measured.t_s, prepared.frame_t_imu[frames])
            np.testing.assert_array_equal(measured.position, prepared.position[frames, column])
            np.testing.assert_array_equal(window.t[measured.node], prepared.t[prepared.frame_node[frames]])
            assert np.abs(window.t[measured.node] - measured.t_s).max() <= 1.5 * GROUPED_S
            # less what the IMU saw in between, a sample is where the joint was at its node
            t, lever = window.t[measured.node], LEVERS[measured.joint]
            at_node = CURVE.position(t) + CURVE.rotation(t).apply(lever)
            np.testing.assert_allclose(measured.position - measured.shift, at_node, atol=2e-4)
        assert {measured.joint for measured in window.joint_measurements} == (
            set(LEVERS) if inside.any() else set()
        )
        # only intervals in a gap keep their velocity
        middle, dt = 0.5 * (window.t[1:] + window.t[:-1]), np.diff(window.t)
        in_gap = np.array([any(g.start_s < t < g.end_s for g in prepared.gaps) for t in middle])
        np.testing.assert_array_equal(np.isfinite(window.velocity_change), in_gap)
        expected = np.hypot(0.5, STILL_ACCELERATION) * np.sqrt(0.2 * dt[in_gap])
        np.testing.assert_allclose(window.velocity_change[in_gap], expected)


def test_the_core_the_shoulders_knots_and_the_attitude_prior() -> None:
    """At each window's best node, as many times as wide as there are windows, never wider than free."""
    prepared = replace(PREPARED, start_s=2.0, end_s=31.0)
    for (start_s, end_s), window in zip(SPANS, windows_of(prepared), strict=True):
        t, shoulder = window.t, window.shoulder
        assert (window.core_start_s, window.core_end_s) == (max(2.0, t[0]), min(31.0, t[-1]))
        knots = t[shoulder.node]
        assert (shoulder.node[0], shoulder.node[-1]) == (0, len(t) - 1)
        assert np.diff(knots)[:-1].min() >= KNOT_S
        at = 0.3 + 0.01 * knots
        np.testing.assert_allclose(shoulder.start[:, 1], at, atol=0.01 * KNOT_S)
        visible = np.isfinite(shoulder.position[:, 0])
        assert visible[:-1].all()  # the end of the segment has no frame of its own
        assert (shoulder.sigma_m[visible] <= 0.01 + 1e-12).all()  # a mean of one frame or more
        np.testing.assert_allclose(shoulder.position[visible, 1], at[visible], atol=0.01 * KNOT_S)
        rows = rows_of(PREPARED, (start_s, end_s))
        traces = np.trace(PREPARED.forearm.attitude_covariance[rows], axis1=1, axis2=2)
        best = int(np.argmin(traces))
        assert window.forearm.attitude_node == best
        np.testing.assert_array_equal(window.forearm.attitude, PREPARED.forearm.attitude[rows][best])
        expected = np.minimum(traces[best] / 3 * SHARING, FREE_RAD**2) * np.eye(3)
        np.testing.assert_allclose(window.forearm.attitude_covariance, expected, atol=1e-12)
    accepted = PREPARED.accepted.copy()
    accepted[:, SHOULDER] = False
    accepted[PREPARED.frame_t_imu < 15.0] = False
    _, first, *_, last = windows_of(replace(PREPARED, accepted=accepted))
    assert first.shoulder is None and first.joint_measurements == ()
    assert [measured.joint for measured in last.joint_measurements] == ["elbow", "wrist"]


@pytest.fixture(scope="module")
def made() -> SimulatedArm:
    gaps = {"occlusion_lengths_s": (8.0,), "occlusion_every_s": 16.0}
    return arm(4, imus="wrist,upper-arm", protocol="random", duration_s=22.0, **gaps)


def test_start_values_in_a_gap_come_from_the_chain(made: SimulatedArm) -> None:
    """Else from a cubic bridge over 8 s, against the inertial filter's heading."""
    truth, off, step_s = made.recording.truth, [], []
    for recording in (made.recording, made.recording.with_imu("upper_arm", None)):
        window = first_window(recording, made.calibration)
        hidden = np.flatnonzero(np.isfinite(window.velocity_change))
        true = interpolate(truth.t_s, truth.position, window.t[hidden])
        off.append(np.sqrt(np.mean(np.sum((window.forearm.start.p[hidden] - true) ** 2, axis=1))))
        step_s.append(np.diff(window.t)[hidden].max())
    assert off[0] < 0.04 < 0.10 < off[1]
    assert step_s[0] <= GAP_NODE_CHAIN_S + 1e-9 < step_s[1] <= GAP_NODE_S + 1e-9


@pytest.mark.parametrize("unseen", [False, True])
def test_parts_beside_a_pause(made: SimulatedArm, unseen: bool) -> None:
    """One in which the camera sees nothing of the upper arm is left out: its heading is open there."""
    upper, seen = made.recording.upper_imu, made.recording.arm
    paused = upper.select((upper.t_s < 12.0) | (upper.t_s > 15.0))
    recording = made.recording.with_imu("upper_arm", paused)
    if unseen:
        recording = replace(recording, arm=seen.hide(seen.t_s > 14.5, ("shoulder", "elbow")))
    window = first_window(recording, made.calibration)
    covered = np.zeros(len(window.t), dtype=bool)
    for run in window.further:
        covered[run.first : run.first + len(run.start.p)] = True
        assert len(run.increments.first) == len(run.start.p)
    before, after = (window.t > 0.1) & (window.t < 11.9), (window.t > 15.1) & (window.t < 21.8)
    assert not covered[(window.t > 12.1) & (window.t < 14.9)].any()
    assert covered[before].all() and (covered[after].all(), covered[after].any()) == (not unseen,) * 2
