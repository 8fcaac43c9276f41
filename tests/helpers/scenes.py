"""Simulated recordings, and what the smoother makes of them inside: the one place that knows how."""

from __future__ import annotations

import os
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp
from simulated_points import PointSimulation, simulate_point
from small_window import with_forearm

from smoother import Config, Recovery
from smoother.array_types import FloatArray
from smoother.calibration import ArmCalibration
from smoother.evaluation.validate import Validation, validate
from smoother.graph.solve import WindowOptimum, solution_of
from smoother.recording import Recording
from smoother.simulation import ArmSimulation, SimulatedArm, simulate_arm
from smoother.smoothing import smooth
from smoother.window.problem import Window
from smoother.window.solution import Solution

#: One process: the tests share two cores, and a recording of 30 s is no work.
ALONE = Config.model_validate({"windows": {"processes": 1}})
#: Seeds of the recordings that are recovered with nothing calibrated.
SEEDS = (0, 1)
#: Limits in the gaps, m: 10 seeds gave 0.36 and 0.7 cm (0.54 and 0.84 at worst), so these leave half as
#: much again.
GAP_RMS_M, GAP_MAX_M = 0.008, 0.016
#: A point has one sample a frame instead of three, and gaps of up to 3 s: 0.6 and 1.3 cm at worst.
POINT_RMS_M, POINT_MAX_M = 0.010, 0.020
#: Mean squared error in sigmas of one recording: 1 is consistent. A gap is one draw, so these are wide;
#: tests/core/test_sigmas.py bounds both sides closely over several recordings.
UNDER_CONFIDENT, OVER_CONFIDENT = 0.1, 3.0
#: The field of middle Europe in a frame with z up: 65 degrees down.
FIELD_K = np.array([np.cos(np.radians(65.0)) * np.sin(0.4), 0.0, -np.sin(np.radians(65.0))])
FIELD_K[1] = np.sqrt(1.0 - FIELD_K @ FIELD_K)


@dataclass(frozen=True)
class Scene:
    """A simulated recording and its recovery."""

    made: SimulatedArm
    recovery: Recovery

    @property
    def recording(self) -> Recording:
        return self.made.recording

    @property
    def validation(self) -> Validation:
        assert self.recording.truth is not None
        return validate(self.recovery, self.recording.truth)


@cache
def arm(seed: int = 0, preset: str = "white", **changes: Any) -> SimulatedArm:
    return simulate_arm(ArmSimulation.preset(preset, **changes), seed=seed)


def moving(
    seed: int = 0, preset: str = "realistic", duration_s: float = 30.0, **changes: Any
) -> SimulatedArm:
    """An arm that moves at random."""
    return arm(seed, preset, protocol="random", duration_s=duration_s, **changes)


def point(seed: int = 0, preset: str = "white", **changes: Any) -> SimulatedArm:
    return simulate_point(PointSimulation.preset(preset, **changes), seed=seed)


def answer(recording: Recording, calibration: ArmCalibration | None = None, **more: Any) -> Recovery:
    """What `smooth` makes of a recording, its truth taken away, in this process."""
    return smooth(replace(recording, truth=None), calibration, ALONE, **more)


@cache
def solved(seed: int, preset: str = "realistic", duration_s: float = 30.0) -> Recovery:
    """The answer of an arm that moves at random, nothing calibrated; once a test run."""
    return answer(moving(seed, preset, duration_s).recording)


def recovered(made: SimulatedArm, recording: Recording | None = None) -> Scene:
    """Smooth a simulated recording (or a changed copy of it) with its true calibration."""
    recording = recording or made.recording
    made = replace(made, recording=recording)
    return Scene(made, answer(recording, made.calibration))


def blind(made: SimulatedArm, recording: Recording | None = None) -> Scene:
    """Smooth a simulated recording with nothing calibrated beforehand."""
    made = replace(made, recording=recording or made.recording)
    return Scene(made, answer(made.recording))


def with_field(recording: Recording, extra_A: FloatArray | float = 0.0, noise: float = 0.01) -> Recording:
    """The recording with a calibrated magnetometer that reads the field and something near it."""
    assert recording.truth is not None
    truth = recording.truth
    turn = Slerp(truth.t_s, Rotation.from_quat(truth.quaternion[:, [1, 2, 3, 0]]))
    t = np.clip(recording.imu.t_s, truth.t_s[0], truth.t_s[-1])
    mag = turn(t).inv().apply(FIELD_K) + extra_A
    mag += np.random.default_rng(0).normal(0.0, noise, mag.shape)
    return replace(recording, imu=replace(recording.imu, mag=mag, mag_calibrated=True))


@dataclass(frozen=True)
class Job:
    """The window of a section, with its answer."""

    window: Window
    solution: Solution


def first_window(recording: Recording, calibration: ArmCalibration | None) -> Window:
    """The first section's window as it is solved first, from the camera's start values."""
    given: list[Window] = []

    def listen(window: Window, tolerance: float) -> WindowOptimum:
        given.append(window)
        raise Found

    with suppress(Found), patch("smoother.recovery.solve_section.optimise_window", listen):
        answer(recording, calibration)
    return given[0]


class Found(Exception):
    """What was waited for is there: the rest is of no interest."""


def section_windows(recording: Recording, calibration: ArmCalibration | None) -> list[Job]:
    """The windows that give the answer, one a section, in the order of time."""
    jobs: list[Job] = []

    def listen(optimised: WindowOptimum, with_covariance: bool, **more: Any) -> Solution:
        solution = solution_of(optimised, with_covariance, **more)
        if with_covariance:
            jobs.append(Job(optimised.window, solution))
        return solution

    with patch("smoother.recovery.solve_section.solution_of", listen):
        answer(recording, calibration)
    return jobs


def plain(window: Window, cauchy: float = 1e6) -> Window:
    """The window with white noise only: no robust loss, no impacts, no noise that grows with the motion."""
    increments = replace(window.forearm.increments, velocity_error=np.zeros(len(window.t) - 1))
    noise = replace(window.noise, cauchy=cauchy, accelerometer_share=0.0, gyroscope_share=0.0)
    return with_forearm(replace(window, noise=noise), increments=increments)


def assert_accurate(scene: Scene, rms_m: float = GAP_RMS_M, max_m: float = GAP_MAX_M) -> None:
    found = scene.validation
    assert found.all.unanswered == 0
    assert found.occluded.samples > 100
    assert found.occluded.position_rms_m is not None
    assert found.occluded.position_max_m is not None
    assert found.visible.position_rms_m is not None
    assert found.all.orientation_max_deg is not None
    assert found.occluded.position_rms_m <= rms_m
    assert found.occluded.position_max_m <= max_m
    assert found.visible.position_rms_m <= 0.005  # measured 0.15 to 0.3 cm with 0.8 cm of camera noise
    assert found.all.orientation_max_deg <= 2.5  # measured 0.5 to 1.2


def there(*parts: str) -> Path:
    """A file of the data sets; the test is skipped where it is not."""
    folder = os.environ.get("UNOCCLUDE_DATASETS")
    if not folder:
        pytest.skip("UNOCCLUDE_DATASETS names no folder with BROAD and UTD-MHAD")
    path = Path(folder).joinpath(*parts)
    if not path.exists():
        pytest.skip(f"{path} is not there")
    return path
