"""The thorax by an IMU on the trunk or by both shoulders: mounting, clock, heading, what goes wrong."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from made_results import recovery as made_recovery
from measured_arms import recovery_of
from scipy.spatial.transform import Rotation

from smoother.angles import shoulder_angles
from smoother.array_types import FloatArray
from smoother.io import read_recovery, write_recovery
from smoother.linalg import unit
from smoother.measures.measuring import measure
from smoother.recording import JOINTS, ImuStream, JointTracks, Recording, TrunkSensors
from smoother.recovery.trunk import with_trunk
from smoother.recovery.trunk_by_shoulders import LEAN_RAD, trunk_by_shoulders
from smoother.result import Recovery, SegmentMotion
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
    truth, recording = made.recording.truth, made.recording
    R, position = made.further_motions["upper_arm"].imu_pose(truth.t_s)
    quaternion = Rotation.from_matrix(R).as_quat(scalar_first=True)
    small = np.tile(1e-6 * np.eye(6), (len(truth), 1, 1))
    offset_s = made.parameters["clock_offset_s"]
    return replace(
        recovery_of(truth.t_s, dict(truth.joints), recording.side, unit(made.parameters["gravity"])),
        position=truth.position,
        quaternion=truth.quaternion,
        pose_covariance=small,
        calibration=made.calibration,
        clock_offset_s=offset_s,
        arm=replace(recording.arm, t_s=recording.arm.t_s + offset_s),
        segments={"upper_arm": SegmentMotion(position, quaternion, small, np.full(3, 0.01))},
    )


def errors_deg(recovery: Recovery, made: SimulatedArm) -> np.ndarray:
    """Errors (k, 3) about the thorax's axes where there is an answer, degrees."""
    known = np.isfinite(recovery.trunk.quaternion[:, 0])
    true = made.trunk_motion.thorax(recovery.t_s[known])
    answer = Rotation.from_quat(recovery.trunk.quaternion[known], scalar_first=True).as_matrix()
    return np.degrees(Rotation.from_matrix(np.swapaxes(true, 1, 2) @ answer).as_rotvec())


@pytest.fixture(scope="module", params=["left", "right"])
def made(request: pytest.FixtureRequest) -> SimulatedArm:
    return simulated(side=request.param, trunk_clock_s=0.12)


@pytest.fixture(scope="module")
def recovery(made: SimulatedArm) -> Recovery:
    return with_trunk(recovered(made), made.recording)


@pytest.mark.slow
def test_orientation_mounting_clock_and_sigma(made: SimulatedArm, recovery: Recovery) -> None:
    error, trunk = errors_deg(recovery, made), recovery.trunk
    assert len(error) == len(recovery)
    tilt, heading = np.sqrt(np.mean(error[:, [0, 2]] ** 2)), np.sqrt(np.mean(error[:, 1] ** 2))
    assert tilt < 2.0 and heading < 5.0  # 0.5 to 1, and 2 as measured: a shoulder moves against the trunk
    assert trunk.clock_offset_s - recovery.clock_offset_s == pytest.approx(0.12, abs=0.1)
    off = Rotation.from_matrix(trunk.R_T_D @ made.trunk_motion.R_T_D.T).magnitude()
    assert np.degrees(off) < 6.0
    R = Rotation.from_quat(trunk.quaternion, scalar_first=True).as_matrix()
    covariance = np.swapaxes(R, 1, 2) @ trunk.covariance @ R + np.diag(trunk.mount_sigma_rad**2)
    error = np.radians(error)
    squares = np.einsum("ni,nij,nj->n", error, np.linalg.inv(covariance), error) / 3.0
    assert squares.mean() < 2.0
    assert trunk.sigma_deg.max() < 5.0


def test_angles_of_the_shoulder_follow_the_trunk(made: SimulatedArm, recovery: Recovery) -> None:
    assert made.trunk_motion is not None and recovery.trunk is not None and recovery.upper is not None
    angles, sigmas = shoulder_angles(recovery, recovery.trunk)
    true = made.trunk_motion.thorax(recovery.t_s)
    known = replace(recovery.trunk, quaternion=Rotation.from_matrix(true).as_quat(scalar_first=True))
    truth, _ = shoulder_angles(recovery, known)
    raised = (truth["shoulder_elevation"] > 25.0) & (truth["shoulder_elevation"] < 155.0)
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
    off = angles["shoulder_elevation"]
    assert np.sqrt(np.nanmean((off - to_trunk) ** 2)) < 0.8 * np.sqrt(np.nanmean((off - to_room) ** 2))


def test_a_pause_of_the_trunks_imu_is_left_open() -> None:
    made = simulated(duration_s=50.0)
    trunk = made.recording.trunk
    imu = trunk.imu.select((trunk.imu.t_s < 20.0) | (trunk.imu.t_s > 30.0))
    recording = replace(made.recording, trunk=replace(trunk, imu=imu))
    recovery = with_trunk(recovered(made), recording)
    known = np.isfinite(recovery.trunk.quaternion[:, 0])
    inside = (recovery.t_s > 20.2) & (recovery.t_s < 29.8)
    assert not known[inside].any() and known[(recovery.t_s < 19.0) | (recovery.t_s > 31.0)].all()
    assert np.sqrt(np.mean(errors_deg(recovery, made) ** 2)) < 4.0


def test_what_it_cannot_do_without_is_said() -> None:
    """Both shoulders; and an IMU that turns as their line does, not the wrist's by another name."""
    made = simulated(duration_s=40.0)
    trunk, truth = made.recording.trunk, recovered(made)
    hidden = trunk.other_arm.hide(np.ones(len(trunk.other_arm), bool), ("shoulder",))
    for sensors, said in (
        (TrunkSensors(trunk.imu), "needs both shoulders"),
        (replace(trunk, other_arm=hidden), "hardly saw both shoulders"),
        (replace(trunk, imu=made.recording.imu), "check that it was on the trunk"),
    ):
        alone = with_trunk(truth, replace(made.recording, trunk=sensors))
        assert alone.trunk is None and said in alone.notes[-1]
    assert with_trunk(truth, replace(made.recording, trunk=None)) is truth


UP = np.array([0.1, 0.97, -0.2]) / np.linalg.norm([0.1, 0.97, -0.2])
NOISE_M, WIDTH_M = 0.01, 0.36


def turning(side: str, seed: int = 0, turn_deg: float = 30.0) -> tuple[Recovery, Recording, FloatArray]:
    """20 s of a trunk that turns to and fro; the true `R_K_T` at the samples."""
    rng = np.random.default_rng(seed)
    made = made_recovery(2000, seed, side=side)
    frames = np.arange(0.0, 20.0, 1 / 30)
    upright = np.linalg.qr(np.column_stack([UP, np.eye(3)[:, :2]]))[0]
    right = upright[:, 1]

    def axes(t: FloatArray) -> FloatArray:
        heading = np.radians(turn_deg) * np.sin(2 * np.pi * t / 8.0)
        z = Rotation.from_rotvec(heading[:, None] * UP).apply(right)
        return np.stack([np.cross(UP, z), np.tile(UP, (len(t), 1)), z], axis=2)

    def shoulder(where: float) -> JointTracks:
        position = np.full((len(frames), len(JOINTS), 3), np.nan)
        position[:, 0] = where * WIDTH_M * axes(frames)[:, :, 2] + rng.normal(0.0, NOISE_M, (len(frames), 3))
        state = np.where(np.isfinite(position[:, :, 0]), 2, 0).astype(np.int8)
        return JointTracks("camera", frames - 0.3, position, state)

    own, other = (shoulder(0.5), shoulder(-0.5)) if side == "right" else (shoulder(-0.5), shoulder(0.5))
    stream = ImuStream("imu", made.t_s, np.zeros((2000, 3)), np.zeros((2000, 3)))
    recording = Recording(stream, own, side, opposite=other)
    made = replace(made, gravity_direction=-UP, arm=replace(own, t_s=frames), trunk=None)
    return made, recording, axes(made.t_s)


@pytest.mark.parametrize("side", ["right", "left"])
def test_the_heading_follows_both_shoulders(side: str) -> None:
    made, recording, true = turning(side)
    trunk = trunk_by_shoulders(made, recording)
    assert trunk is not None and not trunk.by_imu
    R = Rotation.from_quat(trunk.quaternion, scalar_first=True).as_matrix()
    off = Rotation.from_matrix(R @ true.transpose(0, 2, 1)).as_rotvec()
    about_up = off @ UP
    # a quarter of a second of 30 frames, each off by 10 mm at both ends of 36 cm: less than a degree
    assert np.degrees(np.sqrt(np.mean(about_up**2))) < 1.5
    np.testing.assert_allclose(off - about_up[:, None] * UP, 0.0, atol=1e-9)
    stated = np.sqrt(np.einsum("i,nij,j->n", UP, trunk.covariance, UP))
    assert (np.degrees(stated) > 1.5).all() and (np.degrees(stated) < 6.0).all()
    side_lean = np.einsum("ni,nij,nj->n", true[:, :, 0], trunk.covariance, true[:, :, 0])
    np.testing.assert_allclose(np.median(side_lean), LEAN_RAD[0] ** 2, rtol=0.05)


def test_hidden_shoulders_leave_nothing_a_second_later() -> None:
    made, recording, _ = turning("right")
    frames = recording.opposite.t_s
    hidden = (frames > 6.0) & (frames < 12.0)
    recording = replace(recording, opposite=recording.opposite.hide(hidden, ("shoulder",)))
    trunk = trunk_by_shoulders(made, recording)
    empty = np.isnan(trunk.quaternion[:, 0])
    # the recording's clock is 0.3 s behind the IMU's
    inside = (made.t_s > 7.35) & (made.t_s < 11.25)
    assert empty[inside].all() and not empty[(made.t_s < 6.2) | (made.t_s > 12.4)].any()
    sigma = trunk.sigma_deg
    assert sigma[np.flatnonzero(~empty & (made.t_s > 7.0))[0]] > np.median(sigma[made.t_s < 6.0])


def test_what_does_not_show_it() -> None:
    made, recording, _ = turning("right")
    never = recording.opposite.hide(np.ones(len(recording.opposite), bool), ("shoulder",))
    for without in ({"opposite": None}, {"side": ""}, {"opposite": never}):
        assert trunk_by_shoulders(made, replace(recording, **without)) is None
    assert trunk_by_shoulders(replace(made, gravity_direction=np.full(3, np.nan)), recording) is None


def test_a_file_keeps_where_it_comes_from(tmp_path: Path) -> None:
    made, recording, _ = turning("right")
    made = with_trunk(made, recording)
    write_recovery(made, tmp_path / "a.mcap")
    (back,) = read_recovery(tmp_path / "a.mcap")
    assert back.trunk is not None and made.trunk is not None and not back.trunk.by_imu
    np.testing.assert_allclose(back.trunk.quaternion, made.trunk.quaternion, atol=1e-12)
    assert "shoulder_plane_trunk" in back.angles().values
    assert "shoulder_plane_trunk_deg" in back.to_table().schema.names


def test_measures_still_count_the_trunk_as_upright() -> None:
    made, recording, _ = turning("right")
    with_one = with_trunk(made, recording)
    assert with_one.trunk is not None
    before, after = (measure(each).by_key for each in (made, with_one))
    assert before.keys() == after.keys()
    for key, row in before.items():
        np.testing.assert_equal(row.value, after[key].value, err_msg=key)
