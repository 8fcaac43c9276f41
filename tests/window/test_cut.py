"""A window of a segment: its nodes and pauses, samples by node, start values, a further IMU's part."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import arm, first_window

from smoother.array_types import BoolArray, FloatArray, IntArray
from smoother.linalg import interpolate
from smoother.measurements.clock import Clock, constant_clock
from smoother.measurements.segment import Segment, split_into_segments
from smoother.measurements.timestamps import PAUSE_S, split_at_pauses
from smoother.measurements.visibility import Gap, enough_joints, occluded_at
from smoother.recording import FOREARM_JOINTS, JOINTS, ImuStream
from smoother.rotation import Rotation
from smoother.simulation import SimulatedArm
from smoother.window.cut import FREE_RAD, KNOT_S, STILL_ACCELERATION, window_between
from smoother.window.nodes import (
    CLOSEST_S,
    GAP_NODE_CHAIN_S,
    GAP_NODE_S,
    GROUPED_S,
    decimate,
    insert_nodes,
)
from smoother.window.prepare import PreparedSegment, prepare, reach
from smoother.window.problem import NoiseModel, Priors, States, Window
from smoother.window.shared import Gaussian, SharedLayout, axes_across

SIGMA_M = np.full(len(JOINTS), 0.01)
MARGIN_S = 2.5
#: Shorter than the real one, so that a short recording reaches beyond it.
REACH_S = 10.0


@pytest.fixture(scope="module")
def made() -> SimulatedArm:
    return arm(2, "clean", protocol="random", duration_s=40.0, occlusion_lengths_s=(1.5, 2.0))


@pytest.fixture(scope="module")
def clock(made: SimulatedArm) -> Clock:
    return constant_clock(made.parameters["clock_offset_s"])


@pytest.fixture(scope="module")
def segment(made: SimulatedArm) -> Segment:
    (segment,) = split_into_segments(replace(made.recording, truth=None))
    return segment


def ready(segment: Segment, made: SimulatedArm, clock: Clock) -> PreparedSegment:
    return prepare(segment, made.calibration, clock, SIGMA_M, MARGIN_S)[0]


def hidden(segment: Segment, frames: BoolArray) -> Segment:
    """The segment without any joint in some frames."""
    return replace(segment, accepted=segment.accepted & ~frames[:, None])


def test_nodes_frames_and_start_values(made: SimulatedArm, segment: Segment, clock: Clock) -> None:
    """Frames are on the IMU's clock, with a node near each; beside gaps they are nodes of their own."""
    found, t = ready(segment, made, clock), segment.frame_t_camera + clock.offset[0]
    inside = (t >= segment.start_s) & (t <= segment.end_s)
    np.testing.assert_allclose(found.frame_t_imu, t[inside], atol=1e-12)
    np.testing.assert_array_equal(found.position, segment.position[inside])
    np.testing.assert_array_equal(found.accepted, segment.accepted[inside])
    with_node = found.frame_node >= 0
    np.testing.assert_array_equal(with_node, enough_joints(found.accepted, 1))
    nodes, t = found.frame_node[with_node], found.frame_t_imu[with_node]
    apart = np.abs(found.t[nodes] - t)
    assert apart.max() <= 1.5 * GROUPED_S and (np.diff(nodes) >= 0).all()
    # of a group one frame is the node itself
    np.testing.assert_array_equal(np.unique(nodes[apart < 1e-9]), np.unique(nodes))
    inner = [gap for gap in found.gaps if not (gap.open_start or gap.open_end)]
    assert len(inner) >= 2
    for gap in inner:
        assert np.abs(found.t - gap.start_s).min() < 1e-9 and np.abs(found.t - gap.end_s).min() < 1e-9
        between = (found.frame_t_imu > gap.start_s) & (found.frame_t_imu < gap.end_s)
        assert not enough_joints(found.accepted[between], 2).any()
    truth, start = made.recording.truth, found.forearm.start
    near = np.abs(found.t[:, None] - found.frame_t_imu[enough_joints(found.accepted, 2)]).min(axis=1)
    rows = np.flatnonzero((near < 0.02) & (found.t > truth.t_s[0]) & (found.t < truth.t_s[-1]))
    true = interpolate(truth.t_s, truth.position, found.t[rows])
    assert np.median(np.linalg.norm(start.p[rows] - true, axis=1)) < 0.02
    R = Rotation.from_quat(truth.quaternion[np.searchsorted(truth.t_s, found.t[rows])], scalar_first=True)
    off = (Rotation.from_matrix(start.R[rows]) * R.inv()).magnitude()
    assert np.degrees(np.median(off)) < 6.0


def test_a_core_is_solved_with_its_margins(made: SimulatedArm, segment: Segment, clock: Clock) -> None:
    """Which go beyond a gap at either end."""
    whole = ready(segment, made, clock)
    gap = next(gap for gap in whole.gaps if not (gap.open_start or gap.open_end))
    a_s, b_s = gap.end_s + 3.0, gap.end_s + 5.0
    inside = ready(replace(segment, core_start_s=a_s, core_end_s=b_s), made, clock)
    assert (inside.start_s, inside.end_s) == (a_s, b_s) and np.isin(inside.t, whole.t).all()
    assert inside.t[0] >= a_s - MARGIN_S and inside.t[-1] <= b_s + MARGIN_S
    gaps = (Gap(10.0, 14.0), Gap(20.0, 30.0))
    for start_s, end_s, expected in (
        (15.0, 18.0, (13.0, 20.0)),
        (12.0, 18.0, (8.0, 20.0)),
        (15.0, 21.0, (13.0, 32.0)),
        (12.0, 28.0, (8.0, 32.0)),
    ):
        assert reach(start_s, end_s, gaps, 2.0) == expected
    assert reach(15.0, 18.0, (), 2.0) == (13.0, 20.0)


@pytest.mark.parametrize("side", ["start", "end"])
def test_far_from_any_visible_frame_there_are_no_nodes(
    made: SimulatedArm, segment: Segment, clock: Clock, side: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("smoother.window.prepare.REACH_S", REACH_S)
    t = segment.frame_t_imu(clock)
    found = ready(hidden(segment, ~(t > 30.0 if side == "start" else t < 10.0)), made, clock)
    shown: FloatArray = found.frame_t_imu[enough_joints(found.accepted, 1)]
    if side == "start":
        assert found.start_s == found.t[0] == pytest.approx(shown[0] - REACH_S) and found.gaps[0].open_start
    else:
        assert found.end_s == found.t[-1] == pytest.approx(shown[-1] + REACH_S) and found.gaps[-1].open_end
    assert np.isfinite(found.forearm.start.p).all()
    # beyond the last visible frame the arm rests
    beyond = (found.t < shown[0]) | (found.t > shown[-1])
    assert beyond.sum() > REACH_S / GAP_NODE_S - 2 and not found.forearm.start.v[beyond].any()
    # too little seen is no segment
    number = np.arange(len(segment.frame_t_camera))
    for few in (
        hidden(segment, number != 300),
        hidden(segment, number >= 0),
        replace(hidden(segment, t > 10.0), core_start_s=10.0 + REACH_S, core_end_s=40.0),
    ):
        assert prepare(few, made.calibration, clock, SIGMA_M, MARGIN_S) is None


#: Rounding of sums of steps: times are some tens of seconds.
EPS = 1e-9


@given(
    st.floats(-5.0, 60.0),
    st.lists(st.floats(0.0, 3.0) | st.floats(0.0, 0.02), min_size=0, max_size=60),
    st.floats(0.1, 50.0),
    st.floats(0.0, 1.0),
)
def test_nodes_keep_the_given_times_and_are_the_fewest_between_them(
    start: float, gaps: list[float], length: float, shift: float
) -> None:
    """Of the given times those that are apart; between two of them evenly spaced and close enough."""
    t = start + np.concatenate(([0.0], np.cumsum(gaps)))
    keep = decimate(t)
    sparse = t[keep]
    assert keep[0] and (np.diff(sparse) >= CLOSEST_S - EPS).all()
    for other in t[~keep]:  # only because another is just before it
        assert other - sparse[sparse <= other].max() < CLOSEST_S + EPS
    start_s, end_s = start + shift, start + shift + length
    nodes = insert_nodes(sparse, start_s, end_s)
    inner = sparse[(sparse > start_s + CLOSEST_S) & (sparse < end_s - CLOSEST_S)]
    knots = np.concatenate(([start_s], inner, [end_s]))
    assert np.isin(knots, nodes).all() and (nodes[0], nodes[-1]) == (start_s, end_s)
    # an interval is cut into parts longer than half of the limit; given times are CLOSEST_S apart
    assert np.diff(nodes).min() >= CLOSEST_S - EPS and np.diff(nodes).max() <= GAP_NODE_S + EPS
    for a, b in itertools.pairwise(knots):
        inside = nodes[(nodes >= a) & (nodes <= b)]
        assert len(inside) - 1 == max(1, int(np.ceil((b - a) / GAP_NODE_S - 1e-9)))
        np.testing.assert_allclose(np.diff(inside), (b - a) / (len(inside) - 1), atol=EPS)


def test_nodes_are_closer_in_gaps_only() -> None:
    """Where the camera sees both segments of a chain, it ties them; in gaps their joint does, at nodes."""
    t = np.concatenate((np.arange(0.0, 3.0, 0.25), np.arange(6.0, 9.0, 0.25)))
    nodes = insert_nodes(t, 0.0, 9.0, gaps=[Gap(2.75, 6.0)])
    in_gap = (nodes >= 2.75) & (nodes <= 6.0)
    assert np.diff(nodes[in_gap]).max() <= GAP_NODE_CHAIN_S + EPS
    np.testing.assert_allclose(np.diff(nodes[~in_gap & (nodes < 2.75)]), 0.25)
    np.testing.assert_array_equal(nodes[nodes > 6.0], [*t[t > 6.0], 9.0])


@given(st.lists(st.integers(2, 30), min_size=1, max_size=5), st.sampled_from([20.0, 40.0, 100.0, 285.0]))
@settings(max_examples=50)
def test_pauses_split_the_stream(lengths: list[int], rate: float) -> None:
    """Runs of samples per second apart come back as they were made; a lost sample or four are no pause."""
    t, at = [], 0.0
    for n in lengths:
        t.append(at + np.arange(n) / rate)
        at = t[-1][-1] + 1.0
    keep = np.ones(200, dtype=bool)
    keep[100 : 100 + max(1, int(min(4.0, PAUSE_S * rate - 1.5)))] = False
    joined, bridged = np.concatenate(t), np.arange(200)[keep] / rate
    # else the pause is the median spacing, and there is no rate to speak of
    spoken = (np.diff(joined) > 0.5).sum() * 2 < len(joined) - 1
    for times, expected in ((joined, t), (bridged, [bridged])):
        zeros = np.zeros((len(times), 3))
        parts = split_at_pauses(ImuStream("", times, zeros, zeros))
        found = [times[rows].tolist() for rows in parts]
        assert found == [each.tolist() for each in expected] or (times is joined and not spoken)


SHOULDER = JOINTS.index("shoulder")
#: So many windows share the attitude prior.
SHARING = 3
NOISE = NoiseModel(0.01, 0.0015, 0.006, 0.002, 2.8, 0.005, 0.1)
#: Where windows begin and end: all of the segment, and parts of it.
SPANS = [(-np.inf, np.inf), (0.5, 10.0), (7.0, 18.0), (15.0, 26.0), (23.0, 34.0), (31.0, 40.0)]


@pytest.fixture(scope="module")
def prepared(made: SimulatedArm, segment: Segment, clock: Clock) -> PreparedSegment:
    """With true start values, a shoulder that moves evenly, an attitude that is known differently well."""
    found = ready(segment, made, clock)
    n, position, accepted = len(found.t), found.position.copy(), found.accepted.copy()
    (R, p), (_, before), (_, after) = (made.motion.imu_pose(found.t + h) for h in (0.0, -1e-4, 1e-4))
    covariance = np.eye(3) * (0.1 + 0.2 * np.random.default_rng(0).uniform(size=n)[:, None, None])
    start = States(R, p, (after - before) / 2e-4)
    forearm = replace(found.forearm, start=start, attitude=R, attitude_covariance=covariance)
    position[:, SHOULDER] = np.array([0.0, 0.3, 2.0]) + 0.01 * found.frame_t_imu[:, None]
    accepted[:, SHOULDER] = True
    even = {"acceleration_std": np.full(n, 0.5), "still": np.arange(n) % 2 == 0}
    return replace(found, bodies=(forearm,), position=position, accepted=accepted, **even)


def windows_of(prepared: PreparedSegment, made: SimulatedArm) -> list[Window]:
    down, levers = made.parameters["gravity"], made.calibration.lever_arms
    layout = SharedLayout(FOREARM_JOINTS[:3], True, axes_across(down / np.linalg.norm(down)))
    mean = np.zeros(layout.size)
    for joint in layout.joints:
        mean[layout.lever(joint)] = levers[joint].position_m
    priors = Priors(layout, Gaussian(mean, np.eye(layout.size)), np.ones(6))
    return [window_between(prepared, priors, NOISE, SHARING, *span) for span in SPANS]


def rows_of(prepared: PreparedSegment, span: tuple[float, float]) -> IntArray:
    return np.flatnonzero((prepared.t >= span[0]) & (prepared.t <= span[1]))


def test_measurements_belong_to_their_nodes(prepared: PreparedSegment, made: SimulatedArm) -> None:
    for span, window in zip(SPANS, windows_of(prepared, made), strict=True):
        rows = rows_of(prepared, span)
        np.testing.assert_array_equal(window.t, prepared.t[rows])
        np.testing.assert_array_equal(window.forearm.start.p, prepared.forearm.start.p[rows])
        inside = np.isin(prepared.frame_node, rows)
        assert [measured.joint for measured in window.joint_measurements] == [*FOREARM_JOINTS[:3]]
        for measured in window.joint_measurements:
            column = JOINTS.index(measured.joint)
            frames = np.flatnonzero(inside & prepared.accepted[:, column])
            np.testing.assert_array_equal(measured.t_s, prepared.frame_t_imu[frames])
            np.testing.assert_array_equal(measured.position, prepared.position[frames, column])
            t = window.t[measured.node]
            np.testing.assert_array_equal(t, prepared.t[prepared.frame_node[frames]])
            assert np.abs(t - measured.t_s).max() <= 1.5 * GROUPED_S
            # less what the IMU saw in between, a sample is where the joint was at its node
            at_node = made.motion.joints(t)[measured.joint]
            np.testing.assert_allclose(measured.position - measured.shift, at_node, atol=1e-3)
        # only intervals in a gap keep their velocity
        middle, dt = 0.5 * (window.t[1:] + window.t[:-1]), np.diff(window.t)
        in_gap, hidden = (occluded_at(t, prepared.gaps) for t in (middle, window.t))
        np.testing.assert_array_equal(np.isfinite(window.velocity_change), in_gap)
        at_rest = np.isin(window.t, prepared.t[prepared.still])
        assert window.still.tolist() == np.flatnonzero(hidden & at_rest).tolist()
        expected = np.hypot(0.5, STILL_ACCELERATION) * np.sqrt(0.2 * dt[in_gap])
        np.testing.assert_allclose(window.velocity_change[in_gap], expected)


def test_the_core_the_shoulders_knots_and_the_attitude_prior(
    prepared: PreparedSegment, made: SimulatedArm
) -> None:
    """At each window's best node, as many times as wide as there are windows, never wider than free."""
    prepared = replace(prepared, start_s=2.0, end_s=31.0)
    for (start_s, end_s), window in zip(SPANS, windows_of(prepared, made), strict=True):
        t, shoulder = window.t, window.shoulder
        assert (window.core_start_s, window.core_end_s) == (max(2.0, t[0]), min(31.0, t[-1]))
        knots = t[shoulder.node]
        assert (shoulder.node[0], shoulder.node[-1]) == (0, len(t) - 1)
        assert np.diff(knots)[:-1].min() >= KNOT_S
        at = 0.3 + 0.01 * knots
        np.testing.assert_allclose(shoulder.start[:, 1], at, atol=0.01 * KNOT_S)
        visible = np.isfinite(shoulder.position[:, 0])
        assert visible[1:-1].mean() > 0.9  # in gaps nodes have no frame of their own
        assert (shoulder.sigma_m[visible] <= 0.01 + 1e-12).all()  # a mean of one frame or more
        np.testing.assert_allclose(shoulder.position[visible, 1], at[visible], atol=0.01 * KNOT_S)
        rows, forearm = rows_of(prepared, (start_s, end_s)), prepared.forearm
        traces = np.trace(forearm.attitude_covariance[rows], axis1=1, axis2=2)
        best = int(np.argmin(traces))
        assert window.forearm.attitude_node == best
        np.testing.assert_array_equal(window.forearm.attitude, forearm.attitude[rows][best])
        expected = np.minimum(traces[best] / 3 * SHARING, FREE_RAD**2) * np.eye(3)
        np.testing.assert_allclose(window.forearm.attitude_covariance, expected, atol=1e-12)
    accepted = prepared.accepted.copy()
    accepted[:, SHOULDER] = False
    accepted[prepared.frame_t_imu < 15.0] = False
    _, first, *_, last = windows_of(replace(prepared, accepted=accepted), made)
    assert first.shoulder is None and first.joint_measurements == ()
    assert [measured.joint for measured in last.joint_measurements] == [*FOREARM_JOINTS[:3]]


@pytest.fixture(scope="module")
def chain() -> SimulatedArm:
    gaps = {"occlusion_lengths_s": (8.0,), "occlusion_every_s": 16.0}
    return arm(4, imus="wrist,upper-arm", protocol="random", duration_s=22.0, **gaps)


def test_start_values_in_a_gap_come_from_the_chain(chain: SimulatedArm) -> None:
    """Else from a cubic bridge over 8 s, against the inertial filter's heading."""
    truth, off, step_s = chain.recording.truth, [], []
    for recording in (chain.recording, chain.recording.with_imu("upper_arm", None)):
        window = first_window(recording, chain.calibration)
        hidden = np.flatnonzero(np.isfinite(window.velocity_change))
        true = interpolate(truth.t_s, truth.position, window.t[hidden])
        off.append(np.sqrt(np.mean(np.sum((window.forearm.start.p[hidden] - true) ** 2, axis=1))))
        step_s.append(np.diff(window.t)[hidden].max())
    assert off[0] < 0.04 < 0.10 < off[1]
    assert step_s[0] <= GAP_NODE_CHAIN_S + 1e-9 < step_s[1] <= GAP_NODE_S + 1e-9


@pytest.mark.parametrize("unseen", [False, True])
def test_parts_beside_a_pause(chain: SimulatedArm, unseen: bool) -> None:
    """One in which the camera sees nothing of the upper arm is left out: its heading is open there."""
    upper, seen = chain.recording.upper_imu, chain.recording.arm
    paused = upper.select((upper.t_s < 12.0) | (upper.t_s > 15.0))
    recording = chain.recording.with_imu("upper_arm", paused)
    if unseen:
        recording = replace(recording, arm=seen.hide(seen.t_s > 14.5, ("shoulder", "elbow")))
    window = first_window(recording, chain.calibration)
    covered = np.zeros(len(window.t), dtype=bool)
    for run in window.further:
        covered[run.first : run.first + len(run.start.p)] = True
        assert len(run.increments.first) == len(run.start.p)
    before, after = (window.t > 0.1) & (window.t < 11.9), (window.t > 15.1) & (window.t < 21.8)
    assert not covered[(window.t > 12.1) & (window.t < 14.9)].any()
    assert covered[before].all() and (covered[after].all(), covered[after].any()) == (not unseen,) * 2
