"""Speed, memory and exactness of `unocclude smooth`, file to file: `python -m tools.benchmark`.

Simulates recordings (80 Hz IMU, 30 Hz camera, an occlusion of 2 s about every 10 s) and runs the command on
them with nothing calibrated: how many times faster than real time, how much memory, how far off in the gaps.
`--against PYTHON` runs the command of another installation in turn with ours and prints ratios; `--waiting`
times what a person waits for, command by command. Let nothing else run meanwhile.
"""

from __future__ import annotations

import argparse
import compileall
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import calib
import smoother
from smoother.cli.output import PROGRESS_FILE
from smoother.evaluation.validate import sample_errors
from smoother.io import read_recovery, write_recording
from smoother.recording import Truth
from smoother.runtime.printable import plain
from smoother.simulation import ArmSimulation, simulate_arm
from tools.benchmark.isolated import PrivatePeak

COMMAND = "from smoother.cli import main; main()"
#: The recordings that are measured on, s and Hz.
MADE = {
    "protocol": "random",
    "imu_rate_hz": 80.0,
    "frame_rate_hz": 30.0,
    "occlusion_lengths_s": (2.0,),
    "occlusion_every_s": 10.0,
}
#: Longest time without a display of progress, and after which a command is given up, s.
PATIENCE_S, LIMIT_S = 3.0, 1800.0
EXPORTS = ("csv", "parquet", "trc", "mot", "c3d", "sto")
Figures = dict[str, float]


def make(path: Path, minutes: float, preset: str, seed: int) -> Truth:
    """Simulate and write a recording; its truth."""
    config = ArmSimulation.preset(preset, duration_s=60.0 * minutes, **MADE)
    recording = simulate_arm(config, seed).recording
    truth = recording.truth
    assert truth is not None
    write_recording(recording, path)
    return truth


def smoothed(source: Path, result: Path, processes: int, python: str = sys.executable) -> Figures:
    """One run of `unocclude smooth`, that of another installation where its `python` is given."""
    words = ["smooth", str(source), "-o", str(result), "--force", "--processes", str(processes)]
    began = time.perf_counter()
    # -P: not what is in the folder where this runs
    command = subprocess.Popen([python, "-P", "-c", COMMAND, *words], stdout=subprocess.DEVNULL)
    peak = PrivatePeak(command.pid)
    _, status, usage = os.wait4(command.pid, 0)
    seconds = time.perf_counter() - began
    command.returncode = os.waitstatus_to_exitcode(status)
    if command.returncode:
        sys.exit(f"unocclude {' '.join(words)}: ended with {command.returncode}")
    return {
        "seconds": seconds,
        "cpu_s": usage.ru_utime + usage.ru_stime,
        "main_mb": peak.mb(),
        "worker_mb": peak.worker_mb(),
        "workers": peak.workers,
    }


def exactness(result: Path, truth: Truth) -> Figures:
    """Errors of a result file's occluded samples."""
    (recovery,) = read_recovery(result)
    truth = replace(truth, t_s=truth.t_s - 1e-9 * recovery.origin_ns)
    found = sample_errors(recovery, truth).figures(recovery.occluded)
    return {
        "gaps": len(recovery.gaps),
        "rms_cm": 100.0 * (found.position_rms_m or float("nan")),
        "max_cm": 100.0 * (found.position_max_m or float("nan")),
        "rms_deg": found.orientation_rms_deg or float("nan"),
        "inside_95_percent": 100.0 * (found.coverage_95 or float("nan")),
    }


def against(python: str, source: Path, result: Path, processes: int, runs: int) -> Figures:
    """Medians of another installation over ours, both run in turn on one recording."""
    pairs = [
        (smoothed(source, result, processes, python), smoothed(source, result, processes))
        for _ in range(runs)
    ]
    names = ("seconds", "cpu_s", "main_mb", "worker_mb")
    medians = {
        name: [statistics.median(each[name] for each in own) for own in zip(*pairs, strict=True)]
        for name in names
    }
    return {name: theirs / (ours or float("nan")) for name, (theirs, ours) in medians.items()}


def commands(source: str, folder: Path) -> Iterator[list[str]]:
    """Commands in an order in which each finds what it reads."""
    result = str(folder / "waited.mcap")
    yield from (["info", source], ["check", source], ["match", source], ["smooth", source, "-o", result])
    yield ["smooth", source, "-o", result, "--force", "--report", str(folder / "waited.html")]
    yield from (["measures", result], ["validate", result, "--truth", source], ["methods", result])
    for kind in EXPORTS:
        yield ["export", result, "--format", kind, "-o", str(folder / f"waited.{kind}")]
    yield from (["gaps", source], ["compare", source])


def waited(words: list[str], progress: Path) -> tuple[float, bool]:
    """Seconds that a command takes, and whether it shows how far it is."""
    progress.unlink(missing_ok=True)
    began = time.perf_counter()
    done = subprocess.run(
        [sys.executable, "-P", "-c", COMMAND, *words],
        env=os.environ | {PROGRESS_FILE: str(progress)},
        capture_output=True,
        timeout=LIMIT_S,
    )
    seconds = time.perf_counter() - began
    if done.returncode not in (0, 3):
        sys.exit(f"unocclude {' '.join(words)}: {done.stderr.decode(errors='replace')}")
    return seconds, progress.exists()


def shown(title: str, figures: Figures) -> str:
    """A line of figures."""
    return f"{title:>14}: " + ", ".join(f"{name} {value:.4g}" for name, value in figures.items())


def main() -> None:
    """Make the recordings one after the other, measure, print, and keep the figures."""
    parser = argparse.ArgumentParser(
        prog="python -m tools.benchmark",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--minutes", type=float, nargs="+", default=[0.5333, 6.0, 60.0], help="lengths")
    parser.add_argument("--against", metavar="PYTHON", help="interpreter of another installation: ratios")
    parser.add_argument("--runs", type=int, default=5, help="of each, with --against")
    parser.add_argument("--waiting", action="store_true", help="every command instead")
    parser.add_argument("--preset", default="white", help="errors of the simulation")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--processes", type=int, default=0, help="worker processes; 0 = one per core")
    parser.add_argument("--folder", type=Path, help="where to put the recordings meanwhile")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all figures")
    options = parser.parse_args()
    # as pip does: a start that may not keep what it compiles takes 0.2 s more
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
    for package in (smoother, calib):
        compileall.compile_dir(Path(str(package.__file__)).parent, quiet=1)
    if (load := os.getloadavg()[0]) > 0.3:
        print(f"Other work runs here (load {load:.1f}): times are longer than they would be.")
    figures: dict[str, Figures] = {}
    for minutes in options.minutes:
        with tempfile.TemporaryDirectory(dir=options.folder) as name:
            folder = Path(name)
            source, result, title = folder / "rec.mcap", folder / "out.mcap", f"{minutes:g} min"
            truth = make(source, minutes, options.preset, options.seed)
            if options.waiting:
                for words in commands(str(source), folder):
                    seconds, has_progress = waited(words, folder / "progress.json")
                    kind = " ".join(
                        word for word in words if not word.startswith(name) and word not in ("-o", "--force")
                    )
                    figures[f"{title}, {kind}"] = {"seconds": seconds}
                    silent = " <-- without progress" if seconds > PATIENCE_S and not has_progress else ""
                    print(f"{seconds:7.1f} s  {kind}{silent}", flush=True)
                continue
            if options.against:
                found = against(options.against, source, result, options.processes, options.runs)
            else:
                found = smoothed(source, result, options.processes) | exactness(result, truth)
                found = {"times_real_time": 60.0 * minutes / found["seconds"]} | found
            figures[title] = found
            print(shown(title, found), flush=True)
    if options.json:
        options.json.write_text(json.dumps(plain(figures), indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
