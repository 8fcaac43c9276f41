"""Real people as judges: `python -m tools.reliability.real smartfallmm|utd [--lengths 0.5 1] [--seed S]`.

Elbow, wrist and hand are hidden for a while in a trial, and the answer is held against what the camera saw
there. SmartFallMM's trials (Azure Kinect and a MetaMotion, cut apart by hand) are imported as a user imports
files, so that the importer's information on their clocks goes with them; of UTD-MHAD's the arm's calibration
comes from the subject's first trials. (`python -m tools.accuracy coverage utd` prints the regions of all
trials, `.. coverage broad` those of BROAD, orientation too.) `--pairs` gives every skeleton somebody else's
IMU: none may be trusted.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation

from calib.motion.motion_calibration import calibrate_motion
from smoother.array_types import BoolArray, FloatArray
from smoother.calibration import ArmCalibration
from smoother.errors import UnoccludeError
from smoother.evaluation.datasets import BenchmarkTrial, imported, open_utd, smartfallmm_trials, utd_files
from smoother.linalg import interpolate, unit
from smoother.measurements.visibility import accepted_samples, visible_frames
from smoother.recording import Recording
from smoother.result import Recovery
from smoother.smoothing import smooth

from .judging import CHI2_95, ONE_PROCESS, TooSlow, time_limit, trusted_samples

#: An answer that is farther off than this must not be trusted, m.
WRONG_M = 0.10
#: What stays visible on each side of a hidden stretch, s.
SIDE_S = 0.8
#: Two ways to find a clock agree within this, and an answer has found it within this, s.
KNOWN_S, FOUND_S = 0.15, 0.25
#: Shifts to try, s; what each way must explain, and how slow it looks, s.
SHIFTS_S = np.arange(-6.0, 6.0, 0.04)
EXPLAINED, SLOW_S = 0.5, 0.10
#: Axes of the sensor that the forearm may lie along, spread evenly over half a sphere.
_STEPS = np.arange(60) + 0.5
_POLAR, _AZIMUTH = np.arccos(1.0 - _STEPS / 60), np.pi * (1.0 + np.sqrt(5.0)) * _STEPS
AXES = np.stack(
    [np.cos(_AZIMUTH) * np.sin(_POLAR), np.sin(_AZIMUTH) * np.sin(_POLAR), np.cos(_POLAR)], axis=1
)


def datasets(name: str) -> Path:
    """One of the folders of recordings that others made."""
    folder = os.environ.get("UNOCCLUDE_DATASETS")
    if not folder:
        sys.exit("set UNOCCLUDE_DATASETS to the folder of the data sets")
    return Path(folder) / name


@dataclass(frozen=True)
class RealTrial:
    """A trial's name, its recording and a calibration of its arm."""

    name: str
    recording: Recording
    calibration: ArmCalibration | None = None


def smartfallmm_names() -> list[str]:
    """Trials that have a skeleton and both sensors of the MetaMotion."""
    return [trial.name for trial in smartfallmm_trials(datasets("smartfallmm"))]


def smartfallmm_trial(skeleton: str, imu: str = "") -> RealTrial:
    """A trial as `unocclude import files` makes it, with its own IMU or another trial's."""
    trials = {trial.name: trial for trial in smartfallmm_trials(datasets("smartfallmm"))}
    recording = imported(skeleton, trials[skeleton].files[0], trials[imu or skeleton].files[1:])
    return RealTrial(f"{skeleton} with {imu}" if imu else skeleton, recording)


@cache
def _utd_calibration(subject: int) -> ArmCalibration:
    first = [_utd_recording(action, subject, 1) for action in range(1, 22)]
    return calibrate_motion([each for each in first if each is not None]).calibration


def _utd_recording(action: int, subject: int, trial: int) -> Recording | None:
    found = _utd_files().get((subject, action, trial))
    return None if found is None else open_utd(found)


@cache
def _utd_files() -> dict[tuple[int, int, int], BenchmarkTrial]:
    return utd_files(datasets("utd_mhad"))


def utd_trials(count: int, rng: np.random.Generator) -> list[RealTrial]:
    """Trials 2 to 4 of a subject of the draw, with the calibration of the subject's first trials."""
    subject = int(rng.integers(1, 5))
    drawn = rng.permutation([(action, trial) for action in range(1, 22) for trial in (2, 3, 4)])
    found: list[RealTrial] = []
    for action, trial in drawn[:count]:
        recording = _utd_recording(int(action), subject, int(trial))
        if recording is not None:
            found.append(RealTrial(recording.name, recording, _utd_calibration(subject)))
    return found


# --- judging


@dataclass(frozen=True)
class HiddenStretch:
    """How the answer in a hidden stretch compares with the camera's hidden samples."""

    name: str  # Of the trial
    length_s: float
    # Rms of the wrist's error and of a straight line's, and what is stated (3D, with the camera's noise)
    error_m: float = float("nan")
    # Rms of the wrist's error and of a straight line's, and what is stated (3D, with the camera's noise)
    line_m: float = float("nan")
    # Rms of the wrist's error and of a straight line's, and what is stated (3D, with the camera's noise)
    sigma_m: float = float("nan")
    inside: float = float("nan")  # Share of the samples in the 95 % region
    trusted: bool = False
    clock_s: float = float("nan")  # Offset that the answer found, less the known one
    reason: str = ""  # The first one, or the error that it ended with
    seconds: float = float("nan")  # s: that `smooth` took

    def show(self) -> None:
        """Print a row."""
        mark = "WRONG AND TRUSTED " if self.trusted and self.error_m > WRONG_M else ""
        print(
            f"{self.name:26} {self.length_s:4.1f} s {100 * self.error_m:6.1f} cm,"
            f" line {100 * self.line_m:6.1f} cm, stated {100 * self.sigma_m:6.1f} cm,"
            f" inside {100 * self.inside:4.0f} %  {'trusted' if self.trusted else 'not':8}"
            f" clock {self.clock_s:+6.2f} s  {mark}{self.reason[:110]}",
            flush=True,
        )


def hidden_rows(recording: Recording, length_s: float, rng: np.random.Generator) -> BoolArray | None:
    """(F,) frames to hide: a stretch in the middle of what is seen; None where the trial is too short."""
    t_s = recording.arm.t_s[visible_frames(recording.arm, accepted_samples(recording.arm))]
    if len(t_s) < 10 or t_s[-1] - t_s[0] < length_s + 2 * SIDE_S:
        return None
    start_s = rng.uniform(t_s[0] + SIDE_S, t_s[-1] - SIDE_S - length_s)
    rows = (recording.arm.t_s >= start_s) & (recording.arm.t_s < start_s + length_s)
    return rows if (recording.arm.tracked("wrist") & rows).sum() >= 5 else None


def compared(trial: RealTrial, rows: BoolArray, length_s: float, known_s: float = np.nan) -> HiddenStretch:
    """Hide the frames, recover them, and compare."""
    recording, began = trial.recording, time.process_time()
    arm = recording.arm
    try:
        with time_limit(recording):
            recovery = smooth(
                replace(recording, arm=arm.hide(rows), truth=None), trial.calibration, ONE_PROCESS
            )
    except (UnoccludeError, TooSlow) as refusal:
        return HiddenStretch(trial.name, length_s, reason=str(refusal))
    seconds = time.process_time() - began
    seen = arm.tracked("wrist") & rows
    true, t_s = arm.joint("wrist")[seen], recovery.arm.t_s[seen]
    line = interpolate(
        arm.t_s[arm.tracked("wrist") & ~rows], arm.joint("wrist")[arm.tracked("wrist") & ~rows], arm.t_s
    )
    trusted = _at(recovery, trusted_samples(recovery).astype(float), t_s) > 0.5
    known = (t_s >= recovery.t_s[0]) & (t_s <= recovery.t_s[-1])
    if not known.any():
        return HiddenStretch(trial.name, length_s, reason="the answer's clock leaves nothing of the stretch")
    error = (_at(recovery, recovery.joints["wrist"], t_s) - true)[known]
    noise_m = (recovery.estimates.camera_sigma_m or {}).get("wrist", 0.0)
    covariance = _at(recovery, recovery.joint_covariance["wrist"], t_s)[known] + noise_m**2 * np.eye(3)
    squares = np.einsum("ni,ni->n", error, np.linalg.solve(covariance, error[:, :, None])[:, :, 0])
    estimates = recovery.estimates
    reasons = (*estimates.reasons, *(reason for gap in recovery.gap_verdicts for reason in gap.reasons))
    return HiddenStretch(
        trial.name,
        length_s,
        _rms(error),
        _rms((line[seen] - true)[known]),
        float(np.sqrt(np.trace(covariance, axis1=1, axis2=2).mean())),
        float(np.mean(squares <= CHI2_95)),
        bool(trusted.mean() > 0.5),
        recovery.clock_offset_s - known_s,
        next(iter((*reasons, *estimates.cautions)), ""),
        seconds,
    )


def _at(recovery: Recovery, values: FloatArray, t_s: FloatArray) -> FloatArray:
    return interpolate(recovery.t_s, values, t_s)


def _rms(error: FloatArray) -> float:
    return float(np.sqrt((error**2).sum(axis=1).mean()))


# --- a clock found in two other ways


def known_offset_s(recording: Recording) -> float:
    """The offset t_imu - t_camera where two independent ways agree; nan where they do not."""
    from vqf import offlineVQF

    arm, imu, step_s = recording.arm, recording.imu, 0.04
    seen = arm.tracked("elbow") & arm.tracked("wrist")
    if seen.sum() < 60 or len(imu) < 100:
        return float("nan")
    t_s = np.arange(arm.t_s[seen][0], arm.t_s[seen][-1], step_s)
    along = unit(interpolate(arm.t_s[seen], (arm.joint("wrist") - arm.joint("elbow"))[seen], t_s))
    along = unit(gaussian_filter1d(along, SLOW_S / step_s, axis=0))
    turning = np.linalg.norm(np.gradient(along, step_s, axis=0), axis=1)
    acc, gyro = np.ascontiguousarray(imu.acc), np.ascontiguousarray(imu.gyro)
    quaternion = offlineVQF(gyro, acc, None, 1.0 / imu.rate_hz)["quat6D"]
    up = Rotation.from_quat(quaternion, scalar_first=True).inv().apply([0.0, 0.0, 1.0])
    clipped = (np.abs(gyro) > 0.98 * np.abs(gyro).max()).any(axis=1)
    slow = gaussian_filter1d(gyro, SLOW_S * imu.rate_hz, axis=0)
    rates = np.sqrt(np.maximum((slow**2).sum(axis=1)[:, None] - (slow @ AXES.T) ** 2, 0.0))
    by_height, by_turning = [], []
    for shift_s in SHIFTS_S:
        at_s = t_s + shift_s
        inside = (at_s >= imu.t_s[0]) & (at_s <= imu.t_s[-1])
        if inside.sum() < max(0.6 * len(t_s), 50):
            by_height.append(-np.inf)
            by_turning.append(-np.inf)
            continue
        # what lies outside of what both cover is explained by nothing
        columns = np.column_stack([interpolate(imu.t_s, up, at_s[inside]), np.ones(inside.sum())])
        height = along[inside, 1]
        rest = height - columns @ np.linalg.lstsq(columns, height, rcond=None)[0]
        by_height.append(inside.mean() * (1.0 - (rest**2).mean() / along[:, 1].var()))
        inside[inside] = interpolate(imu.t_s, clipped.astype(float), at_s[inside]) < 0.3
        missed = (turning[inside, None] - interpolate(imu.t_s, rates, at_s[inside])) ** 2
        by_turning.append(
            1.0 - missed.mean(axis=0).min() / (turning[inside] ** 2).mean() - 0.3 * np.mean(~inside)
        )
    if min(max(by_height), max(by_turning)) < EXPLAINED:
        return float("nan")
    one_s, other_s = (float(SHIFTS_S[int(np.argmax(share))]) for share in (by_height, by_turning))
    return 0.5 * (one_s + other_s) if abs(one_s - other_s) < KNOWN_S else float("nan")


# --- runs


def summarise(rows: Sequence[HiddenStretch]) -> None:
    """Print what counts."""
    trusted = [row for row in rows if row.trusted]
    print(
        f"\n{len(rows)} hidden stretches, {len(trusted)} trusted,"
        f" {sum(np.isnan(row.error_m) for row in rows)} unanswered"
    )
    print(f"wrist more than 10 cm off and trusted: {sum(row.error_m > WRONG_M for row in trusted)}")
    if trusted:
        ratio = [row.error_m / row.line_m for row in trusted]
        inside = np.mean([row.inside for row in trusted])
        print(
            f"trusted: error / a straight line's error, median {np.median(ratio):.2f};"
            f" inside the 95 % region: {100 * inside:.0f} %"
        )
        for length_s in sorted({row.length_s for row in trusted}):
            own = [row for row in trusted if row.length_s == length_s]
            error, line = (100 * np.median([getattr(row, of) for row in own]) for of in ("error_m", "line_m"))
            print(f"  {length_s:g} s: median {error:.1f} cm, line {line:.1f} cm, {len(own)} stretches")
    clocks = {row.name: row.clock_s for row in rows if np.isfinite(row.clock_s)}
    if clocks:
        found = sum(abs(off_s) < FOUND_S for off_s in clocks.values())
        print(f"clocks found to {FOUND_S:g} s: {found} of {len(clocks)} that are known")


def _imported(skeleton: str, imu: str = "") -> RealTrial | None:
    """A trial of SmartFallMM; where its files cannot be used that is printed, as they are somebody else's."""
    try:
        return smartfallmm_trial(skeleton, imu)
    except UnoccludeError as refusal:
        print(f"{skeleton} {imu:14} not imported: {str(refusal)[:120]}", flush=True)
        return None


def show_pairs(count: int, rng: np.random.Generator) -> None:
    """Skeletons of SmartFallMM with the IMU of another trial: the same activity in most, as it is hardest."""
    names, trusted = smartfallmm_names(), 0
    for skeleton in rng.permutation(names)[:count]:
        same = [name for name in names if name != skeleton and name[3:6] == skeleton[3:6]]
        others = (
            same if same and rng.uniform() < 0.75 else [name for name in names if name[3:6] != skeleton[3:6]]
        )
        trial = _imported(str(skeleton), str(rng.choice(others)))
        if trial is None:
            continue
        try:
            with time_limit(trial.recording):
                recovery = smooth(trial.recording, None, ONE_PROCESS)
        except (UnoccludeError, TooSlow) as error:
            print(f"{trial.name:26} refused      {str(error)[:120]}", flush=True)
            continue
        estimates = recovery.estimates
        trusted += bool(estimates.trusted)
        said = next(iter((*estimates.reasons, *estimates.cautions)), "")
        verdict = "TRUSTED" if estimates.trusted else "not trusted"
        print(
            f"{trial.name:26} {verdict:12} offset {recovery.clock_offset_s:+6.2f} s  {said[:110]}", flush=True
        )
    print(f"\nwrong pairs of real people called trusted: {trusted} of {count}")


def main() -> None:
    """Read the options and run."""
    parser = argparse.ArgumentParser(
        prog="python -m tools.reliability.real",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("source", choices=["smartfallmm", "utd"])
    parser.add_argument("--lengths", type=float, nargs="+", default=[0.5, 1.0], metavar="S")
    parser.add_argument(
        "--count", type=int, default=0, help="trials; 0 for all of SmartFallMM, 12 of UTD-MHAD"
    )
    parser.add_argument("--seed", type=int, default=0, help="of what is drawn and hidden")
    parser.add_argument("--pairs", action="store_true", help="wrong pairs of SmartFallMM instead")
    options = parser.parse_args()
    rng = np.random.default_rng([options.seed, 5])
    if options.pairs:
        show_pairs(options.count or 12, rng)
        return
    if options.source == "utd":
        trials = utd_trials(options.count or 12, rng)
    else:
        names = smartfallmm_names()
        drawn = rng.permutation(names)[: options.count] if options.count else names
        trials = [trial for name in drawn if (trial := _imported(str(name)))]
    rows = []
    for trial in trials:
        known_s = known_offset_s(trial.recording) if options.source == "smartfallmm" else float("nan")
        for length_s in options.lengths:
            hidden = hidden_rows(trial.recording, length_s, rng)
            if hidden is not None:
                rows.append(compared(trial, hidden, length_s, known_s))
                rows[-1].show()
    summarise(rows)


if __name__ == "__main__":
    main()
