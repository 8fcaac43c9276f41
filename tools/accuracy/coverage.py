"""Stated uncertainty against error in gaps: `coverage SOURCE ..`.

For position, orientation and elbow flexion: squared error over variance, and how many samples lie inside the
regions that should hold 50 and 95 of 100. Sources are simulated presets and data sets of others; of UTD-MHAD,
whose only truth is its camera, the wrist's hidden samples count, with the camera's noise added.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.stats import chi2

from calib.motion.motion_calibration import calibrate_motion
from smoother.calibration import ArmCalibration
from smoother.evaluation.align import truth_at
from smoother.evaluation.hidden_gaps import place_gaps
from smoother.evaluation.metrics import squared_sigmas
from smoother.evaluation.validate import sample_errors
from smoother.io import import_broad, import_utd_mhad
from smoother.joint_angles import arm_angles, elbow_flexion_sigma, recovery_angles
from smoother.linalg import interpolate
from smoother.recording import Recording
from smoother.result import Recovery
from smoother.simulation import ArmSimulation, simulate_arm
from smoother.smoothing import smooth
from tools.accuracy.check import PRESETS, SUBJECTS, Check, datasets, option, seeds_option

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
    for length in UTD_LENGTHS_S:
        hidden = np.abs(arm.t_s - middle) <= 0.5 * length
        recovery = smooth(replace(recording, arm=arm.hide(hidden)), calibration, processes=1)
        seen = arm.tracked("wrist") & hidden
        t = recovery.arm.t_s[seen]
        off = interpolate(recovery.t_s, recovery.joints["wrist"], t) - arm.joint("wrist")[seen]
        noise = (recovery.estimates.camera_sigma_m or {})["wrist"]
        covariance = interpolate(recovery.t_s, recovery.joint_covariance["wrist"], t) + noise**2 * np.eye(3)
        squares.append(Squares(f"utd {subject} {length:g} s", "wrist", 3, squared_sigmas(off, covariance)))
    return squares


def _trials(subject: int) -> dict[tuple[int, int], Recording]:
    folder = datasets("utd_mhad")
    return {
        (action, trial): import_utd_mhad(
            inertial, folder / "Skeleton" / inertial.name.replace("inertial", "skeleton")
        )
        for action in range(1, 22)
        for trial in range(1, 5)
        if (inertial := folder / "Inertial" / f"a{action}_s{subject}_t{trial}_inertial.mat").exists()
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
    yield (f"{'':16} {'':14} samples  squared error / sigma^2  inside 50 %  inside 95 %")
    with ProcessPoolExecutor(os.cpu_count()) as workers:
        for source in options.sources:
            for function, jobs in _jobs(source, options):
                yield from _show([each for answer in workers.map(function, jobs) for each in answer])


def _show(squares: list[Squares]) -> Iterator[str]:
    for part, quantity, freedom in dict.fromkeys((s.part, s.quantity, s.freedom) for s in squares):
        values = np.concatenate([s.values for s in squares if (s.part, s.quantity) == (part, quantity)])
        values = values[np.isfinite(values)]
        half, most = (100 * np.mean(values <= chi2.ppf(p, freedom)) for p in (0.5, 0.95))
        yield (
            f"{part:16} {quantity:14} {len(values):7} {np.mean(values) / freedom:12.2f}"
            f" {half:21.0f} % {most:10.0f} %"
        )


CHECKS = (
    Check(
        "coverage",
        coverage,
        (option("sources", nargs="+", choices=(*PRESETS, "broad", "utd")), SUBJECTS, seeds_option("3")),
    ),
)
