"""A segment made ready to cut: its nodes and pauses, the node of each frame, initial values or none."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import arm

from smoother.array_types import BoolArray, FloatArray
from smoother.measurements.clock import Clock, constant_clock
from smoother.measurements.segment import Segment, split_into_segments
from smoother.measurements.timestamps import PAUSE_S, split_at_pauses
from smoother.measurements.visibility import Gap, enough_joints
from smoother.recording import JOINTS, ImuStream
from smoother.rotation import Rotation
from smoother.simulation import SimulatedArm
from smoother.window.nodes import CLOSEST_S, GAP_NODE_CHAIN_S, GAP_NODE_S, GROUPED_S, decimate, insert_nodes
from smoother.window.prepare import PreparedSegment, prepare, reach

SIGMA_M = np.full(len(JOINTS), 0.01)
MARGIN_S = 2.5
#: Shorter than the real one, so that a short recording reaches beyond it.
REACH_S = 10.0


@pytest.fixture(scope="module")
def made() -> SimulatedArm:
    return arm(2, protocol="random", duration_s=40.0, occlusion_lengths_s=(1.5, 2.0))


@pytest.fixture(scope="module")
def clock(made: SimulatedArm) -> Clock:
    return constant_clock(made.parameters["clock_offset_s"])


@pytest.fixture(scope="module")
def segment(made: SimulatedArm) -> Segment:
    (segment,) = split_into_segments(replace(made.recording, truth=None))
    return segment


@pytest.fixture(scope="module")
def prepared(made: SimulatedArm, segment: Segment, clock: Clock) -> PreparedSegment:
    return ready(segment, made, clock)


def ready(segment: Segment, made: SimulatedArm, clock: Clock) -> PreparedSegment:
    answer = prepare(segment, made.calibration, clock, SIGMA_M, MARGIN_S)
    return answer[0]


def hidden(segment: Segment, frames: BoolArray) -> Segment:
    """The segment without any joint in some frames."""
    return replace(segment, accepted=segment.accepted & ~frames[:, None])


def core(segment: Segment, start_s: float, end_s: float) -> Segment:
    return replace(segment, core_start_s=start_s, core_end_s=end_s)


def test_frames_are_on_the_imus_clock(segment: Segment, prepared: PreparedSegment, clock: Clock) -> None:
    t = segment.frame_t_camera + clock.offset[0]
    inside = (t >= segment.start_s) & (t <= segment.end_s)
    np.testing.assert_allclose(prepared.frame_t_imu, t[inside], atol=1e-12)
    np.testing.assert_array_equal(prepared.position, segment.position[inside])
    np.testing.assert_array_equal(prepared.accepted, segment.accepted[inside])
    assert (prepared.sigma_m == 0.01).all()


def test_every_frame_with_a_joint_has_a_node_near_it(prepared: PreparedSegment) -> None:
    with_node = prepared.frame_node >= 0
    apart = np.abs(prepared.t[prepared.frame_node] - prepared.frame_t_imu)[with_node]
    assert apart.max() <= 1.5 * GROUPED_S
    assert (np.diff(prepared.frame_node[with_node]) >= 0).all()
    np.testing.assert_array_equal(with_node, enough_joints(prepared.accepted, 1))
    # of a group one frame is the node itself
    nodes = np.unique(prepared.frame_node[with_node])
    exact = prepared.frame_node[with_node][apart < 1e-9]
    np.testing.assert_array_equal(np.unique(exact), nodes)


def test_frames_beside_a_gap_are_nodes_of_their_own(prepared: PreparedSegment) -> None:
    inner = [gap for gap in prepared.gaps if not (gap.open_start or gap.open_end)]
    assert len(inner) >= 2
    for gap in inner:
        assert np.abs(prepared.t - gap.start_s).min() < 1e-9
        assert np.abs(prepared.t - gap.end_s).min() < 1e-9
        between = (prepared.frame_t_imu > gap.start_s) & (prepared.frame_t_imu < gap.end_s)
        assert not enough_joints(prepared.accepted[between], 2).any()


def test_initial_values_are_near_the_truth(made: SimulatedArm, prepared: PreparedSegment) -> None:
    truth = made.recording.truth
    near = np.abs(prepared.t[:, None] - prepared.frame_t_imu[enough_joints(prepared.accepted, 2)]).min(axis=1)
    rows = np.flatnonzero((near < 0.02) & (prepared.t > truth.t_s[0]) & (prepared.t < truth.t_s[-1]))
    true = np.stack([np.interp(prepared.t[rows], truth.t_s, axis) for axis in truth.position.T], axis=1)
    assert np.median(np.linalg.norm(prepared.forearm.start.p[rows] - true, axis=1)) < 0.02
    nearest = np.searchsorted(truth.t_s, prepared.t[rows])
    R = Rotation.from_quat(truth.quaternion[nearest], scalar_first=True)
    off = (Rotation.from_matrix(prepared.forearm.start.R[rows]) * R.inv()).magnitude()
    assert np.degrees(np.median(off)) < 6.0
    np.testing.assert_array_equal(prepared.forearm.start.R, prepared.forearm.attitude)


def test_a_core_is_solved_with_its_margins(made: SimulatedArm, segment: Segment, clock: Clock) -> None:
    whole = ready(segment, made, clock)
    gap = next(gap for gap in whole.gaps if not (gap.open_start or gap.open_end))
    inside = ready(core(segment, gap.end_s + 3.0, gap.end_s + 5.0), made, clock)
    assert (inside.start_s, inside.end_s) == (gap.end_s + 3.0, gap.end_s + 5.0)
    assert inside.t[0] >= inside.start_s - MARGIN_S
    assert inside.t[-1] <= inside.end_s + MARGIN_S
    assert np.isin(inside.t, whole.t).all()
    in_gap = ready(core(segment, 0.5 * (gap.start_s + gap.end_s), gap.end_s + 5.0), made, clock)
    assert gap.start_s - MARGIN_S <= in_gap.t[0] <= gap.start_s - MARGIN_S + GAP_NODE_S


def test_reach_goes_beyond_a_gap_at_either_end() -> None:
    gaps = (Gap(10.0, 14.0), Gap(20.0, 30.0))
    assert reach(15.0, 18.0, gaps, 2.0) == (13.0, 20.0)
    assert reach(12.0, 18.0, gaps, 2.0) == (8.0, 20.0)
    assert reach(15.0, 21.0, gaps, 2.0) == (13.0, 32.0)
    assert reach(12.0, 28.0, gaps, 2.0) == (8.0, 32.0)
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
        assert found.start_s == found.t[0] == pytest.approx(shown[0] - REACH_S)
        assert found.gaps[0].open_start
    else:
        assert found.end_s == found.t[-1] == pytest.approx(shown[-1] + REACH_S)
        assert found.gaps[-1].open_end
    assert np.isfinite(found.forearm.start.p).all()
    # beyond the last visible frame the arm rests
    beyond = (found.t < shown[0]) | (found.t > shown[-1])
    assert beyond.sum() > REACH_S / GAP_NODE_S - 2
    assert not found.forearm.start.v[beyond].any()


def test_too_little_seen_is_no_segment(
    made: SimulatedArm, segment: Segment, clock: Clock, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("smoother.window.prepare.REACH_S", REACH_S)
    number = np.arange(len(segment.frame_t_camera))
    for shown in (0, 1):
        few = hidden(segment, (number < 300) | (number >= 300 + shown))
        assert prepare(few, made.calibration, clock, SIGMA_M, MARGIN_S) is None
    t = segment.frame_t_imu(clock)
    early = core(hidden(segment, t > 10.0), 10.0 + REACH_S, 40.0)
    assert prepare(early, made.calibration, clock, SIGMA_M, MARGIN_S) is None


#: Rounding of sums of steps: times are some tens of seconds.
EPS = 1e-9
steps = st.lists(st.floats(0.0, 3.0) | st.floats(0.0, 0.02), min_size=0, max_size=60)
starts = st.floats(-5.0, 60.0)


def stream(t: np.ndarray) -> ImuStream:
    return ImuStream("", t, np.zeros((len(t), 3)), np.zeros((len(t), 3)))


def times(start: float, gaps: list[float]) -> FloatArray:
    return start + np.concatenate(([0.0], np.cumsum(gaps)))


@given(starts, steps)
def test_thin_keeps_times_apart_and_no_fewer_than_needed(start: float, gaps: list[float]) -> None:
    t = times(start, gaps)
    keep = decimate(t)
    sparse = t[keep]
    assert keep[0]
    assert (np.diff(sparse) >= CLOSEST_S - EPS).all()
    for other in t[~keep]:  # only because another is just before it
        assert other - sparse[sparse <= other].max() < CLOSEST_S + EPS


@given(starts, steps, st.floats(0.1, 50.0), st.floats(0.0, 1.0))
def test_nodes_keep_the_given_times_and_are_the_fewest_between_them(
    start: float, gaps: list[float], length: float, shift: float
) -> None:
    """Evenly spaced between two given times, increasing and close enough."""
    t = times(start, gaps)
    t = t[decimate(t)]
    start_s = start + shift
    end_s = start_s + length
    nodes = insert_nodes(t, start_s, end_s)
    inner = t[(t > start_s + CLOSEST_S) & (t < end_s - CLOSEST_S)]
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
    """Runs of samples per second apart come back as they were made."""
    t, at = [], 0.0
    for n in lengths:
        t.append(at + np.arange(n) / rate)
        at = t[-1][-1] + 1.0
    joined = np.concatenate(t)
    if (np.diff(joined) > 0.5).sum() * 2 >= len(joined) - 1:
        return  # then the pause is the median spacing, and there is no rate to speak of
    segments = split_at_pauses(stream(joined))
    assert [joined[rows].tolist() for rows in segments] == [times.tolist() for times in t]


def test_a_lost_sample_or_four_are_no_pause() -> None:
    """Five sample periods are bridged where they are longer than a tenth of a second."""
    for rate in (20.0, 100.0, 285.0):
        t = np.arange(200) / rate
        lost = max(1, int(min(4.0, PAUSE_S * rate - 1.5)))
        keep = np.ones(200, dtype=bool)
        keep[100 : 100 + lost] = False
        assert len(split_at_pauses(stream(t[keep]))) == 1
