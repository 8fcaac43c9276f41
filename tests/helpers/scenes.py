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
#: Mean squared error in sigmas of one recording: 1 is consistent. A gap is one draw, so this is wide;
#: tests/core/test_accuracy.py bounds both sides closely over several recordings.
OVER_CONFIDENT = 3.0
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


@cache
def point(seed: int = 0, preset: str = "white", **changes: Any) -> SimulatedArm:
    """A point that carries an IMU, in a frame with z up: an arm of which the camera finds the strap alone."""
    often = {"occlusion_lengths_s": (0.5, 1.0, 2.0, 3.0), "occlusion_every_s": 6.0, "camera_frame": "zup"}
    made = moving(seed, preset, **(often | {"strap": True} | changes))
    seen, truth = made.recording.arm, made.recording.truth
    recording = replace(
        made.recording,
        arm=seen.hide(np.ones(len(seen), bool), ("shoulder", "elbow", "wrist", "hand")),
        side="",
        truth=replace(truth, joints={"strap": truth.position}),
    )
    return replace(made, recording=recording, calibration=ArmCalibration())


def answer(recording: Recording, calibration: ArmCalibration | None = None, **more: Any) -> Recovery:
    """What `smooth` makes of a recording, its truth taken away, in this process."""
    return smooth(replace(recording, truth=None), calibration, ALONE, **more)


@cache
def solved(seed: int, preset: str = "realistic", duration_s: float = 30.0) -> Recovery:
    """The answer of an arm that moves at random, nothing calibrated; once a test run."""
    return answer(moving(seed, preset, duration_s).recording)


@cache
def solved_arm(preset: str = "white", seed: int = 0, **changes: Any) -> Scene:
    """A simulated arm and its recovery with the true calibration; once a test run."""
    return recovered(arm(seed, preset, **changes))


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


def section_windows(recording: Recording, calibration: ArmCalibration | None) -> list[Window]:
    """The windows that give the answer, one a section, in the order of time."""
    windows: list[Window] = []

    def listen(optimised: WindowOptimum, with_covariance: bool, **more: Any) -> Solution:
        windows.extend([optimised.window] * with_covariance)
        return solution_of(optimised, with_covariance, **more)

    with patch("smoother.recovery.solve_section.solution_of", listen):
        answer(recording, calibration)
    return windows


def there(*parts: str) -> Path:
    """A file of the data sets; the test is skipped where it is not."""
    folder = os.environ.get("UNOCCLUDE_DATASETS")
    if not folder:
        pytest.skip("UNOCCLUDE_DATASETS names no folder with BROAD and UTD-MHAD")
    path = Path(folder).joinpath(*parts)
    if not path.exists():
        pytest.skip(f"{path} is not there")
    return path
