"""Wrong pairs of the project's own presets: the skeleton of one recording with the IMU of another."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from smoother.array_types import FloatArray
from smoother.linalg import runs
from smoother.simulation import ArmSimulation, simulate_arm

from .judging import Interval, Trial

PRESETS = ("white", "realistic", "azure")
#: What the presets' people do: the protocol, and how long.
PROTOCOLS = ("behind", "random")
PRESET_S = 70.0


def preset_pair(preset: str, protocol: str, skeleton_seed: int, imu_seed: int) -> Trial:
    """The skeleton of one simulated arm with the IMU of another one that does the same."""
    config = ArmSimulation.preset(preset, protocol=protocol, repetitions=3, duration_s=PRESET_S)
    one, other = simulate_arm(config, skeleton_seed), simulate_arm(config, imu_seed)
    offset_s = float(one.parameters["clock_offset_s"])
    true_t = one.recording.arm.t_s + offset_s

    def truth_at(t_s: FloatArray) -> dict[str, FloatArray]:
        inside = np.clip(t_s, true_t[0], true_t[-1])
        wrist = np.where((t_s == inside)[:, None], one.motion.joints(inside)["wrist"], np.nan)
        return {"wrist": wrist[None]}

    hidden = tuple(
        Interval(float(true_t[run.start]), float(true_t[run.stop - 1]))
        for run in runs(one.occluded)
        if run.stop - run.start > 3
    )
    recording = replace(one.recording, imu=other.recording.imu, truth=None)
    return Trial(recording, truth_at, hidden, offset_s)


def preset_jobs(count: int, rng: np.random.Generator) -> list[tuple[str, str, int, int]]:
    """As many pairs: preset, protocol, seed of the skeleton, seed of the IMU."""
    return [
        (
            PRESETS[number % len(PRESETS)],
            PROTOCOLS[number % len(PROTOCOLS)],
            int(rng.integers(2**30)),
            int(rng.integers(2**30, 2**31)),
        )
        for number in range(count)
    ]
