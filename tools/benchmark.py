"""How many times faster than real time: `python tools/benchmark.py`.

Simulates a recording of 6 minutes with an occlusion of 2 s about every 10 s, writes it as MCAP, and runs
`unocclude smooth` on it, file to file, with nothing calibrated. Then the same once more inside this program,
to see where the time goes.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from smoother.config import Config
from smoother.io import read_recording, write_recording, write_recovery
from smoother.simulation import ArmSimulation, simulate_arm
from smoother.smoothing import smooth


class Clock:
    """Time spent by part, in the order in which the parts came."""

    def __init__(self) -> None:
        self.spent: dict[str, float] = {}
        self._part, self._since = "", time.perf_counter()

    def now(self, part: str) -> None:
        """What is done from here on."""
        moment = time.perf_counter()
        if self._part:
            self.spent[self._part] = self.spent.get(self._part, 0.0) + moment - self._since
        self._part, self._since = part, moment


def make(path: Path, options: argparse.Namespace) -> float:
    """Simulate and write the recording; its length, s."""
    config = ArmSimulation.preset(
        options.preset,
        protocol="random",
        duration_s=60.0 * options.minutes,
        imu_rate_hz=80.0,
        frame_rate_hz=30.0,
        occlusion_lengths_s=(2.0,),
        occlusion_every_s=10.0,
    )
    recording = simulate_arm(config, options.seed).recording
    write_recording(recording, path)
    return float(recording.imu.t_s[-1] - recording.imu.t_s[0])


def end_to_end(source: Path, result: Path, processes: int) -> float:
    """Seconds that the command takes, start of the program included."""
    began = time.perf_counter()
    command = "import sys; from smoother.cli import main; main()"
    arguments = ["smooth", str(source), "-o", str(result), "--processes", str(processes)]
    subprocess.run([sys.executable, "-c", command, *arguments], check=True, stdout=subprocess.DEVNULL)
    return time.perf_counter() - began


def profile(source: Path, result: Path, processes: int) -> tuple[dict[str, float], int]:
    """Seconds by part, and the number of gaps."""
    clock = Clock()
    clock.now("read")
    recording = read_recording(source)
    clock.now("calibrate")
    config = Config.model_validate({"windows": {"processes": processes}})
    names = {
        "calibrating": "calibrate",
        "first pass": "solve: first pass",
        "recovering": "solve: second pass",
    }
    recovery = smooth(
        recording, None, config, lambda fraction, text: clock.now(names.get(text, "join and assemble"))
    )
    clock.now("write")
    write_recovery(recovery, result, source=source)
    clock.now("")
    return clock.spent, len(recovery.gaps)


def main() -> None:
    """Make the recording, run, print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=6.0)
    parser.add_argument("--preset", default="white", help="errors of the simulation: white, realistic, clean")
    parser.add_argument("--processes", type=int, default=0, help="worker processes; 0 = one a core")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        length_s = make(folder / "rec.mcap", options)
        spent_s = end_to_end(folder / "rec.mcap", folder / "out.mcap", options.processes)
        parts, gaps = profile(folder / "rec.mcap", folder / "again.mcap", options.processes)
    cores = options.processes or os.cpu_count() or 1
    print(f"{length_s:.0f} s of recording, {gaps} gaps, {cores} processes")
    print(f"unocclude smooth, file to file: {length_s / spent_s:.0f} times real time")
    total = sum(parts.values())
    print(f"without the program's start: {length_s / total:.0f} times real time, of which")
    for part, seconds in parts.items():
        print(f"  {part:20} {100 * seconds / total:5.1f} %")


if __name__ == "__main__":
    main()
