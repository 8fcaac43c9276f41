"""Sections of about a minute: no seam, borders, and a minute without the camera."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from unittest.mock import patch

import numpy as np
import pytest
from scenes import FIELD_K, answer, section_windows, with_field

import smoother.recovery.solve_section
from smoother import Recovery
from smoother.array_types import FloatArray
from smoother.measurements.clock import constant_clock
from smoother.measurements.segment import Timeline
from smoother.measurements.visibility import Gap
from smoother.recording import FOREARM_JOINTS, JOINTS, Recording
from smoother.recovery.blended_columns import BlendedColumns, between_quaternions
from smoother.recovery.merge import merged_gaps
from smoother.recovery.samples import SectionAnswer
from smoother.recovery.sections import (
    SECTION_S,
    Section,
    SectionData,
    Sections,
    section_borders,
)
from smoother.recovery.task import Task
from smoother.rotation import Rotation
from smoother.selfcal.excerpts import informative_excerpts
from smoother.simulation import SimulatedArm


@pytest.fixture(scope="module")
def whole(three_minutes: SimulatedArm) -> Recovery:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("smoother.recovery.sections.SECTION_S", 1e6)
        return answer(three_minutes.recording, three_minutes.calibration)


def sections_of(made: SimulatedArm) -> list[Section]:
    return Sections(made.recording, Timeline.of(made.recording), constant_clock(0.0)).all


def test_every_sample_is_in_one_section_and_borders_only_where_something_is_seen(
    three_minutes: SimulatedArm,
) -> None:
    sections, t = sections_of(three_minutes), three_minutes.recording.imu.t_s
    assert len(sections) == 3
    assert sections[0].start_s == -np.inf and sections[-1].end_s == np.inf
    for a, b in pairwise(sections):
        assert a.end_s == b.start_s
        assert t[a.samples.stop - 1] > a.end_s + 11 and t[b.samples.start] < b.start_s - 11  # context
    for start_s, end_s, runs in (
        (0.0, 240.0, [[0.0, 20.0], [220.0, 240.0]]),
        (0.0, 240.0, np.zeros((0, 2))),
        (0.0, SECTION_S, [[0.0, SECTION_S]]),
    ):
        assert section_borders(start_s, end_s, np.array(runs)) == []


@pytest.mark.slow
def test_borders_lie_in_visible_time_and_show_no_seam(
    three_minutes: SimulatedArm, sectioned: Recovery
) -> None:
    """Second differences at the borders are no larger than elsewhere."""
    jump = np.linalg.norm(np.diff(sectioned.position, n=2, axis=0), axis=1)
    t = sectioned.t_s[1:-1]
    near = np.zeros(len(t), dtype=bool)
    for border in (section.start_s for section in sections_of(three_minutes)[1:]):
        assert all(not gap.start_s - 1.0 < border < gap.end_s + 1.0 for gap in sectioned.gaps)
        near |= np.abs(t - border) < 1.0
    assert near.sum() > 300
    assert jump[near].max() <= jump[~near].max()


@pytest.mark.slow
def test_sections_answer_as_the_whole(sectioned: Recovery, whole: Recovery) -> None:
    """Windows differ (their borders do), and their priors from the others: far below a sigma."""
    away = np.linalg.norm(sectioned.position - whole.position, axis=1)
    sigma = np.sqrt(np.trace(whole.pose_covariance[:, :3, :3], axis1=1, axis2=2))
    assert np.isfinite(sectioned.position).all()
    assert np.percentile(away / sigma, 99) < 1.0
    assert np.median(away / sigma) < 0.2
    np.testing.assert_array_equal(sectioned.occluded, whole.occluded)
    assert sectioned.gaps == whole.gaps
    np.testing.assert_array_equal(sectioned.residuals.used, whole.residuals.used)


@pytest.mark.slow
def test_a_border_in_a_gap_that_only_rejection_finds(three_minutes: SimulatedArm) -> None:
    """A camera that freezes for 6 s where the border was going to be: both sides bridge it, and agree."""
    border = sections_of(three_minutes)[1].start_s
    arm = three_minutes.recording.arm
    rows = np.flatnonzero((arm.t_s > border - 3.0) & (arm.t_s < border + 3.0))
    position = arm.position.copy()
    for joint in FOREARM_JOINTS:
        position[rows, JOINTS.index(joint)] = position[rows[0], JOINTS.index(joint)]
    recording = replace(three_minutes.recording, arm=replace(arm, position=position))
    recovery = answer(recording, three_minutes.calibration)
    inside = [gap for gap in recovery.gaps if gap.start_s < border < gap.end_s]
    assert len(inside) == 1 and not inside[0].open_start and not inside[0].open_end
    truth = three_minutes.recording.truth
    rows = np.flatnonzero((truth.t_s > inside[0].start_s) & (truth.t_s < inside[0].end_s))
    error = np.linalg.norm(recovery.position - truth.position, axis=1)[rows]
    sigma = np.sqrt(np.trace(recovery.pose_covariance[rows, :3, :3], axis1=1, axis2=2))
    assert error.max() < 0.12  # 6 s without a camera
    assert np.mean(error < 3.0 * sigma) > 0.95


def test_gaps_of_two_sections_are_one() -> None:
    first = [Gap(1.0, 2.0), Gap(8.0, 12.0, open_end=True)]
    assert merged_gaps(first, (Gap(8.0, 14.0), Gap(20.0, 21.0))) == [
        Gap(1.0, 2.0),
        Gap(8.0, 14.0),
        Gap(20.0, 21.0),
    ]
    assert merged_gaps([], (Gap(0.0, 1.0, open_start=True),)) == [Gap(0.0, 1.0, open_start=True)]


SHARE = np.array([0.0, 0.2, 0.5, 0.8, 1.0, 1.0])


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_columns_are_blended_where_both_sections_know_them(dtype: type) -> None:
    """What either section does not know is the other's; what none knows is nan."""
    columns = BlendedColumns(12, dtype)
    first, later = np.ones((5, 2)), np.full((6, 2), 3.0)
    first[4, 1] = later[1, 0] = later[5, 0] = np.nan
    columns.add(slice(1, 6), {"place": first}, np.ones(5))
    columns.add(slice(3, 9), {"place": later, "late": later}, SHARE)
    columns.add(slice(9, 11), {"place": first[:2]}, np.zeros(2))  # nothing is there to blend with
    values = columns.done()
    none = np.nan
    np.testing.assert_allclose(values["place"][:, 0], [none, 1, 1, 1, 1, 2, 3, 3, none, 1, 1, none])
    np.testing.assert_allclose(values["place"][:, 1], [none, 1, 1, 1, 1.4, 3, 3, 3, 3, 1, 1, none])
    np.testing.assert_allclose(values["late"][:, 1], [none] * 3 + [3.0] * 6 + [none] * 3)


def test_quaternions_on_the_way():
    before = np.tile([1.0, 0.0, 0.0, 0.0], (4, 1))
    after = np.tile(Rotation.from_rotvec(np.array([0.0, 0.0, 0.8])).as_quat(scalar_first=True), (4, 1))
    before[0], after[1] = np.nan, np.nan
    between = between_quaternions(before, after, np.full(4, 0.25))
    np.testing.assert_allclose(between[:2], [after[0], before[1]])
    assert Rotation.from_quat(between[2:], scalar_first=True).magnitude() == pytest.approx(0.2)


#: The IMU pauses so long at both ends of what drops out, so that it is a segment of its own, s.
PAUSE_S = 0.5
#: The camera is away so much longer on both sides, s: excerpts beside the segment see nothing of it.
AWAY_S = 13.0
#: Minutes that drop out of three, s, and which of the sections that is.
START, MIDDLE, END = (-1.0, 45.0), (60.0, 115.0), (135.0, 181.0)


def without_camera(recording: Recording, start_s: float, end_s: float, one_frame: bool = False) -> Recording:
    """A frame in the middle may stay: one is too few to say anything."""
    t = recording.arm.t_s
    hidden = (t > start_s) & (t < end_s)
    hidden[np.searchsorted(t, 0.5 * (start_s + end_s))] &= not one_frame
    return replace(recording, arm=recording.arm.hide(hidden, JOINTS))


def without_imu(recording: Recording, start_s: float, end_s: float) -> Recording:
    t = recording.imu.t_s
    return replace(recording, imu=recording.imu.select((t < start_s) | (t > end_s)))


def paused(recording: Recording, start_s: float, end_s: float) -> Recording:
    """A segment of the IMU's own between two times."""
    return without_imu(without_imu(recording, start_s - PAUSE_S, start_s), end_s, end_s + PAUSE_S)


def smoothed(
    recording: Recording, made: SimulatedArm, excerpts_of: Recording | None = None
) -> tuple[Recovery, list[bool]]:
    """The recovery, and which sections were answered; self-calibrated on another's excerpts."""
    solve_section, answered = smoother.recovery.solve_section.solve_section, []

    def listen(data: SectionData, task: Task) -> SectionAnswer | None:
        answer = solve_section(data, task)
        answered.append(answer is not None)
        return answer

    chosen = recording if excerpts_of is None else excerpts_of
    excerpts = informative_excerpts(chosen, Timeline.of(chosen))
    with (
        patch("smoother.recovery.solve_section.solve_section", listen),
        patch("smoother.smoothing.informative_excerpts", lambda recording, timeline: excerpts),
    ):
        return answer(recording, made.calibration), answered


def inside(recovery: Recovery, start_s: float, end_s: float) -> FloatArray:
    return np.flatnonzero((recovery.t_s >= start_s) & (recovery.t_s <= end_s))


def off_in_sigmas(a: Recovery, b: Recovery) -> FloatArray:
    """Distance of two recoveries at the same samples, in the second one's sigma; nan where both are nan."""
    np.testing.assert_array_equal(a.answered, b.answered)
    sigma = np.sqrt(np.trace(b.pose_covariance[:, :3, :3], axis1=1, axis2=2))
    return np.linalg.norm(a.position - b.position, axis=1) / sigma


@pytest.mark.slow
@pytest.mark.parametrize(("start_s", "end_s"), [START, END], ids=["start", "end"])
def test_a_section_drops_out_and_the_others_answer_as_without_it(
    three_minutes: SimulatedArm, start_s: float, end_s: float
) -> None:
    """By the same excerpts, so that nothing but the sections differs (other excerpts: up to 0.2 sigma)."""
    hidden = without_camera(three_minutes.recording, start_s - AWAY_S, end_s + AWAY_S, one_frame=True)
    recording = paused(hidden, start_s, end_s)
    shorter = without_imu(recording, start_s, end_s)
    recovery, answered = smoothed(recording, three_minutes, excerpts_of=shorter)
    expected, all_answered = smoothed(shorter, three_minutes)
    assert all(all_answered) and answered.count(False) == 1
    assert answered[0 if start_s == START[0] else -1] is False
    t = recovery.t_s
    there = recovery.rows(inside(recovery, start_s, end_s))
    assert len(there) > 3000 and there.occluded.all()
    for values in (there.position, there.quaternion, there.velocity, there.sigma_m, there.sigma_deg):
        assert np.isnan(values).all()
    assert np.isnan(there.joints["wrist"]).all()
    others = recovery.rows(np.flatnonzero((t < start_s) | (t > end_s)))
    np.testing.assert_array_equal(others.t_s, expected.t_s)
    # measured 2e-4 sigma: the optimiser's tolerance
    assert np.nanmax(off_in_sigmas(others, expected)) < 0.002
    np.testing.assert_allclose(others.sigma_m, expected.sigma_m, rtol=2e-4)
    np.testing.assert_array_equal(others.occluded, expected.occluded)
    np.testing.assert_array_equal(recovery.residuals.used, expected.residuals.used)


@pytest.mark.slow
def test_each_window_gets_its_own_field(three_minutes: SimulatedArm) -> None:
    """Turned by its node's attitude it is the one in the room, also after a dropped section.

    Attitudes of other times would turn it anywhere: an arm that moves points elsewhere within a second.
    """
    start_s, end_s = MIDDLE
    recording = paused(with_field(three_minutes.recording), start_s, end_s)
    recording = without_camera(recording, start_s - AWAY_S, end_s + AWAY_S)
    jobs = section_windows(recording, three_minutes.calibration)
    windows = [job.window for job in jobs if job.window.field is not None]
    assert windows[0].t[-1] < start_s and windows[-1].t[0] > end_s
    for window in windows:
        in_K = np.einsum("nij,nj->ni", window.forearm.start.R[window.field.node], window.field.in_A)
        # 1 % of noise, orientations known to half a degree, and to some where the camera is away for long
        assert np.degrees(np.arccos(in_K @ FIELD_K)).max() < 6.0


@pytest.mark.slow
def test_a_minute_without_the_camera_is_one_gap(three_minutes: SimulatedArm, sectioned: Recovery) -> None:
    """Without a pause no section drops out: the shoulder holds the arm, and the answer says how vaguely."""
    start_s, end_s = 60.0, 120.0
    truth = three_minutes.recording.truth
    hidden = without_camera(three_minutes.recording, start_s, end_s)
    recovery, answered = smoothed(hidden, three_minutes, excerpts_of=three_minutes.recording)
    assert all(answered)
    (gap,) = (gap for gap in recovery.gaps if gap.length_s > 5.0)
    assert (gap.start_s, gap.end_s) == pytest.approx((start_s, end_s), abs=0.1)
    middle = inside(recovery, start_s + 15.0, end_s - 15.0)
    assert recovery.occluded[middle].all()
    sigma = recovery.sigma_m[middle].max(axis=1)
    # 3 mm in sight; no more than an arm's length, which the shoulder holds
    assert sigma.min() > 0.2 and sigma.max() < 1.0
    error = np.linalg.norm(recovery.position[middle] - truth.position[middle], axis=1)
    assert np.mean(error < 2.0 * sigma) > 0.95
    away = np.flatnonzero((recovery.t_s < gap.start_s - 10.0) | (recovery.t_s > gap.end_s + 10.0))
    # a third of the windows say nothing any more of what all share: measured 0.08 sigma, 0.17 at worst
    assert off_in_sigmas(recovery.rows(away), sectioned.rows(away)).max() < 0.3


@pytest.mark.slow
def test_a_segment_without_the_camera_that_sees_it_again_right_after(three_minutes: SimulatedArm) -> None:
    start_s, end_s = MIDDLE
    hidden = without_camera(three_minutes.recording, start_s - 2.0, end_s + 2.0)
    recovery, answered = smoothed(paused(hidden, start_s, end_s), three_minutes)
    assert answered and all(answered)  # no section is made of what the camera never saw
    assert np.isnan(recovery.position[inside(recovery, start_s, end_s)]).all()
