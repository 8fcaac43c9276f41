"""A calibrated magnetometer on BROAD, `magnetometer`: orientation, heading and gaps with it and without."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from calib.imu import calibrate_magnetometer
from smoother.evaluation.gaps import evaluate_gaps
from smoother.evaluation.metrics import rotation_error
from smoother.io import import_broad
from smoother.recording import Recording
from smoother.smoothing import smooth
from tools.accuracy.check import ONLY, check, datasets, rms, seeds_option

#: Gaps to hide, s; the trial that calibrates.
LENGTHS_S, CALIBRATED_ON = (1.0, 3.0), "05_"


def figures(recording: Recording, seed: int) -> list[float]:
    """Orientation and heading error, degrees rms; errors in gaps of each length, cm and degrees."""
    recovery, truth = smooth(replace(recording, truth=None)), recording.truth
    assert truth is not None
    known = np.isfinite(truth.quaternion).all(axis=1) & np.isfinite(recovery.quaternion).all(axis=1)
    known &= truth.score
    error = np.degrees(rotation_error(recovery.quaternion[known], truth.quaternion[known]))
    row = [rms(np.linalg.norm(error, axis=1)), rms(error[:, 2])]
    for length_s in LENGTHS_S:
        table = evaluate_gaps(recording, [length_s], {"graph": smooth}, seed=seed)
        found = table.lengths[length_s]["graph"].figures
        row += [100.0 * (found.position_rms_m or np.nan), found.orientation_rms_deg or np.nan]
    return row


@check(
    ONLY,
    seeds_option("2"),
)
def magnetometer(options: argparse.Namespace) -> Iterator[str]:
    """Orientation, heading and gaps on BROAD, with a calibrated magnetometer and without."""
    trials = sorted(datasets("broad").glob("*.mat"))
    source = next(path for path in trials if path.stem.startswith(CALIBRATED_ON))
    mag = import_broad(source).imu.mag
    assert mag is not None
    calibration = calibrate_magnetometer(mag)
    yield f"calibrated on {source.stem}: {100 * calibration.residual:.1f} % off the sphere"
    for path in (path for path in trials if options.only in path.stem):
        for name in ("without", "with"):
            rows = []
            for seed in options.seeds:
                recording = import_broad(path, seed=seed)
                if name == "with":
                    mag = calibration.apply(recording.imu.mag)
                    recording = replace(recording, imu=replace(recording.imu, mag=mag, mag_calibrated=True))
                rows.append(figures(recording, seed))
            turn, heading, *gaps = np.sqrt(np.mean(np.square(rows), axis=0))
            parts = "   ".join(
                f"{length_s:g} s: {cm:5.2f} cm {deg:5.2f} deg"
                for length_s, cm, deg in zip(LENGTHS_S, gaps[::2], gaps[1::2], strict=True)
            )
            words = f"{path.stem[:34]:34} {name:7}: orientation {turn:5.2f}  heading {heading:5.2f} deg"
            yield f"{words}   {parts}"
