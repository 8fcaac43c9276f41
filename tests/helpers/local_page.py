"""Sessions as files that devices export, for the tests of the local page."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from smoother.recording import JOINTS, JointState
from smoother.simulation import ArmSimulation, simulate_arm
from smoother.units import STANDARD_GRAVITY

DAY_S = 86_400.0
#: 12 March 2026, when the sessions were.
START_S = 1_773_300_000.0


def write_session(folder: Path, start_s: float = 0.0, mirror: bool = False) -> dict[str, Path]:
    """An arm of some 30 s with gaps: a table of joints, and what Shimmer's Consensys exports of an IMU.

    Parameters
    ----------
    folder : Path
        Where they go; made.
    start_s : float, s
        After 12 March 2026, of both.
    mirror : bool
        The skeleton's x has the other sign.
    """
    folder.mkdir(parents=True)
    recording = simulate_arm(ArmSimulation.preset("realistic", repetitions=2), seed=5).recording
    imu, arm = recording.imu, recording.arm
    stamp = imu.t_s + START_S + start_s
    sensor = folder / "shimmer.csv"
    rows = np.column_stack([np.round(stamp * 1e3), imu.acc / STANDARD_GRAVITY, np.degrees(imu.gyro)])
    heads = ["S_Timestamp_Unix_CAL"]
    heads += [f"S_Accel_WR_{axis}_CAL" for axis in "XYZ"] + [f"S_Gyro_{axis}_CAL" for axis in "XYZ"]
    units = ["ms", *["g"] * 3, *["deg/s"] * 3]
    lines = ['"sep=,"', ",".join(heads), ",".join(units)]
    lines += [",".join([f"{row[0]:.1f}", *(f"{value:.7f}" for value in row[1:])]) for row in rows]
    sensor.write_text("\n".join(lines) + "\n", encoding="utf-8")
    kinect = folder / "kinect.csv"
    side = recording.side or "right"
    names = [joint for joint in JOINTS if joint in ("shoulder", "elbow", "wrist")]
    heads = ["timestamp"]
    for name in names:
        heads += [f"{name}_{side}_{axis}" for axis in "xyz"] + [f"{name}_{side}_state"]
    lines = [",".join(heads)]
    for row, t_s in enumerate(arm.t_s):
        cells = [f"{(t_s + START_S + start_s):.4f}"]
        for name in names:
            at = JOINTS.index(name)
            seen = arm.state[row, at] != JointState.NOT_TRACKED
            values = arm.position[row, at] * ([-1, 1, 1] if mirror else [1, 1, 1])
            cells += [f"{value:.5f}" if seen else "" for value in values]
            cells += [str(int(arm.state[row, at]))]
        lines.append(",".join(cells))
    kinect.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return {"imu": sensor, "skeleton": kinect}


def own_table(path: Path, imu: Path) -> Path:
    """The same IMU in a laboratory's own layout."""
    lines = imu.read_text().splitlines()[3:]
    path.write_text("\n".join(["Zeit;F1;F2;F3;D1;D2;D3", *(line.replace(",", ";") for line in lines)]) + "\n")
    return path
