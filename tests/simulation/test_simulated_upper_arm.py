"""The simulated upper-arm IMU: where it sits, what moves it, its clock; the rest of the recording stays."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from smoother.simulation import ArmSimulation, SimulatedArm, simulate_arm

SHORT = {"protocol": "random", "duration_s": 8.0, "occlusion_lengths_s": ()}


def simulated(preset: str = "clean", **changes: object) -> SimulatedArm:
    return simulate_arm(
        ArmSimulation.preset(preset, **(SHORT | {"imus": "wrist,upper-arm"} | changes)), seed=5
    )


@pytest.mark.parametrize("side", ["left", "right"])
def test_elbow_and_shoulder_are_constant_in_its_axes(side: str) -> None:
    made = simulated(side=side)
    assert made.upper_motion is not None and made.recording.upper_imu is not None
    t = np.linspace(0.5, 7.0, 30)
    R, position = made.upper_motion.imu_pose(t)
    joints = made.motion.joints(t)
    np.testing.assert_allclose(np.linalg.det(R), 1.0)
    for joint, lever in made.calibration.upper_imu.items():
        np.testing.assert_allclose(position + R @ lever.position_m, joints[joint], atol=1e-9)
    # the bone's axes: y from the elbow to the shoulder, z towards the lateral epicondyle
    assert made.calibration.R_U_B is not None
    bone = R @ made.calibration.R_U_B.T
    along = joints["shoulder"] - joints["elbow"]
    np.testing.assert_allclose(bone[:, :, 1], along / np.linalg.norm(along, axis=1)[:, None], atol=1e-9)
    np.testing.assert_allclose(bone[:, :, 2], made.motion.bone_axes(t)[0], atol=1e-9)  # type: ignore[attr-defined]


def test_its_samples_are_those_of_its_motion() -> None:
    """Turned by its own gyroscope from the start, it ends where the motion says (0.05 degrees in 7 s)."""
    made = simulated()
    imu, motion = made.recording.upper_imu, made.upper_motion
    assert imu is not None and motion is not None
    step = 1.0 / 80.0
    turn = Rotation.identity()
    for rate in imu.gyro[40:600]:
        turn = turn * Rotation.from_rotvec(rate * step)
    ends = Rotation.from_matrix(motion.imu_pose(np.array([40, 600]) * step)[0])
    assert np.degrees((ends[0] * turn * ends[1].inv()).magnitude()) < 0.05


def test_soft_tissue_turns_it_as_much_as_asked() -> None:
    made = simulated(upper_wobble_deg=5.0)
    still = simulated()
    assert made.upper_motion is not None and still.upper_motion is not None
    t = np.linspace(0.0, 8.0, 400)
    turn = Rotation.from_matrix(
        made.upper_motion.imu_pose(t)[0].transpose(0, 2, 1) @ still.upper_motion.imu_pose(t)[0]
    )
    assert np.degrees(np.sqrt(np.mean(turn.magnitude() ** 2))) == pytest.approx(5.0, rel=0.15)


def test_the_wrist_and_the_camera_do_not_notice_it() -> None:
    both = simulated("realistic").recording
    one = simulated("realistic", imus="wrist").recording
    assert one.upper_imu is None
    np.testing.assert_array_equal(both.imu.acc, one.imu.acc)
    np.testing.assert_array_equal(both.arm.position, one.arm.position)


def test_its_clock_is_its_own() -> None:
    made = simulated(upper_clock_s=0.2, upper_clock_ppm=100.0)
    imu = made.recording.upper_imu
    assert imu is not None
    offset = imu.t_s - made.recording.imu.t_s
    assert offset[0] == pytest.approx(0.2, abs=1e-5) and offset[-1] - offset[0] == pytest.approx(
        8e-4, rel=0.01
    )


def test_the_end_is_occluded() -> None:
    made = simulated(end_gap_s=3.0)
    t = made.recording.arm.t_s
    np.testing.assert_array_equal(made.occluded, t >= 5.0)
    assert not made.recording.arm.tracked("wrist")[t > 5.2].any()
    assert made.recording.arm.tracked("shoulder")[t > 5.2].all()
