"""Damaged C3D files read as the commands read them: `python -m tools.faults.c3d --count 1200`.

Each mutant is drawn from a seed out of a few sound files: simulated motion capture, files with residuals and
many parameters, and those named on the command line. It is read in a child with a guard for time and memory,
markers and segments' poses. What it ends in: read (the same numbers, or others: nothing in a C3D file shows
of a digit that was changed), one clear sentence, or unexpected (a traceback, a signal, time or memory).
"""

from __future__ import annotations

import argparse
import faulthandler
import os
import resource
import signal
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

import numpy as np

from smoother.errors import RecordingError
from smoother.io.devices.marker_skeletons import read_segment_origins
from smoother.io.export.markers import C3dContent, write_c3d
from smoother.io.markers import read_c3d
from tools.faults import file_faults, write_table

#: Guard of a mutant: s of the processor and in all, bytes.
MOST_CPU_S, MOST_S, MOST_MEMORY = 30, 240, 3 << 30
ENDS = ("the same numbers", "other numbers", "one sentence", "unexpected")


def sound_files(folder: Path, more: list[Path]) -> list[bytes]:
    """The files that are damaged."""
    from io import StringIO

    from smoother.cli.run import run

    rng = np.random.default_rng(0)
    few = rng.normal(size=(20, 3, 3))
    write_c3d(folder / "few.c3d", C3dContent(("A", "B", "C"), few, 100.0), True)
    gaps = rng.normal(size=(50, 40, 3))
    gaps[10:20, ::3] = np.nan
    write_c3d(folder / "gaps.c3d", C3dContent(tuple(f"M{k}" for k in range(40)), gaps, 250.0), True)
    words = ["simulate", "arm", "-o", f"{folder}/rec.mcap", "--mocap", "--duration-s", "4"]
    shown, sys.stdout = sys.stdout, StringIO()
    try:
        assert run(words) == 0
    finally:
        sys.stdout = shown
    return [path.read_bytes() for path in [*sorted(folder.glob("*.c3d")), *more]]


def mutants(files: list[bytes], count: int, seed: int) -> list[tuple[str, int, bytes]]:
    """Fault, number of the sound file and bytes of this many mutants; some have several faults."""
    rng = np.random.default_rng(seed)
    changes = {**file_faults.C3D, "parameters filled": _filled}
    drawn = []
    for number in range(count):
        fault = list(changes)[number % len(changes)]
        which = int(rng.integers(len(files)))
        data = changes[fault](files[which], rng)
        while rng.random() < 0.25 and len(data) > 2048:
            data = changes[str(rng.choice(list(changes)))](data, rng)
        drawn.append((fault, which, data))
    return drawn


def _filled(data: bytes, rng: np.random.Generator) -> bytes:
    """Some bytes of the parameters, where lengths and dimensions lie, at the ends of their range."""
    for _ in range(int(rng.integers(1, 6))):
        at = int(rng.integers(512, min(len(data), 4096) - 2))
        value = bytes([int(rng.choice([0, 1, 127, 128, 255]))])
        data = file_faults.put(data, at, value * int(rng.integers(1, 3)))
    return data


def outcome(path: Path, sound: np.ndarray) -> tuple[str, str]:
    """What reading a file ends in, and why."""
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        end, text = ENDS[3], ""
        try:
            faulthandler.disable()  # how the child ends is the answer
            signal.alarm(MOST_S)
            resource.setrlimit(resource.RLIMIT_CPU, (MOST_CPU_S, MOST_CPU_S + 1))
            pages = int(Path("/proc/self/statm").read_text().split()[0])
            most = pages * resource.getpagesize() + MOST_MEMORY
            resource.setrlimit(resource.RLIMIT_AS, (most, most))
            os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
            position = read_c3d(path).position
            read_segment_origins(path)
            end = ENDS[0] if np.array_equal(position, sound, equal_nan=True) else ENDS[1]
        except RecordingError as error:
            end, text = (ENDS[2], str(error)) if "\n" not in str(error) else (ENDS[3], "several lines")
        except BaseException as error:
            text = f"{type(error).__name__}: {error}"
        os.write(writing, f"{end}\0{text[:300]}".encode(errors="replace"))
        os._exit(0)
    os.close(writing)
    with os.fdopen(reading, "rb") as answer:
        end, _, text = answer.read().decode(errors="replace").partition("\0")
    code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    return (end, text) if end else (ENDS[3], f"ended by signal {-code}")


def main() -> int:
    """Read all mutants; 1 where one was unexpected."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("files", nargs="*", type=Path, help="more sound files")
    parser.add_argument("--count", type=int, default=1200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--write", type=Path, help="put the table into this page")
    options = parser.parse_args()
    counts: dict[str, Counter[str]] = {}
    slowest = 0.0
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        files = sound_files(folder, options.files)
        path = folder / "mutant.c3d"
        sound = []
        for data in files:
            path.write_bytes(data)
            sound.append(read_c3d(path).position)
        for fault, which, data in mutants(files, options.count, options.seed):
            path.write_bytes(data)
            began = time.monotonic()
            end, text = outcome(path, sound[which])
            slowest = max(slowest, time.monotonic() - began)
            counts.setdefault(fault, Counter())[end] += 1
            if end == ENDS[3]:
                print(f"{fault} of file {which}: {text}", file=sys.stderr, flush=True)
    rows = [f"| fault | mutants | {' | '.join(ENDS)} |", "|---" * (len(ENDS) + 2) + "|"]
    for fault, ends in [*counts.items(), ("all", sum(counts.values(), Counter()))]:
        rows.append(f"| {fault} | {sum(ends.values())} | {' | '.join(str(ends[end]) for end in ENDS)} |")
    text = "\n".join(rows)
    print(f"{text}\nthe slowest took {slowest:.1f} s")
    if options.write:
        said = f"`python -m tools.faults.c3d --count {options.count} --seed {options.seed}` gave"
        write_table(options.write, f"{said}\n\n{text}", "tools.faults.c3d")
    return int(any(ends[ENDS[3]] for ends in counts.values()))


if __name__ == "__main__":
    sys.exit(main())
