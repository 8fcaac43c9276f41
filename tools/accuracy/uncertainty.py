"""Whether the stated uncertainty holds: `coverage` and `draws`.

`coverage SOURCE ..`, for position, orientation and elbow flexion in gaps: squared error over variance, and
how many samples lie inside the regions that should contain 50 and 95 %. Sources are simulated presets and
public data sets. The only reference in UTD-MHAD is its camera: the hidden samples of the wrist are used, with
the camera's noise added, per subject and for all; all samples and trusted ones, with the calibration's sigma
factors and without.

`draws --gaps 200`: where the truth ranks among motions drawn from the posterior. Simulation-based calibration
(Talts et al., arXiv:1804.06788, 2018): if the posterior is right, the truth's rank among the draws is
uniform. One sample per gap, at a random time and along a random direction, so that the ranks are nearly
independent. A spread below 1 means that sigma is too wide (ranks pile up in the middle), above 1 that it is
too narrow.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.stats import chi2, chisquare, norm

from calib.motion.motion_calibration import calibrate_motion
from smoother.calibration import ArmCalibration
from smoother.evaluation.datasets import open_utd, utd_files
from smoother.evaluation.hidden_gaps import place_gaps
from smoother.evaluation.metrics import squared_sigmas, truth_at
from smoother.evaluation.validate import sample_errors
from smoother.io import import_broad
from smoother.joint_angles import arm_angles, elbow_flexion_sigma, recovery_angles
from smoother.linalg import interpolate
from smoother.recording import Recording
from smoother.result import Recovery
from smoother.simulation import ArmSimulation, SimulatedArm, simulate_arm
from smoother.smoothing import smooth
from tools.accuracy.check import ONE_PROCESS, PRESETS, SUBJECTS, Check, datasets, option, seeds_option

LENGTHS_S = (0.5, 1.0, 2.0, 3.0)
UTD_LENGTHS_S = (0.5, 1.0)
#: Gaps of a length in a trial of BROAD.
GAPS = 8


@dataclass(frozen=True)
class Squares:
    """Squared errors in sigmas of a quantity, and its degrees of freedom."""

    part: str
    quantity: str
    freedom: int
    values: np.ndarray


def _of_truth(recovery: Recovery, recording: Recording, part: str, rows: np.ndarray) -> list[Squares]:
    """What a recovery's rows (n,) are off the recording's truth."""
    truth = recording.truth
    assert truth is not None
    errors = sample_errors(recovery, truth)
    squares = [
        Squares(part, "position", 3, errors.squared_sigmas[rows]),
        Squares(part, "orientation", 3, errors.turn_squared_sigmas[rows]),
    ]
    reference = truth_at(truth, recovery.t_s)
    if {"shoulder", "elbow", "wrist"} <= set(reference.joints):
        true = arm_angles(reference.joints, len(recovery))["elbow_flexion"]
        off = recovery_angles(recovery)["elbow_flexion"] - true
        squares.append(Squares(part, "elbow flexion", 1, ((off / elbow_flexion_sigma(recovery)) ** 2)[rows]))
    return squares


def _simulated(seed: int, preset: str) -> list[Squares]:
    recording = simulate_arm(ArmSimulation.preset(preset), seed=seed).recording
    recovery = smooth(replace(recording, truth=None), processes=1)
    return _of_truth(recovery, recording, preset, recovery.occluded)


def _broad(job: tuple[str, int]) -> list[Squares]:
    path, seed = job
    recording = import_broad(path, seed=seed)
    squares = []
    for length in LENGTHS_S:
        gaps = place_gaps(recording, length, np.random.default_rng(seed), count=GAPS)
        rows = np.any([gap.contains(recording.arm.t_s) for gap in gaps], axis=0)
        recovery = smooth(replace(recording, arm=recording.arm.hide(rows), truth=None), processes=1)
        squares += _of_truth(recovery, recording, f"broad {length:g} s", recovery.occluded)
    return squares


def _utd(recording: Recording, calibration: ArmCalibration, subject: int) -> list[Squares]:
    arm, squares = recording.arm, []
    middle = 0.5 * (arm.t_s[0] + arm.t_s[-1])
    unscaled = replace(calibration, sigma_factors=None)
    for length in UTD_LENGTHS_S:
        hidden = np.abs(arm.t_s - middle) <= 0.5 * length
        for name, given in (("wrist", calibration), ("no factor", unscaled)):
            recovery = smooth(replace(recording, arm=arm.hide(hidden)), given, processes=1)
            seen = arm.tracked("wrist") & hidden
            t = recovery.arm.t_s[seen]
            off = interpolate(recovery.t_s, recovery.joints["wrist"], t) - arm.joint("wrist")[seen]
            noise = (recovery.estimates.camera_sigma_m or {})["wrist"]
            covariance = interpolate(recovery.t_s, recovery.joint_covariance["wrist"], t)
            values = squared_sigmas(off, covariance + noise**2 * np.eye(3))
            trusted = np.interp(t, recovery.t_s, recovery.trusted) > 0.5
            for quantity, rows in ((name, slice(None)), (f"{name}, trusted", trusted)):
                for who in (str(subject), "all"):
                    squares.append(Squares(f"utd {who} {length:g} s", quantity, 3, values[rows]))
    return squares


def _trials(subject: int) -> dict[tuple[int, int], Recording]:
    return {
        (action, number): open_utd(trial)
        for (whose, action, number), trial in utd_files(datasets("utd_mhad")).items()
        if whose == subject
    }


def _jobs(source: str, options: argparse.Namespace) -> Iterator[tuple[Callable, Iterable]]:
    if source in PRESETS:
        yield partial(_simulated, preset=source), options.seeds
    elif source == "broad":
        yield (
            _broad,
            [(str(path), s) for path in sorted(datasets("broad").glob("*.mat")) for s in options.seeds],
        )
    else:
        for subject in options.subjects:
            trials = _trials(subject)
            first = [recording for (_, trial), recording in trials.items() if trial == 1]
            calibration = calibrate_motion(first).calibration
            yield (
                partial(_utd, calibration=calibration, subject=subject),
                [recording for (_, trial), recording in trials.items() if trial != 1],
            )


def coverage(options: argparse.Namespace) -> Iterator[str]:
    """Stated uncertainty against error in gaps, by source and quantity."""
    yield (f"{'':16} {'':18} samples  squared error / sigma^2  inside 50 %  inside 95 %")
    with ProcessPoolExecutor(os.cpu_count()) as workers:
        for source in options.sources:
            squares: list[Squares] = []
            for function, jobs in _jobs(source, options):
                squares += [each for answer in workers.map(function, jobs) for each in answer]
            yield from _show(squares)


def _show(squares: list[Squares]) -> Iterator[str]:
    for part, quantity, freedom in dict.fromkeys((s.part, s.quantity, s.freedom) for s in squares):
        values = np.concatenate([s.values for s in squares if (s.part, s.quantity) == (part, quantity)])
        values = values[np.isfinite(values)]
        half, most = (100 * np.mean(values <= chi2.ppf(p, freedom)) for p in (0.5, 0.95))
        yield (
            f"{part:16} {quantity:18} {len(values):7} {np.mean(values) / freedom:12.2f}"
            f" {half:21.0f} % {most:10.0f} %"
        )


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
        "coverage",
        coverage,
        (option("sources", nargs="+", choices=(*PRESETS, "broad", "utd")), SUBJECTS, seeds_option("3")),
    ),
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
                help="give the true calibration, not one with errors as stated",
            ),
        ),
    ),
)
