"""Excerpts: what of a recording the self-calibration reads, in which round, and that it reads no more."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from made_segments import forearm
from scenes import moving

from smoother.calibration import ArmCalibration, LeverArm
from smoother.config import Config
from smoother.errors import CalibrationError
from smoother.measurements.clock import constant_clock
from smoother.measurements.segment import Segment, Timeline, split_into_segments
from smoother.recording import FOREARM_JOINTS, Recording
from smoother.runtime.pool import Pool
from smoother.selfcal import rounds
from smoother.selfcal.error_estimate import JointBias
from smoother.selfcal.excerpts import (
    CONTEXT_S,
    EXCERPT_S,
    EXCERPTS_S,
    WANTED,
    choose_excerpts,
    informative_excerpts,
    spread_excerpts,
)

IMU_HZ, FRAME_HZ = 50.0, 25.0
Times = Sequence[tuple[float, float]]


def within(t: np.ndarray, times: Times) -> np.ndarray:
    return np.any([(t >= a) & (t < b) for a, b in times], axis=0) if times else np.zeros(len(t), bool)


def recording(
    length_s: float, visible: Times | None = None, moving: Times | None = None, pauses: Times = ()
) -> Recording:
    """A forearm that turns at 1 rad/s and is seen, everywhere or at some times only; the IMU may pause."""
    everywhere = [(-1.0, length_s + 1.0)]
    t = np.arange(0.0, length_s, 1 / IMU_HZ)
    t = t[~within(t, pauses)]
    frame_t = np.arange(0.003, length_s, 1 / FRAME_HZ)
    gyro = np.zeros((len(t), 3))
    gyro[within(t, everywhere if moving is None else moving), 2] = 1.0
    seen = within(frame_t, everywhere if visible is None else visible)[:, None]
    joints = {
        joint: np.where(seen, [0.1 * place, 0.0, 2.0], np.nan) for place, joint in enumerate(FOREARM_JOINTS)
    }
    return Recording.from_arrays(t, np.tile([0.0, 9.81, 0.0], (len(t), 1)), gyro, frame_t, joints)


def spans(segments: list[Segment]) -> Times:
    return [(segment.start_s, segment.end_s) for segment in segments]


def test_what_moves_in_sight_is_chosen() -> None:
    """Of each minute of four, one third moves in sight; the others move hidden or rest in sight."""
    best = [(20.0, 40.0), (60.0, 80.0), (160.0, 180.0), (200.0, 220.0)]
    hidden = [(0.0, 20.0), (80.0, 100.0), (140.0, 160.0), (220.0, 240.0)]
    visible = [(a, b) for a, b in pairwise(np.arange(0.0, 241.0, 20.0)) if (a, b) not in hidden]
    made = recording(240.0, visible=visible, moving=[*best, *hidden])
    excerpts = spread_excerpts(made, Timeline.of(made), WANTED, CONTEXT_S)
    # excerpts divide the time between the first and the last sample evenly: a sample's time of 20 s
    np.testing.assert_allclose([(each.start_s, each.end_s) for each in excerpts], best, atol=0.03)
    np.testing.assert_allclose(spans(informative_excerpts(made, Timeline.of(made))), best, atol=0.03)


def test_only_the_excerpts_of_a_long_recording_are_read() -> None:
    """Ten minutes: four excerpts of 20 s with 12 s around them; all else may be anything."""
    made = recording(600.0)
    expected = informative_excerpts(made, Timeline.of(made))
    assert len(expected) == WANTED
    kept = [(a - CONTEXT_S - 0.1, b + CONTEXT_S + 0.1) for a, b in spans(expected)]
    acc, position = made.imu.acc.copy(), made.arm.position.copy()
    acc[~within(made.imu.t_s, kept)], position[~within(made.arm.t_s, kept)] = np.inf, np.inf
    partly = replace(made, imu=replace(made.imu, acc=acc), arm=replace(made.arm, position=position))
    actual = informative_excerpts(partly, Timeline.of(partly))
    assert spans(actual) == spans(expected)
    for a, b in zip(actual, expected, strict=True):
        np.testing.assert_array_equal(a.position, b.position)
        edges = np.linspace(a.start_s, a.end_s, 50)
        np.testing.assert_array_equal(
            a.signal.mean(edges[:-1], edges[1:]), b.signal.mean(edges[:-1], edges[1:])
        )


def test_all_of_a_short_recording() -> None:
    made = recording(1.5 * EXCERPTS_S, pauses=[(50.0, 51.0)])
    expected = split_into_segments(made)
    actual = informative_excerpts(made, Timeline.of(made))
    assert spans(actual) == spans(expected)
    assert len(actual) == 2
    for a, b in zip(actual, expected, strict=True):
        np.testing.assert_array_equal(a.frame_t_camera, b.frame_t_camera)
        np.testing.assert_array_equal(a.accepted, b.accepted)


def segments_of(count: int, length_s: float) -> Iterator[Segment]:
    """Segments of equal length, turning at 1 rad/s, the forearm accepted in the middle third."""
    segment = forearm(int(30 * length_s), rate=np.array([0.0, 0.0, 1.0]))
    t = segment.frame_t_camera
    seen = (t > length_s / 3) & (t < 2 * length_s / 3)
    for number in range(count):
        yield replace(segment, recording=number, accepted=segment.accepted & seen[:, None])


def test_of_segments_what_is_visible_is_chosen() -> None:
    chosen = choose_excerpts(list(segments_of(WANTED, 60.0)))
    assert [segment.recording for segment in chosen] == list(range(WANTED))
    # a segment made by hand is half a second longer than its frames
    np.testing.assert_allclose(spans(chosen), [(20.0, 40.0)] * WANTED, atol=1.0)
    few = list(segments_of(2, 50.0))
    assert [each.signal for each in choose_excerpts(few)] == [each.signal for each in few]
    assert spans(choose_excerpts(few)) == spans(few)


@st.composite
def recordings_with_pauses(draw: st.DrawFn) -> Recording:
    lengths = draw(st.lists(st.floats(1.0, 70.0), min_size=1, max_size=5))
    pause_s = draw(st.floats(0.5, 15.0))
    starts = np.cumsum([0.0, *(length + pause_s for length in lengths)])
    pauses = [(start - pause_s, start) for start in starts[1:-1]]
    away = sorted(draw(st.tuples(st.floats(0.0, 100.0), st.floats(0.0, 100.0))))
    end_s = float(starts[-1]) - pause_s
    return recording(end_s, visible=[(0.0, away[0]), (away[1], end_s)], pauses=pauses)


@settings(max_examples=40, deadline=None, derandomize=True)
@given(recordings_with_pauses(), st.integers(1, 12), st.floats(0.0, 15.0), st.floats(0.0, 30.0))
def test_spread_excerpts_with_pauses(made: Recording, count: int, around_s: float, more_s: float) -> None:
    """In order, apart, each inside its segment, with the context that the segment has; as many as wanted."""
    timeline, t = Timeline.of(made), made.imu.t_s
    excerpts = spread_excerpts(made, timeline, count, around_s, around_s + more_s)
    lengths = [float(t[segment.stop - 1] - t[segment.start]) for segment in timeline.segments]
    candidates = sum(max(round(length / EXCERPT_S), 1) for length in lengths)
    assert len(excerpts) == min(count, candidates)
    assert all(a.end_s <= b.start_s for a, b in pairwise(excerpts))
    for excerpt in excerpts:
        assert excerpt.end_s - excerpt.start_s <= 1.5 * EXCERPT_S + 1e-9  # half an excerpt is rounded away
        (segment,) = (
            rows
            for rows in timeline.segments
            if t[rows.start] <= excerpt.start_s and excerpt.end_s <= t[rows.stop - 1]
        )
        reach_s = around_s + more_s
        near = (t >= excerpt.start_s - reach_s) & (t < excerpt.end_s + reach_s)
        own = np.arange(len(t))
        own = own[near & (own >= segment.start) & (own < segment.stop)]
        np.testing.assert_array_equal(np.arange(len(t))[excerpt.samples], own)
        arm_t = made.arm.t_s
        seen = (arm_t >= excerpt.start_s - around_s) & (arm_t < excerpt.end_s + around_s)
        np.testing.assert_array_equal(np.flatnonzero(seen), np.arange(len(arm_t))[excerpt.frames])


@pytest.mark.parametrize(
    ("rejected", "calls"), [(0.04, 1), (0.06, 2)], ids=["few contradict it", "more than 1 in 20 do"]
)
def test_the_closed_form_is_done_again_without_what_contradicts_it(
    rejected: float, calls: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    segment, done = forearm(100), []

    def without(segment: Segment, *_: object) -> tuple[Segment]:
        accepted = segment.accepted.copy()
        accepted[: round(rejected * len(accepted))] = False
        return (replace(segment, accepted=accepted),)

    monkeypatch.setattr(rounds, "reject_by_direction", without)
    found = SimpleNamespace(calibration=None, offset_s=np.zeros(1))
    monkeypatch.setattr(rounds, "find_mounting", lambda segments, *_: done.append(segments) or found)
    (left,), _ = rounds._closed_form([segment], ArmCalibration(), 0.05)
    assert len(done) == calls and done[-1][0] is (segment if calls == 1 else left)
    assert left.accepted.sum() < segment.accepted.sum()


#: A round's lever arm (sigma 10 mm), joint bias (sigma 5 mm) and clock (sigma 3 ms).
ROUND = (
    ArmCalibration("right", {"wrist": LeverArm(np.array([0.0, 0.05, 0.0]), np.full(3, 0.010))}),
    JointBias(np.zeros((5, 3)), sigma_m=0.005),
    (constant_clock(0.02, 0.003),),
)


@pytest.mark.parametrize(
    ("moved", "settled"),
    [  # up to 0.4 sigma, and up to a millimetre (or millisecond) whatever sigma is
        ({"lever_m": 0.0039}, True),
        ({"lever_m": -0.0041}, False),
        ({"bias_m": 0.0019}, True),
        ({"bias_m": -0.0021}, False),
        ({"bias_m": 0.0009, "scale": 1e-3}, True),
        ({"bias_m": 0.0011, "scale": 1e-3}, False),
        ({"clock_s": 0.0011}, True),
        ({"clock_s": -0.0013}, False),
        ({"lever_m": 0.0039, "bias_m": 0.0019, "clock_s": 0.0011}, True),
    ],
)
def test_rounds_end_where_nothing_moves_by_much_of_its_sigma(moved: dict[str, float], settled: bool) -> None:
    (arm, bias, (clock,)), by = ROUND, {"lever_m": 0.0, "bias_m": 0.0, "clock_s": 0.0, "scale": 1.0} | moved
    lever, error_m = arm.lever_arms["wrist"], bias.error_m.copy()
    error_m[2, 1] += by["bias_m"]
    lever = LeverArm(
        lever.position_m + by["lever_m"] * np.array([0.6, 0.0, 0.8]), by["scale"] * lever.sigma_m
    )
    clock = replace(clock, offset=clock.offset + by["clock_s"])
    after = (
        replace(arm, lever_arms={"wrist": lever}),
        JointBias(error_m, sigma_m=by["scale"] * bias.sigma_m),
        (clock,),
    )
    assert rounds._settled(ROUND, after) is settled


@pytest.mark.parametrize(
    ("settles", "read"),
    [([True], [1, 2]), ([False, True], [1, 2, 2]), ([False] * 9, [1, 2, 2, 2])],
    ids=["at once", "later", "never"],
)
def test_the_first_round_reads_half_and_ends_nothing(
    settles: list[bool], read: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    made = moving(5, "white", 24.0, occlusion_lengths_s=()).recording
    seen, original = [], rounds.solve_round
    excerpts = split_into_segments(replace(made, imu=made.imu.select(np.abs(made.imu.t_s - 12.0) > 0.5)))
    monkeypatch.setattr(
        rounds, "solve_round", lambda cut, *more: seen.append(len(cut)) or original(cut, *more)
    )
    monkeypatch.setattr(rounds, "_settled", lambda *_: settles.pop(0))
    with Pool(1, 0) as workers:
        rounds.self_calibrate(excerpts, ArmCalibration(side="right"), Config(), workers)
    assert seen == read


@pytest.fixture
def long() -> tuple[list[Segment], ArmCalibration]:
    """Excerpts of two minutes, and what is given of the arm."""
    recording = moving(5, "white", 130.0, occlusion_lengths_s=(2.0,), occlusion_every_s=10.0).recording
    excerpts = informative_excerpts(recording, Timeline.of(recording))
    assert len(excerpts) > 2
    return excerpts, ArmCalibration(side=recording.side)


@pytest.mark.slow
def test_a_half_that_cannot_be_used_is_no_reason_to_refuse(
    long: tuple[list[Segment], ArmCalibration], monkeypatch: pytest.MonkeyPatch
) -> None:
    excerpts, given = long
    unusable = {excerpts[number].start_s for number in rounds._every_second(excerpts)}
    original = rounds.prepare

    def prepare(segment: Segment, *others: object) -> object:
        return None if segment.start_s in unusable else original(segment, *others)  # type: ignore[arg-type]

    monkeypatch.setattr(rounds, "prepare", prepare)
    with Pool(1, 0) as workers:
        assert rounds.self_calibrate(excerpts, given, Config(), workers).estimate.lever_arms
        unusable |= {excerpt.start_s for excerpt in excerpts}
        with pytest.raises(CalibrationError, match="never overlap"):
            rounds.self_calibrate(excerpts, given, Config(), workers)
