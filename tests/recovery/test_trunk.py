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
from smoother.angles.definitions import wrapped_deg
from smoother.array_types import FloatArray
from smoother.io import read_recovery, write_recovery
from smoother.linalg import unit
from smoother.measures.measuring import measure
from smoother.recording import Recording, TrunkSensors
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


@pytest.mark.parametrize("side", ["left", "right"])
def test_orientation_mounting_clock_sigma_and_the_angles_of_the_shoulder(side: str) -> None:
    """Known but in a pause of the trunk's IMU; the elevation is to the trunk, not to the room."""
    made = simulated(side=side, trunk_clock_s=0.12)
    sensors, t = made.recording.trunk, made.recording.trunk.imu.t_s
    paused = replace(sensors, imu=sensors.imu.select((t < 40.0) | (t > 50.0)))
    recovery = with_trunk(recovered(made), replace(made.recording, trunk=paused))
    trunk, t = recovery.trunk, recovery.t_s
    known = np.isfinite(trunk.quaternion[:, 0])
    assert not known[(t > 40.2) & (t < 49.6)].any() and known[(t < 39.0) | (t > 51.0)].all()
    true = made.trunk_motion.thorax(t)
    R = Rotation.from_quat(trunk.quaternion[known], scalar_first=True).as_matrix()
    error = Rotation.from_matrix(np.swapaxes(true[known], 1, 2) @ R).as_rotvec()
    tilt, heading = np.degrees(np.sqrt([np.mean(error[:, [0, 2]] ** 2), np.mean(error[:, 1] ** 2)]))
    assert tilt < 2.0 and heading < 5.0  # 0.5 to 1, and 2 as measured: a shoulder moves against the trunk
    assert trunk.clock_offset_s - recovery.clock_offset_s == pytest.approx(0.12, abs=0.1)
    off = Rotation.from_matrix(trunk.R_T_D @ made.trunk_motion.R_T_D.T).magnitude()
    assert np.degrees(off) < 6.0
    covariance = np.swapaxes(R, 1, 2) @ trunk.covariance[known] @ R + np.diag(trunk.mount_sigma_rad**2)
    squares = np.einsum("ni,nij,nj->n", error, np.linalg.inv(covariance), error) / 3.0
    assert squares.mean() < 2.0 and np.nanmax(trunk.sigma_deg) < 5.0
    angles, sigmas = shoulder_angles(recovery, trunk)
    right = Rotation.from_matrix(true).as_quat(scalar_first=True)
    truth, _ = shoulder_angles(recovery, replace(trunk, quaternion=right))
    raised = known & (truth["shoulder_elevation"] > 25.0) & (truth["shoulder_elevation"] < 155.0)
    assert raised.mean() > 0.3
    for name, angle in angles.items():
        off = wrapped_deg(angle - truth[name])[raised]
        assert np.sqrt(np.mean(off**2)) < 6.0, name
        assert np.mean((off / sigmas[name][raised]) ** 2) < 2.0, name
    humerus = made.motion.joints(t)
    along = unit(humerus["shoulder"] - humerus["elbow"])
    to_room = np.degrees(np.arccos(np.clip(along @ -recovery.gravity_direction, -1, 1)))
    to_trunk = np.degrees(np.arccos(np.clip(np.einsum("ni,ni->n", along, true[:, :, 1]), -1, 1)))
    off = angles["shoulder_elevation"]
    assert np.sqrt(np.nanmean((off - to_trunk) ** 2)) < 0.8 * np.sqrt(np.nanmean((off - to_room) ** 2))


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

    def seen(where: float) -> Recording:
        place = where * WIDTH_M * axes(frames)[:, :, 2] + rng.normal(0.0, NOISE_M, (len(frames), 3))
        still = np.zeros((2000, 3))
        return Recording.from_arrays(made.t_s, still, still, frames - 0.3, {"shoulder": place}, side=side)

    own, other = (seen(where) for where in ((0.5, -0.5) if side == "right" else (-0.5, 0.5)))
    recording, own = replace(own, opposite=other.arm), own.arm
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
    # hidden shoulders leave nothing a second later; the recording's clock is 0.3 s behind the IMU's
    frames, t = recording.opposite.t_s, made.t_s
    away = recording.opposite.hide((frames > 6.0) & (frames < 12.0), ("shoulder",))
    trunk = trunk_by_shoulders(made, replace(recording, opposite=away))
    empty = np.isnan(trunk.quaternion[:, 0])
    assert empty[(t > 7.35) & (t < 11.25)].all() and not empty[(t < 6.2) | (t > 12.4)].any()
    sigma = trunk.sigma_deg
    assert sigma[np.flatnonzero(~empty & (t > 7.0))[0]] > np.median(sigma[t < 6.0])
    never = recording.opposite.hide(np.ones(len(frames), bool), ("shoulder",))
    for without in ({"opposite": None}, {"side": ""}, {"opposite": never}):
        assert trunk_by_shoulders(made, replace(recording, **without)) is None
    assert trunk_by_shoulders(replace(made, gravity_direction=np.full(3, np.nan)), recording) is None


def test_a_file_keeps_where_it_comes_from_and_measures_count_the_trunk_as_upright(tmp_path: Path) -> None:
    made, recording, _ = turning("right")
    with_one = with_trunk(made, recording)
    write_recovery(with_one, tmp_path / "a.mcap")
    (back,) = read_recovery(tmp_path / "a.mcap")
    assert back.trunk is not None and with_one.trunk is not None and not back.trunk.by_imu
    np.testing.assert_allclose(back.trunk.quaternion, with_one.trunk.quaternion, atol=1e-12)
    assert "shoulder_plane_trunk" in back.angles().values
    assert "shoulder_plane_trunk_deg" in back.to_table().schema.names
    before, after = (measure(each).by_key for each in (made, with_one))
    assert before.keys() == after.keys()
    for key, row in before.items():
        np.testing.assert_equal(row.value, after[key].value, err_msg=key)
