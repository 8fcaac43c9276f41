"""The smoother on data sets of others and on simulated arms: `broad`, `utd`, `arm`, `magnetometer`.

The data sets' folder is in UNOCCLUDE_DATASETS. `magnetometer` is what one brings on BROAD: calibrated on one
trial and used in all. The strap alone is seen (30 Hz, 8 mm of noise), so that the heading comes from
accelerations otherwise. Of every trial: orientation and heading of the whole recovery while the body moves,
and error in hidden gaps.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from calib.imu.magnetometer import MagnetometerCalibration, calibrate_magnetometer
from calib.motion.motion_calibration import calibrate_motion
from smoother.calibration import ArmCalibration
from smoother.cli.config import read_config
from smoother.evaluation.datasets import open_utd, utd_files
from smoother.evaluation.gaps import evaluate_gaps
from smoother.evaluation.metrics import Figures
from smoother.evaluation.validate import sample_errors, validate
from smoother.io import import_broad
from smoother.linalg import interpolate
from smoother.recording import Recording
from smoother.result import Recovery
from smoother.simulation import ArmSimulation, simulate_arm
from smoother.smoothing import smooth
from tools.accuracy.check import (
    CALIBRATED,
    CHANGES,
    CONFIG,
    ONLY,
    SUBJECTS,
    Check,
    changes,
    datasets,
    option,
    preset_option,
    rms,
    seeds_option,
)
from tools.accuracy.more_imus import compare_imus

LENGTHS_S = (0.5, 1.0, 2.0, 3.0)
#: What is seen between two long gaps, about, s.
BETWEEN_GAPS_S = 8.0


class Tally:
    """Squared errors summed over recordings, by gap length or part."""

    def __init__(self) -> None:
        self._sums: dict[object, np.ndarray] = {}
        self._worst: dict[object, float] = {}

    def add(self, key: object, figures: Figures) -> None:
        """Take in a recording's figures."""
        n, deg = figures.samples, figures.orientation_rms_deg or 0.0
        row = np.array([figures.position_rms_m**2 * n, deg**2 * n, figures.nees * n, n])
        self._sums[key] = self._sums.get(key, np.zeros(4)) + row
        self._worst[key] = max(self._worst.get(key, 0.0), figures.position_max_m)

    def show(self) -> Iterator[str]:
        """Print one line per key."""
        for key, (e, d, c, n) in self._sums.items():
            yield (
                f"  {key!s:>10}: rms {100 * np.sqrt(e / n):5.2f} cm  max {100 * self._worst[key]:5.2f} cm"
                f"  orientation {np.sqrt(d / n):5.2f} deg  squared error / sigma^2 {c / n:5.2f}"
            )


def broad(options: argparse.Namespace) -> Iterator[str]:
    """BROAD: the strap alone at 30 Hz with 8 mm of noise, gaps at random."""
    tally, config = Tally(), read_config(options.config)
    for path in sorted(each for each in datasets("broad").glob("*.mat") if options.only in each.stem):
        line, began = [], time.perf_counter()
        for length in LENGTHS_S:
            own = Tally()
            for seed in options.seeds:
                recording = import_broad(path, seed=seed)
                table = evaluate_gaps(
                    recording, [length], {"graph": lambda r: smooth(r, None, config)}, seed=seed
                )
                figures = table.lengths[length]["graph"].figures
                if figures.position_rms_m is None:
                    yield (f"  {path.stem}, seed {seed}, {length:g} s: {'; '.join(table.notes)}")
                    continue
                for each in (own, tally):
                    each.add(f"{length:g} s", figures)
            e, _, c, n = own._sums[f"{length:g} s"]
            line.append(f"{100 * np.sqrt(e / n):5.2f} ({c / n:4.1f})")
        runs = len(LENGTHS_S) * len(options.seeds)
        yield (f"{path.stem[:42]:42} {'  '.join(line)}   {(time.perf_counter() - began) / runs:.1f} s a run")
    yield from tally.show()


def arm(options: argparse.Namespace) -> Iterator[str]:
    """The simulated protocol (behind the head, belly, behind the back), or gaps of given lengths."""
    tally, config = Tally(), read_config(options.config)
    if options.imus == 2:
        options.gap_s = options.gap_s or [3.0, 10.0, 30.0, 60.0]
        yield from compare_imus(options)
        return
    if options.gap_s:
        for length_s in options.gap_s:
            yield from _long_gaps(length_s, options)
        return
    squares: list[np.ndarray] = []
    for seed in options.seeds:
        simulated = simulate_arm(ArmSimulation.preset(options.preset, **changes(options)), seed=seed)
        calibration = simulated.calibration if options.calibrated else None
        blind: Recording = replace(simulated.recording, truth=None)
        began = time.perf_counter()
        recovery = smooth(blind, calibration, config)
        spent = time.perf_counter() - began
        assert simulated.recording.truth is not None
        figures = validate(recovery, simulated.recording.truth)
        for part in ("occluded", "visible"):
            if getattr(figures, part).samples:
                tally.add(part, getattr(figures, part))
        squares.append(sample_errors(recovery, simulated.recording.truth).squared_sigmas[recovery.occluded])
        yield (f"seed {seed:3}: {_parts(figures.to_dict())} {_found(recovery, simulated)} {spent:.1f} s")
    yield from tally.show()
    yield (f"  occluded samples inside the region that should hold  {_coverage(np.concatenate(squares))}")


def _long_gaps(length_s: float, options: argparse.Namespace) -> Iterator[str]:
    """Gaps of one length in random motion: print what they contain, and each gap with `--each`."""
    config, gaps = read_config(options.config), []
    settings: dict[str, Any] = {
        "protocol": "random",
        "duration_s": max(60.0, 2.5 * length_s),
        "occlusion_lengths_s": (length_s,),
        "occlusion_every_s": length_s + BETWEEN_GAPS_S,
    }
    for seed in options.seeds:
        simulated = simulate_arm(
            ArmSimulation.preset(options.preset, **(settings | changes(options))), seed=seed
        )
        truth = simulated.recording.truth
        assert truth is not None
        calibration = simulated.calibration if options.calibrated else None
        recovery = smooth(replace(simulated.recording, truth=None), calibration, config)
        errors = sample_errors(recovery, truth)
        variance = np.trace(recovery.pose_covariance[:, :3, :3], axis1=1, axis2=2)
        for gap in recovery.gaps:
            rows = (recovery.t_s > gap.start_s) & (recovery.t_s < gap.end_s) & errors.scored
            if gap.length_s < 0.5 * length_s or not rows.any():
                continue  # a gap of some frames that the preset makes besides
            gaps.append(
                GapErrors(
                    errors.distance_m[rows],
                    errors.angle_deg[rows],
                    variance[rows],
                    errors.squared_sigmas[rows],
                    errors.turn_squared_sigmas[rows],
                )
            )
            if options.each:
                yield (f"  seed {seed:3} gap {gap.start_s:6.1f} s + {gap.length_s:4.1f} s: {gaps[-1]}")
    if gaps:
        yield from _show_gaps(length_s, gaps)
    else:
        yield (f"{length_s:g} s: no gap")


@dataclass(frozen=True)
class GapErrors:
    """Errors of a gap's samples (n,): m, degrees, and against what is stated."""

    distance_m: np.ndarray
    angle_deg: np.ndarray
    variance_m2: np.ndarray
    squared_sigmas: np.ndarray
    turn_squared_sigmas: np.ndarray

    @property
    def rms_m(self) -> float:
        """Of the position."""
        return float(np.sqrt(np.nanmean(self.distance_m**2)))

    @property
    def sigmas(self) -> float:
        """Position rms over the stated sigma's."""
        return self.rms_m / float(np.sqrt(np.nanmean(self.variance_m2)))

    def __str__(self) -> str:
        return (
            f"rms {100 * self.rms_m:6.2f} cm  max {100 * np.nanmax(self.distance_m):6.2f} cm"
            f"  {self.sigmas:4.1f} sigma  orientation {np.sqrt(np.nanmean(self.angle_deg**2)):5.2f} deg"
            f"  answered {100 * np.isfinite(self.distance_m).mean():.0f} %"
        )


def _show_gaps(length_s: float, gaps: list[GapErrors]) -> Iterator[str]:
    rms, sigmas = (np.array([getattr(gap, name) for gap in gaps]) for name in ("rms_m", "sigmas"))
    distance, angle, squares, turns = (
        np.concatenate([getattr(gap, name) for gap in gaps])
        for name in ("distance_m", "angle_deg", "squared_sigmas", "turn_squared_sigmas")
    )
    yield (
        f"{length_s:g} s, {len(gaps)} gaps: rms {100 * np.sqrt(np.nanmean(distance**2)):.2f} cm"
        f"  worst gap {100 * np.nanmax(rms):.2f} cm  orientation {np.sqrt(np.nanmean(angle**2)):.2f} deg"
        f"  squared error / sigma^2 {np.nanmean(squares) / 3:.2f} (orientation {np.nanmean(turns) / 3:.2f})\n"
        f"    largest rms / sigma of a gap {np.nanmax(sigmas):.1f}, above 4: {np.sum(sigmas > 4)}"
        f"  inside the region  {_coverage(squares, (0.5, 0.95))}"
        f"  (orientation  {_coverage(turns, (0.5, 0.95))})"
    )


def _coverage(squared_sigmas: np.ndarray, shares: tuple[float, ...] = (0.2, 0.4, 0.6, 0.8, 0.95)) -> str:
    """Share of occluded samples inside the regions that should contain a given share."""
    known = squared_sigmas[np.isfinite(squared_sigmas)]
    inside = [(p, np.mean(known <= chi2.ppf(p, df=3))) for p in shares]
    return "   ".join(f"{100 * p:.0f} %: {100 * share:.0f} %" for p, share in inside)


def _parts(figures: dict) -> str:
    return "  ".join(
        f"{part} {100 * figures[part]['position_rms_m']:5.2f} / {100 * figures[part]['position_max_m']:5.2f}"
        f" cm {figures[part]['orientation_rms_deg']:5.2f} deg ({figures[part]['nees']:5.2f})"
        for part in ("occluded", "visible")
        if figures[part]["samples"]
    )


def _found(recovery: Recovery, simulated: object) -> str:
    """Errors of what was calibrated, and the largest in sigmas."""
    truth: ArmCalibration = simulated.calibration  # type: ignore[attr-defined]
    found = recovery.calibration
    assert found is not None
    worst, sigmas = 0.0, 0.0
    for joint, lever in found.lever_arms.items():
        error = lever.position_m - truth.lever_arms[joint].position_m
        worst = max(worst, float(np.linalg.norm(error)))
        sigmas = max(sigmas, float(np.max(np.abs(error) / lever.sigma_m)))
    offset = recovery.clock_offset_s - simulated.parameters["clock_offset_s"]  # type: ignore[attr-defined]
    a, b = found.forearm_direction, truth.forearm_direction
    turn = np.degrees(np.arccos(min(1.0, float(a @ b)))) if a is not None and b is not None else np.nan
    upper = (
        found.upper_arm.value_m - truth.upper_arm.value_m if found.upper_arm and truth.upper_arm else np.nan
    )
    return (
        f"| offset {1e3 * offset:5.1f} ms ({offset / recovery.clock_offset_sigma_s:4.1f} sigma)"
        f" levers {1e3 * worst:4.1f} mm ({sigmas:3.1f} sigma) upper arm {1e3 * upper:5.1f} mm"
        f" direction {turn:3.1f} deg |"
    )


def utd(options: argparse.Namespace) -> Iterator[str]:
    """UTD-MHAD: calibrated on a subject's first trials, a gap in the middle of every other one."""
    folder, config = datasets("utd_mhad"), read_config(options.config)
    rows: list[tuple[float, int, bool, np.ndarray, np.ndarray, float]] = []
    for subject in options.subjects:
        trials = {
            (action, number): open_utd(trial)
            for (whose, action, number), trial in utd_files(folder).items()
            if whose == subject
        }
        first = [recording for (_, t), recording in trials.items() if t == 1]
        found = calibrate_motion(first, None, config)
        yield (f"subject {subject}: {found.calibration}")
        for (action, trial), recording in trials.items():
            if trial == 1:
                continue
            for length in (0.5, 1.0):
                middle = 0.5 * (recording.arm.t_s[0] + recording.arm.t_s[-1])
                hidden = np.abs(recording.arm.t_s - middle) <= 0.5 * length
                seen = recording.arm.tracked("wrist") & hidden
                copy = replace(recording, arm=recording.arm.hide(hidden))
                recovery = smooth(copy, found.calibration, config)
                t = recovery.arm.t_s[seen]
                path, truth = recovery.joints["wrist"], recording.arm.joint("wrist")[seen]
                answer = interpolate(recovery.t_s, path, t)
                sigma = np.sqrt(np.trace(recovery.joint_covariance["wrist"], axis1=1, axis2=2))
                noise = recovery.estimates.camera_sigma_m["wrist"]
                kept = recording.arm.tracked("wrist") & ~hidden
                wrist, frame_t = recording.arm.joint("wrist"), recording.arm.t_s
                line = interpolate(frame_t[kept], wrist[kept], frame_t[seen])
                calm = uniform_filter1d(truth, 5, axis=0)  # without the camera's own noise
                moved = float(np.sum(np.linalg.norm(np.diff(calm, axis=0), axis=1)))
                off, line_off = (np.linalg.norm(each - truth, axis=1) for each in (answer, line))
                stated = np.interp(t, recovery.t_s, sigma)
                inside = off < 2 * np.hypot(stated, np.sqrt(3) * noise)
                rows.append((length, action, moved < 0.30, off, line_off, float(np.nanmax(stated)), inside))
    for length in (0.5, 1.0):
        for name, pick in (("all", lambda r: True), ("slow", lambda r: r[2]), ("fast", lambda r: not r[2])):
            yield from _show_utd(f"{length:g} s {name}", [r for r in rows if r[0] == length and pick(r)])
    for action in sorted({r[1] for r in rows}):
        yield from _show_utd(f"1 s action {action}", [r for r in rows if r[0] == 1.0 and r[1] == action])


def _show_utd(title: str, rows: list) -> Iterator[str]:
    if not rows:
        return
    graph, line = (np.concatenate([r[k] for r in rows]) for k in (3, 4))
    trial = [(rms(r[3]), rms(r[4])) for r in rows]
    yield (
        f"  {title:15}: graph rms {100 * rms(graph):5.1f} median {100 * np.median(graph):5.1f} cm"
        f"   interpolation rms {100 * rms(line):5.1f} median {100 * np.median(line):5.1f} cm   graph nearer"
        f" in {100 * np.mean([g < i for g, i in trial]):3.0f} % of {len(rows)}   median sigma"
        f" {100 * np.median([r[5] for r in rows]):4.1f} cm   inside 2 sigma (camera's noise added)"
        f" {100 * np.mean(np.concatenate([r[6] for r in rows])):3.0f} %"
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


CHECKS = (
    Check("broad", broad, (ONLY, CONFIG, seeds_option("3"))),
    Check(
        "arm",
        arm,
        (
            preset_option("white"),
            CALIBRATED,
            CHANGES,
            option(
                "--gap-s", type=float, nargs="+", metavar="S", help="random motion with such gaps instead"
            ),
            option("--imus", type=int, choices=(1, 2), default=1, help="2: one IMU and two, side by side"),
            option("--at-end", action="store_true", help="with --imus 2: one gap, at the recording's end"),
            option("--each", action="store_true", help="with --gap-s: also print every gap"),
            CONFIG,
            seeds_option("3"),
        ),
    ),
    Check("utd", utd, (SUBJECTS, CONFIG)),
    Check(
        "magnetometer",
        magnetometer,
        (
            ONLY,
            option("--calibrated-on", default="05_", help="trial whose name starts so"),
            option("--lengths", type=float, nargs="*", default=[1.0, 3.0], help="gaps to hide, s"),
            seeds_option("2"),
        ),
    ),
)
