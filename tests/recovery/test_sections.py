"""Sections of about a minute: the same answer as the whole in one section, no seam, borders."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scenes import ALONE

from smoother import Recovery, smooth
from smoother.measurements.clock import constant_clock
from smoother.measurements.segment import Timeline
from smoother.measurements.visibility import Gap
from smoother.recording import FOREARM_JOINTS, JOINTS
from smoother.recovery.blended_columns import between_quaternions, blend
from smoother.recovery.merge import merged_gaps
from smoother.recovery.sections import SECTION_S, Section, Sections, section_borders
from smoother.rotation import Rotation
from smoother.simulation import SimulatedArm


@pytest.fixture(scope="module")
def whole(three_minutes: SimulatedArm) -> Recovery:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("smoother.recovery.sections.SECTION_S", 1e6)
        return smooth(replace(three_minutes.recording, truth=None), three_minutes.calibration, ALONE)


def sections_of(made: SimulatedArm) -> list[Section]:
    return Sections(made.recording, Timeline.of(made.recording), constant_clock(0.0)).all


def test_every_sample_and_frame_is_in_one_section(three_minutes: SimulatedArm) -> None:
    sections = Sections(
        three_minutes.recording, Timeline.of(three_minutes.recording), constant_clock(0.0)
    ).all
    assert len(sections) == 3
    assert sections[0].start_s == -np.inf and sections[-1].end_s == np.inf
    for a, b in pairwise(sections):
        assert a.end_s == b.start_s
        t = three_minutes.recording.imu.t_s
        assert t[a.samples.stop - 1] > a.end_s + 11 and t[b.samples.start] < b.start_s - 11  # context


def test_borders_lie_in_visible_time(three_minutes: SimulatedArm, sectioned: Recovery) -> None:
    borders = [
        section.start_s
        for section in Sections(
            three_minutes.recording, Timeline.of(three_minutes.recording), constant_clock(0.0)
        ).all[1:]
    ]
    for border in borders:
        assert all(not gap.start_s - 1.0 < border < gap.end_s + 1.0 for gap in sectioned.gaps)


def test_no_border_where_nothing_is_seen() -> None:
    runs = np.array([[0.0, 20.0], [220.0, 240.0]])
    assert section_borders(0.0, 240.0, runs) == []
    assert section_borders(0.0, 240.0, np.zeros((0, 2))) == []
    assert section_borders(0.0, SECTION_S, np.array([[0.0, SECTION_S]])) == []


def test_sections_answer_as_the_whole(sectioned: Recovery, whole: Recovery) -> None:
    """Windows differ (their borders do), and their priors from the others: far below a sigma."""
    away = np.linalg.norm(sectioned.position - whole.position, axis=1)
    sigma = np.sqrt(np.trace(whole.pose_covariance[:, :3, :3], axis1=1, axis2=2))
    assert np.isfinite(sectioned.position).all()
    assert np.percentile(away / sigma, 99) < 1.0
    assert np.median(away / sigma) < 0.2
    np.testing.assert_array_equal(sectioned.occluded, whole.occluded)
    assert sectioned.gaps == whole.gaps
    assert sectioned.residuals is not None and whole.residuals is not None
    np.testing.assert_array_equal(sectioned.residuals.used, whole.residuals.used)


def test_accuracy_is_the_whole_one(three_minutes: SimulatedArm, sectioned: Recovery, whole: Recovery) -> None:
    truth = three_minutes.recording.truth
    assert truth is not None

    def rms(recovery: Recovery) -> float:
        error = np.linalg.norm(recovery.position - truth.position, axis=1)[recovery.occluded]
        return float(np.sqrt(np.mean(error**2)))

    assert rms(sectioned) < 1.05 * rms(whole)  # 4.0 against 4.0 mm


def test_no_seam_at_the_section_borders(three_minutes: SimulatedArm, sectioned: Recovery) -> None:
    """Second differences at the borders are no larger than elsewhere."""
    jump = np.linalg.norm(np.diff(sectioned.position, n=2, axis=0), axis=1)
    t = sectioned.t_s[1:-1]
    near = np.zeros(len(t), dtype=bool)
    for section in Sections(
        three_minutes.recording, Timeline.of(three_minutes.recording), constant_clock(0.0)
    ).all[1:]:
        near |= np.abs(t - section.start_s) < 1.0
    assert near.sum() > 300
    assert jump[near].max() <= jump[~near].max()


def test_a_border_in_a_gap_that_only_rejection_finds(three_minutes: SimulatedArm) -> None:
    """A camera that freezes for 6 s where the border was going to be: both sides bridge it, and agree."""
    border = (
        Sections(three_minutes.recording, Timeline.of(three_minutes.recording), constant_clock(0.0))
        .all[1]
        .start_s
    )
    arm = three_minutes.recording.arm
    rows = np.flatnonzero((arm.t_s > border - 3.0) & (arm.t_s < border + 3.0))
    position = arm.position.copy()
    for joint in FOREARM_JOINTS:
        position[rows, JOINTS.index(joint)] = position[rows[0], JOINTS.index(joint)]
    recording = replace(three_minutes.recording, arm=replace(arm, position=position), truth=None)
    recovery = smooth(recording, three_minutes.calibration, ALONE)
    inside = [gap for gap in recovery.gaps if gap.start_s < border < gap.end_s]
    assert len(inside) == 1 and not inside[0].open_start and not inside[0].open_end
    truth = three_minutes.recording.truth
    assert truth is not None
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


def test_both_known():
    column = np.ones((7, 3))
    blend(column, slice(1, 7), np.full((6, 3), 3.0), SHARE)
    np.testing.assert_allclose(column[:, 0], [1.0, *(1.0 + 2.0 * SHARE)])


def test_what_the_later_section_does_not_know_stays():
    column, later = np.ones((6, 2)), np.full((6, 2), 3.0)
    later[[1, 2, 5], 0] = np.nan
    blend(column, slice(0, 6), later, SHARE)
    np.testing.assert_allclose(column[:, 0], [1.0, 1.0, 1.0, 2.6, 3.0, np.nan])
    np.testing.assert_allclose(column[:, 1], 1.0 + 2.0 * SHARE)


def test_what_the_earlier_section_does_not_know_is_taken_from_the_later():
    column = np.full((6, 2, 2), np.nan)
    blend(column, slice(0, 6), np.full((6, 2, 2), 3.0), SHARE)
    np.testing.assert_array_equal(column, 3.0)


def test_quaternions_on_the_way():
    before = np.tile([1.0, 0.0, 0.0, 0.0], (4, 1))
    after = np.tile(Rotation.from_rotvec(np.array([0.0, 0.0, 0.8])).as_quat(scalar_first=True), (4, 1))
    before[0], after[1] = np.nan, np.nan
    between = between_quaternions(before, after, np.full(4, 0.25))
    np.testing.assert_allclose(between[:2], [after[0], before[1]])
    assert Rotation.from_quat(between[2:], scalar_first=True).magnitude() == pytest.approx(0.2)
