"""Every page that a command writes, each from a small simulated input."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from made_measures import made_measure, made_measures, person

from smoother.cli.run import run
from smoother.io import write_recording
from smoother.measures import BothArms
from smoother.measures.symmetry import COMPARED
from smoother.report.pages import measures_page, progress_page
from smoother.simulation import ArmSimulation, simulate_arm

#: A file may be called so; a name cannot hold a slash.
HOSTILE_NAME = "<img src=x onerror=hacked=1>"


def command(*arguments: object, ends: tuple[int, ...] = (0,)) -> None:
    """Run a command of unocclude in this process."""
    assert run([str(argument) for argument in arguments]) in ends, arguments


def paged(folder: Path, name: str, *words: object) -> Path:
    """The page of a command."""
    command(*words, "--report", folder / f"{name}.html")
    return folder / f"{name}.html"


def arm_session(folder: Path) -> Path:
    """Sixteen seconds of an arm with occlusions, its calibration and its motion capture; made once."""
    path = folder / "arm.mcap"
    if not path.exists():
        options = ("--set", "protocol=random", "--set", "duration_s=16", "--seed", 6)
        command("simulate", "arm", *options, "-o", path, "--mocap", "--calibration-out", folder / "cal.toml")
    return path


def smooth(folder: Path) -> Path:
    """With what `smooth` makes of the session; made once."""
    if (folder / "smooth.html").exists():
        return folder / "smooth.html"
    known = ("--calibration", folder / "cal.toml", "--processes", 1, "--draws", 20)
    return paged(folder, "smooth", "smooth", arm_session(folder), "-o", folder / "recovered.mcap", *known)


def validate(folder: Path) -> Path:
    smooth(folder)
    return paged(folder, "validate", "validate", folder / "recovered.mcap", "--truth", arm_session(folder))


def gaps(folder: Path) -> Path:
    known = ("--calibration", folder / "cal.toml", "--processes", 1)
    return paged(folder, "gaps", "gaps", arm_session(folder), "--lengths", "0.5,1", *known)


def compare(folder: Path) -> Path:
    known = ("--calibration", folder / "cal.toml", "--processes", 1)
    methods = ("--methods", "graph,linear-drift,pchip,hold")
    return paged(folder, "compare", "compare", arm_session(folder), *known, *methods)


def study(folder: Path, name: str = HOSTILE_NAME) -> Path:
    """Two recordings and a file that is none."""
    sessions = folder / "sessions"
    sessions.mkdir()
    gap = {"occlusion_lengths_s": (0.8,), "occlusion_every_s": 4.0}
    settings = ArmSimulation.preset("white", protocol="random", duration_s=6.0, **gap)
    for seed, stem in enumerate((name, "b")):
        write_recording(simulate_arm(settings, seed).recording, sessions / f"{stem}.mcap")
    (sessions / f"{name} broken.mcap").write_bytes(b"this is not a recording")
    command("batch", sessions, "-o", folder / "study", "--processes", 1, "--report", ends=(0, 1))
    return folder / "study" / "report.html"


#: What people and devices call something, as long as a line.
LONG_NAME = f"{HOSTILE_NAME} that takes a whole line of the page to say"


def measures(folder: Path) -> Path:
    """Both arms with many movements and notes."""
    notes = tuple(f"{LONG_NAME}, number {n}" for n in range(9))
    about = {"movements": 40, "notes": notes, "name": LONG_NAME, "verdict": LONG_NAME}
    left, right = (made_measures(side, **about) for side in ("left", "right"))
    compared = (key for key in COMPARED if key in left.by_key)
    symmetry = tuple(made_measure(f"{key}_symmetry_percent", -100.4, 12.2) for key in compared)
    measures_page([left, right], [BothArms(left, right, symmetry)]).write(folder / "measures.html")
    return folder / "measures.html"


def progress(folder: Path) -> Path:
    """Forty sessions of both arms."""
    whole = person(40, ("left", "right"), LONG_NAME)
    series = tuple(replace(each, task=HOSTILE_NAME) for each in whole.series)
    notes = tuple(f"{LONG_NAME}, number {n}" for n in range(9))
    told = replace(whole, series=series, left_out=(HOSTILE_NAME,), notes=notes)
    progress_page(told).write(folder / "progress.html")
    return folder / "progress.html"


#: By the name of the command whose page it is.
PAGES: dict[str, Callable[[Path], Path]] = {
    page.__name__: page for page in (*(smooth, validate, gaps, compare, study, measures, progress),)
}
