"""Writing a result, and what is said of it afterwards, in memory that does not grow with the recording."""

from __future__ import annotations

from pathlib import Path

import pytest
from private_memory import program_output

PROGRAM = """
import sys
from pathlib import Path
import numpy as np
from smoother.calibration import ArmCalibration, Length, LeverArm
from smoother.cli.methods import limit_sigma
from smoother.cli.smooth import print_recovery, smooth_figures
from smoother.io import write_recovery
from private_memory import PrivatePeak
from smoother.runtime.disk_store import DiskStore
from smoother.recording import ImuStream, JointTracks, Recording
from smoother.report import write_report
from smoother.measurements.visibility import Gap
from smoother.result import Estimates, FrameResiduals, Recovery
from smoother.measurements.visibility import REASONS


peak = PrivatePeak()
minutes, folder = int(sys.argv[1]), Path(sys.argv[2])
names, rng = ("shoulder", "elbow", "wrist", "hand"), np.random.default_rng(0)
levers = list(enumerate(names[1:]))
with DiskStore(folder) as store:

    def column(rows, shape, make, block=4096):
        values = store.array((rows, *shape), 0.0)
        for start in range(0, rows, block):
            count = min(block, rows - start)
            values[start : start + count] = make(np.arange(start, start + count))
        return values

    def covariance(size):
        def make(row):
            root = 0.01 * rng.normal(size=(len(row), size, size))
            return root @ root.transpose(0, 2, 1)

        return make

    def unit(row):
        values = rng.normal(size=(len(row), 4))
        return values / np.linalg.norm(values, axis=1)[:, None]

    def places(*shape):
        return lambda row: 0.1 * rng.normal(size=(len(row), *shape)) + [0.0, 0.0, 2.0]

    samples, frames = 4800 * minutes, 1800 * minutes
    t = column(samples, (), lambda row: row / 80)
    frame_t = column(frames, (), lambda row: row / 30 + 0.01)
    state = np.full((frames, 5), 2, np.int8)
    arm = JointTracks("/skeleton", frame_t, column(frames, (5, 3), places(5, 3)), state)
    reason = ((rng.random((frames, 5)) < 0.01) * rng.integers(1, 8, (frames, 5))).astype(np.uint8)
    residual = column(frames, (5, 3), lambda row: 0.01 * rng.normal(size=(len(row), 5, 3)))
    recovery = Recovery(
        method="graph",
        t_s=t,
        occluded=np.arange(samples) % 800 > 640,
        position=column(samples, (3,), places(3)),
        quaternion=column(samples, (4,), unit),
        velocity=column(samples, (3,), places(3)),
        pose_covariance=column(samples, (6, 6), covariance(6)),
        velocity_covariance=column(samples, (3, 3), covariance(3)),
        joints={joint: column(samples, (3,), places(3)) for joint in names},
        joint_covariance={joint: column(samples, (3, 3), covariance(3)) for joint in names},
        gaps=tuple(Gap(10.0 * k + 8.0, 10.0 * k + 10.0) for k in range(6 * minutes)),
        calibration=ArmCalibration(
            "right",
            {joint: LeverArm(np.array([0.03, 0.1 * k, 0.0]), np.full(3, 0.005)) for k, joint in levers},
            Length(0.3, 0.01),
        ),
        gravity_direction=np.array([0.0, 1.0, 0.0]),
        clock_offset_s=0.01,
        clock_offset_sigma_s=0.001,
        arm=arm,
        residuals=FrameResiduals(frame_t, residual, reason == 0, reason, REASONS),
        side="right",
        estimates=Estimates(camera_sigma_m=dict.fromkeys(names, 0.01)),
    )
    recording = Recording(ImuStream("imu", t, np.zeros((0, 3)), np.zeros((0, 3))), arm, side="right")
    write_recovery(recovery, folder / "out.mcap")
    recovery = limit_sigma(recovery, 0.02)
    assert smooth_figures(recording, recovery)["samples"] == samples
    print_recovery(recording, recovery)
    before = peak.mb()
    write_report(recovery, folder / "out.html", recording=recording)
    print("peaks", before, peak.mb(), (folder / "out.html").stat().st_size / 1e6)
"""


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="Linux tells the peak of the memory")
def test_peak_of_short_and_long(tmp_path: Path) -> None:
    peaks = []
    for minutes in (3, 15):
        folder = tmp_path / str(minutes)
        folder.mkdir()
        said = program_output(PROGRAM, minutes, folder)
        peaks.append([float(value) for value in said.splitlines()[-1].split()[1:]])
    (short, short_page, _), (long, long_page, page_mb) = peaks
    # 12 minutes more are 63 MB of columns; what may grow are a few numbers a sample
    assert long - short < 15
    assert long_page - short_page < 25
    assert long < 150  # MB of its own
    assert page_mb < 10
