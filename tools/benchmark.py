"""Speed, memory and exactness of `unocclude smooth`, file to file: `python -m tools.benchmark`.

Simulates recordings (80 Hz IMU, 30 Hz camera, an occlusion of 2 s about every 10 s) and runs the command on
them with nothing calibrated: how many times faster than real time, how much memory, how far off in the gaps.
Let nothing else run meanwhile.
"""

from __future__ import annotations

import argparse
import compileall
import json
import os
import subprocess
import sys
import tempfile
import threading
import time
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import psutil  # of `distributed`

import calib
import smoother
from smoother.evaluation.validate import sample_errors
from smoother.io import read_recovery, write_recording
from smoother.recording import Truth
from smoother.runtime.printable import plain
from smoother.simulation import ArmSimulation, simulate_arm

#: The recordings that are measured on, s and Hz.
MADE = {
    "protocol": "random",
    "imu_rate_hz": 80.0,
    "frame_rate_hz": 30.0,
    "occlusion_lengths_s": (2.0,),
    "occlusion_every_s": 10.0,
}
Figures = dict[str, float]


class PrivatePeak:
    """Looks at the private memory of a process and of its workers again and again.

    Private is what a process has for itself (RssAnon): mapped files are the system's, and libraries are
    shared. The kernel keeps no peak of this.
    """

    def __init__(self, pid: int | None = None, look_s: float = 0.02) -> None:
        self._process, self._most = psutil.Process(pid), dict[int, float]()
        self._look()
        threading.Thread(target=self._watch, args=(look_s,), daemon=True).start()

    def mb(self) -> float:
        """The peak of the process so far, 10^6 bytes."""
        self._look()
        return self._most[self._process.pid]

    def worker_mb(self) -> float:
        """The peak of the largest worker so far, 10^6 bytes; 0 without one."""
        return max((mb for pid, mb in list(self._most.items()) if pid != self._process.pid), default=0.0)

    def _watch(self, look_s: float) -> None:
        while self._look():
            time.sleep(look_s)

    def _look(self) -> bool:
        """Look once; False where the process has ended."""
        try:
            seen = [self._process, *self._process.children(recursive=True)]
        except psutil.Error:
            return False
        for each in seen:
            with suppress(psutil.Error):
                memory = each.memory_info()
                mb = (memory.rss - memory.shared) / 1e6
                self._most[each.pid] = max(self._most.get(each.pid, 0.0), mb)
        return self._process.status() != psutil.STATUS_ZOMBIE


def make(path: Path, minutes: float, preset: str, seed: int) -> Truth:
    """Simulate and write a recording; its truth."""
    config = ArmSimulation.preset(preset, duration_s=60.0 * minutes, **MADE)
    recording = simulate_arm(config, seed).recording
    write_recording(recording, path)
    assert recording.truth is not None
    return recording.truth


def smoothed(source: Path, result: Path, processes: int) -> Figures:
    """One run of `unocclude smooth`."""
    words = ["smooth", str(source), "-o", str(result), "--force", "--processes", str(processes)]
    began = time.perf_counter()
    # -P: not what is in the folder where this runs
    start = [sys.executable, "-P", "-c", "from smoother.cli import main; main()"]
    command = subprocess.Popen([*start, *words], stdout=subprocess.DEVNULL)
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


def main() -> None:
    """Make the recordings one after the other, measure, print, and keep the figures."""
    parser = argparse.ArgumentParser(prog="python -m tools.benchmark", description=__doc__)
    parser.add_argument("--minutes", type=float, nargs="+", default=[0.5333, 6.0, 60.0], help="lengths")
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
            source, result, title = Path(name) / "rec.mcap", Path(name) / "out.mcap", f"{minutes:g} min"
            truth = make(source, minutes, options.preset, options.seed)
            found = smoothed(source, result, options.processes) | exactness(result, truth)
            found = {"times_real_time": 60.0 * minutes / found["seconds"]} | found
        figures[title] = found
        print(f"{title:>14}: " + ", ".join(f"{key} {value:.4g}" for key, value in found.items()), flush=True)
    if options.json:
        options.json.write_text(json.dumps(plain(figures), indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
