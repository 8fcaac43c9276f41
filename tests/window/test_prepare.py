"""A segment made ready to cut: its nodes, the node of each frame, initial values, and when there are none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scenes import arm

from smoother.array_types import BoolArray, FloatArray
from smoother.measurements.clock import Clock, constant_clock
from smoother.measurements.segment import Segment, split_into_segments
from smoother.measurements.visibility import Gap, enough_joints
from smoother.recording import JOINTS
from smoother.rotation import Rotation
from smoother.simulation import SimulatedArm
from smoother.window.nodes import CLOSEST_S, GAP_NODE_S, GROUPED_S
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
    (segment,) = split_into_segments(replace(made.recording, truth=None), 0.5)
    return segment


@pytest.fixture(scope="module")
def prepared(made: SimulatedArm, segment: Segment, clock: Clock) -> PreparedSegment:
    return ready(segment, made, clock)


def ready(segment: Segment, made: SimulatedArm, clock: Clock) -> PreparedSegment:
    answer = prepare(segment, made.calibration, clock, SIGMA_M, MARGIN_S)
    assert answer is not None
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


def test_nodes_fill_the_segment(segment: Segment, prepared: PreparedSegment) -> None:
    assert (prepared.t[0], prepared.t[-1]) == (segment.start_s, segment.end_s)
    assert np.diff(prepared.t).min() >= CLOSEST_S
    assert np.diff(prepared.t).max() <= GAP_NODE_S + 1e-9
    forearm = prepared.forearm
    for values in (forearm.attitude, forearm.attitude_covariance, prepared.acceleration_std):
        assert len(values) == len(prepared.t)


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
    assert truth is not None
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
    visible = t > 30.0 if side == "start" else t < 10.0
    one_sided = ready(hidden(segment, ~visible), made, clock)
    shown: FloatArray = one_sided.frame_t_imu[enough_joints(one_sided.accepted, 1)]
    if side == "start":
        assert one_sided.t[0] == pytest.approx(shown[0] - REACH_S)
        assert one_sided.gaps[0].open_start
        assert one_sided.start_s == one_sided.t[0]
    else:
        assert one_sided.t[-1] == pytest.approx(shown[-1] + REACH_S)
        assert one_sided.gaps[-1].open_end
        assert one_sided.end_s == one_sided.t[-1]
    assert np.isfinite(one_sided.forearm.start.p).all()
    # beyond the last visible frame the arm rests
    beyond = (one_sided.t < shown[0]) | (one_sided.t > shown[-1])
    assert beyond.sum() > REACH_S / GAP_NODE_S - 2
    assert not one_sided.forearm.start.v[beyond].any()


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


def test_a_given_alignment_is_used_as_it_is(made: SimulatedArm, segment: Segment, clock: Clock) -> None:
    answer = prepare(segment, made.calibration, clock, SIGMA_M, MARGIN_S)
    assert answer is not None
    turned = replace(answer[1], R_K_E=Rotation.from_rotvec([0.0, 0.3, 0.0]) * answer[1].R_K_E)
    again = prepare(segment, made.calibration, clock, SIGMA_M, MARGIN_S, turned)
    assert again is not None
    assert again[1] is turned
    off = (
        Rotation.from_matrix(again[0].forearm.attitude)
        * Rotation.from_matrix(answer[0].forearm.attitude).inv()
    )
    np.testing.assert_allclose(off.as_rotvec(), np.tile([0.0, 0.3, 0.0], (len(again[0].t), 1)), atol=1e-9)
