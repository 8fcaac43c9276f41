"""A segment cut into windows: borders, nodes, and what a window is given of an upper-arm IMU."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest
from curve import Curve, G, angle_rad
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import ALONE, arm
from scipy.spatial.transform import Rotation

import smoother.recovery.first_pass
from smoother.array_types import FloatArray
from smoother.body import FOREARM
from smoother.linalg import interpolate
from smoother.measurements.inertial import STEP_S, InertialSignal
from smoother.measurements.visibility import Gap
from smoother.recording import JOINTS, ImuStream, Recording
from smoother.simulation import SimulatedArm
from smoother.smoothing import smooth
from smoother.window.cut import FREE_RAD, KEEP_S, KNOT_S, STILL_ACCELERATION, cut, cut_times, window_nodes
from smoother.window.nodes import GAP_NODE_CHAIN_S, GAP_NODE_S, GROUPED_S, group_frames, insert_nodes
from smoother.window.prepare import PreparedRun, PreparedSegment
from smoother.window.problem import NoiseModel, Priors, States, Window
from smoother.window.shared import Gaussian, SharedLayout, axes_across
from smoother.window.solution import Solution

SHOULDER = JOINTS.index("shoulder")
LEVERS = {"elbow": np.array([0.0, -0.2, 0.02]), "wrist": np.array([0.01, 0.05, -0.01])}
MARGIN_S = 1.5
NOISE = NoiseModel(0.01, 0.0015, 0.006, 0.002, 2.8, 0.005, 0.1)
CURVE = Curve(5)
SIGNAL = InertialSignal(CURVE.imu(100.0, 41.0))
END_S = 40.0

#: Gaps that follow each other: seconds of visible time, seconds of gap.
gap_lengths = st.lists(st.tuples(st.floats(0.3, 12.0), st.floats(0.2, 8.0)), max_size=6)
lengths = st.floats(1.0, 15.0)


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


def windows_of(prepared: PreparedSegment, borders: list[float]) -> list[Window]:
    count = len(borders) - 1
    return list(cut(prepared, [priors()] * count, NOISE, borders, MARGIN_S, G, count))


@given(gap_lengths, lengths)
def test_borders_lie_in_visible_time(steps: list[tuple[float, float]], length_s: float) -> None:
    gaps = gaps_of(steps)
    prepared = replace(PREPARED, gaps=gaps)
    borders = cut_times(prepared, length_s)
    assert (borders[0], borders[-1]) == (0.5, END_S)
    assert (np.diff(borders) > 0).all()
    ends = [0.5, *(end for gap in gaps for end in (gap.start_s, gap.end_s)), END_S]
    visible = list(zip(ends[::2], ends[1::2], strict=True))
    for border in borders[1:-1]:
        ((a, b),) = [(a, b) for a, b in visible if a <= border <= b]
        away = min(KEEP_S, 0.5 * (b - a)) - 1e-9
        assert border - a >= away
        assert b - border >= away


def test_no_border_behind_a_gap_that_reaches_the_end() -> None:
    """A window of the gap's last moment alone would hold no sample of the camera."""
    gaps = (Gap(3.0, 4.0), Gap(15.0, END_S, open_end=True))
    borders = cut_times(replace(PREPARED, gaps=gaps), 8.0)
    assert borders[-1] == END_S and (np.diff(borders) > 0).all()
    assert borders[-2] < 15.0


@given(gap_lengths, lengths)
def test_windows_are_as_long_as_the_gaps_allow(steps: list[tuple[float, float]], length_s: float) -> None:
    gaps = gaps_of(steps)
    borders = cut_times(replace(PREPARED, gaps=gaps), length_s)
    inner = list(pairwise(borders))[:-1]
    for a, b in inner:
        assert b - a >= 0.5 * length_s - 1e-9
        if b - a > length_s + 1e-9:  # then what was aimed at is in a gap, or too near to one or to the start
            near = any(gap.start_s - KEEP_S < a + length_s < gap.end_s + KEEP_S for gap in gaps)
            assert near or a + length_s < 0.5 + KEEP_S
    if not gaps:
        assert END_S - borders[-2] <= max(1.5 * length_s, KEEP_S + 0.5 * length_s) + 1e-9


def test_only_the_wanted_time_is_cut() -> None:
    prepared = replace(PREPARED, start_s=12.0, end_s=31.0)
    borders = cut_times(prepared, 6.0)
    np.testing.assert_allclose(borders, [12.0, 18.0, 24.0, 31.0])


@given(gap_lengths, lengths, st.floats(0.0, 4.0))
@settings(max_examples=50, deadline=None)
def test_windows_cover_the_segment(
    steps: list[tuple[float, float]], length_s: float, margin_s: float
) -> None:
    borders = cut_times(replace(PREPARED, gaps=gaps_of(steps)), length_s)
    t = PREPARED.t
    covered = np.zeros(len(t), dtype=int)
    for index, (a, b) in enumerate(pairwise(borders)):
        rows = window_nodes(t, borders, index, margin_s)
        covered[rows] += 1
        core = (t >= a) & (t <= b)
        assert core[rows].sum() == core.sum()  # its own time with all its nodes
        beyond = (t[rows] < a - margin_s - 1e-9) | (t[rows] > b + margin_s + 1e-9)
        assert not beyond.any() or index in (0, len(borders) - 2)
    assert (covered >= 1).all()
    assert covered.max() <= 1 + 2 * np.ceil((margin_s + 0.3) / (0.3 * length_s))


@given(gap_lengths, lengths)
@settings(max_examples=15, deadline=None)
def test_measurements_belong_to_their_nodes(steps: list[tuple[float, float]], length_s: float) -> None:
    prepared = prepared_of(gaps_of(steps))
    borders = cut_times(prepared, length_s)
    windows = windows_of(prepared, borders)
    assert [(w.core_start_s, w.core_end_s) for w in windows] == list(pairwise(borders))
    assert [w.index for w in windows] == list(range(len(windows)))
    for index, window in enumerate(windows):
        rows = window_nodes(prepared.t, borders, index, MARGIN_S)
        np.testing.assert_array_equal(window.t, prepared.t[rows])
        np.testing.assert_array_equal(window.forearm.start.p, prepared.forearm.start.p[rows])
        inside = (prepared.frame_node >= rows.start) & (prepared.frame_node < rows.stop)
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


@given(gap_lengths, lengths)
@settings(max_examples=15, deadline=None)
def test_only_intervals_in_a_gap_keep_their_velocity(
    steps: list[tuple[float, float]], length_s: float
) -> None:
    prepared = prepared_of(gaps_of(steps))
    for window in windows_of(prepared, cut_times(prepared, length_s)):
        middle, dt = 0.5 * (window.t[1:] + window.t[:-1]), np.diff(window.t)
        in_gap = np.array([any(g.start_s < t < g.end_s for g in prepared.gaps) for t in middle])
        np.testing.assert_array_equal(np.isfinite(window.velocity_change), in_gap)
        expected = np.hypot(0.5, STILL_ACCELERATION) * np.sqrt(0.2 * dt[in_gap])
        np.testing.assert_allclose(window.velocity_change[in_gap], expected)


@pytest.fixture(scope="module")
def windows() -> list[Window]:
    return windows_of(PREPARED, cut_times(PREPARED, 8.0))


def integrated(window: Window, interval: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(R, v, p) of an interval from its equivalent samples, by GTSAM's simple steps."""
    R, v, p, increments = np.eye(3), np.zeros(3), np.zeros(3), window.forearm.increments
    for step in range(increments.first[interval], increments.first[interval + 1]):
        h = increments.h[step]
        for acc in increments.acc[step]:
            a = R @ acc
            p, v = p + v * h + 0.5 * a * h**2, v + a * h
            R = R @ Rotation.from_rotvec(increments.gyro[step] * h).as_matrix()
    return R, v, p


def test_increments_are_those_of_their_intervals(windows: list[Window]) -> None:
    """Against the motion in closed form; 100 Hz samples of 8 m/s^2."""
    for window in windows:
        increments, dt = window.forearm.increments, np.diff(window.t)
        assert len(increments.first) == len(window.t)
        total = np.add.reduceat(2 * increments.h, increments.first[:-1])
        np.testing.assert_allclose(total, dt, atol=1e-12)
        assert 2 * increments.h.max() <= STEP_S + 1e-9
        delta_R, delta_v, delta_p = CURVE.increments(window.t)
        for interval in range(0, len(dt), 7):
            R, v, p = integrated(window, interval)
            assert angle_rad(R, delta_R[interval]) < 1e-4
            np.testing.assert_allclose(v, delta_v[interval], atol=2e-4)
            np.testing.assert_allclose(p, delta_p[interval], atol=5e-5)


def test_the_shoulders_knots(windows: list[Window]) -> None:
    for window in windows:
        shoulder = window.shoulder
        knots = window.t[shoulder.node]
        assert (shoulder.node[0], shoulder.node[-1]) == (0, len(window.t) - 1)
        assert np.diff(knots)[:-1].min() >= KNOT_S
        np.testing.assert_allclose(shoulder.start[:, 1] - 0.3, 0.01 * knots, atol=0.01 * KNOT_S)
        visible = np.isfinite(shoulder.position[:, 0])
        assert visible[:-1].all()  # the end of the segment has no frame of its own
        assert (shoulder.sigma_m[visible] <= 0.01 + 1e-12).all()  # a mean of one frame or more
        np.testing.assert_allclose(
            shoulder.position[visible, 1] - 0.3, 0.01 * knots[visible], atol=0.01 * KNOT_S
        )


def test_the_attitude_prior_is_shared(windows: list[Window]) -> None:
    """At each window's best node, as many times as wide as there are windows, never wider than free."""
    count = len(windows)
    for index, window in enumerate(windows):
        rows = window_nodes(PREPARED.t, [w.core_start_s for w in windows] + [END_S], index, MARGIN_S)
        traces = np.trace(PREPARED.forearm.attitude_covariance[rows], axis1=1, axis2=2)
        best = int(np.argmin(traces))
        assert window.forearm.attitude_node == best
        np.testing.assert_array_equal(window.forearm.attitude, PREPARED.forearm.attitude[rows][best])
        expected = np.minimum(traces[best] / 3 * count, FREE_RAD**2) * np.eye(3)
        np.testing.assert_allclose(window.forearm.attitude_covariance, expected, atol=1e-12)


def test_without_a_shoulder_or_a_sample() -> None:
    accepted = PREPARED.accepted.copy()
    accepted[:, SHOULDER] = False
    accepted[PREPARED.frame_t_imu < 15.0] = False
    borders = cut_times(PREPARED, 8.0)
    first, *_, last = windows_of(replace(PREPARED, accepted=accepted), borders)
    assert first.shoulder is None
    assert first.joint_measurements == ()
    assert [measured.joint for measured in last.joint_measurements] == ["elbow", "wrist"]


@pytest.fixture(scope="module")
def made() -> SimulatedArm:
    return arm(
        4,
        imus="wrist,upper-arm",
        protocol="random",
        duration_s=22.0,
        occlusion_lengths_s=(8.0,),
        occlusion_every_s=16.0,
    )


class FirstPassDone(Exception):
    """What comes after it is of no interest here."""


def first_pass(made: SimulatedArm, recording: Recording) -> list[Window]:
    """Windows whose start values come from the camera: those of the first pass, listened for."""
    windows: list[Window] = []
    solve = smoother.recovery.first_pass.solve

    def listen(window: Window, with_covariance: bool, **more: Any) -> Solution:
        windows.append(window)
        return solve(window, with_covariance, **more)

    with (
        patch("smoother.recovery.first_pass.solve", listen),
        patch("smoother.smoothing.second_pass", side_effect=FirstPassDone),
        pytest.raises(FirstPassDone),
    ):
        smooth(replace(recording, truth=None), made.calibration, ALONE)
    return windows


def off_in_gap(made: SimulatedArm, windows: list[Window]) -> tuple[float, float]:
    """Rms error of the start values inside gaps, m, and the longest interval there, s."""
    truth = made.recording.truth
    squares, steps = [], []
    for window in windows:
        hidden = np.flatnonzero(np.isfinite(window.velocity_change))
        off = window.forearm.start.p[hidden] - interpolate(truth.t_s, truth.position, window.t[hidden])
        squares.append(np.sum(off**2, axis=1))
        steps.append(np.diff(window.t)[hidden])
    return float(np.sqrt(np.mean(np.concatenate(squares)))), float(np.concatenate(steps).max())


def test_start_values_in_a_gap_come_from_the_chain(made: SimulatedArm) -> None:
    with_two, step_two = off_in_gap(made, first_pass(made, made.recording))
    with_one, step_one = off_in_gap(made, first_pass(made, made.recording.with_imu("upper_arm", None)))
    assert with_two < 0.04 < 0.10 < with_one  # a cubic bridge over 8 s against the inertial filter's heading
    assert step_two <= GAP_NODE_CHAIN_S + 1e-9 < step_one <= GAP_NODE_S + 1e-9


def test_parts_beside_a_pause(made: SimulatedArm) -> None:
    upper = made.recording.upper_imu
    assert isinstance(upper, ImuStream)
    paused = upper.select((upper.t_s < 12.0) | (upper.t_s > 15.0))
    windows = first_pass(made, made.recording.with_imu("upper_arm", paused))
    for window in windows:
        covered = np.zeros(len(window.t), dtype=bool)
        for run in window.further:
            covered[run.first : run.first + len(run.start.p)] = True
            assert len(run.increments.first) == len(run.start.p)
        inside = (window.t > 12.1) & (window.t < 14.9)
        outside = (window.t > 0.1) & ((window.t < 11.9) | (window.t > 15.1)) & (window.t < 21.8)
        assert not covered[inside].any() and covered[outside].all()


def test_a_part_without_the_camera_is_left_out(made: SimulatedArm) -> None:
    """After a pause, and nothing seen of the upper arm to the end: its heading is open there."""
    upper = made.recording.upper_imu
    t = made.recording.arm.t_s
    recording = replace(
        made.recording,
        further_imus={"upper_arm": upper.select((upper.t_s < 12.0) | (upper.t_s > 18.0))},
        arm=made.recording.arm.hide(t > 17.5, ("shoulder", "elbow")),
    )
    windows = first_pass(made, recording)
    starts = [window.t[run.first] for window in windows for run in window.further]
    assert starts and max(starts) < 12.0
