"""Speed, memory and exactness in one run, as ratios: `python -m tools.benchmark`.

Simulates recordings (80 Hz IMU, 30 Hz camera, an occlusion of 2 s about every 10 s) and runs `unocclude
smooth` on them, file to file, with nothing calibrated: how many times faster than real time, how much memory,
how far off in the gaps; and beside it, on the same recordings, one plain graph over the whole, `rts` and
`linear-drift`. On the shortest recording also what
a person waits for, command by command. Let nothing else run meanwhile.
"""

from __future__ import annotations

import argparse
import compileall
import json
import os
import platform
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path
from typing import Any

import calib
import smoother
from smoother.runtime.printable import plain
from tools.benchmark.whole import METHODS, Beside, exactness_of_file, run_method, run_smooth

from . import tables
from .isolated import Stopped, isolated
from .whole import Made, against, end_to_end, help_seconds, make, waited

MEASURES = ("whole", "beside", "waiting")


def main() -> None:
    """Make the recordings one after the other, measure, print, and keep the figures."""
    options = _options()
    _as_installed()
    cores = options.processes or len(os.sched_getaffinity(0))
    figures: dict[str, Any] = {"machine": _machine(cores), "whole": [], "beside": {}}
    figures |= {"against": {}, "waiting": []}
    print("\n".join(_heading(figures["machine"], options)), flush=True)
    lengths_s: dict[float, float] = {}
    figures["help_s"] = help_seconds()
    with tempfile.TemporaryDirectory(dir=options.folder) as name:
        for made in _recordings(Path(name), options):
            lengths_s[made.minutes] = made.length_s
            _measure(made, Path(name), options, cores, figures)
    if options.against:
        print("\n".join(tables.against(figures["against"], options.against)))
    else:
        _print(figures, lengths_s, cores)
    if options.json:
        options.json.write_text(json.dumps(plain(figures), indent=1) + "\n", encoding="utf-8")


def _measure(
    made: Made, folder: Path, options: argparse.Namespace, cores: int, figures: dict[str, Any]
) -> None:
    """Everything that is asked for of one recording, into the figures."""
    result = folder / "out.mcap"
    if options.against:
        _say(f"{made.minutes:g} min: {options.against} and this one in turn")
        ratios = against(options.against, made.path, result, options.processes, options.runs)
        figures["against"][made.minutes] = ratios
        return
    if "whole" in options.only:
        _say(f"{made.minutes:g} min: the command")
        figures["whole"] += _whole(made, result, options)
    if "waiting" in options.only and made.minutes == options.minutes[0]:
        _say(f"{made.minutes:g} min: every command")
        figures["waiting"] = [asdict(each) for each in waited(made, folder)]
    if "beside" in options.only and made.minutes in options.beside:
        figures["beside"][made.minutes] = _beside(made, folder / "settings.pickle", options)


def _print(figures: dict[str, Any], lengths_s: dict[float, float], cores: int) -> None:
    lines = [f"`unocclude --help`: {figures['help_s']:.2f} s (aim: {tables.AIM_HELP_S:g})"]
    if figures["whole"]:
        lines += tables.whole(figures["whole"])
    for minutes, found in figures["beside"].items():
        command_s = _command_s(minutes, figures["whole"])
        lines += tables.beside(minutes, found, command_s, lengths_s[minutes])
    if figures["waiting"]:
        lines += tables.waiting(figures["waiting"], min(lengths_s))
    print("\n".join(lines))


def _as_installed() -> None:
    """Compile the packages, as pip does: a start that may not keep what it compiles takes 0.2 s more."""
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
    for package in (smoother, calib):
        compileall.compile_dir(Path(str(package.__file__)).parent, quiet=1)


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m tools.benchmark",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--minutes", type=float, nargs="+", help="lengths; 1 6 30 60 if not given")
    parser.add_argument(
        "--against",
        metavar="PYTHON",
        help="interpreter of another installation: only compare with that",
    )
    parser.add_argument("--runs", type=int, default=5, help="of each, with --against")
    parser.add_argument("--long", action="store_true", help="10 minutes and 6 hours as well")
    parser.add_argument("--without-truth", action="store_true", help="leave the true motion out of the files")
    parser.add_argument("--preset", default="white", help="errors of the simulation: white, realistic, clean")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--processes", type=int, default=0, help="worker processes; 0 = one per core")
    parser.add_argument("--only", nargs="+", choices=MEASURES, default=MEASURES, help="measure only this")
    parser.add_argument("--beside", type=float, nargs="*", default=[6, 30], help="lengths for other methods")
    parser.add_argument("--limit-s", type=float, default=600.0, help="stop another method after this")
    parser.add_argument("--limit-gb", type=float, default=8.0, help="or at this much memory")
    parser.add_argument("--folder", type=Path, help="where to put the recordings meanwhile")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all figures")
    options = parser.parse_args()
    options.minutes = options.minutes or [1.0, 6.0, 30.0] + ([] if options.against else [60.0])
    if options.long:
        options.minutes = [*options.minutes, 10.0, 360.0]
    options.minutes = sorted({float(minutes) for minutes in options.minutes})
    return options


def _machine(cores: int) -> dict[str, Any]:
    cpu = platform.processor() or platform.machine()
    info = Path("/proc/cpuinfo")
    if info.exists():
        names = [
            line.partition(":")[2].strip() for line in info.read_text().splitlines() if "model name" in line
        ]
        cpu = names[0] if names else cpu
    return {
        "cpu": cpu,
        "cores": cores,
        "load_before": os.getloadavg()[0],
        "python": platform.python_version(),
        "gtsam": version("gtsam"),
        "numpy": version("numpy"),
    }


def _heading(machine: dict[str, Any], options: argparse.Namespace) -> list[str]:
    lines = [
        f"{machine['cpu']}, {machine['cores']} processes; Python {machine['python']},"
        f" GTSAM {machine['gtsam']}, NumPy {machine['numpy']}; preset {options.preset}, seed {options.seed},"
        f" truth {'left out of' if options.without_truth else 'in'} the files"
    ]
    if machine["load_before"] > 0.3:
        lines.append(
            f"Other work runs here (load {machine['load_before']:.1f}): times are longer than they would be."
        )
    return lines


def _recordings(folder: Path, options: argparse.Namespace) -> Iterator[Made]:
    """One recording after the other, each taken away when the next one is made."""
    for minutes in options.minutes:
        made: Made = isolated(make, folder, minutes, options.preset, options.seed, not options.without_truth)
        yield made
        for path in folder.iterdir():
            path.unlink()


def _whole(made: Made, result: Path, options: argparse.Namespace) -> list[dict[str, Any]]:
    run = end_to_end(made.path, result, options.processes)
    exact = isolated(exactness_of_file, result, made.truth)
    about = {"minutes": made.minutes, "length_s": made.length_s, "file_mb": made.path.stat().st_size / 1e6}
    return [about | asdict(run) | {"exact": asdict(exact)}]


def _command_s(minutes: float, whole: list[dict[str, Any]]) -> float | None:
    """Seconds of the command on the recording of this length."""
    return next((r["seconds"] for r in whole if r["minutes"] == minutes), None)


def _beside(made: Made, kept: Path, options: argparse.Namespace) -> dict[str, Any]:
    _say(f"{made.minutes:g} min: `smooth` from memory to memory")
    found: dict[str, Any] = {"smooth": asdict(isolated(run_smooth, made, options.processes, kept))}
    for name in METHODS:
        _say(f"{made.minutes:g} min: {name}")
        try:
            each: Beside = isolated(
                run_method, made, name, kept, limit_s=options.limit_s, limit_gb=options.limit_gb
            )
            found[name] = asdict(each)
        except Stopped as why:
            found[name] = {
                "stopped": str(why),
                "own_s": why.seconds,
                "all_s": why.seconds,
                "cpu_s": None,
                "peak_mb": why.peak_mb,
                "exact": None,
                "steps": {},
            }
        except RuntimeError as error:
            found[name] = f"failed: {error}"
    return found


def _say(text: str) -> None:
    """What is being measured, on stderr."""
    print(f"  .. {text}", file=sys.stderr, flush=True)


if __name__ == "__main__":
    main()
