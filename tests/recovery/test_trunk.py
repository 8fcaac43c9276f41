"""The thorax by an IMU on the trunk: its mounting, its clock, its heading, and what goes wrong with it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from smoother.linalg import unit
from smoother.recording import TrunkSensors
from smoother.recovery.trunk import with_trunk
from smoother.result import Recovery
from smoother.result.segment_motion import SegmentMotion
from smoother.runtime.store import Store
from smoother.shoulder_angles import trunk_angles
from smoother.simulation import ArmSimulation, SimulatedArm, simulate_arm


def simulated(preset: str = "realistic", seed: int = 21, **changes: object) -> SimulatedArm:
    settings = {
        "imus": "wrist,upper-arm,trunk",
        "protocol": "random",
        "duration_s": 65.0,
        "trunk_turn_deg": 10.0,
        "joint_bias_m": 0.0,
    }
    return simulate_arm(ArmSimulation.preset(preset, **(settings | changes)), seed=seed)


def recovered(made: SimulatedArm) -> Recovery:
    """A recovery that is the truth, for the trunk to be put to."""
    truth, recording, upper = made.recording.truth, made.recording, made.upper_motion
    assert truth is not None and upper is not None
    n = len(truth)
    R, position = upper.imu_pose(truth.t_s)
    quaternion = Rotation.from_matrix(R).as_quat(scalar_first=True)
    small = np.tile(1e-6 * np.eye(6), (n, 1, 1))
    return Recovery(
        method="truth",
        t_s=truth.t_s,
        occluded=np.zeros(n, bool),
        position=truth.position,
        quaternion=truth.quaternion,
        velocity=np.zeros((n, 3)),
        pose_covariance=small,
        velocity_covariance=small[:, :3, :3],
        joints=truth.joints,
        joint_covariance={joint: small[:, :3, :3] for joint in truth.joints},
        gaps=(),
        calibration=made.calibration,
        gravity_direction=unit(made.parameters["gravity"]),
        clock_offset_s=made.parameters["clock_offset_s"],
        clock_offset_sigma_s=0.001,
        arm=replace(recording.arm, t_s=recording.arm.t_s + made.parameters["clock_offset_s"]),
        side=recording.side,
        segments={"upper_arm": SegmentMotion(position, quaternion, small, np.full(3, 0.01))},
    )


def errors_deg(recovery: Recovery, made: SimulatedArm) -> np.ndarray:
    """Errors (k, 3) about the thorax's axes where there is an answer, degrees."""
    assert recovery.trunk is not None and made.trunk_motion is not None
    known = np.isfinite(recovery.trunk.quaternion[:, 0])
    true = made.trunk_motion.thorax(recovery.t_s[known])
    answer = Rotation.from_quat(recovery.trunk.quaternion[known], scalar_first=True).as_matrix()
    return np.degrees(Rotation.from_matrix(np.swapaxes(true, 1, 2) @ answer).as_rotvec())


@pytest.fixture(scope="module", params=["left", "right"])
def made(request: pytest.FixtureRequest) -> SimulatedArm:
    return simulated(side=request.param, trunk_clock_s=0.12)


@pytest.fixture(scope="module")
def recovery(made: SimulatedArm) -> Recovery:
    return with_trunk(recovered(made), made.recording, Store())


def test_orientation_mounting_and_clock(made: SimulatedArm, recovery: Recovery) -> None:
    assert recovery.trunk is not None and made.trunk_motion is not None
    error = errors_deg(recovery, made)
    assert len(error) == len(recovery)
    tilt, heading = np.sqrt(np.mean(error[:, [0, 2]] ** 2)), np.sqrt(np.mean(error[:, 1] ** 2))
    assert tilt < 2.0 and heading < 5.0  # 0.5 to 1, and 2 as measured: a shoulder moves against the trunk
    offset_s = recovery.trunk.clock_offset_s - recovery.clock_offset_s
    assert offset_s == pytest.approx(0.12, abs=0.1)
    off = Rotation.from_matrix(recovery.trunk.R_T_D @ made.trunk_motion.R_T_D.T).magnitude()
    assert np.degrees(off) < 6.0


def test_sigma_holds(made: SimulatedArm, recovery: Recovery) -> None:
    trunk = recovery.trunk
    assert trunk is not None
    error = np.radians(errors_deg(recovery, made))
    R = Rotation.from_quat(trunk.quaternion, scalar_first=True).as_matrix()
    covariance = np.swapaxes(R, 1, 2) @ trunk.covariance @ R + np.diag(trunk.mount_sigma_rad**2)
    squares = np.einsum("ni,nij,nj->n", error, np.linalg.inv(covariance), error) / 3.0
    assert squares.mean() < 2.0
    assert trunk.sigma_deg.max() < 5.0


def test_angles_of_the_shoulder_follow_the_trunk(made: SimulatedArm, recovery: Recovery) -> None:
    assert made.trunk_motion is not None and recovery.trunk is not None and recovery.upper is not None
    angles, sigmas = trunk_angles(recovery)
    true = made.trunk_motion.thorax(recovery.t_s)
    known = replace(recovery.trunk, quaternion=Rotation.from_matrix(true).as_quat(scalar_first=True))
    truth, _ = trunk_angles(replace(recovery, trunk=known))
    raised = (truth["shoulder_elevation_trunk"] > 25.0) & (truth["shoulder_elevation_trunk"] < 155.0)
    assert raised.mean() > 0.3
    for name, angle in angles.items():
        off = (angle - truth[name] + 180.0) % 360.0 - 180.0
        assert np.sqrt(np.mean(off[raised] ** 2)) < 6.0, name
        assert np.mean((off / sigmas[name])[raised] ** 2) < 2.0, name
    # the elevation to the room is another thing once the trunk leans
    up = -recovery.gravity_direction
    humerus = made.motion.joints(recovery.t_s)
    along = unit(humerus["shoulder"] - humerus["elbow"])
    to_room = np.degrees(np.arccos(np.clip(along @ up, -1, 1)))
    to_trunk = np.degrees(np.arccos(np.clip(np.einsum("ni,ni->n", along, true[:, :, 1]), -1, 1)))
    off = angles["shoulder_elevation_trunk"]
    assert np.sqrt(np.nanmean((off - to_trunk) ** 2)) < 0.8 * np.sqrt(np.nanmean((off - to_room) ** 2))


def test_a_pause_of_the_trunks_imu_is_left_open() -> None:
    made = simulated(duration_s=50.0)
    trunk = made.recording.trunk
    assert trunk is not None
    imu = trunk.imu.select((trunk.imu.t_s < 20.0) | (trunk.imu.t_s > 30.0))
    recording = replace(made.recording, trunk=replace(trunk, imu=imu))
    recovery = with_trunk(recovered(made), recording, Store())
    assert recovery.trunk is not None
    known = np.isfinite(recovery.trunk.quaternion[:, 0])
    inside = (recovery.t_s > 20.2) & (recovery.t_s < 29.8)
    assert not known[inside].any() and known[(recovery.t_s < 19.0) | (recovery.t_s > 31.0)].all()
    assert np.sqrt(np.mean(errors_deg(recovery, made) ** 2)) < 4.0


def test_what_it_cannot_do_without_is_said() -> None:
    made = simulated(duration_s=20.0)
    trunk, truth = made.recording.trunk, recovered(made)
    assert trunk is not None and trunk.other_arm is not None
    alone = with_trunk(truth, replace(made.recording, trunk=TrunkSensors(trunk.imu)), Store())
    assert alone.trunk is None and "needs both shoulders" in alone.notes[-1]
    hidden = trunk.other_arm.hide(np.ones(len(trunk.other_arm), bool), ("shoulder",))
    unseen = with_trunk(truth, replace(made.recording, trunk=replace(trunk, other_arm=hidden)), Store())
    assert unseen.trunk is None and "hardly saw both shoulders" in unseen.notes[-1]
    assert with_trunk(truth, replace(made.recording, trunk=None), Store()) is truth


def test_an_imu_that_is_not_on_the_trunk() -> None:
    """The wrist's, by another name: the line of shoulders does not turn as it does."""
    made = simulated(duration_s=40.0)
    trunk = made.recording.trunk
    assert trunk is not None
    recording = replace(made.recording, trunk=replace(trunk, imu=made.recording.imu))
    recovery = with_trunk(recovered(made), recording, Store())
    assert recovery.trunk is None and "look whether it was on the trunk" in recovery.notes[-1]
