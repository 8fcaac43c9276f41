"""Other ways to the same answer, timed on the same recording: the plain graphs, `rts`, `linear-drift`.

Each runs in a process of its own on what `smooth` found, as every baseline does (`smoother.baselines`):
calibration, clock, gravity, which samples to believe, and the gaps. Finding that is in `smooth`'s time and
not in theirs.
Two times of each: its own (from scene to path), and with what it needs beside (orientation filter and
alignment before, putting the answer together after). Neither reads nor writes a file.
"""

from __future__ import annotations

import os
import pickle
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from smoother.baselines.adapter import recovery_of, scenes_of
from smoother.baselines.registry import BASELINES
from smoother.baselines.scene import Path as Answer
from smoother.baselines.scene import Scene
from smoother.config import Config
from smoother.io import read_recording
from smoother.smoothing import smooth

from .exactness import Exactness, apart_cm, exactness
from .memory import PrivatePeak
from .plain import WAYS, Timed, solve_plainly
from .recordings import Made, read_truth

BASELINES_BESIDE = ("rts", "linear-drift")
METHODS = (*(f"plain graph, {way}" for way in WAYS), *BASELINES_BESIDE)


@dataclass(frozen=True)
class Beside:
    """A method's time and errors.

    Attributes
    ----------
    own_s, all_s : float, s
        Its own time, and with what it needs; of `smooth` both are the whole call, from a recording in memory
        to a recovery in memory, self-calibration included.
    cpu_s : float, s
        Processor time of `all_s`, workers' included where they have ended.
    peak_mb : float, MB
        Private memory of the process that ran it, which holds recording and `smooth`'s answer too.
    exact : Exactness
        Errors in the gaps.
    from_smooth_cm : float, cm
        Rms distance from `smooth`'s answer in the gaps.
    steps : dict
        Seconds by step, and iterations, of a plain graph.
    """

    own_s: float
    all_s: float
    cpu_s: float
    peak_mb: float
    exact: Exactness
    from_smooth_cm: float
    steps: dict[str, float] = field(default_factory=dict)


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
