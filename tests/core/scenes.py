"""Simulated recordings, and what the smoother makes of them inside: the one place that knows how."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any
from unittest.mock import patch

import numpy as np

import smoother.solve
from smoother import Config, Recovery, smooth
from smoother.calibration import ArmCalibration
from smoother.evaluation import Validation, validate
from smoother.recording import BoolArray, Recording
from smoother.simulation import ArmSimulation, PointSimulation, SimulatedArm, simulate_arm, simulate_point
from smoother.window import Solution, Window

#: One process: the tests share two cores, and a recording of 30 s is no work.
ALONE = Config.model_validate({"windows": {"processes": 1}})


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


def arm(seed: int = 0, preset: str = "white", **changes: Any) -> SimulatedArm:
    return simulate_arm(ArmSimulation.preset(preset, **changes), seed=seed)


def point(seed: int = 0, preset: str = "white", **changes: Any) -> SimulatedArm:
    return simulate_point(PointSimulation.preset(preset, **changes), seed=seed)


def recovered(made: SimulatedArm, recording: Recording | None = None) -> Scene:
    """Smooth a simulated recording (or a changed copy of it) with its true calibration."""
    recording = recording or made.recording
    made = replace(made, recording=recording)
    return Scene(made, smooth(replace(recording, truth=None), made.calibration, ALONE))


def blind(made: SimulatedArm, recording: Recording | None = None) -> Scene:
    """Smooth a simulated recording with nothing calibrated beforehand."""
    made = replace(made, recording=recording or made.recording)
    return Scene(made, smooth(replace(made.recording, truth=None), None, ALONE))


def without_frames(recording: Recording, hidden: BoolArray) -> Recording:
    """The same recording, the forearm not tracked in the hidden frames (F,)."""
    return replace(recording, arm=recording.arm.hide(hidden))


@dataclass(frozen=True)
class Job:
    """One window that was solved on the way, with its answer."""

    window: Window
    with_covariance: bool
    solution: Solution


def jobs(recording: Recording, calibration: ArmCalibration, config: Config = ALONE) -> list[Job]:
    """Every window that `smooth` solves, pass by pass, by listening at the solver."""
    heard: list[Job] = []
    solve = smoother.solve.solve

    def listen(window: Window, with_covariance: bool, **more: Any) -> Solution:
        solution = solve(window, with_covariance, **more)
        heard.append(Job(window, with_covariance, solution))
        return solution

    with patch("smoother.passes.solve", listen), patch("smoother.selfcal.solve", listen):
        smooth(replace(recording, truth=None), calibration, config)
    return heard


def last_pass(recording: Recording, calibration: ArmCalibration, config: Config = ALONE) -> list[Job]:
    """The windows of the pass that gives the answer, in the order of time."""
    return [job for job in jobs(recording, calibration, config) if job.with_covariance]


def plain(window: Window, cauchy: float = 1e6) -> Window:
    """The window with white noise only: no robust loss, no knocks, no noise that grows with the motion."""
    inertia = replace(window.inertia, velocity_error=np.zeros(len(window.t) - 1))
    noise = replace(window.noise, cauchy=cauchy, accelerometer_share=0.0, gyroscope_share=0.0)
    return replace(window, noise=noise, inertia=inertia)
