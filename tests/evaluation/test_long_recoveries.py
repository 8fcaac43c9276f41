"""What is said of a recovery, a block of samples at a time: as of the whole at once, in flat memory."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from arms import make_recording, make_recovery
from private_memory import program_output

from smoother.evaluation.summary import gap_summaries, recovery_figures, rejected
from smoother.measurements.visibility import REASONS, Gap, Reason
from smoother.recording import JOINTS
from smoother.result import Recovery


@pytest.fixture
def recovery(monkeypatch: pytest.MonkeyPatch) -> Recovery:
    """Gaps, missing answers, rejected samples; looked at in batches that end anywhere."""
    monkeypatch.setattr("smoother.result.recovery.BATCH_ROWS", 37)
    rng = np.random.default_rng(3)
    made = make_recovery(make_recording(40.0), error_m=0.01)
    gaps = (Gap(0.0, 0.31, open_start=True), Gap(5.0, 7.0), Gap(7.5, 7.5125), Gap(22.222, 23.1))
    t, count = made.t_s, len(made)
    occluded = np.zeros(count, bool)
    for gap in gaps:
        occluded |= (t > gap.start_s) & (t < gap.end_s)
    root = rng.normal(size=(count, 6, 6)) * 0.02
    covariance = root @ root.transpose(0, 2, 1)
    quaternion, position = made.quaternion.copy(), made.position.copy()
    hole = (t > 6.5) & (t < 7.2)
    for values in (quaternion, position, covariance):
        values[hole] = np.nan
    covariance[1000] = np.nan
    kept = made.residuals
    assert kept is not None
    reason = np.where(rng.random(kept.used.shape) < 0.02, rng.integers(1, 5, kept.used.shape), 0)
    kept = replace(kept, reason=reason.astype(np.uint8), reasons=REASONS, used=kept.used & (reason == 0))
    return replace(
        made,
        occluded=occluded,
        quaternion=quaternion,
        position=position,
        pose_covariance=covariance,
        gaps=gaps,
        residuals=kept,
    )


def sigmas(recovery: Recovery) -> tuple[np.ndarray, np.ndarray]:
    variance = np.diagonal(recovery.pose_covariance, axis1=1, axis2=2)
    return np.sqrt(variance[:, :3]).max(axis=1), np.degrees(np.sqrt(variance[:, 3:].sum(axis=1)))


def test_gaps(recovery: Recovery) -> None:
    sigma_m, sigma_deg = sigmas(recovery)
    answered = np.isfinite(recovery.position).all(axis=1)
    for gap, found in zip(recovery.gaps, gap_summaries(recovery), strict=True):
        inside = (recovery.t_s >= gap.start_s) & (recovery.t_s <= gap.end_s)
        assert (found.start_s, found.end_s, found.open_start) == (gap.start_s, gap.end_s, gap.open_start)
        assert found.sigma_max_m == np.nanmax(sigma_m[inside])
        assert found.sigma_max_deg == pytest.approx(np.nanmax(sigma_deg[inside]), rel=1e-12)
        assert found.answered == answered[inside].mean()
    (nothing,) = gap_summaries(replace(recovery, gaps=(Gap(100.0, 101.0),)))
    assert (nothing.sigma_max_m, nothing.sigma_max_deg, nothing.answered) == (None, None, 0.0)


def test_figures(recovery: Recovery) -> None:
    sigma_m, _ = sigmas(recovery)
    figures = recovery_figures(recovery)
    assert figures["answered"] == np.isfinite(recovery.position).all(axis=1).sum()
    for name, chosen in (("visible", ~recovery.occluded), ("occluded", recovery.occluded)):
        values = sigma_m[chosen & np.isfinite(sigma_m)]
        assert figures["sigma_m"][name] == {"median": np.median(values), "max": values.max()}


def test_rejected(recovery: Recovery) -> None:
    kept = recovery.residuals
    assert kept is not None
    rows = rejected(recovery)
    assert sum(row["count"] for row in rows) == np.count_nonzero(kept.reason)
    totals = []
    for row in rows:
        code = REASONS.index(Reason(row["reason"], row["why"]))
        column = JOINTS.index(row["joint"])
        at = kept.t_s[kept.reason[:, column] == code]
        tracked = (kept.used[:, column] | (kept.reason[:, column] != 0)).sum()
        assert (row["count"], row["first_s"], row["last_s"]) == (len(at), at[0], at[-1])
        assert row["share"] == len(at) / tracked
        totals.append(int((kept.reason == code).sum()))
    assert totals == sorted(totals, reverse=True)


def occluded_recovery():
    recording = make_recording(20.0)
    t = recording.arm.t_s
    return make_recovery(replace(recording, arm=recording.arm.hide((t > 5) & (t < 7))), sigma_m=0.02)


def test_figures_without_a_covariance():
    recovery = occluded_recovery()
    blank = replace(
        recovery, pose_covariance=np.full_like(recovery.pose_covariance, np.nan), calibration=None
    )
    figures = recovery_figures(blank)
    assert figures["sigma_m"]["occluded"] == {"median": None, "max": None}
    assert figures["error_95_m"]["occluded"] == {"all": None, "max": None}
    assert figures["calibration"] is None
    assert figures["gaps"][0]["sigma_max_m"] is None
    assert recovery_figures(recovery)["calibration"]["upper_arm_m"] == 0.31


PROGRAM = """
import sys
from pathlib import Path
import numpy as np
from smoother.calibration import ArmCalibration, Length, LeverArm
from smoother.cli.smooth import limit_sigma
from smoother.cli.smooth import print_recovery, smooth_figures
from smoother.io import write_recovery
from private_memory import PrivatePeak
from smoother.runtime.store import large_array
from smoother.recording import ImuStream, JointTracks, Recording
from smoother.report import write_report
from smoother.measurements.visibility import Gap
from smoother.result import Estimates, FrameResiduals, Recovery
from smoother.measurements.visibility import REASONS


peak = PrivatePeak()
minutes, folder = int(sys.argv[1]), Path(sys.argv[2])
names, rng = ("shoulder", "elbow", "wrist", "hand"), np.random.default_rng(0)
levers = list(enumerate(names[1:]))

def column(rows, shape, make, block=4096):
    values = large_array((rows, *shape), 0.0)
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
write_report([(recording, recovery, None, None)], folder / "out.html")
print("peaks", before, peak.mb(), (folder / "out.html").stat().st_size / 1e6)
"""


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="Linux gives the peak of the memory")
def test_peak_of_short_and_long(tmp_path: Path) -> None:
    peaks = []
    for minutes in (3, 9):
        folder = tmp_path / str(minutes)
        folder.mkdir()
        said = program_output(PROGRAM, minutes, folder)
        peaks.append([float(value) for value in said.splitlines()[-1].split()[1:]])
    (short, short_page, _), (long, long_page, page_mb) = peaks
    # 6 minutes more are 31 MB of columns; what may grow are a few numbers a sample
    assert long - short < 15
    assert long_page - short_page < 25
    assert long < 215  # MB of its own; writing Parquet takes some 50 of them
    assert page_mb < 10
