"""Where the truth ranks among motions drawn from the posterior: `draws --gaps 200`.

Simulation-based calibration (Talts et al., arXiv:1804.06788, 2018): if the posterior is right, the truth's
rank among the draws is uniform. One sample a gap, at a random time and along a random direction, so that the
ranks are nearly independent. A spread below 1 means that sigma is too wide (ranks pile up in the middle),
above 1 that it is too narrow.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.stats import chisquare, norm

from smoother.calibration import ArmCalibration
from smoother.result import Recovery
from smoother.simulation import ArmSimulation, SimulatedArm, simulate_arm
from smoother.smoothing import smooth
from tools.accuracy.check import ONE_PROCESS, PRESETS, Check, option

#: With one draw less than a multiple of the bins all bins hold as many ranks.
DRAWS, BINS = 63, 16
#: Shorter gaps are interpolation between two frames, s.
SHORTEST_S = 0.3
SETTINGS = {"protocol": "random", "duration_s": 60.0}


def ranks_of(preset: str, seed: int, exact: bool) -> Iterator[dict[str, int]]:
    """The truth's rank in each gap of a simulated recording, by quantity."""
    made = simulate_arm(ArmSimulation.preset(preset, **SETTINGS), seed=seed)
    rng = np.random.default_rng([seed, 1])
    calibration = made.calibration if exact else as_measured(made.calibration, rng)
    recovery = smooth(replace(made.recording, truth=None), calibration, ONE_PROCESS, draws=DRAWS, seed=seed)
    assert recovery.draws is not None
    for gap in recovery.gaps:
        inside = np.flatnonzero((recovery.draws.t_s > gap.start_s) & (recovery.draws.t_s < gap.end_s))
        if gap.length_s >= SHORTEST_S and len(inside):
            yield ranks_at(recovery, made, int(rng.choice(inside)), rng)


def as_measured(calibration: ArmCalibration, rng: np.random.Generator) -> ArmCalibration:
    """A calibration with errors as large as its sigmas."""
    levers = {
        joint: replace(lever, position_m=rng.normal(lever.position_m, lever.sigma_m))
        for joint, lever in calibration.lever_arms.items()
    }
    length = calibration.upper_arm
    if length is not None:
        length = replace(length, value_m=float(rng.normal(length.value_m, length.sigma_m)))
    return replace(calibration, lever_arms=levers, upper_arm=length)


def ranks_at(recovery: Recovery, made: SimulatedArm, row: int, rng: np.random.Generator) -> dict[str, int]:
    """Ranks at a drawn time, along a random direction."""
    draws, truth = recovery.draws, made.recording.truth
    assert draws is not None and truth is not None
    at = int(np.argmin(np.abs(recovery.t_s - draws.t_s[row])))
    there = int(np.argmin(np.abs(truth.t_s - draws.t_s[row])))
    turn = Rotation.from_quat(truth.quaternion[there], scalar_first=True)
    turn = turn * Rotation.from_quat(recovery.quaternion[at], scalar_first=True).inv()
    errors = {"position": (draws.position[:, row], truth.position[there] - recovery.position[at])}
    errors["rotation"] = (draws.rotation[:, row], turn.as_rotvec())
    for joint, drawn in draws.joints.items():
        if joint in truth.joints:
            errors[joint] = (drawn[:, row], truth.joints[joint][there] - recovery.joints[joint][at])
    ranks = {}
    for name, (drawn, error) in errors.items():
        along = rng.normal(size=3)
        ranks[name] = int(np.count_nonzero(drawn @ along < error @ along))
    if {"shoulder", "elbow", "wrist"} <= errors.keys():
        answer = {joint: recovery.joints[joint][at] for joint in ("shoulder", "elbow", "wrist")}
        drawn_flexion = flexion(*(answer[joint] + errors[joint][0] for joint in answer))
        ranks["flexion"] = int(
            np.count_nonzero(drawn_flexion < flexion(*(answer[joint] + errors[joint][1] for joint in answer)))
        )
    return ranks


def flexion(shoulder: np.ndarray, elbow: np.ndarray, wrist: np.ndarray) -> np.ndarray:
    """Angle between upper arm and forearm, rad."""
    upper, fore = elbow - shoulder, wrist - elbow
    across = np.linalg.norm(np.cross(upper, fore), axis=-1)
    return np.arctan2(across, (upper * fore).sum(axis=-1))


def line(name: str, ranks: np.ndarray) -> str:
    """Chi-square of a quantity's ranks, their spread as a normal's, and the histogram."""
    histogram = np.bincount(ranks * BINS // (DRAWS + 1), minlength=BINS)
    spread = float(np.std(norm.ppf((ranks + 0.5) / (DRAWS + 1))))
    p = chisquare(histogram).pvalue
    inside = np.mean((ranks >= 0.025 * DRAWS) & (ranks <= 0.975 * DRAWS))
    return (
        f"  {name:9} n {len(ranks)}  p {p:6.3f}  spread {spread:4.2f}"
        f"  in the 95 % interval {100 * inside:3.0f} %  {' '.join(map(str, histogram))}"
    )


def draws(options: argparse.Namespace) -> Iterator[str]:
    """The truth's rank among motions drawn from the posterior, by preset and quantity."""
    for preset in options.presets:
        ranks: dict[str, list[int]] = {}
        seed, count = options.first_seed, 0
        while count < options.gaps:
            for of_gap in ranks_of(preset, seed, options.exact):
                count += 1
                for name, rank in of_gap.items():
                    ranks.setdefault(name, []).append(rank)
            seed += 1
        recordings = f"{seed - options.first_seed} recordings of {SETTINGS['duration_s']} s"
        yield f"{preset}: {count} gaps of {recordings}"
        for name, found in ranks.items():
            yield line(name, np.array(found[: options.gaps]))


CHECKS = (
    Check(
        "draws",
        draws,
        (
            option("presets", nargs="*", default=PRESETS),
            option("--gaps", type=int, default=200),
            option("--first-seed", type=int, default=0),
            option(
                "--exact",
                action="store_true",
                help="give the true calibration, not one as uncertain as it says",
            ),
        ),
    ),
)
