"""One table of today's accuracy, to compare tomorrow's with: `oracle`.

A row is scored where the arm was hidden, told by the simulation or by what was hidden on purpose, never by
the answer. Samples without an answer show in `answered`; a refused recording's gaps count as not trusted. A
gap is wrong where it is trusted, above 10 cm rms and above 3 stated sigmas; in a set-up error, above 10 cm.
Workers have one thread each, so that their number changes nothing.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import resource
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from calib.motion import calibrate_motion
from smoother.array_types import FloatArray
from smoother.calibration import ArmCalibration
from smoother.evaluation.benchmark import open_utd, utd_files
from smoother.evaluation.gaps import hide, place_gaps
from smoother.evaluation.metrics import CHI2_95_3, rotation_error, squared_sigmas
from smoother.evaluation.validate import sample_errors
from smoother.io import import_broad
from smoother.linalg import interpolate, runs
from smoother.recording import Recording, Truth
from smoother.result import Recovery
from smoother.simulation import ArmSimulation, SimulatedArm, simulate_arm
from smoother.smoothing import smooth
from tools.accuracy.check import ONE_PROCESS, PRESETS, Run, check, datasets, ended, option, rms
from tools.accuracy.live import play
from tools.reliability import scenes, setup_errors

#: The first of a row's seeds; no other tool draws from here.
SEED = 61_400
BROAD_S, UTD_S = (1.0, 3.0), (0.5, 1.0)
#: Shorter occlusions, in frames, are interpolation.
FEWEST_FRAMES = 4
#: Digits by column; counts have none.
DIGITS = {
    "rms cm": 2,
    "max cm": 2,
    "turn deg": 2,
    "inside %": 1,
    "turn inside %": 1,
    "NEES": 2,
    "answered %": 1,
}
DIGITS |= dict.fromkeys(("recordings", "refused", "crashed", "trusted", "gaps", "gaps trusted", "wrong"), 0)
#: What a count is a part of, and which must not rise.
WHOLE = {"trusted": "recordings", "refused": "recordings", "gaps trusted": "gaps"}
WORSE = ("crashed", "wrong")
SECONDS = "cpu s"

#: A gap counts as trusted if more than this share of its samples are, and as wrong beyond this many sigmas.
TRUSTED_SHARE, SIGMAS = 0.5, 3.0
#: In view between two long gaps, s.
BETWEEN_GAPS_S = 8.0

Interval = tuple[float, float]
#: Of a recovery, times (n,) on the IMU's clock and errors (n, 4), nan without an answer: position m, its
#: square over sigma's, turn degrees, its square over sigma's.
Scored = Callable[[Recovery], tuple[FloatArray, FloatArray]]


#: A job: its rows, and what gives a list of runs for each.
Job = tuple[tuple[str, ...], Callable[[], Sequence[Sequence[Run]]]]


def work(job: Job) -> list[tuple[str, Run, float]]:
    """A job's runs by row, with the processor time, s, of each."""
    began = _spent_s()
    found = [(row, run) for row, own in zip(job[0], job[1](), strict=True) for run in own]
    share_s = (_spent_s() - began) / len(found)
    return [(row, run, share_s) for row, run in found]


def _spent_s() -> float:
    usage = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(each.ru_utime + each.ru_stime for each in usage)


def judged(
    recording: Recording, gaps: Sequence[Interval], scored: Scored, calibration: ArmCalibration | None = None
) -> Run:
    """Recover a recording, score it in its gaps, and count."""
    counts = Counter({"recordings": 1, "gaps": len(gaps)})
    try:
        recovery = smooth(replace(recording, truth=None), calibration, ONE_PROCESS)
    except Exception as error:
        return Run([], counts | ended(error))
    (t_s, values), found = scored(recovery), []
    trusted = np.asarray(recovery.trusted, float) * (recovery.estimates.trusted is not False)
    believed = np.interp(t_s, recovery.t_s, trusted) > 0.5
    counts["trusted"] += recovery.estimates.trusted is True
    for rows in ((t_s > start_s) & (t_s < end_s) for start_s, end_s in gaps):
        found.append(values[rows])
        known = found[-1][np.isfinite(found[-1][:, 1])]
        if len(known) and believed[rows].mean() > TRUSTED_SHARE:
            counts["gaps trusted"] += 1
            far = rms(known[:, 0]) > setup_errors.LARGEST_ERROR_M
            counts["wrong"] += far and bool(known[:, 1].mean() / 3 > SIGMAS**2)
    return Run(found, counts)


def pose_errors(answer: Any, motion: Any, t_s: FloatArray) -> FloatArray:
    """(n, 4) of an IMU's poses against its motion."""
    R, true = motion.imu_pose(t_s)
    off, quaternion = answer.position - true, Rotation.from_matrix(R).as_quat(scalar_first=True)
    covariance, turn = answer.pose_covariance, rotation_error(answer.quaternion, quaternion)
    squares = squared_sigmas(off, covariance[:, :3, :3]), squared_sigmas(turn, covariance[:, 3:, 3:])
    degrees = np.degrees(np.linalg.norm(turn, axis=1))
    return np.column_stack([np.linalg.norm(off, axis=1), squares[0], degrees, squares[1]])


def by_truth(truth: Truth) -> Scored:
    """The IMU's errors against a recorded truth."""

    def scored(recovery: Recovery) -> tuple[FloatArray, FloatArray]:
        found = sample_errors(recovery, truth)
        names = ("distance_m", "squared_sigmas", "angle_deg", "turn_squared_sigmas")
        return recovery.t_s[found.scored], np.column_stack([getattr(found, n)[found.scored] for n in names])

    return scored


def occlusions(made: SimulatedArm, least_s: float = 0.0) -> list[Interval]:
    """When the camera could not see the forearm, s on the IMU's clock."""
    t_s = made.recording.arm.t_s + made.parameters["clock_offset_s"]
    spans = [run for run in runs(made.occluded) if run.stop - run.start >= FEWEST_FRAMES]
    ends = [(float(t_s[run.start]), float(t_s[run.stop - 1])) for run in spans]
    return [(start_s, end_s) for start_s, end_s in ends if end_s - start_s >= least_s]


def of_simulation(made: SimulatedArm, recording: Recording, segment: str = "", least_s: float = 0.0) -> Run:
    """The IMU of a simulated arm; of the hand, or the thorax's turn, where that segment is named."""

    def scored(recovery: Recovery) -> tuple[FloatArray, FloatArray]:
        answer: Any = recovery
        motion: Any = made.motion
        if segment == "hand":
            answer, motion = recovery.segments.get("hand"), made.further_motions["hand"]
        if answer is None:
            return recovery.t_s, np.full((len(recovery), 4), np.nan)
        errors = pose_errors(answer, motion, recovery.t_s)
        if segment == "trunk":
            errors[:, 2:] = np.nan
            if recovery.trunk is not None:
                turn, nees = _thorax(recovery, made)
                known = np.isfinite(recovery.trunk.quaternion[:, 0])
                errors[known, 2:] = np.column_stack([np.linalg.norm(turn, axis=1), 3.0 * nees])
        return recovery.t_s, errors

    return judged(recording, occlusions(made, least_s), scored)


def _thorax(recovery: Recovery, made: SimulatedArm) -> tuple[FloatArray, FloatArray]:
    """Errors (n, 3) about the thorax's axes, degrees, and squared errors over sigma^2 (n,)."""
    trunk = recovery.trunk
    assert trunk is not None and made.trunk_motion is not None
    known = np.isfinite(trunk.quaternion[:, 0])
    R = Rotation.from_quat(trunk.quaternion[known], scalar_first=True).as_matrix()
    true = made.trunk_motion.thorax(recovery.t_s[known])
    error = Rotation.from_matrix(np.swapaxes(true, 1, 2) @ R).as_rotvec()
    covariance = np.swapaxes(R, 1, 2) @ trunk.covariance[known] @ R + np.diag(trunk.mount_sigma_rad**2)
    return np.degrees(error), np.einsum("ni,nij,nj->n", error, np.linalg.inv(covariance), error) / 3.0


def arm(preset: str, settings: dict[str, Any], segment: str, least_s: float, seed: int) -> list[list[Run]]:
    """A simulated arm; `one`: without the upper arm's IMU."""
    made = simulate_arm(ArmSimulation.preset(preset, **settings), seed=seed)
    recording = made.recording.with_imu("upper_arm", None) if segment == "one" else made.recording
    return [[of_simulation(made, recording, segment, least_s)]]


def broad(path: Path, length_s: float) -> list[list[Run]]:
    """Hidden gaps of a trial of BROAD; camera and IMU share a clock."""
    recording = import_broad(path, seed=SEED)
    gaps = place_gaps(recording, length_s, np.random.default_rng(SEED), count=8)
    spans = [(gap.start_s, gap.end_s) for gap in gaps]
    assert recording.truth is not None
    return [[judged(hide(recording, gaps), spans, by_truth(recording.truth))]]


def utd(subject: int) -> list[list[Run]]:
    """A subject's second trials, by the calibration of the first ones; the camera's hidden wrist judges."""
    files = {k: v for k, v in utd_files(datasets("utd_mhad")).items() if k[0] == subject}
    first, second = ([open_utd(v) for (*_, t), v in files.items() if t == trial] for trial in (1, 2))
    calibration = calibrate_motion(first, None, ONE_PROCESS).calibration

    def run(recording: Recording, length_s: float) -> Run:
        arm = recording.arm
        rows = np.abs(arm.t_s - 0.5 * (arm.t_s[0] + arm.t_s[-1])) <= 0.5 * length_s

        def scored(recovery: Recovery) -> tuple[FloatArray, FloatArray]:
            seen = arm.tracked("wrist") & rows
            t_s, noise_m = recovery.arm.t_s[seen], (recovery.estimates.camera_sigma_m or {}).get("wrist", 0.0)
            off = interpolate(recovery.t_s, recovery.joints["wrist"], t_s) - arm.joint("wrist")[seen]
            covariance = interpolate(recovery.t_s, recovery.joint_covariance["wrist"], t_s)
            squares = squared_sigmas(off, covariance + noise_m**2 * np.eye(3))
            nothing = np.full(len(off), np.nan)
            return t_s, np.column_stack([np.linalg.norm(off, axis=1), squares, nothing, nothing])

        return judged(replace(recording, arm=arm.hide(rows)), [(-np.inf, np.inf)], scored, calibration)

    return [[run(recording, length_s) for recording in second] for length_s in UTD_S]


def live(seed: int) -> list[list[Run]]:
    """What the live smoother shows a lag ago and now, visible and in gaps of 1 s."""
    settings = {"protocol": "random", "duration_s": 60.0, "imu_rate_hz": 100, "occlusion_lengths_s": (1.0,)}
    made = simulate_arm(ArmSimulation.preset("realistic", **settings), seed)
    outputs, found = play(made), []
    for kind in ("settled", "now"):
        answers = [each for each in (getattr(output, kind) for output in outputs) if each is not None]
        names = ("t_s", "position", "quaternion", "pose_covariance")
        poses = argparse.Namespace(**{name: np.array([getattr(e, name) for e in answers]) for name in names})
        hidden = np.any([(poses.t_s > start) & (poses.t_s < end) for start, end in occlusions(made)], axis=0)
        errors = pose_errors(poses, made.motion, poses.t_s)
        found += [[Run([errors[rows]], Counter(recordings=1))] for rows in (~hidden, hidden)]
    return found


def second(draw: Callable[[], scenes.Scene]) -> list[list[Run]]:
    """A set-up of the second simulator."""
    scene = draw()

    def scored(recovery: Recovery) -> tuple[FloatArray, FloatArray]:
        return recovery.t_s, pose_errors(recovery, scene, recovery.t_s)

    return [[judged(scene.recording, scene.gaps, scored)]]


def wrong_pair(preset: str, protocol: str, skeleton_seed: int, imu_seed: int) -> list[list[Run]]:
    """A simulated arm's skeleton with the IMU of another one that does the same: wrong if it is trusted."""
    config = ArmSimulation.preset(preset, protocol=protocol, repetitions=3, duration_s=70.0)
    recording, imu = (simulate_arm(config, seed).recording for seed in (skeleton_seed, imu_seed))
    run = judged(replace(recording, imu=imu.imu), [], lambda recovery: (recovery.t_s, np.empty((0, 4))))
    return [[Run([], run.counts | Counter(wrong=run.counts["trusted"]))]]


def set_up(job: setup_errors.Job) -> list[list[Run]]:
    """A wrong set-up: how it ended; a sound one: with its errors."""
    setup = job.setup()
    if job.case is setup_errors.sound:
        return [[of_simulation(setup.simulated, setup.recording)]]
    run = judged(setup.recording, occlusions(setup.simulated), by_truth(setup.truth), setup.calibration)
    known = np.concatenate([each[np.isfinite(each[:, 0]), 0] for each in run.errors] or [np.zeros(0)])
    far = bool(len(known)) and rms(known) > setup_errors.LARGEST_ERROR_M
    counts = {name: run.counts[name] for name in ("recordings", "refused", "crashed", "trusted")}
    return [[Run([], Counter(counts, wrong=far and counts["trusted"]))]]


def wrong_pairs(count: int, rng: np.random.Generator) -> Iterator[tuple[str, str, int, int]]:
    """Presets, protocols and seeds of as many wrong pairs."""
    for number in range(count):
        seeds = int(rng.integers(2**30)), int(rng.integers(2**30, 2**31))
        yield PRESETS[number % len(PRESETS)], ("behind", "random")[number % 2], *seeds


def jobs() -> Iterator[Job]:
    """The jobs of all rows, row by row."""
    random = {"protocol": "random", "duration_s": 60.0}
    arms: list[tuple[str, str, int, dict[str, Any], str, float]] = []
    for preset in PRESETS:
        arms.append((f"arm {preset}, behind the back", preset, 8, {}, "", 0.0))
        for length_s, seeds in ((30.0, 8), (180.0, 4), (600.0, 3)):
            arms.append(
                (f"arm {preset}, {length_s:g} s", preset, seeds, random | {"duration_s": length_s}, "", 0.0)
            )
    for length_s in (10.0, 30.0, 60.0):
        for name, segment in (("one IMU", "one"), ("two IMUs", "")):
            settings = {
                "imus": "wrist,upper-arm",
                "protocol": "random",
                "duration_s": max(60.0, 2.5 * length_s),
                "occlusion_lengths_s": (length_s,),
                "occlusion_every_s": length_s + BETWEEN_GAPS_S,
            }
            arms.append((f"gaps of {length_s:g} s, {name}", "realistic", 4, settings, segment, length_s / 2))
    for name, seeds, segment, changes in (
        ("two cameras", 4, "", {"cameras": (75.0,), "camera_clock_s": 0.35}),
        ("three cameras", 4, "", {"cameras": (75.0, -60.0), "camera_clock_s": 0.35}),
        ("one webcam", 6, "", {"rgb": "all", "occlusion_lengths_s": (1.0, 2.0)}),
        ("hand IMU", 4, "hand", {"imus": "wrist,hand"}),
        ("trunk IMU", 4, "trunk", {"imus": "wrist,upper-arm,trunk", "trunk_turn_deg": 10.0}),
    ):
        arms.append((name, "realistic", seeds, random | changes, segment, 0.0))
    for name, preset, seeds, settings, segment, least_s in arms:
        for seed in range(SEED, SEED + seeds):
            yield (name,), partial(arm, preset, settings, segment, least_s, seed)
    for length_s in BROAD_S:
        for path in sorted(datasets("broad").glob("*.mat")):
            yield (f"BROAD, {length_s:g} s",), partial(broad, path, length_s)
    for subject in (1, 2, 3, 4):
        yield tuple(f"UTD-MHAD, {length_s:g} s" for length_s in UTD_S), partial(utd, subject)
    shown = tuple(f"live, {kind}, {where}" for kind in ("settled", "now") for where in ("visible", "gaps"))
    for seed in range(SEED, SEED + 3):
        yield shown, partial(live, seed)
    for pair in wrong_pairs(12, np.random.default_rng(SEED)):
        yield ("wrong pairs",), partial(wrong_pair, *pair)
    for drawn in scenes.unusual_scenes(30, np.random.default_rng(SEED)):
        yield ("unusual set-ups",), partial(second, drawn)
    for wrong in setup_errors.draw(100, SEED):
        yield ("set-up errors",), partial(set_up, wrong)
    for sound in setup_errors.draw(50, SEED, (setup_errors.sound,)):
        yield ("sound set-ups",), partial(set_up, sound)


def row_of(found: Sequence[Run], seconds: float) -> dict[str, float | None]:
    """A row's figures to the digits that are printed; None where nothing gives one."""
    values = np.vstack([errors for run in found for errors in run.errors] or [np.full((1, 4), np.nan)])
    distance, squares, degrees, turns = (column[np.isfinite(column)] for column in values.T)
    inside = [np.mean(each <= CHI2_95_3) if len(each) else np.nan for each in (squares, turns)]
    row: dict[str, Any] = dict.fromkeys(DIGITS) | sum((run.counts for run in found), Counter())
    row |= {name: row[name] or 0 for name, digits in DIGITS.items() if not digits}
    if len(distance):
        row |= {"rms cm": 100 * rms(distance), "max cm": 100 * distance.max(), "inside %": 100 * inside[0]}
        row |= {"NEES": squares.mean() / 3, "answered %": 100 * len(distance) / len(values)}
    if len(degrees):
        row |= {"turn deg": rms(degrees), "turn inside %": 100 * inside[1]}
    rounded = {k: v if v is None or not DIGITS[k] else round(float(v), DIGITS[k]) for k, v in row.items()}
    return rounded | {SECONDS: round(seconds, 1)}


def differing(old: dict[str, Any], new: dict[str, Any], tolerance: float) -> list[str]:
    """What of a row differs by more than a part of the old figure, of 100 for percent, of all for counts."""
    told = []
    for name in DIGITS:
        was, now = old[name], new[name]
        known, worse = None not in (was, now), name in WORSE and (now or 0) > (was or 0)
        scale = 100.0 if name.endswith("%") else old[WHOLE.get(name, name)]
        if was != now and (worse or not known or abs(now - was) > tolerance * scale + 1e-9):
            told.append(f"{name} {was} -> {now}")
    return told


def table(only: str, processes: int) -> Iterator[tuple[str, dict[str, Any]]]:
    """Every row as soon as it is complete."""
    wanted = [job for job in jobs() if any(only in row for row in job[0])]
    last = {row: number for number, (rows, _) in enumerate(wanted) for row in rows}
    found: dict[str, list[tuple[Run, float]]] = {}
    os.environ["OMP_NUM_THREADS"] = "1"  # of the workers: sums in another order end in other digits
    with ProcessPoolExecutor(processes, multiprocessing.get_context("spawn")) as pool:
        for number, answer in enumerate(pool.map(work, wanted)):
            for row, run, seconds in answer:
                found.setdefault(row, []).append((run, seconds))
            for row in (row for row in wanted[number][0] if last[row] == number and only in row):
                runs_, spent = zip(*found.pop(row), strict=True)
                yield row, row_of(runs_, sum(spent))


@check(
    option("--json", type=Path, help="the figures in a file"),
    option("--against", type=Path, metavar="FILE", help="a stored table; 1 is returned if it differs"),
    option("--tolerance", type=float, default=0.0, metavar="PART", help="what may differ, as 0.02 [nothing]"),
    option("--only", default="", metavar="PATTERN", help="rows so called; --json keeps the others"),
    option("--processes", type=int, default=2, help="recordings at a time [2]"),
)
def oracle(options: argparse.Namespace) -> Iterator[str]:
    """One table of errors, coverage, verdicts and processor time; with --against the rows that differ."""
    if options.against and not options.against.is_file():
        sys.exit(f"there is no {options.against}; --json writes a table")
    old, new = json.loads(options.against.read_text()) if options.against else {}, {}
    digits = DIGITS | {SECONDS: 0}
    yield f"| {'':29} | {' | '.join(digits)} |\n|{'---|' * (len(digits) + 1)}"
    for name, row in table(options.only, options.processes):
        new[name] = row
        cells = ("-" if row[key] is None else f"{row[key]:.{places}f}" for key, places in digits.items())
        padded = (f"{cell:>{len(key)}}" for cell, key in zip(cells, digits, strict=True))
        yield f"| {name:29} | {' | '.join(padded)} |"
    if not new:
        sys.exit(f"no row's name contains '{options.only}'")
    if options.json:
        kept = json.loads(options.json.read_text()) if options.only and options.json.is_file() else {}
        lines = (f"{json.dumps(name)}: {json.dumps(row)}" for name, row in (kept | new).items())
        options.json.write_text("{\n" + ",\n".join(lines) + "\n}\n")
    if options.against:
        both = dict.fromkeys((*(name for name in old if options.only in name), *new))
        told = {name: ["not in both tables"] for name in both if name not in old or name not in new}
        told |= {n: differing(old[n], new[n], options.tolerance) for n in both if n not in told}
        yield from ("", *(f"{name}: {', '.join(each)}" for name, each in told.items() if each))
        yield f"{sum(map(bool, told.values()))} of {len(both)} rows differ from {options.against}"
        sys.exit(int(any(told.values())))
