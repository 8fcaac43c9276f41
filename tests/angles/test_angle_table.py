"""The table of joint angles: names, values, reasons, and sigmas against drawn errors; the wrist."""

from __future__ import annotations

import csv
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from made_results import recovery
from scipy.spatial.transform import Rotation

from smoother.angles import JOINT_ANGLES
from smoother.angles.definitions import arm_angles, forearm_axes, torso_axes, wrapped_deg
from smoother.angles.found import UPPER_ARM_SHARE, direction_variance
from smoother.array_types import FloatArray
from smoother.calibration import ArmCalibration, LeverArm, SegmentMounting
from smoother.io.export.prepare import export_csv
from smoother.linalg import unit
from smoother.result import Estimates, Recovery, SegmentMotion, TrunkMotion

ALWAYS = ["elbow_flexion", "shoulder_plane", "shoulder_elevation", "shoulder_rotation", "pronation"]
DOWN = np.array([0.05, -0.99, 0.1]) / np.linalg.norm([0.05, -0.99, 0.1])
UPPER_M, FOREARM_M = 0.3, 0.25
#: The forearm's axes as the IMU carries them: turned anyhow.
R_F_A = Rotation.from_rotvec([0.4, -1.1, 0.7]).as_matrix()


def bones(
    plane: FloatArray, elevation: FloatArray, rotation: FloatArray, flexion: FloatArray, turn: FloatArray
):
    """Axes `R_K_H` and `R_K_F` of a right arm with these angles, degrees, by the ISB's own sequences."""
    thorax = Rotation.from_matrix(torso_axes(DOWN))
    humerus = thorax * Rotation.from_euler("YXY", np.stack([plane, -elevation, rotation], 1), degrees=True)
    forearm = humerus * Rotation.from_euler("ZXY", np.stack([flexion, 0 * flexion, turn], 1), degrees=True)
    return humerus.as_matrix(), forearm.as_matrix()


def arm(count: int, sigma: float = 1.0, seed: int = 0, **angles: FloatArray) -> Recovery:
    """An arm with known angles; sigma scales all stated errors (6 mm, 0.6 degrees)."""
    rng = np.random.default_rng(seed)
    humerus, forearm = bones(**angles)
    shoulder = rng.normal(size=(count, 3))
    elbow = shoulder - UPPER_M * humerus[:, :, 1]
    wrist = elbow - FOREARM_M * forearm[:, :, 1]
    # ISB's y points from the wrist to the elbow, the calibration's F the other way, x to the back of the hand
    back = np.stack([-forearm[:, :, 0], -forearm[:, :, 1], forearm[:, :, 2]], axis=2)
    R_K_A = back @ R_F_A
    root = rng.normal(size=(count, 6, 6)) / np.sqrt(6.0)
    scale = sigma * np.repeat([0.006, 0.01], 3)
    pose = (root @ root.transpose(0, 2, 1) + 0.3 * np.eye(6)) * scale[:, None] * scale
    lever = {
        "elbow": LeverArm(R_F_A.T @ [0.0, -0.2, 0.0], np.full(3, 0.004 * sigma)),
        "wrist": LeverArm(R_F_A.T @ [0.0, 0.05, 0.0], np.full(3, 0.004 * sigma)),
    }
    made = recovery(max(count, 60), seed).rows(slice(0, count))
    return replace(
        made,
        position=wrist - 0.05 * unit(wrist - elbow),
        quaternion=Rotation.from_matrix(R_K_A).as_quat(scalar_first=True),
        joints={"shoulder": shoulder, "elbow": elbow, "wrist": wrist},
        joint_covariance={
            joint: np.tile((0.008 * sigma) ** 2 * np.eye(3), (count, 1, 1))
            for joint in ("shoulder", "elbow", "wrist")
        },
        pose_covariance=pose,
        calibration=ArmCalibration("right", lever, R_F_A=R_F_A),
        gravity_direction=DOWN,
        estimates=Estimates(joint_bias_sigma_m=0.003 * sigma),
        side="right",
        trunk=None,
    )


def some(count: int, seed: int = 1, **fixed: float) -> dict[str, FloatArray]:
    rng = np.random.default_rng(seed)
    ranges = {
        "plane": (-60.0, 120.0),
        "elevation": (25.0, 150.0),
        "rotation": (-80.0, 80.0),
        "flexion": (25.0, 140.0),
        "turn": (10.0, 160.0),
    }
    return {
        name: np.full(count, fixed[name]) if name in fixed else rng.uniform(*ends, count)
        for name, ends in ranges.items()
    }


def mirrored(made: Recovery) -> Recovery:
    """The left arm that is a right one's mirror image; a rotation in it turns the other way."""
    mirror = np.diag([-1.0, 1.0, 1.0])
    R = np.asarray(Rotation.from_quat(made.quaternion, scalar_first=True).as_matrix())
    assert made.calibration is not None
    levers = {
        name: replace(lever, position_m=lever.position_m @ mirror)
        for name, lever in made.calibration.lever_arms.items()
    }
    # of the forearm's axes z changes sides too: to the little finger
    R_F = np.diag([1.0, 1.0, -1.0]) @ R_F_A @ mirror
    return replace(
        made,
        side="left",
        joints={name: place @ mirror for name, place in made.joints.items()},
        position=made.position @ mirror,
        gravity_direction=DOWN @ mirror,
        quaternion=Rotation.from_matrix(mirror @ R @ mirror).as_quat(scalar_first=True),
        calibration=replace(made.calibration, lever_arms=levers, R_F_A=R_F),
    )


@pytest.mark.parametrize("side", ["right", "left"])
def test_the_angles_are_those_that_the_bones_were_turned_by(side: str) -> None:
    true = some(50)
    made = arm(50, **true)
    table = (mirrored(made) if side == "left" else made).angles()
    for name, of in zip(ALWAYS, ("flexion", "plane", "elevation", "rotation", "turn"), strict=True):
        np.testing.assert_allclose(wrapped_deg(table.values[name] - true[of]), 0.0, atol=1e-7)
    assert set(table.reasons) == {f"shoulder_{kind}_trunk" for kind in ("plane", "elevation", "rotation")}
    assert "no IMU is on it" in table.reasons["shoulder_plane_trunk"]


@pytest.mark.parametrize("side", ["right", "left"])
@pytest.mark.parametrize("lean", [None, [0.1, 0.4, -0.2]])
def test_sigmas_have_the_slopes_of_the_angles(side: str, lean: list[float] | None) -> None:
    """Against central differences of the angles over all that is uncertain; the thorax upright, or known."""
    count, step = 12, 1e-6
    made = replace(arm(count, **some(count)), side=side)
    R_K_T, down, forward, of_trunk = np.eye(3), DOWN, None, np.zeros((3, 3))
    suffix, names = "", ALWAYS[1:]
    if lean is not None:
        R_K_T = Rotation.from_rotvec(lean).as_matrix()
        down, forward, of_trunk = np.array([0.0, -1, 0]), np.array([1.0, 0, 0]), 4e-4 * np.diag([1, 2, 3.0])
        quaternion = np.tile(Rotation.from_matrix(R_K_T).as_quat(scalar_first=True), (count, 1))
        trunk = TrunkMotion(quaternion, np.tile(of_trunk, (count, 1, 1)), np.eye(3), np.zeros(3))
        made, suffix, names = replace(made, trunk=trunk), "_trunk", ALWAYS[1:4]
    share = np.sqrt(UPPER_ARM_SHARE)

    def moved(by: FloatArray) -> dict[str, FloatArray]:
        """By errors of the pose, the shoulder, the forearm in the IMU's axes and the thorax, (15,)."""
        turns = [Rotation.from_rotvec(by[k : k + 3]).as_matrix() for k in (3, 9, 12)]
        at, fore = made.joints, turns[1] @ turns[0]
        elbow = by[:3] + (at["elbow"] - made.position) @ (turns[0] - np.eye(3)).T
        joints = {
            "elbow": np.zeros((count, 3)),
            "shoulder": at["shoulder"] - at["elbow"] + share * (by[6:9] - elbow),
            "wrist": (at["wrist"] - at["elbow"]) @ fore.T,
        }
        axes = fore @ forearm_axes(made.quaternion, R_F_A)
        thorax = turns[2] @ R_K_T
        joints = {name: place @ thorax for name, place in joints.items()}
        return arm_angles(joints, count, thorax.T @ axes, side, down, forward=forward)

    steps = [(moved(by), moved(-by)) for by in step * np.eye(15)]
    table = made.angles()
    for name in names:
        slope = np.stack([wrapped_deg(a[name] - b[name]) / (2 * step) for a, b in steps], axis=1)
        variance = np.einsum("ni,nij,nj->n", slope[:, :6], made.pose_covariance, slope[:, :6])
        for at, covariance in ((6, made.joint_covariance["shoulder"][0]), (12, of_trunk)):
            variance += (slope[:, at : at + 3] @ covariance * slope[:, at : at + 3]).sum(axis=1)
        variance += direction_variance(made) * (slope[:, 9:12] ** 2).sum(axis=1)
        stated = table.sigmas[name + suffix]
        if name == "pronation":
            stated = np.sqrt(stated**2 - 15.0**2)  # how the IMU was calibrated on the forearm
        if name == "shoulder_elevation":  # it holds what the error across adds as well
            assert (stated >= np.sqrt(variance)).all()
            tight = np.sin(np.radians(table.values[name + suffix])) > 0.5
            np.testing.assert_allclose(stated[tight], np.sqrt(variance[tight]), rtol=0.01)
        else:
            np.testing.assert_allclose(stated, np.sqrt(variance), rtol=1e-6)


@pytest.mark.parametrize("elevation", [0.0, 0.5, 2.0, 179.5, 180.0])
def test_a_hanging_or_upright_arm_has_no_plane(elevation: float) -> None:
    made = arm(20, **some(20, elevation=elevation))
    table = made.angles()
    for name in ("shoulder_plane", "shoulder_rotation"):
        sigma = table.sigmas[name]
        assert (sigma > 30.0).all() and (sigma <= 180.0).all()


@pytest.mark.parametrize("flexion", [0.0, 1.0])
def test_a_straight_elbow_shows_neither_rotation_nor_pronation(flexion: float) -> None:
    table = arm(20, **some(20, flexion=flexion)).angles()
    for name in ("shoulder_rotation", "pronation"):
        value, sigma = table.values[name], table.sigmas[name]
        assert (np.isnan(value) | (sigma > 40.0)).all()
    assert (table.sigmas["shoulder_elevation"] < 5.0).all()


def test_against_the_trunk() -> None:
    true = some(30)
    made = arm(30, **true)
    lean = Rotation.from_euler("xyz", [[5.0, 20.0, -10.0]], degrees=True).as_matrix()[0]
    R_K_T = np.tile(torso_axes(DOWN), (30, 1, 1))
    quaternion = Rotation.from_matrix(R_K_T).as_quat(scalar_first=True)
    known = np.tile((np.radians(4.0)) ** 2 * np.eye(3), (30, 1, 1))
    upright = replace(made, trunk=TrunkMotion(quaternion, known, np.eye(3), np.zeros(3)))
    table = upright.angles()
    for name in ("shoulder_plane", "shoulder_elevation", "shoulder_rotation"):
        np.testing.assert_allclose(table.values[f"{name}_trunk"], table.values[name], atol=1e-7)
        assert (table.sigmas[f"{name}_trunk"] > table.sigmas[name]).all()
    # the trunk and the arm turned together change nothing
    turned = {joint: place @ lean.T for joint, place in made.joints.items()}
    both = Rotation.from_matrix(lean @ R_K_T).as_quat(scalar_first=True)
    moved = replace(upright, joints=turned, position=made.position @ lean.T)
    moved = replace(moved, trunk=replace(upright.trunk, quaternion=both))  # type: ignore[type-var]
    for name in ("shoulder_plane_trunk", "shoulder_elevation_trunk", "shoulder_rotation_trunk"):
        np.testing.assert_allclose(moved.angles().values[name], table.values[name], atol=1e-7)


def test_all_outputs_have_the_same_columns(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made = arm(30, **some(30))
    columns = [f"{name}_{what}" for name in ALWAYS for what in ("deg", "sigma_deg")]
    table = made.angles()
    assert list(table.to_arrays()) == columns
    export_csv(made, tmp_path / "a.csv")
    with open(tmp_path / "a.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    arrow = made.to_table()
    assert [name for name in rows[0] if name in columns] == columns
    for name, values in table.to_arrays().items():
        np.testing.assert_allclose([float(row[name]) for row in rows], values, atol=1e-9)
        np.testing.assert_array_equal(arrow[name], values)
        assert arrow.schema.field(name).metadata == {b"unit": b"deg"}
    given: list[dict[str, FloatArray]] = []
    monkeypatch.setitem(sys.modules, "pandas", SimpleNamespace(DataFrame=given.append))
    table.to_dataframe()
    assert list(given[0]) == ["t_s", *columns]


def test_what_is_not_known_is_empty_with_a_reason() -> None:
    made = arm(30, **some(30))
    no_wrist = {name: place for name, place in made.joints.items() if name != "wrist"}
    table = replace(made, joints=no_wrist).angles()
    empty = {name for name in table.reasons if not name.endswith("_trunk")}
    assert empty == {"elbow_flexion", "shoulder_rotation", "pronation"}
    assert table.reasons["elbow_flexion"] == "The recording has no wrist."
    table = replace(made, gravity_direction=np.full(3, np.nan)).angles()
    assert "does not solve the direction of gravity" in table.reasons["shoulder_plane"]
    assert np.isnan(table.values["shoulder_plane"]).all() and np.isfinite(table.values["pronation"]).all()
    table = replace(made, calibration=replace(made.calibration, R_F_A=None)).angles()
    assert "`unocclude calibrate forearm`" in table.reasons["pronation"]
    table = replace(made, joint_covariance={}).angles()
    assert "sigma is empty" in table.reasons["shoulder_plane"]
    gone = made.joints["wrist"].copy()
    gone[:3] = np.nan
    table = replace(made, joints=made.joints | {"wrist": gone}).angles()
    assert table.reasons["elbow_flexion"].startswith("Empty in 10 % of the samples")
    assert all(name in {angle.name for angle in JOINT_ANGLES} for name in table.reasons)


@pytest.mark.parametrize("side", ["right", "left"])
@pytest.mark.parametrize("seed", range(3))
def test_the_forearm_that_turned_far_shows_how_the_imu_sits(side: str, seed: int) -> None:
    true = some(1500, seed=seed)
    made = arm(1500, seed=seed, **true)
    made = mirrored(made) if side == "left" else made
    table = replace(made, calibration=replace(made.calibration, R_F_A=None)).angles()
    off = wrapped_deg(table.values["pronation"] - true["turn"])
    assert np.abs(off).max() < 12.0  # 10 to 160 degrees: hardly anything is left open
    assert (table.sigmas["pronation"] >= 7.0).all() and np.median(table.sigmas["pronation"]) < 12.0
    little = arm(1500, seed=seed, **(true | {"turn": 60.0 + 0.3 * (true["turn"] - 10.0)}))
    table = replace(little, calibration=replace(little.calibration, R_F_A=None)).angles()
    assert np.isnan(table.values["pronation"]).all()
    assert "turned by 44 degrees only" in table.reasons["pronation"]
    assert "palm fully up and fully down" in table.reasons["pronation"]


R_H_I = Rotation.from_rotvec([-0.9, 0.2, 1.3]).as_matrix()
HAND_M = 0.08


def arm_with_hand(
    flexion: FloatArray, deviation: FloatArray, side: str = "right", sigma_rad: float = 0.0
) -> Recovery:
    """Forearms that lie anyhow, with a wrist that is bent so far, degrees."""
    count, rng = len(flexion), np.random.default_rng(3)
    R_K_F = Rotation.random(count, random_state=rng).as_matrix()
    thumb = -1.0 if side == "left" else 1.0
    bend = Rotation.from_euler("ZX", np.stack([flexion, thumb * deviation], axis=1), degrees=True)
    R_K_I = R_K_F @ bend.as_matrix() @ R_H_I
    pose = np.zeros((count, 6, 6))
    pose[:, 3:, 3:] = sigma_rad**2 * np.eye(3)
    quaternion = Rotation.from_matrix(R_K_I).as_quat(scalar_first=True)
    exact = np.zeros(3)
    levers = {
        "wrist": LeverArm(R_H_I.T @ [0.02, -0.03, 0.0], exact),
        "hand": LeverArm(R_H_I.T @ [0.02, HAND_M - 0.03, 0.0], exact),
    }
    calibration = ArmCalibration(side, R_F_A=R_F_A, mountings={"hand": SegmentMounting(levers, tissue_m=0.0)})
    made = recovery(max(count, 60), 1).rows(slice(0, count))
    return replace(
        made,
        quaternion=Rotation.from_matrix(R_K_F @ R_F_A).as_quat(scalar_first=True),
        pose_covariance=pose,
        segments={"hand": SegmentMotion(np.zeros((count, 3)), quaternion, pose, exact)},
        calibration=calibration,
        estimates=Estimates(),
        side=side,
    )


@pytest.mark.parametrize("side", ["right", "left"])
def test_known_angles(side: str) -> None:
    rng = np.random.default_rng(0)
    flexion, deviation = rng.uniform(-70, 80, 40), rng.uniform(-35, 25, 40)
    table = arm_with_hand(flexion, deviation, side).angles()
    np.testing.assert_allclose(table.values["wrist_flexion"], flexion, atol=1e-9)
    np.testing.assert_allclose(table.values["wrist_deviation"], deviation, atol=1e-9)


def test_sigma_is_that_of_drawn_errors(monkeypatch: pytest.MonkeyPatch) -> None:
    """Turns of both IMUs and of the forearm's roll, drawn 4000 times: a standard deviation to 2.3 %."""
    sigma_rad, count, rng = 0.02, 4000, np.random.default_rng(1)
    monkeypatch.setattr("smoother.angles.found.CALIBRATED_DEG", 3.0)  # 15 are not quite linear
    made = arm_with_hand(np.full(1, 40.0), np.full(1, 15.0), sigma_rad=sigma_rad)
    table = made.angles()
    many = made.rows(np.zeros(count, int))

    def turned(quaternion: FloatArray) -> FloatArray:
        error = Rotation.from_rotvec(rng.normal(0.0, sigma_rad, (count, 3)))
        return (error * Rotation.from_quat(quaternion, scalar_first=True)).as_quat(scalar_first=True)

    hand = replace(many.segments["hand"], quaternion=turned(many.segments["hand"].quaternion))
    roll = Rotation.from_rotvec(np.radians(3.0) * rng.normal(size=(count, 1)) * [0.0, 1.0, 0.0])
    R_F_K = Rotation.from_matrix(R_F_A) * Rotation.from_quat(turned(many.quaternion), scalar_first=True).inv()
    rolled = (roll * R_F_K).inv() * Rotation.from_matrix(R_F_A)
    drawn = replace(many, quaternion=rolled.as_quat(scalar_first=True), segments={"hand": hand}).angles()
    for name in ("wrist_flexion", "wrist_deviation"):
        stated = float(table.sigmas[name][0])
        assert drawn.values[name].std() == pytest.approx(stated, rel=0.05)


def test_rough_lever_arms_make_the_wrist_less_certain() -> None:
    made = arm_with_hand(np.full(3, 20.0), np.full(3, 5.0), sigma_rad=0.01)
    assert made.calibration is not None
    places = {"elbow": R_F_A.T @ [0.0, -0.2, 0.0], "wrist": R_F_A.T @ [0.0, 0.05, 0.0]}
    levers = {name: LeverArm(place, np.full(3, 0.02)) for name, place in places.items()}
    rough = replace(made, calibration=replace(made.calibration, lever_arms=levers))
    for name in ("wrist_flexion", "wrist_deviation"):
        assert (rough.angles().sigmas[name] > made.angles().sigmas[name] + 0.1).all()


def test_what_is_not_known_has_a_reason() -> None:
    made = arm_with_hand(np.zeros(30), np.zeros(30))
    assert "wrist_flexion" not in replace(made, segments={}).angles().values
    table = replace(made, calibration=replace(made.calibration, R_F_A=None)).angles()
    assert "calibrate forearm" in table.reasons["wrist_flexion"]
    paused = made.segments["hand"].quaternion.copy()
    paused[:10] = np.nan
    gone = replace(made, segments={"hand": replace(made.segments["hand"], quaternion=paused)}).angles()
    flexion = gone.values["wrist_flexion"]
    assert np.isnan(flexion[:10]).all() and np.isfinite(flexion[10:]).all()
    assert gone.reasons["wrist_flexion"].startswith("Empty in 33 % of the samples")
