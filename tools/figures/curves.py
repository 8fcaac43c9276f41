"""Error against gap length: jobs by data set and method, run, kept, summed up, tabled and drawn.

The drawing has one panel per data set, every method as a line, and quartiles as its spread.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, replace
from functools import lru_cache
from multiprocessing import get_context
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
from scipy.spatial.transform import Rotation

from calib.motion.motion_calibration import calibrate_motion
from smoother.calibration import ArmCalibration
from smoother.config import Config
from smoother.evaluation.gap_table import spread_of
from smoother.evaluation.gaps import evaluate_gaps
from smoother.evaluation.methods import METHODS, make_methods
from smoother.io import import_broad, import_utd_mhad
from smoother.measurements.clock import constant_clock
from smoother.recording import Recording
from smoother.report.method_comparison import PLAIN, STYLES
from smoother.result import Recovery
from smoother.simulation import ArmSimulation, simulate_arm
from smoother.smoothing import smooth
from tools.accuracy.check import ONE_PROCESS, datasets

#: How far a tripod's camera is taken to be off the level, degrees.
TILT_DEG = 3.0


def without_shoulder(recording: Recording, config: Config) -> Recovery:
    """No upper-arm length: the elbow is held to no sphere about the shoulder."""
    return smooth(_hidden(recording, "shoulder"), None, config)


def without_wrist(recording: Recording, config: Config) -> Recovery:
    """Neither wrist nor hand: of the forearm the camera sees the elbow alone, in the gaps and beside them."""
    return smooth(_hidden(recording, "wrist", "hand"), None, config)


def without_gravity(recording: Recording, config: Config) -> Recovery:
    """Gravity not solved, but taken from the camera's axes, which are off the level by `TILT_DEG`."""
    assert recording.camera_frame is not None
    tilt = Rotation.from_euler("xz", [TILT_DEG / np.sqrt(2)] * 2, degrees=True)
    down = tilt.apply(recording.camera_frame.down)
    return smooth(replace(recording, gravity_hint=down, gravity_sigma_rad=1e-4), None, config)


def without_clock(recording: Recording, config: Config) -> Recovery:
    """Clock offset not solved: the camera's stamps are believed as they came."""
    place = "smoother.selfcal.rounds"
    with (
        patch(f"{place}.constant_clock", lambda *_: constant_clock(0.0, 1e-4)),
        patch(f"{place}.refined_clock", lambda clock, *_: clock),
    ):
        return smooth(recording, None, config)


def _hidden(recording: Recording, *joints: str) -> Recording:
    everywhere = np.ones(len(recording.arm), dtype=bool)
    return replace(recording, arm=recording.arm.hide(everywhere, joints))


WITHOUT: dict[str, Callable[[Recording, Config], Recovery]] = {
    "no upper-arm length": without_shoulder,
    "no wrist": without_wrist,
    f"gravity {TILT_DEG:g} degrees off": without_gravity,
    "clock offset not solved": without_clock,
}


LENGTHS_S = (1.0, 3.0, 2.0, 5.0, 0.5, 0.25)
#: Of UTD-MHAD's trials, 2 to 6.5 s long; and what stays seen on both sides of a gap there, s.
UTD_LENGTHS_S, UTD_MARGIN_S = (1.0, 0.5, 0.25, 2.0), 0.5
#: For what each ingredient brings.
INGREDIENT_LENGTHS_S = (1.0, 3.0)
#: Simulated recordings and stretches of BROAD's trials are this long, s.
DURATION_S, BROAD_S = 60.0, 40.0
#: Not used while the methods were made.
FIRST_SEED = 500

TITLES = {
    "clean": "simulated arm, no errors",
    "realistic": "simulated arm, realistic errors",
    "broad": "BROAD: a real IMU moved by hand",
    "utd": "UTD-MHAD: Kinect v1 and a wrist IMU",
    "ingredients": "the graph without ..",
}


@dataclass(frozen=True)
class Job:
    """One recording with gaps of one length, all methods."""

    data: str  # A name of `TITLES`
    recording: str  # Which of its recordings: a seed, a file, or "subject/trial"
    length_s: float  # The gaps' length, s
    methods: tuple[str, ...] = METHODS  # Names to run

    @property
    def name(self) -> str:
        """Tells the job from every other one."""
        return f"{self.data} {self.recording} {self.length_s:g} s"


def jobs(data: list[str], seeds: int) -> Iterator[Job]:
    """All jobs, the most informative first, so that an unfinished run has something of everything."""
    for rank in range(max(seeds, len(LENGTHS_S))):
        for name in data:
            lengths = {"utd": UTD_LENGTHS_S, "ingredients": INGREDIENT_LENGTHS_S}.get(name, LENGTHS_S)
            methods = tuple(WITHOUT) if name == "ingredients" else METHODS
            if rank < len(lengths):
                for recording in recordings_of(name, seeds):
                    yield Job(name, recording, lengths[rank], methods)


def recordings_of(data: str, seeds: int) -> list[str]:
    """The recordings of a data set."""
    if data == "broad":
        return sorted(path.name for path in datasets("broad").glob("*.mat"))
    if data == "utd":
        return [f"{subject}/2" for subject in range(1, 5)]
    # recordings without errors differ in nothing but the motion: one of them will do
    count = {"clean": 1, "ingredients": (seeds + 1) // 2}.get(data, seeds)
    return [str(FIRST_SEED + k) for k in range(count)]


def run_job(job: Job) -> list[dict[str, object]]:
    """Hide, recover with every method, and score; one row per gap and method."""
    rows = []
    for recording, calibration in _recordings(job):
        methods = _methods(job, calibration)
        utd = job.data == "utd"
        try:
            table = evaluate_gaps(
                recording,
                [job.length_s],
                methods,
                seed=FIRST_SEED,
                gaps_per_run=1 if utd else 6,
                margin_s=UTD_MARGIN_S if utd else 1.5,
            )
        except Exception as error:  # a trial too short for the gap; a job never stops the others
            rows.append({"recording": recording.name, "skipped": str(error)})
            continue
        rows += [{"recording": recording.name, **row.to_dict()} for row in table.rows]
    return rows


def _methods(job: Job, calibration: ArmCalibration | None) -> dict[str, Callable]:
    if job.data == "ingredients":
        return {name: partial_graph(WITHOUT[name]) for name in job.methods}
    return dict(make_methods(job.methods, calibration, ONE_PROCESS))


def partial_graph(without: Callable) -> Callable:
    """The graph on a recording from which something was taken."""
    return lambda recording: without(recording, ONE_PROCESS)


def _recordings(job: Job) -> Iterator[tuple[Recording, ArmCalibration | None]]:
    if job.data == "broad":
        yield _moving(import_broad(datasets("broad") / job.recording)), None
    elif job.data == "utd":
        subject, trial = (int(part) for part in job.recording.split("/"))
        calibration = _calibrated(subject)
        for recording in _utd(subject, trial):
            yield recording, calibration
    else:
        preset = "clean" if job.data == "clean" else "realistic"
        settings = ArmSimulation.preset(
            preset, protocol="random", duration_s=DURATION_S, occlusion_lengths_s=()
        )
        yield simulate_arm(settings, seed=int(job.recording)).recording, None


def _moving(recording: Recording) -> Recording:
    """From where the body begins to move."""
    assert recording.truth is not None
    start = float(recording.truth.t_s[np.argmax(recording.truth.score)])
    imu, frames = recording.imu.t_s, recording.arm.t_s
    return replace(
        recording,
        imu=recording.imu.select((imu >= start) & (imu < start + BROAD_S)),
        arm=recording.arm.select((frames >= start) & (frames < start + BROAD_S)),
    )


def _utd(subject: int, trial: int) -> list[Recording]:
    folder = datasets("utd_mhad")
    names = [f"a{action}_s{subject}_t{trial}" for action in range(1, 22)]
    files = [
        (folder / "Inertial" / f"{name}_inertial.mat", folder / "Skeleton" / f"{name}_skeleton.mat")
        for name in names
    ]
    return [import_utd_mhad(*pair) for pair in files if all(path.exists() for path in pair)]


@lru_cache(maxsize=4)
def _calibrated(subject: int) -> ArmCalibration:
    """From the subject's first trials, none of which is scored."""
    return calibrate_motion(_utd(subject, 1), None, ONE_PROCESS).calibration


Rows = list[dict[str, Any]]


def measure(todo: Iterable[Job], kept: Path, processes: int, until_s: float = float("inf")) -> None:
    """Run what `kept` does not hold yet, and add each job to it as it ends."""
    done = {entry["job"] for entry in read_rows(kept)}
    left = [job for job in todo if job.name not in done]
    began = time.perf_counter()
    with ProcessPoolExecutor(processes, get_context("spawn")) as pool, open(kept, "a") as file:
        running = {}
        while left or running:
            while left and len(running) < processes and time.perf_counter() - began < until_s:
                job = left.pop(0)
                running[pool.submit(run_job, job)] = job
            if not running:
                break
            ended = next(as_completed(running))
            job = running.pop(ended)
            file.write(json.dumps({"job": job.name, "data": job.data, "rows": ended.result()}) + "\n")
            file.flush()
            print(f"{time.perf_counter() - began:6.0f} s  {job.name}, {len(left)} left", flush=True)


def read_rows(kept: Path) -> list[dict[str, Any]]:
    """The jobs that are done."""
    if not kept.exists():
        return []
    return [json.loads(line) for line in kept.read_text(encoding="utf-8").splitlines()]


def summed_up(entries: list[dict[str, Any]]) -> dict[str, Any]:
    """Figures by data set, gap length and method; the graph beside its ingredients is on the same gaps."""
    found: dict[str, Any] = {}
    for data, title in TITLES.items():
        rows = [row for entry in entries if entry["data"] == data for row in entry["rows"]]
        if data == "ingredients":
            rows = _graph_beside(rows, entries) + rows
        scored = [row for row in rows if "skipped" not in row]
        if scored:
            found[data] = {"title": title, "lengths": _lengths(scored)}
    return found


def _graph_beside(rows: Rows, entries: list[dict[str, Any]]) -> Rows:
    """The whole graph's rows in the gaps of these rows."""
    gaps = {(row["recording"], row["length_s"], row["start_s"]) for row in rows}
    return [
        row
        for entry in entries
        if entry["data"] == "realistic"
        for row in entry["rows"]
        if row["method"] == "graph" and (row["recording"], row["length_s"], row["start_s"]) in gaps
    ]


def _lengths(rows: Rows) -> list[dict[str, Any]]:
    found = []
    for length in sorted({row["length_s"] for row in rows}):
        here = [row for row in rows if row["length_s"] == length]
        methods = {}
        for name in dict.fromkeys(row["method"] for row in here):
            mine = [row for row in here if row["method"] == name]
            spread = spread_of([None if row["failure"] else row["rms_m"] for row in mine])
            samples = [(row["rms_m"] ** 2 * row["samples"], row["samples"]) for row in mine if row["samples"]]
            count = sum(n for _, n in samples)
            pooled = (sum(total for total, _ in samples) / count) ** 0.5 if count else None
            methods[name] = {
                **{key: _rounded(value) for key, value in spread.to_dict().items()},
                "samples_rms_m": _rounded(pooled),
                "nees": _rounded(_mean_nees(mine)),
            }
        found.append({"length_s": length, "methods": methods})
    return found


def _mean_nees(rows: Rows) -> float | None:
    known = [(row["nees"] * row["samples"], row["samples"]) for row in rows if row["nees"] is not None]
    count = sum(n for _, n in known)
    return sum(total for total, _ in known) / count if count else None


def _rounded(value: float | int | None) -> float | int | None:
    return round(value, 5) if isinstance(value, float) else value


def tables(found: dict[str, Any]) -> Iterator[str]:
    """One table per data set: rms over all samples in the gaps, and median and quartiles over gaps, cm."""
    for panel in found.values():
        lengths = panel["lengths"]
        names = list(dict.fromkeys(name for entry in lengths for name in entry["methods"]))
        gaps = ", ".join(str(max(each["gaps"] for each in entry["methods"].values())) for entry in lengths)
        yield f"\n**{panel['title']}** (gaps per length: {gaps}); cm, rms / median (25 % .. 75 %)\n"
        yield "| gap | " + " | ".join(f"{entry['length_s']:g} s" for entry in lengths) + " |"
        yield "|---" * (len(lengths) + 1) + "|"
        for name in sorted(names, key=lambda name: _order(lengths, name)):
            yield f"| {name} | " + " | ".join(_cell(entry["methods"].get(name)) for entry in lengths) + " |"


def _order(lengths: list[dict[str, Any]], name: str) -> float:
    """By the sum of the medians, each against the best at its length."""
    total = 0.0
    for entry in lengths:
        known = [each["median_m"] for each in entry["methods"].values() if each["median_m"]]
        mine = entry["methods"].get(name, {}).get("median_m")
        total += mine / min(known) if mine and known else 1e3
    return total


def _cell(each: dict[str, Any] | None) -> str:
    if each is None or each["median_m"] is None:
        return "-"
    digits = 1 if each["median_m"] >= 0.1 else 2 if each["median_m"] >= 0.001 else 3
    rms, median, low, high = (
        f"{100 * each[key]:.{digits}f}" for key in ("samples_rms_m", "median_m", "low_m", "high_m")
    )
    failed = f", {each['failed']} failed" if each["failed"] else ""
    return f"{rms} / {median} ({low} .. {high}){failed}"


_DASHES = {"solid": "-", "dash": "--", "dot": ":"}
_MARKERS = dict(zip(STYLES, "osD^vPX<>.", strict=True))
_INGREDIENTS = ("#D55E00", "#444444", "#777777", "#A3A3A3", "#CCCCCC")
#: Panels in this order; the last is of the graph's own ingredients.
_PANELS = ("realistic", "broad", "utd", "clean", "ingredients")


def draw(found: dict[str, Any], output: Path) -> None:
    """Draw what `measure.summed_up` gives, as the kind of picture that the name ends in."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    plt.rcParams.update({"svg.hashsalt": "unocclude", "svg.fonttype": "none", "font.size": 9})
    plt.rcParams.update({"font.family": "sans-serif", "font.sans-serif": ["Arial", "DejaVu Sans"]})
    figure, axes = plt.subplots(2, 3, figsize=(12.0, 7.6), layout="constrained")
    places = axes.ravel()
    for axis, name in zip(places, _PANELS, strict=False):
        if name not in found:
            axis.axis("off")
        elif name == "ingredients":
            _ingredients(axis, found[name])
        else:
            _curves(axis, found[name])
    _legend(places[-1], found)
    figure.suptitle(
        "Error inside a gap against its length: median over gaps, bars and band from 25 % to 75 %",
        fontsize=11,
    )
    figure.savefig(output, metadata={"Date": None} if output.suffix == ".svg" else None, dpi=110)
    plt.close(figure)


def _curves(axis: Any, panel: dict[str, Any]) -> None:
    """One data set: lines of medians, a band of quartiles for the graph and bars for the others."""
    methods = list(dict.fromkeys(name for entry in panel["lengths"] for name in entry["methods"]))
    for place, name in enumerate(reversed(methods)):
        x, low, median, high = _points(panel, name)
        if not len(x):
            continue
        colour, dash = STYLES.get(name, PLAIN)
        bold = name == "graph"
        at = x if bold else x * 1.012 ** (place - len(methods) / 2)  # bars beside each other
        look: dict[str, Any] = {"color": colour, "ls": _DASHES[dash], "marker": _MARKERS.get(name, "o")}
        look |= {"lw": 3.0 if bold else 1.2, "ms": 6 if bold else 3.5, "zorder": 10 if bold else 3}
        axis.plot(at, median, label=name, **look)
        if bold:
            axis.fill_between(x, low, high, color=colour, alpha=0.22, lw=0, zorder=2)
        else:
            axis.errorbar(
                at, median, [median - low, high - median], fmt="none", ecolor=colour, lw=0.7, alpha=0.7
            )
    _dress(axis, panel, logarithmic=True)


def _ingredients(axis: Any, panel: dict[str, Any]) -> None:
    """Bars: the whole graph and what it loses without each ingredient."""
    names = list(panel["lengths"][0]["methods"])
    width = 0.8 / len(names)
    for place, name in enumerate(names):
        for number, entry in enumerate(panel["lengths"]):
            each = entry["methods"].get(name)
            if each is None or each["median_m"] is None:
                continue
            low, median, high = (100 * each[key] for key in ("low_m", "median_m", "high_m"))
            at = number + (place - (len(names) - 1) / 2) * width
            axis.bar(
                at,
                median,
                0.9 * width,
                color=_INGREDIENTS[place % len(_INGREDIENTS)],
                label=("the whole graph" if name == "graph" else name) if number == 0 else None,
            )
            axis.errorbar(at, median, [[median - low], [high - median]], fmt="none", ecolor="#333333", lw=0.9)
    axis.set_xticks(range(len(panel["lengths"])), [f"{entry['length_s']:g} s" for entry in panel["lengths"]])
    axis.set_ylabel("error in a gap, rms, cm")
    axis.set_title("What each ingredient brings\n(simulated arm, realistic errors)", fontsize=10)
    axis.set_ylim(0, 1.4 * axis.get_ylim()[1])  # room for the names
    axis.legend(fontsize=8, frameon=False, loc="upper left", ncols=2)
    axis.grid(axis="y", alpha=0.3)


def _points(panel: dict[str, Any], name: str) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Lengths, s, and the quartiles at them, cm."""
    rows = [
        (entry["length_s"], *(100 * entry["methods"][name][key] for key in ("low_m", "median_m", "high_m")))
        for entry in panel["lengths"]
        if name in entry["methods"] and entry["methods"][name]["median_m"] is not None
    ]
    x, low, median, high = np.array(rows).reshape(-1, 4).T
    return x, low, median, high


def _dress(axis: Any, panel: dict[str, Any], logarithmic: bool) -> None:
    lengths = [entry["length_s"] for entry in panel["lengths"]]
    counts = [next(iter(entry["methods"].values()))["gaps"] for entry in panel["lengths"]]
    if logarithmic:
        axis.set_xscale("log")
        axis.set_yscale("log")
    axis.set_xticks(lengths, [f"{length:g}" for length in lengths])
    axis.minorticks_off()
    low, high = axis.get_ylim()
    ticks = [
        tick
        for tick in (0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100)
        if low <= tick <= high
    ]
    axis.set_yticks(ticks, [f"{tick:g}" for tick in ticks])
    axis.set_xlabel("gap, s")
    axis.set_ylabel("error in a gap, rms, cm")
    gaps = f"{min(counts)} to {max(counts)}" if min(counts) < max(counts) else f"{max(counts)}"
    axis.set_title(f"{panel['title']}\n({gaps} gaps per length)", fontsize=10)
    axis.grid(alpha=0.3)


def _legend(axis: Any, found: dict[str, Any]) -> None:
    """The methods once for all panels, in the sixth place."""
    from matplotlib.lines import Line2D

    axis.axis("off")
    names = [name for name in STYLES if any(_has(found[panel], name) for panel in found)]
    lines = [
        Line2D(
            [],
            [],
            color=STYLES[name][0],
            ls=_DASHES[STYLES[name][1]],
            marker=_MARKERS[name],
            lw=3.0 if name == "graph" else 1.4,
            ms=6 if name == "graph" else 4,
        )
        for name in names
    ]
    labels = [f"{name} (unocclude)" if name == "graph" else name for name in names]
    axis.legend(lines, labels, loc="center", frameon=False, fontsize=10, handlelength=3.5, labelspacing=0.8)


def _has(panel: dict[str, Any], name: str) -> bool:
    return any(name in entry["methods"] for entry in panel["lengths"])
