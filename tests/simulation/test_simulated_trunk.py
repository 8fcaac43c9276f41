"""The simulated trunk: it turns, carries the arms and an IMU, and leaves all else as it was."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from smoother.simulation import ArmSimulation, SimulatedArm, simulate_arm


def simulated(**changes: object) -> SimulatedArm:
    settings = {"imus": "wrist,upper-arm,trunk", "protocol": "random", "duration_s": 12.0}
    return simulate_arm(ArmSimulation.preset("clean", **(settings | changes)), seed=3)


def test_a_trunk_that_stands_still_changes_nothing_else() -> None:
    with_trunk, without = simulated(), simulated(imus="wrist,upper-arm")
    for name in ("imu", "upper_imu"):
        one, other = getattr(with_trunk.recording, name), getattr(without.recording, name)
        np.testing.assert_array_equal(one.acc, other.acc)
        np.testing.assert_array_equal(one.gyro, other.gyro)
    np.testing.assert_array_equal(with_trunk.recording.arm.position, without.recording.arm.position)
    assert without.recording.trunk is None and without.trunk_motion is None
    trunk = with_trunk.recording.trunk
    assert trunk is not None and with_trunk.trunk_motion is not None
    np.testing.assert_allclose(trunk.imu.gyro, 0.0, atol=1e-9)
    down = with_trunk.trunk_motion.imu_pose(np.zeros(1))[0][0].T @ with_trunk.parameters["gravity"]
    np.testing.assert_allclose(trunk.imu.acc, np.tile(-down, (len(trunk.imu), 1)), atol=1e-6)


@pytest.mark.parametrize("side", ["left", "right"])
def test_the_gyroscope_feels_what_the_shoulders_show(side: str) -> None:
    made = simulated(trunk_turn_deg=12.0, side=side, sway_m=0.0)
    trunk, motion = made.recording.trunk, made.trunk_motion
    assert trunk is not None and trunk.other_arm is not None and motion is not None
    t = trunk.imu.t_s
    R, _ = motion.imu_pose(t)
    turned = Rotation.from_matrix(np.swapaxes(R[:-1], 1, 2) @ R[1:]).as_rotvec() / np.diff(t)[:, None]
    np.testing.assert_allclose(0.5 * (trunk.imu.gyro[1:] + trunk.imu.gyro[:-1]), turned, atol=2e-3)
    angle = Rotation.from_matrix(motion.thorax(t[:1])[0].T @ motion.thorax(t)).magnitude()
    assert np.degrees(angle).max() > 6.0
    # z of the thorax points from the left shoulder to the right one, but for what the girdle moves
    frame_t = trunk.other_arm.t_s
    np.testing.assert_array_equal(frame_t, made.recording.arm.t_s)
    line = made.recording.arm.joint("shoulder") - trunk.other_arm.joint("shoulder")
    line *= 1.0 if side == "right" else -1.0
    along = np.einsum("ni,ni->n", line, motion.thorax(frame_t)[:, :, 2]) / np.linalg.norm(line, axis=1)
    assert np.degrees(np.arccos(along)).max() < 20.0


def test_the_arm_turns_with_the_trunk() -> None:
    """The wrist's gyroscope and truth stay one motion."""
    made = simulated(trunk_turn_deg=12.0)
    truth, imu = made.recording.truth, made.ideal_imu
    assert truth is not None
    R = Rotation.from_quat(truth.quaternion, scalar_first=True)
    turned = (R[:-1].inv() * R[1:]).as_rotvec() / np.diff(truth.t_s)[:, None]
    off = 0.5 * (imu.gyro[1:] + imu.gyro[:-1]) - turned
    assert np.sqrt(np.mean(off**2)) < 0.02  # means over samples against a difference of means
    elbow, wrist, hand = (truth.joints[joint] for joint in ("elbow", "wrist", "hand"))
    for a, b in ((elbow, wrist), (wrist, hand)):
        assert np.ptp(np.linalg.norm(a - b, axis=1)) < 1e-9
