"""Self-calibration: its first round reads every second excerpt, and ends where all of them would."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scenes import arm

from smoother.calibration import ArmCalibration
from smoother.config import Config
from smoother.errors import CalibrationError
from smoother.measurements.segment import Segment, Timeline
from smoother.runtime.pool import Pool
from smoother.selfcal import rounds
from smoother.selfcal.excerpts import informative_excerpts


def test_every_second_excerpt_of_each_recording() -> None:
    made = arm(3, protocol="random", duration_s=12.0)
    (segment,) = informative_excerpts(made.recording, Timeline.of(made.recording))
    excerpts = [replace(segment, recording=number) for number in (0, 0, 1, 0, 1, 2)]
    assert rounds._every_second(excerpts) == [0, 2, 3, 5]
    assert rounds._every_second(excerpts[:1]) == [0]


def test_a_coarse_round_changes_little(monkeypatch: pytest.MonkeyPatch) -> None:
    made = arm(5, protocol="random", duration_s=130.0, occlusion_lengths_s=(2.0,), occlusion_every_s=10.0)
    excerpts = informative_excerpts(made.recording, Timeline.of(made.recording))
    assert len(excerpts) > 2
    read: list[int] = []
    original = rounds.cut_round

    def cut(segments: dict, *others: object) -> object:
        read.append(len(segments))
        starts = [segment.start_s for segment in segments.values()]
        assert starts == sorted(starts)  # the clock's wander is followed in time
        return original(segments, *others)

    monkeypatch.setattr(rounds, "cut_round", cut)
    config, given = Config(), ArmCalibration(side=made.recording.side)
    with Pool(1, 0) as workers:
        coarse = rounds.self_calibrate(excerpts, given, config, workers)
        assert read[0] == len(excerpts) // 2 and set(read[1:]) == {len(excerpts)}
        monkeypatch.setattr(rounds, "_every_second", lambda excerpts: list(range(len(excerpts))))
        whole = rounds.self_calibrate(excerpts, given, config, workers)
    # rounds end when nothing moves by more than 0.4 sigma; the windows solve all of it again
    for joint, lever in coarse.estimate.lever_arms.items():
        moved_m = lever.position_m - whole.estimate.lever_arms[joint].position_m
        assert (np.abs(moved_m) < 0.5 * lever.sigma_m).all(), joint
    moved_s = coarse.clock.mean_s - whole.clock.mean_s
    assert abs(moved_s) < 0.5 * whole.clock.sigma_s


def test_a_half_that_cannot_be_used_is_no_reason_to_refuse(monkeypatch: pytest.MonkeyPatch) -> None:
    made = arm(5, protocol="random", duration_s=130.0, occlusion_lengths_s=(2.0,), occlusion_every_s=10.0)
    excerpts = informative_excerpts(made.recording, Timeline.of(made.recording))
    unusable = {excerpts[number].start_s for number in rounds._every_second(excerpts)}
    original = rounds.prepare

    def prepare(segment: Segment, *others: object) -> object:
        return None if segment.start_s in unusable else original(segment, *others)  # type: ignore[arg-type]

    monkeypatch.setattr(rounds, "prepare", prepare)
    with Pool(1, 0) as workers:
        given = ArmCalibration(side=made.recording.side)
        assert rounds.self_calibrate(excerpts, given, Config(), workers).estimate.lever_arms
        unusable |= {excerpt.start_s for excerpt in excerpts}
        with pytest.raises(CalibrationError, match="at no time"):
            rounds.self_calibrate(excerpts, given, Config(), workers)
