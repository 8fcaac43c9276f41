"""The simulated motion capture against the truth of the recording that it belongs to."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from smoother.recording import CameraFrame
from smoother.simulation import ArmSimulation, MocapSimulation, SimulatedArm, capture, simulate_arm
from smoother.simulation.mocap import MarkerCapture
from smoother.simulation.motion import optical_axes

CLEAN = MocapSimulation(marker_noise_m=0.0, marker_lost=0.0)
#: Axes (x right, y down, z forward) in the axes of each frame, written out from their definitions.
RIGHT_DOWN_FORWARD = {
    CameraFrame.KINECT: [[-1, 0, 0], [0, -1, 0], [0, 0, 1]],
    CameraFrame.OPTICAL: [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
    CameraFrame.ZUP: [[0, -1, 0], [0, 0, -1], [1, 0, 0]],
}


def simulated(
    side: str = "right", frame: CameraFrame = CameraFrame.KINECT, wobble: float = 0.0
) -> SimulatedArm:
    config = ArmSimulation.preset(
        "clean", protocol="random", duration_s=8, side=side, camera_frame=frame, wobble_deg=wobble
    )
    return simulate_arm(config, 11)


def in_camera(marks: MarkerCapture, arm: SimulatedArm) -> dict[str, np.ndarray]:
    """Markers (N, 3) by name in the recording's camera frame."""
    optical = marks.position @ marks.R_C_E.T + marks.translation_m
    axes = np.array(RIGHT_DOWN_FORWARD[arm.recording.camera_frame], float)  # rows: the axes
    place = optical @ axes
    return {name: place[:, number] for number, name in enumerate(marks.names)}


@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.parametrize("frame", list(CameraFrame))
def test_means_of_markers_are_joint_centres(side, frame):
    arm = simulated(side, frame, wobble=2.0)
    marks = capture(arm, CLEAN, 4)
    t_imu = marks.t_s * (1 + 1e-6 * marks.skew_ppm) + marks.offset_s
    inside = (t_imu > 0) & (t_imu < 8)
    assert inside.sum() > 900
    truth = arm.motion.joints(t_imu[inside])
    seen = in_camera(marks, arm)
    for joint, names in marks.marker_map.items():
        mean = np.mean([seen[name][inside] for name in names], axis=0)
        true = arm.motion.imu_pose(t_imu[inside])[1] if joint == "imu_plate" else truth[joint]
        np.testing.assert_allclose(mean, true, atol=1e-9)


@pytest.mark.parametrize("side", ["left", "right"])
def test_markers_are_where_anatomy_has_them(side):
    arm = simulate_arm(ArmSimulation.preset("clean", protocol="hang", duration_s=3, side=side), 2)
    marks = capture(arm, CLEAN, 0)
    seen = in_camera(marks, arm)
    outwards = -1.0 if side == "left" else 1.0  # the person faces a Kinect, whose x is the person's right
    across = (seen["EL_LAT"] - seen["EL_MED"]).mean(axis=0)
    assert across[0] * outwards > 0.05
    thumb = (seen["WR_RAD"] - seen["WR_ULN"]).mean(axis=0)
    assert thumb[2] < -0.03  # towards the camera


@pytest.mark.parametrize("frame", list(CameraFrame))
def test_the_frame_of_the_mocap_has_z_up(frame):
    arm = simulated(frame=frame)
    marks = capture(arm, CLEAN, 9)
    gravity = marks.R_C_E.T @ optical_axes(frame).T @ arm.parameters["gravity"]
    np.testing.assert_allclose(gravity, [0, 0, -9.81], atol=1e-9)
    assert np.linalg.det(marks.R_C_E) == pytest.approx(1)
    rotation = Rotation.from_quat(marks.extrinsics["rotation"], scalar_first=True)
    np.testing.assert_allclose(rotation.as_matrix(), marks.R_C_E, atol=1e-12)
    np.testing.assert_allclose(optical_axes(frame).T, RIGHT_DOWN_FORWARD[frame])


def test_noise_and_lost_markers_are_as_asked():
    arm = simulated()
    clean = capture(arm, CLEAN, 4)
    noisy = capture(arm, MocapSimulation(marker_noise_m=0.001, marker_lost=0.0), 4)
    # 1000 frames x 45 numbers: the standard deviation is known to 0.4 %.
    assert (noisy.position - clean.position).std() == pytest.approx(0.001, rel=0.02)
    lost = np.isnan(capture(arm, MocapSimulation(marker_lost=0.2), 4).position)
    assert (lost.any(axis=2) == lost.all(axis=2)).all()
    share = lost[..., 0].mean(axis=0)
    assert (share > 0).all()
    assert share.mean() == pytest.approx(0.18, abs=0.05)  # stretches may lie over each other


def test_a_capture_that_begins_after_the_recording_is_refused():
    arm = simulated()
    with pytest.raises(ValueError, match="mocap_offset_s=300 begins when the recording of 8 s is over"):
        capture(arm, MocapSimulation(mocap_offset_s=300.0))
    assert len(capture(arm, MocapSimulation(mocap_offset_s=5.0)).position) > 300
