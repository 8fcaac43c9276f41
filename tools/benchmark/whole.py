"""End to end, file to file: time, memory, exactness, and other ways to the same answer beside it.

Each runs in a process of its own on what `smooth` found, as every baseline does (`smoother.baselines`):
calibration, clock, gravity, which samples to believe, and the gaps. Finding that is in `smooth`'s time and
not in theirs.
Two times of each: its own (from scene to path), and with what it needs beside (orientation filter and
alignment before, putting the answer together after). Neither reads nor writes a file.

The recordings that are measured on: simulated, written as MCAP, their truth kept beside.
"""

from __future__ import annotations

import os
import pickle
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from smoother.array_types import BoolArray, FloatArray
from smoother.baselines.registry import BASELINES
from smoother.baselines.scene import Path as Answer
from smoother.baselines.scene import Scene, recovery_of, scenes_of
from smoother.cli.output import PROGRESS_FILE
from smoother.config import Config
from smoother.evaluation.validate import sample_errors
from smoother.io import read_recording, read_recovery, write_recording
from smoother.recording import Truth
from smoother.result import Recovery
from smoother.simulation import ArmSimulation, simulate_arm
from smoother.smoothing import smooth
from tools.benchmark.isolated import PrivatePeak
from tools.benchmark.plain import WAYS, Timed, solve_plainly

IMU_RATE_HZ, FRAME_RATE_HZ = 80.0, 30.0
OCCLUSION_S, OCCLUSION_EVERY_S = 2.0, 10.0


@dataclass(frozen=True)
class Made:
    """A recording on disk."""

    path: Path
    truth: Path  # The simulated motion (.npz), which the measured file contains too unless it was left out
    minutes: float
    length_s: float  # Of the recording
    samples: int  # s: of the recording
    frames: int  # s: of the recording


def make(folder: Path, minutes: float, preset: str, seed: int, truth_inside: bool) -> Made:
    """Simulate and write a recording of `OCCLUSION_S` of occlusion about every `OCCLUSION_EVERY_S`."""
    config = ArmSimulation.preset(
        preset,
        protocol="random",
        duration_s=60.0 * minutes,
        imu_rate_hz=IMU_RATE_HZ,
        frame_rate_hz=FRAME_RATE_HZ,
        occlusion_lengths_s=(OCCLUSION_S,),
        occlusion_every_s=OCCLUSION_EVERY_S,
    )
    recording = simulate_arm(config, seed).recording
    truth = recording.truth
    assert truth is not None
    path, truth_path = folder / f"rec{minutes:g}.mcap", folder / f"truth{minutes:g}.npz"
    np.savez(truth_path, t_s=truth.t_s, position=truth.position, quaternion=truth.quaternion)
    if not truth_inside:
        recording = replace(recording, truth=None)
    write_recording(recording, path)
    return Made(
        path=path,
        truth=truth_path,
        minutes=minutes,
        length_s=float(recording.imu.t_s[-1] - recording.imu.t_s[0]),
        samples=len(recording.imu),
        frames=len(recording.arm),
    )


def read_truth(path: Path, origin_ns: int) -> Truth:
    """The truth, its times counted from `origin_ns`."""
    with np.load(path) as kept:
        t_s = kept["t_s"] - 1e-9 * origin_ns
        return Truth(t_s, kept["position"], kept["quaternion"], np.ones(len(t_s), dtype=bool))


def smooth_arguments(source: Path, result: Path, processes: int) -> list[str]:
    """Words of the command that is measured."""
    return ["smooth", str(source), "-o", str(result), "--force", "--processes", str(processes)]


COMMAND = "from smoother.cli import main; main()"


@dataclass(frozen=True)
class Run:
    """One run of the command."""

    seconds: float  # s: from start to end of the program
    cpu_s: float  # Of all its processes
    main_mb: float  # Peak of the private memory (RssAnon) of the main process and of the largest worker
    worker_mb: float  # Peak of the private memory (RssAnon) of the main process and of the largest worker
    workers: int  # Processes that it started, at most this many at a time


def end_to_end(source: Path, result: Path, processes: int, python: str = sys.executable) -> Run:
    """Run `unocclude smooth SOURCE -o RESULT`, that of another installation where its `python` is given."""
    with tempfile.TemporaryFile() as said:
        began = time.perf_counter()
        command = subprocess.Popen(
            # -P: not what is in the folder where this runs
            [python, "-P", "-c", COMMAND, *smooth_arguments(source, result, processes)],
            stdout=subprocess.DEVNULL,
            stderr=said,
        )
        peak = PrivatePeak(command.pid)
        _, status, usage = os.wait4(command.pid, 0)
        seconds = time.perf_counter() - began
        command.returncode = os.waitstatus_to_exitcode(status)
        if command.returncode:
            said.seek(0)
            raise RuntimeError(f"unocclude smooth {source}: {said.read().decode(errors='replace').strip()}")
    return Run(seconds, usage.ru_utime + usage.ru_stime, peak.mb(), peak.worker_mb(), peak.workers)


def against(python: str, source: Path, result: Path, processes: int, runs: int) -> dict[str, float]:
    """Run the command of another installation and ours in turn on one recording."""
    theirs, ours = [], []
    for _ in range(runs):
        theirs.append(end_to_end(source, result, processes, python))
        ours.append(end_to_end(source, result, processes))

    def middle(measured: list[Run], name: str) -> float:
        return statistics.median(getattr(run, name) for run in measured)

    names = ("seconds", "cpu_s", "main_mb", "worker_mb")
    return {name: middle(theirs, name) / (middle(ours, name) or float("nan")) for name in names}


def help_seconds(runs: int = 3) -> float:
    """The shortest of some runs of `unocclude --help`, s."""
    spent = []
    for _ in range(runs):
        began = time.perf_counter()
        subprocess.run([sys.executable, "-c", COMMAND, "--help"], check=True, stdout=subprocess.DEVNULL)
        spent.append(time.perf_counter() - began)
    return min(spent)


@dataclass(frozen=True)
class Exactness:
    """Errors of a recovery's occluded samples."""

    rms_cm: float  # Of the IMU's position, cm
    max_cm: float  # Of the IMU's position, cm
    rms_deg: float  # Of its orientation, degrees; nan where the method has none
    inside_95: float  # Part of the samples inside the region that should hold 95 %; nan without a covariance
    samples: int  # How many have an answer, and how many have not
    unanswered: int  # How many have an answer, and how many have not
    gaps: int  # Of the recording


def exactness(recovery: Recovery, truth: Truth, occluded: BoolArray | None = None) -> Exactness:
    """The errors in the gaps; `occluded` (N,) of another method's recovery, to look at the same samples."""
    chosen = recovery.occluded if occluded is None else occluded
    figures = sample_errors(recovery, truth).figures(chosen)

    def number(value: float | None, scale: float = 1.0) -> float:
        return float("nan") if value is None else scale * value

    return Exactness(
        rms_cm=number(figures.position_rms_m, 100.0),
        max_cm=number(figures.position_max_m, 100.0),
        rms_deg=number(figures.orientation_rms_deg),
        inside_95=number(figures.coverage_95),
        samples=figures.samples,
        unanswered=figures.unanswered,
        gaps=len(recovery.gaps),
    )


def exactness_of_file(result: Path, truth: Path) -> Exactness:
    """The errors of a result file."""
    (recovery,) = read_recovery(result)
    return exactness(recovery, read_truth(truth, recovery.origin_ns))


def apart_cm(one: FloatArray, other: FloatArray) -> float:
    """Rms distance of two answers (N, 3) m, cm; samples that one of them has not are left out."""
    distance = np.linalg.norm(one - other, axis=1)
    return float(100.0 * np.sqrt(np.nanmean(distance**2))) if np.isfinite(distance).any() else float("nan")


BASELINES_BESIDE = ("rts", "linear-drift")
METHODS = (*(f"plain graph, {way}" for way in WAYS), *BASELINES_BESIDE)


@dataclass(frozen=True)
class Beside:
    """A method's time and errors."""

    own_s: float  # Its own time, and with what it needs
    all_s: float  # Its own time, and with what it needs
    cpu_s: float  # Processor time of `all_s`, workers' included where they have ended
    # Private memory of the process that ran it, which contains recording and `smooth`'s answer too
    peak_mb: float
    exact: Exactness  # Errors in the gaps
    from_smooth_cm: float  # Rms distance from `smooth`'s answer in the gaps
    steps: dict[str, float] = field(default_factory=dict)  # Seconds by step, and iterations, of a plain graph


def run_smooth(made: Made, processes: int, kept: Path) -> Beside:
    """`smooth` from memory to memory; recording and answer are kept in a file for the others."""
    peak = PrivatePeak()
    recording = read_recording(made.path)
    config = Config.model_validate({"windows": {"processes": processes}})
    began, cpu = time.perf_counter(), _processor_s()
    recovery = smooth(recording, None, config)
    seconds, cpu = time.perf_counter() - began, _processor_s() - cpu
    with kept.open("wb") as file:
        pickle.dump((recording, recovery), file, protocol=5)
    exact = exactness(recovery, read_truth(made.truth, recovery.origin_ns))
    return Beside(seconds, seconds, cpu, peak.mb(), exact, 0.0)


def run_method(made: Made, name: str, kept: Path) -> Beside:
    """One of `METHODS`, on what `smooth` estimated."""
    peak = PrivatePeak()
    with kept.open("rb") as file:
        recording, settings = pickle.load(file)
    began, cpu = time.perf_counter(), _processor_s()
    scenes = scenes_of(recording, settings)
    timed = Timed()
    solving = time.perf_counter()
    paths = [_path(scene, name, timed) for scene in scenes]
    own_s = time.perf_counter() - solving
    recovery = recovery_of(recording, settings, scenes, paths, name)
    seconds, cpu = time.perf_counter() - began, _processor_s() - cpu
    truth = read_truth(made.truth, recovery.origin_ns)
    steps: dict[str, Any] = dict(timed.seconds)
    if steps:
        own_s = timed.total_s  # without the start values, which are the house's
        steps |= {"iterations": timed.iterations, "nodes": timed.nodes}
    inside = np.asarray(settings.occluded)
    return Beside(
        own_s,
        seconds,
        cpu,
        peak.mb(),
        exactness(recovery, truth, inside),
        apart_cm(recovery.position[inside], settings.position[inside]),
        steps,
    )


def _path(scene: Scene, name: str, timed: Timed) -> Answer:
    if name in BASELINES:
        return BASELINES[name].function({})(scene)
    return solve_plainly(scene, name.removeprefix("plain graph, "), timed)


def _processor_s() -> float:
    """Processor seconds of this process and of those it started that have ended."""
    return sum(os.times()[:4])


#: Longest time without a display of progress, s.
PATIENCE_S = 3.0
#: After this a command is given up, s.
LIMIT_S = 1800.0
EXPORTS = ("csv", "parquet", "trc", "mot", "c3d", "sto")


@dataclass(frozen=True)
class Waited:
    """One command."""

    name: str  # What was called
    seconds: float  # s: from start to end
    shows_progress: bool  # Whether it shows progress


def commands(made: Made, folder: Path) -> Iterator[tuple[str, list[str]]]:
    """Name and arguments of the commands, in an order in which each finds what it reads."""
    source, result = str(made.path), str(folder / "waited.mcap")
    yield "info", ["info", source]
    yield "check", ["check", source]
    yield "match", ["match", source]
    yield "smooth", ["smooth", source, "-o", result]
    report = str(folder / "waited.html")
    yield "smooth --report", ["smooth", source, "-o", result, "--report", report, "--force"]
    yield "measures", ["measures", result]
    yield "validate", ["validate", result, "--truth", source]
    yield "methods", ["methods", result]
    for kind in EXPORTS:
        yield f"export --format {kind}", ["export", result, "--format", kind, "-o", f"{folder}/waited.{kind}"]
    yield "gaps", ["gaps", source]
    yield "compare", ["compare", source]


def waited(made: Made, folder: Path) -> list[Waited]:
    """Run every command on one recording, each in a process of its own."""
    return [_run(name, arguments, folder) for name, arguments in commands(made, folder)]


def _run(name: str, arguments: list[str], folder: Path) -> Waited:
    with tempfile.TemporaryDirectory(dir=folder) as own:
        progress = Path(own) / "progress.json"
        began = time.perf_counter()
        done = subprocess.run(
            [sys.executable, "-P", "-c", COMMAND, *arguments],
            env=os.environ | {PROGRESS_FILE: str(progress)},
            capture_output=True,
            timeout=LIMIT_S,
        )
        seconds = time.perf_counter() - began
        if done.returncode not in (0, 3):
            raise RuntimeError(f"unocclude {' '.join(arguments)}: {done.stderr.decode(errors='replace')}")
        return Waited(name, seconds, progress.exists())
