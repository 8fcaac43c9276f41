"""A minute without the camera: what it leaves unanswered, and that nothing else is moved by it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from unittest.mock import patch

import numpy as np
import pytest
from scenes import ALONE, FIELD_K, last_pass, with_field

import smoother.recovery.first_pass
from smoother import Recovery, smooth
from smoother.array_types import FloatArray
from smoother.measurements.segment import Timeline
from smoother.recording import JOINTS, Recording
from smoother.recovery.first_pass import FirstAnswer
from smoother.recovery.sections import SectionData
from smoother.recovery.task import Task
from smoother.selfcal.excerpts import informative_excerpts
from smoother.simulation import SimulatedArm

#: The IMU pauses so long at both ends of what drops out, so that it is a segment of its own, s.
PAUSE_S = 0.5
#: The camera is away so much longer on both sides, s: excerpts beside the segment see nothing of it.
AWAY_S = 13.0
#: Minutes that drop out of three, s, and which of the sections that is.
START, MIDDLE, END = (-1.0, 45.0), (60.0, 115.0), (135.0, 181.0)


def without_camera(recording: Recording, start_s: float, end_s: float) -> Recording:
    t = recording.arm.t_s
    return replace(recording, arm=recording.arm.hide((t > start_s) & (t < end_s), JOINTS), truth=None)


def with_one_frame(recording: Recording, start_s: float, end_s: float) -> Recording:
    """As `without_camera`, but for a frame in the middle: one is too few to say anything."""
    t = recording.arm.t_s
    hidden = (t > start_s) & (t < end_s)
    hidden[np.searchsorted(t, 0.5 * (start_s + end_s))] = False
    return replace(recording, arm=recording.arm.hide(hidden, JOINTS), truth=None)


def without_imu(recording: Recording, start_s: float, end_s: float) -> Recording:
    t = recording.imu.t_s
    return replace(recording, imu=recording.imu.select((t < start_s) | (t > end_s)), truth=None)


def paused(recording: Recording, start_s: float, end_s: float) -> Recording:
    """A segment of the IMU's own between two times."""
    return without_imu(without_imu(recording, start_s - PAUSE_S, start_s), end_s, end_s + PAUSE_S)


@dataclass(frozen=True)
class Dropped:
    """A recovery of a recording of which a section drops out, and of the same recording without it."""

    start_s: float
    end_s: float
    recording: Recording
    recovery: Recovery
    expected: Recovery
    answered: list[bool]


def smoothed(
    recording: Recording, made: SimulatedArm, excerpts_of: Recording | None = None
) -> tuple[Recovery, list[bool]]:
    """The recovery, and which sections the first pass answered; self-calibrated on another's excerpts."""
    solve_alone: Callable[[SectionData, Task], FirstAnswer | None]
    solve_alone, answered = smoother.recovery.first_pass.solve_alone, []

    def listen(data: SectionData, task: Task) -> FirstAnswer | None:
        answer = solve_alone(data, task)
        answered.append(answer is not None)
        return answer

    chosen = recording if excerpts_of is None else excerpts_of
    excerpts = informative_excerpts(chosen, Timeline.of(chosen))
    with (
        patch("smoother.recovery.first_pass.solve_alone", listen),
        patch("smoother.smoothing.informative_excerpts", lambda recording, timeline: excerpts),
    ):
        return smooth(recording, made.calibration, ALONE), answered


@pytest.fixture(scope="module", params=[START, END], ids=["start", "end"])
def dropped(request: pytest.FixtureRequest, three_minutes: SimulatedArm) -> Dropped:
    start_s, end_s = request.param
    hidden = with_one_frame(three_minutes.recording, start_s - AWAY_S, end_s + AWAY_S)
    recording = paused(hidden, start_s, end_s)
    shorter = without_imu(recording, start_s, end_s)
    recovery, answered = smoothed(recording, three_minutes, excerpts_of=shorter)
    expected, all_answered = smoothed(shorter, three_minutes)
    assert all(all_answered)
    return Dropped(start_s, end_s, recording, recovery, expected, answered)


def inside(recovery: Recovery, start_s: float, end_s: float) -> FloatArray:
    return np.flatnonzero((recovery.t_s >= start_s) & (recovery.t_s <= end_s))


def off_in_sigmas(a: Recovery, b: Recovery) -> FloatArray:
    """Distance of two recoveries at the same samples, in the second one's sigma; nan where both are nan."""
    np.testing.assert_array_equal(a.answered, b.answered)
    sigma = np.sqrt(np.trace(b.pose_covariance[:, :3, :3], axis1=1, axis2=2))
    return np.linalg.norm(a.position - b.position, axis=1) / sigma


def test_the_section_drops_out(dropped: Dropped) -> None:
    assert dropped.answered.count(False) == 1
    assert dropped.answered.index(False) == (0 if dropped.start_s == START[0] else len(dropped.answered) - 1)
    rows = inside(dropped.recovery, dropped.start_s, dropped.end_s)
    there = dropped.recovery.rows(rows)
    assert len(there) > 3000
    for values in (there.position, there.quaternion, there.velocity, there.sigma_m, there.sigma_deg):
        assert np.isnan(values).all()
    assert there.occluded.all()
    assert np.isnan(there.joints["wrist"]).all()


def test_the_others_answer_as_without_it(dropped: Dropped) -> None:
    """By the same excerpts, so that nothing but the sections differs (other excerpts: up to 0.2 sigma)."""
    recovery, expected = dropped.recovery, dropped.expected
    rows = np.flatnonzero((recovery.t_s < dropped.start_s) | (recovery.t_s > dropped.end_s))
    others = recovery.rows(rows)
    np.testing.assert_array_equal(others.t_s, expected.t_s)
    # measured 2e-4 sigma: the optimiser's tolerance
    assert np.nanmax(off_in_sigmas(others, expected)) < 0.002
    np.testing.assert_allclose(others.sigma_m, expected.sigma_m, rtol=2e-4)
    np.testing.assert_array_equal(others.occluded, expected.occluded)
    assert recovery.residuals is not None and expected.residuals is not None
    np.testing.assert_array_equal(recovery.residuals.used, expected.residuals.used)


def test_the_other_sections_are_accurate(dropped: Dropped, three_minutes: SimulatedArm) -> None:
    """Against truth where the camera is there: 8 mm of white noise a joint, 3 mm of sigma here."""
    truth, recovery = three_minutes.recording.truth, dropped.recovery
    assert truth is not None
    rows = np.flatnonzero(~recovery.occluded)
    error = recovery.position[rows] - truth.position[np.searchsorted(truth.t_s, recovery.t_s[rows])]
    assert len(rows) > 5000
    assert np.sqrt(np.mean(np.sum(error**2, axis=1))) < 0.004


def test_each_window_gets_its_own_field(three_minutes: SimulatedArm) -> None:
    """Turned by its node's attitude it is the one in the room, also after a dropped section.

    Attitudes of other times would turn it anywhere: an arm that moves points elsewhere within a second.
    """
    start_s, end_s = MIDDLE
    recording = paused(with_field(three_minutes.recording), start_s, end_s)
    recording = without_camera(recording, start_s - AWAY_S, end_s + AWAY_S)
    jobs = last_pass(recording, three_minutes.calibration)
    windows = [job.window for job in jobs if job.window.field is not None]
    assert windows[0].t[-1] < start_s and windows[-1].t[0] > end_s
    for window in windows:
        assert window.field is not None
        in_K = np.einsum("nij,nj->ni", window.forearm.start.R[window.field.node], window.field.in_A)
        # 1 % of noise, orientations known to half a degree, and to some where the camera is away for long
        assert np.degrees(np.arccos(in_K @ FIELD_K)).max() < 6.0


def test_a_minute_without_the_camera_is_one_gap(three_minutes: SimulatedArm, sectioned: Recovery) -> None:
    """Without a pause no section drops out: the shoulder holds the arm, and the answer says how vaguely."""
    start_s, end_s = 60.0, 120.0
    truth = three_minutes.recording.truth
    assert truth is not None
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


def test_a_segment_without_the_camera_that_sees_it_again_right_after(three_minutes: SimulatedArm) -> None:
    start_s, end_s = MIDDLE
    hidden = without_camera(three_minutes.recording, start_s - 2.0, end_s + 2.0)
    recovery, answered = smoothed(paused(hidden, start_s, end_s), three_minutes)
    assert answered and all(answered)  # no section is made of what the camera never saw
    assert np.isnan(recovery.position[inside(recovery, start_s, end_s)]).all()
