"""What the curves are measured on: recordings, gap lengths and methods, a job each."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from calib.motion.motion_calibration import calibrate_motion
from smoother.calibration import ArmCalibration
from smoother.cli.methods import METHODS, make_methods
from smoother.evaluation.gaps import evaluate_gaps
from smoother.io import import_broad, import_utd_mhad
from smoother.recording import Recording
from smoother.simulation import ArmSimulation, simulate_arm

from ..accuracy.check import ONE_PROCESS, datasets
from .without import WITHOUT

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
    """One recording with gaps of one length, all methods.

    Attributes
    ----------
    data : str
        A name of `TITLES`.
    recording : str or int
        Which of its recordings: a seed, a file, or "subject/trial".
    length_s : float, s
        The gaps' length, s.
    methods : sequence of str
        Names to run.
    """

    data: str
    recording: str
    length_s: float
    methods: tuple[str, ...] = METHODS

    @property
    def name(self) -> str:
        """Tells the job from every other one."""
        return f"{self.data} {self.recording} {self.length_s:g} s"


def jobs(data: list[str], seeds: int) -> Iterator[Job]:
    """All jobs, the ones that say most first, so that an unfinished run has something of everything."""
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
    """Hide, recover with every method, and score; one row a gap and method."""
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
