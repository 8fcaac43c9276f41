"""Simulated arms with the graph's recovery of them, solved once a test run."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from smoother import Config, Recovery
from smoother.array_types import BoolArray, FloatArray
from smoother.recording import Recording
from smoother.simulation import ArmSimulation, SimulatedArm, simulate_arm
from smoother.smoothing import smooth

ALONE = Config.model_validate({"windows": {"processes": 1}})


@dataclass(frozen=True)
class SolvedArm:
    """A simulated arm, its recording without truth, and the graph's recovery of it."""

    made: SimulatedArm
    recording: Recording
    graph: Recovery

    def errors(self, answer: Recovery) -> FloatArray:
        """Distance (N,) m of the IMU's position from the truth."""
        truth = self.made.recording.truth
        return np.linalg.norm(answer.position - truth.position, axis=1)

    @property
    def occluded(self) -> BoolArray:
        return self.graph.occluded


@cache
def solved_arm(preset: str = "white", seed: int = 0, calibrated: bool = True, **changes: object) -> SolvedArm:
    made = simulate_arm(ArmSimulation.preset(preset, **changes), seed=seed)
    recording = replace(made.recording, truth=None)
    return SolvedArm(made, recording, smooth(recording, made.calibration if calibrated else None, ALONE))


def without_gaps(seed: int = 21) -> SolvedArm:
    """A recording without any error and without a gap."""
    return solved_arm("clean", seed, protocol="random", duration_s=12.0, occlusion_lengths_s=())
