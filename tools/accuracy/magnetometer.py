"""A calibrated magnetometer on BROAD, `magnetometer`: orientation, heading and gaps with it and without."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from calib.imu import MagnetometerCalibration, calibrate_magnetometer
from smoother.evaluation.gaps import evaluate_gaps
from smoother.io import import_broad
from smoother.recording import Recording
from smoother.result import Recovery
from smoother.smoothing import smooth
from tools.accuracy.check import (
    ONLY,
    check,
    datasets,
    option,
    rms,
    seeds_option,
)


def corrected(recording: Recording, found: MagnetometerCalibration) -> Recording:
    """The recording with its magnetometer corrected."""
    assert recording.imu.mag is not None
    imu = replace(recording.imu, mag=found.apply(recording.imu.mag), mag_calibrated=True)
    return replace(recording, imu=imu)


def attitude(recovery: Recovery, recording: Recording) -> tuple[float, float]:
    """Orientation and heading error, degrees rms over the samples to score on."""
    truth = recording.truth
    assert truth is not None
    known = np.isfinite(truth.quaternion).all(axis=1) & np.isfinite(recovery.quaternion).all(axis=1)
    known &= truth.score
    turn = [
        Rotation.from_quat(each[known][:, [1, 2, 3, 0]]) for each in (recovery.quaternion, truth.quaternion)
    ]
    error = np.degrees((turn[0] * turn[1].inv()).as_rotvec())
    return rms(np.linalg.norm(error, axis=1)), rms(error[:, 2])


def trial(path: Path, found: MagnetometerCalibration, options: argparse.Namespace) -> Iterator[str]:
    """Both ways over one trial, a line each."""
    for name in ("without", "with"):
        notes: tuple[str, ...] = ()
        rows: list[list[float]] = [[] for _ in range(2 + 2 * len(options.lengths))]
        for seed in options.seeds:
            recording = import_broad(path, seed=seed)
            if name == "with":
                recording = corrected(recording, found)
            recovery = smooth(replace(recording, truth=None))
            notes = tuple(note for note in recovery.notes if "magnetometer" in note)
            for k, value in enumerate(attitude(recovery, recording)):
                rows[k].append(value)
            for k, length in enumerate(options.lengths):
                table = evaluate_gaps(recording, [length], {"graph": smooth}, seed=seed)
                figures = table.lengths[length]["graph"].figures
                rows[2 + 2 * k].append(100.0 * (figures.position_rms_m or np.nan))
                rows[3 + 2 * k].append(figures.orientation_rms_deg or np.nan)
        mean = [rms(row) for row in rows]
        parts = [
            f"{length:g} s: {mean[2 + 2 * k]:5.2f} cm {mean[3 + 2 * k]:5.2f} deg"
            for k, length in enumerate(options.lengths)
        ]
        yield (
            f"{path.stem[:34]:34} {name:7}: orientation {mean[0]:5.2f}  heading {mean[1]:5.2f} deg   "
            f"{'   '.join(parts)}   {' '.join(notes)}"
        )


@check(
    ONLY,
    option("--calibrated-on", default="05_", help="trial whose name starts so"),
    option("--lengths", type=float, nargs="*", default=[1.0, 3.0], help="gaps to hide, s"),
    seeds_option("2"),
)
def magnetometer(options: argparse.Namespace) -> Iterator[str]:
    """Orientation, heading and gaps on BROAD, with a calibrated magnetometer and without."""
    trials = sorted(datasets("broad").glob("*.mat"))
    source = next(path for path in trials if path.stem.startswith(options.calibrated_on))
    mag = import_broad(source).imu.mag
    assert mag is not None
    found = calibrate_magnetometer(mag)
    yield f"calibrated on {source.stem}: {100 * found.residual:.1f} % off the sphere"
    for path in trials:
        if options.only in path.stem:
            yield from trial(path, found, options)
