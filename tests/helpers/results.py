"""Results made by hand, for the tests of what they are exported to."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from arms import make_recording, make_recovery
from scipy.interpolate import CubicSpline

from smoother.io.export import prepare_export
from smoother.measurements.visibility import find_gaps, occluded_at, visible_frames
from smoother.recording import JOINTS, JointState, JointTracks
from smoother.result import Recovery

#: Stretches of the hand-made recording in which the camera has no forearm, s.
HIDDEN = ((4.0, 5.0), (9.0, 11.5))


def made(side: str = "right", *, hidden=HIDDEN, strap: bool = False) -> Recovery:
    """Twenty seconds of an arm that turns, with two gaps; the shoulder stays in sight."""
    recording = make_recording(noise_m=0.004)
    arm = recording.arm
    for start, end in hidden:
        arm = arm.hide((arm.t_s > start) & (arm.t_s < end))
    recovery = make_recovery(replace(recording, arm=arm), error_m=0.002)
    gaps = find_gaps(arm.t_s, visible_frames(arm), 0.0, float(recovery.t_s[-1]))
    recovery = replace(recovery, side=side, gaps=gaps, occluded=occluded_at(recovery.t_s, gaps))
    return strap_only(recovery) if strap else recovery


def strap_only(recovery: Recovery) -> Recovery:
    """The same, of a camera that finds the strap alone."""
    position = np.full_like(recovery.arm.position, np.nan)
    state = np.full_like(recovery.arm.state, JointState.NOT_TRACKED)
    position[:, JOINTS.index("strap")] = recovery.arm.position[:, JOINTS.index("wrist")]
    state[:, JOINTS.index("strap")] = recovery.arm.state[:, JOINTS.index("wrist")]
    return replace(
        recovery,
        arm=JointTracks(recovery.arm.name, recovery.arm.t_s, position, state),
        joints={"strap": recovery.position},
        joint_covariance={"strap": recovery.pose_covariance[:, :3, :3]},
        calibration=None,
        side="",
    )


_SAMPLES = ("position", "quaternion", "velocity", "pose_covariance", "velocity_covariance")


def changed(
    recovery: Recovery,
    values: Callable[[np.ndarray], np.ndarray],
    covariances: Callable[[np.ndarray], np.ndarray],
) -> Recovery:
    """With other samples."""
    columns = {name: getattr(recovery, name) for name in _SAMPLES}
    return replace(
        recovery,
        **{name: (covariances if "cov" in name else values)(each) for name, each in columns.items()},
        joints={name: values(each) for name, each in recovery.joints.items()},
        joint_covariance={name: covariances(each) for name, each in recovery.joint_covariance.items()},
    )


def without_answer(recovery: Recovery, start_s: float, end_s: float) -> Recovery:
    """The same, of a method that has no answer in a stretch."""
    gone = (recovery.t_s > start_s) & (recovery.t_s < end_s)

    def blank(values: np.ndarray) -> np.ndarray:
        values = values.copy()
        values[gone] = np.nan
        return values

    return changed(recovery, blank, blank)


def jittered(recovery: Recovery, seed: int = 0) -> Recovery:
    """The same motion sampled at uneven times: every value moved along its own curve."""
    rng = np.random.default_rng(seed)
    t = recovery.t_s + rng.uniform(-0.002, 0.002, len(recovery.t_s))
    t = t[rng.uniform(size=len(t)) > 0.01]
    t = np.clip(t, recovery.t_s[0], recovery.t_s[-1])
    near = np.searchsorted(recovery.t_s, t).clip(0, len(recovery.t_s) - 1)
    moved = changed(
        recovery, lambda values: CubicSpline(recovery.t_s, values)(t), lambda values: values[near]
    )
    return replace(moved, t_s=t, occluded=recovery.occluded[near])


def read_trc(path) -> tuple[dict[str, str], list[str], np.ndarray, np.ndarray]:
    """A TRC file by a plain reading of its cells: header, names, times (N,), positions (N, M, 3)."""
    lines = path.read_text().splitlines()
    header = dict(zip(lines[1].split("\t"), lines[2].split("\t"), strict=True))
    names = [cell for cell in lines[3].split("\t")[2:] if cell]
    rows = [line.split("\t") for line in lines[6:]]
    cells = [[float(cell or "nan") for cell in row[: 2 + 3 * len(names)]] for row in rows]
    table = np.array(cells).reshape(len(rows), 2 + 3 * len(names))
    assert [int(number) for number in table[:, 0]] == list(range(1, len(rows) + 1))
    return header, names, table[:, 1], table[:, 2:].reshape(len(rows), len(names), 3)


def read_mot(path) -> tuple[dict[str, str], list[str], np.ndarray]:
    """A MOT file by a plain reading: header, columns, table."""
    lines = path.read_text().splitlines()
    end = lines.index("endheader")
    header = dict(line.split("=", 1) for line in lines[1:end] if "=" in line and " " not in line)
    return (
        header,
        lines[end + 1].split("\t"),
        np.array([line.split("\t") for line in lines[end + 2 :]], float),
    )


def export(recovery: Recovery, path: Path, **options) -> Path:
    """Write a recovery in the format of the file's ending."""
    prepare_export(recovery, path.suffix[1:], **options).write(path, False)
    return path


def opensim_python() -> str | None:
    """An interpreter that has OpenSim: this one, or the one that UNOCCLUDE_OPENSIM_PYTHON names."""
    return sys.executable if find_spec("opensim") else os.environ.get("UNOCCLUDE_OPENSIM_PYTHON")
