"""How a method of others is scored: its tasks as plain files, and its answers read.

A task is a folder, `DATASET/TRIAL` where gaps of all lengths are in one copy, else `DATASET/TRIAL_LENGTHs`.
It contains a recording as `unocclude import csv` takes it (`recording.toml`, `skeleton.csv`,
`imu_forearm.csv`), hidden frames as `not_tracked`, and `task.json`. An answer is a file of the task's name
and `.csv` with the columns `t_s, x, y, z` and, where sigma is stated, `sigma_x, sigma_y, sigma_z` (one
standard deviation), on the camera's clock and in its axes.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..array_types import FloatArray
from ..errors import RecordingError, UnoccludeError
from ..evaluation.gaps import hide
from ..evaluation.hidden_gaps import HiddenGap
from ..recording import JOINTS, CameraFrame, JointState, Recording
from .datasets import VERSION, BenchmarkTrial

_STATES = {
    int(JointState.NOT_TRACKED): "not_tracked",
    int(JointState.INFERRED): "inferred",
    int(JointState.TRACKED): "tracked",
}
_FRAMES = {CameraFrame.KINECT: "kinect", CameraFrame.OPTICAL: "optical", CameraFrame.ZUP: "zup"}


#: Gaps of one copy with the lengths that were asked for, s.
PlacedGaps = Sequence[tuple[float, HiddenGap]]


def task_name(trial: BenchmarkTrial, lengths_s: Sequence[float]) -> str:
    """`DATASET/TRIAL_LENGTHs`, or `DATASET/TRIAL` where several lengths are in one copy."""
    return trial.key if len(lengths_s) > 1 else f"{trial.key}_{lengths_s[0]:g}s"


@dataclass(frozen=True)
class Answers:
    """The answers of one method.

    Attributes
    ----------
    method : str
    folder : Path
        With a file for each task that it answered.
    """

    method: str
    folder: Path

    def read(self, task: str) -> tuple[FloatArray, FloatArray, FloatArray] | None:
        """Times (n,) s, positions (n, 3) m and covariances (n, 3, 3) m^2 of a task; None without a file.

        Raises
        ------
        UnoccludeError
            The file cannot be read as answers.
        """
        from ..io.plain.table import read_table

        path = self.folder / f"{task}.csv"
        sigmas = [f"sigma_{axis}" for axis in "xyz"]
        if not path.exists():
            return None
        try:
            columns, _ = read_table(path, ("t_s", "x", "y", "z"), sigmas, empty=("x", "y", "z", *sigmas))
        except RecordingError as error:
            raise UnoccludeError(f"the answers of {self.method} cannot be used: {error}") from error
        position = np.stack([columns[axis] for axis in "xyz"], axis=1)
        covariance = np.full((len(position), 3, 3), np.nan)
        if all(name in columns for name in sigmas):
            sigma = np.stack([columns[name] for name in sigmas], axis=1)
            covariance = np.einsum("ni,ij->nij", sigma**2, np.eye(3))
        return columns["t_s"], position, covariance


def parse_answers(texts: Sequence[str], taken: Sequence[str]) -> list[Answers]:
    """Of `NAME=FOLDER` each.

    Raises
    ------
    UnoccludeError
        A text has another form, a name is one of ours or named twice, or a folder is not there.
    """
    found: list[Answers] = []
    for text in texts:
        name, _, folder = text.partition("=")
        if not name or not folder:
            raise UnoccludeError(f"--answers is NAME=FOLDER, not '{text}'")
        if name in (*taken, *(each.method for each in found)):
            raise UnoccludeError(f"--answers {text}: there is a method '{name}' already; give another name")
        if not Path(folder).is_dir():
            raise UnoccludeError(f"--answers {text}: {folder} is not a folder")
        found.append(Answers(name, Path(folder)))
    return found


def write_task(
    folder: Path,
    trial: BenchmarkTrial,
    recording: Recording,
    lengths_s: Sequence[float],
    gaps: PlacedGaps,
) -> Path:
    """Write one task for other programs; what was hidden is in none of its files.

    Parameters
    ----------
    folder : Path
        Of all tasks.
    trial : BenchmarkTrial
    recording : Recording
        Whole; it is hidden here.
    lengths_s : sequence of float, s
        Of the task.
    gaps : sequence of (float, HiddenGap)
        Each with its length, s.

    Returns
    -------
    path : Path
        The task's folder.
    """
    path = folder / task_name(trial, lengths_s)
    path.mkdir(parents=True, exist_ok=True)
    copy = hide(recording, [gap for _, gap in gaps])
    side = f"_{copy.side}" if copy.side else ""
    imu = f"imu_forearm{side}.csv"
    columns = [copy.imu.t_s[:, None], copy.imu.acc, copy.imu.gyro]
    names = "t_s,ax,ay,az,gx,gy,gz"
    if copy.imu.mag is not None:
        columns, names = [*columns, copy.imu.mag], f"{names},mx,my,mz"
    rows = np.concatenate([np.asarray(each) for each in columns], axis=1).tolist()
    _write_rows(path / imu, names, (",".join(_number(value) for value in row) for row in rows))
    _write_rows(path / "skeleton.csv", "t_s,joint,x,y,z,state", _skeleton_rows(copy, side))
    frame = _FRAMES.get(copy.camera_frame) if copy.camera_frame is not None else None
    described = "" if frame is None else f'frame = "{frame}"\n'
    toml = (
        f'[camera]\n{described}skeleton = "skeleton.csv"\nposition_unit = "m"\n'
        f'[imu.forearm{side}]\nfile = "{imu}"\naccelerometer_unit = "m/s^2"\ngyroscope_unit = "rad/s"\n'
    )
    (path / "recording.toml").write_text(toml, encoding="utf-8", newline="\n")
    task = {
        "benchmark": VERSION,
        "dataset": trial.dataset,
        "trial": trial.name,
        "split": trial.split,
        "side": copy.side,
        "calibrated_on": trial.calibrated_on,
        "point": "imu" if recording.truth is not None else "wrist",
        "answer": f"{task_name(trial, lengths_s)}.csv",
        "gaps": [
            {"length_s": length_s, "start_s": gap.start_s, "end_s": gap.end_s} for length_s, gap in gaps
        ],
    }
    (path / "task.json").write_text(json.dumps(task, indent=2) + "\n", encoding="utf-8", newline="\n")
    return path


def _skeleton_rows(recording: Recording, side: str) -> Iterator[str]:
    arm = recording.arm
    for joint in arm.present:
        column = JOINTS.index(joint)
        for t_s, at, state in zip(arm.t_s, arm.position[:, column], arm.state[:, column], strict=True):
            place = ["", "", ""] if state == JointState.NOT_TRACKED else [_number(value) for value in at]
            yield ",".join([_number(t_s), joint + side, *place, _STATES[int(state)]])


def _number(value: float) -> str:
    return "" if not np.isfinite(value) else repr(float(value))


def _write_rows(path: Path, header: str, rows: Iterable[str]) -> None:
    with open(path, "w", encoding="utf-8", newline="\n") as file:
        file.write(header + "\n")
        file.writelines(row + "\n" for row in rows)
