"""A recording as ROS 2 makes it, by a writer that is not ours, recovered with nothing calibrated."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import ros_bags
from scenes import ALONE, arm

from smoother.io import read_recording
from smoother.measurements.visibility import occluded_at
from smoother.recording import JOINTS, JointState
from smoother.simulation import SimulatedArm
from smoother.smoothing import smooth

ZERO_NS = 1_750_000_000 * 10**9
#: Joint indices of the Azure Kinect's body tracking (right arm), of 32.
AZURE = {"shoulder": 12, "elbow": 13, "wrist": 14, "hand": 15}
BODY = 4


def write(made: SimulatedArm, path: Path) -> None:
    """MarkerArray and Imu, logged as they come; joints that are not tracked have no marker."""
    imu, tracks = made.recording.imu, made.recording.arm
    stamps = [ZERO_NS + np.rint(t * 1e9).astype(int) for t in (imu.t_s, tracks.t_s)]
    events = [(int(ns), kind, i) for kind, each in enumerate(stamps) for i, ns in enumerate(each)]
    rest = {k: np.array([0.3, 0.1 + 0.02 * k, 2.2]) for k in range(32) if k not in AZURE.values()}
    with ros_bags.Bag(path) as bag:
        for ns, kind, i in sorted(events):
            if kind == 0:
                bag.imu("/imu/wrist", ns, "imu_link", imu.acc[i], imu.gyro[i], ns + 2_000_000)
                continue
            tracked = tracks.state[i] == JointState.TRACKED
            places = rest | {
                number: tracks.position[i, JOINTS.index(joint)]
                for joint, number in AZURE.items()
                if tracked[JOINTS.index(joint)]
            }
            markers = [ros_bags.marker(ns, 100 * BODY + k, places[k]) for k in sorted(places)]
            bag.write(
                "/body_tracking_data",
                "visualization_msgs/msg/MarkerArray",
                ros_bags.marker_array(),
                {"markers": markers},
                ns + 40_000_000,
            )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("preset", "changes", "rms_m"),
    [
        ("white", {"latency_s": 0.045, "dropped_frames": 0.03, "frame_jitter_s": 0.002}, 0.012),
        # 8 mm per axis of this are the wrist's own constant error, which nothing can see
        ("realistic", {}, 0.035),
    ],
    ids=["white", "realistic"],
)
def test_an_azure_kinect_recording(
    preset: str, changes: dict[str, float], rms_m: float, tmp_path: Path
) -> None:
    made = arm(1, preset, repetitions=1, camera_frame="optical", imu_rate_hz=100.0, **changes)
    write(made, tmp_path / "azure.mcap")
    recording = read_recording(tmp_path / "azure.mcap", side="right")
    recovery = smooth(replace(recording, truth=None), None, ALONE)
    truth = made.recording.truth
    shift = (recording.origin_ns - ZERO_NS) * 1e-9
    t = recovery.t_s + shift
    path = np.stack([np.interp(t, truth.t_s, truth.joints["wrist"][:, i]) for i in range(3)], axis=1)
    inside = occluded_at(recovery.t_s, recovery.gaps) & (t > truth.t_s[0]) & (t < truth.t_s[-1])
    error = np.linalg.norm(recovery.joints["wrist"] - path, axis=1)[inside]
    assert len(recovery.gaps) >= 2
    assert inside.sum() > 150
    assert np.sqrt(np.mean(error**2)) <= rms_m
    assert recovery.clock_offset_s == pytest.approx(made.parameters["clock_offset_s"], abs=0.004)
