"""A camera that is stopped for minutes, or sees one joint for minutes: what is near is answered as ever."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scenes import answer

from smoother import Recovery
from smoother.array_types import BoolArray
from smoother.measurements.clock import constant_clock
from smoother.measurements.segment import Timeline
from smoother.recording import JointTracks, Recording
from smoother.recovery.sections import CONTEXT_S, SECTION_S, Section, Sections
from smoother.simulation import SimulatedArm

#: The answer reaches so far in these tests, and the camera is away from and until here, s.
REACH_S, AWAY_S = 6.0, (60.0, 130.0)


@pytest.fixture(autouse=True)
def short_reach(monkeypatch: pytest.MonkeyPatch) -> None:
    for place in ("window.prepare", "recovery.sections", "recovery.notes"):
        monkeypatch.setattr(f"smoother.{place}.REACH_S", REACH_S)


def stopped(recording: Recording, away_s: tuple[float, float] = AWAY_S) -> Recording:
    """A camera that was stopped: there are no frames at all."""
    t = recording.arm.t_s
    rows = np.flatnonzero((t < away_s[0]) | (t > away_s[1]))
    return replace(recording, arm=recording.arm.select(rows))


def sections_of(recording: Recording) -> list[Section]:
    return Sections(recording, Timeline.of(recording), constant_clock(0.0)).all


def apart(recovery: Recovery, made: SimulatedArm, rows: BoolArray) -> float:
    """Rms of position against the truth, m."""
    truth = made.recording.truth
    return float(np.sqrt(np.mean(np.sum((recovery.position - truth.position)[rows] ** 2, axis=1))))


@pytest.mark.slow
def test_a_stopped_camera_parts_the_recording(three_minutes: SimulatedArm, sectioned: Recovery) -> None:
    recovery = answer(stopped(three_minutes.recording), three_minutes.calibration)
    t = recovery.t_s
    beyond = (t > AWAY_S[0] + REACH_S) & (t < AWAY_S[1] - REACH_S)
    assert not recovery.answered[beyond].any() and recovery.answered[~beyond].mean() > 0.995
    ends = [gap for gap in recovery.gaps if gap.open_start or gap.open_end]
    assert [(gap.open_start, gap.open_end) for gap in ends] == [(False, True), (True, False)]
    assert ends[0].length_s == pytest.approx(REACH_S, abs=0.1) == ends[1].length_s
    (note,) = [note for note in recovery.notes if "nothing is recovered" in note]
    assert note.startswith(f"from {ends[0].end_s:.1f} s to {ends[1].start_s:.1f} s ")
    seen = (t < AWAY_S[0] - 3.0) | (t > AWAY_S[1] + 3.0)
    assert apart(recovery, three_minutes, seen) < 1.2 * apart(sectioned, three_minutes, seen)
    assert recovery.occluded[beyond].all()


@pytest.mark.slow
def test_an_imu_that_outlasts_the_camera_is_read_no_farther(three_minutes: SimulatedArm) -> None:
    early = stopped(three_minutes.recording, (30.0, np.inf))
    sections = sections_of(early)
    last = max(section.samples.stop for section in sections)
    assert early.imu.t_s[last - 1] == pytest.approx(30.0 + REACH_S + CONTEXT_S, abs=0.1)
    recovery = answer(early, three_minutes.calibration)
    (note,) = [note for note in recovery.notes if "nothing is recovered" in note]
    assert note.startswith("from 36.0 s to 180.0 s ")


def test_nothing_is_left_out_where_something_is_seen(three_minutes: SimulatedArm) -> None:
    """One joint now and then is enough."""
    recording = three_minutes.recording
    t = recording.arm.t_s
    away = (t > AWAY_S[0]) & (t < AWAY_S[1])
    arm: JointTracks = recording.arm.hide(away & (np.arange(len(t)) % 30 > 0), ("elbow", "wrist", "hand"))
    some = replace(recording, arm=arm.hide(away, ("wrist", "hand")))
    sections = sections_of(some)
    assert sections[0].samples.start == 0
    assert sections[-1].samples.stop == len(recording.imu)
    assert len([section for section in sections if section.start_s == -np.inf]) == 1


@pytest.mark.slow
def test_sections_stay_short_where_one_joint_is_seen(three_minutes: SimulatedArm) -> None:
    """A wrist under the table for more than a minute: the elbow holds the answer, in sections as ever."""
    recording = three_minutes.recording
    t = recording.arm.t_s
    away = (t > AWAY_S[0]) & (t < AWAY_S[1])
    some = replace(recording, arm=recording.arm.hide(away, ("wrist", "hand")))
    recovery = answer(some, three_minutes.calibration)
    sections = sections_of(some)
    assert len(sections) == 3 and max(section.length_s for section in sections) < 1.5 * SECTION_S
    assert max(gap.length_s for gap in recovery.gaps) > 69.0
    inside = (recovery.t_s > AWAY_S[0] + 1.0) & (recovery.t_s < AWAY_S[1] - 1.0)
    # the elbow alone: 0.4 cm instead of 0.3
    assert apart(recovery, three_minutes, inside) < 0.008
    sigma = recovery.worst_sigma_m[inside]
    assert np.isfinite(sigma).all() and sigma.max() < 0.02
    assert recovery.answered.all()
