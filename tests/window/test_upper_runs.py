"""What a window is given of an upper-arm IMU: start values by way of the chain, its parts beside pauses."""

from __future__ import annotations

from dataclasses import replace
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest
from scenes import ALONE, arm

import smoother.recovery.first_pass
from smoother import smooth
from smoother.linalg import interpolate
from smoother.recording import ImuStream, Recording
from smoother.simulation import SimulatedArm
from smoother.window.nodes import GAP_NODE_CHAIN_S, GAP_NODE_S
from smoother.window.problem import Window
from smoother.window.solution import Solution


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
    assert truth is not None
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
    assert upper is not None
    t = made.recording.arm.t_s
    recording = replace(
        made.recording,
        further_imus={"upper_arm": upper.select((upper.t_s < 12.0) | (upper.t_s > 18.0))},
        arm=made.recording.arm.hide(t > 17.5, ("shoulder", "elbow")),
    )
    windows = first_pass(made, recording)
    starts = [window.t[run.first] for window in windows for run in window.further]
    assert starts and max(starts) < 12.0
