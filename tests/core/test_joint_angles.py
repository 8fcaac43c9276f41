"""Angles of the arm, against scipy's Euler angles and against postures that were put in."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from smoother.joint_angles import ANGLES, arm_angles, defined, forearm_axes, torso_axes, wrapped_deg

DOWN = np.array([0.0, -1.0, 0.0])  # a level Kinect: x to the camera's left, y up, z away from it
RIGHT_OF_PERSON, UP, TO_CAMERA = np.eye(3)[0], np.eye(3)[1], -np.eye(3)[2]


def _arm(upper: np.ndarray, forearm: np.ndarray) -> dict[str, np.ndarray]:
    shoulder = np.array([[0.2, 0.3, 2.0]])
    elbow = shoulder + 0.3 * upper
    return {"shoulder": shoulder, "elbow": elbow, "wrist": elbow + 0.25 * forearm}


def _forearm(along: np.ndarray, back_of_hand: np.ndarray) -> np.ndarray:
    return np.column_stack([back_of_hand, along, np.cross(back_of_hand, along)])[None]


@pytest.mark.parametrize("side", ["right", "left"])
def test_postures_with_known_angles(side):
    out = RIGHT_OF_PERSON if side == "right" else -RIGHT_OF_PERSON
    # arm hangs, elbow bent by 90, hand to the camera, thumb up: halfway between supine and prone
    joints = _arm(-UP, TO_CAMERA)
    found = arm_angles(joints, 1, _forearm(TO_CAMERA, out), side, DOWN)
    assert found["elbow_flexion"][0] == pytest.approx(90)
    assert found["pronation"][0] == pytest.approx(90)
    assert found["shoulder_elevation"][0] == pytest.approx(0, abs=1e-9)
    # palm up: fully supine
    assert arm_angles(joints, 1, _forearm(TO_CAMERA, -UP), side, DOWN)["pronation"][0] == pytest.approx(0)
    # abducted to the level, forearm forward
    found = arm_angles(_arm(out, TO_CAMERA), 1, None, side, DOWN)
    assert found["shoulder_plane"][0] == pytest.approx(0, abs=1e-9)
    assert found["shoulder_elevation"][0] == pytest.approx(90)
    assert np.isnan(found["pronation"][0])
    # raised forwards, forearm straight up
    found = arm_angles(_arm(TO_CAMERA, UP), 1, None, side, DOWN)
    assert found["shoulder_plane"][0] == pytest.approx(90)
    assert found["elbow_flexion"][0] == pytest.approx(90)
    # arm hangs a little forward, forearm across the belly: turned inwards
    upper = Rotation.from_rotvec(np.radians(30) * RIGHT_OF_PERSON).apply(-UP)
    upper = (
        upper if upper @ TO_CAMERA > 0 else Rotation.from_rotvec(-np.radians(30) * RIGHT_OF_PERSON).apply(-UP)
    )
    turned = [
        arm_angles(_arm(upper, along), 1, None, side, DOWN)
        for along in (-out, np.cross(RIGHT_OF_PERSON, upper))
    ]
    assert turned[0]["shoulder_plane"][0] == pytest.approx(90)
    # ISB's zero of axial rotation goes with the plane of elevation: from the belly forwards is outwards
    assert turned[0]["shoulder_rotation"][0] == pytest.approx(0, abs=1e-6)
    assert turned[1]["shoulder_rotation"][0] == pytest.approx(-90)


@pytest.mark.parametrize("side", ["right", "left"])
def test_against_scipys_euler_angles(side):
    """Random bones in ISB axes; the mirror of a right arm is a left arm with the same angles."""
    rng = np.random.default_rng(3)
    count = 500
    R_T_H = Rotation.random(count, rng=rng)
    bend = np.column_stack(
        [rng.uniform(20, 150, count), rng.uniform(-15, 15, count), rng.uniform(-20, 170, count)]
    )
    R_T_F = R_T_H * Rotation.from_euler("ZXY", bend, degrees=True)
    torso = torso_axes(DOWN)
    mirror = np.diag([1.0, 1.0, -1.0]) if side == "left" else np.eye(3)

    def to_camera(vectors: np.ndarray) -> np.ndarray:
        return vectors @ (torso @ mirror).T

    H, F = R_T_H.as_matrix(), R_T_F.as_matrix()
    elbow = rng.normal(size=(count, 3))
    joints = {
        "shoulder": elbow + 0.3 * to_camera(H[:, :, 1]),
        "elbow": elbow,
        "wrist": elbow - 0.25 * to_camera(F[:, :, 1]),
    }
    back, along, thumb = (to_camera(sign * F[:, :, axis]) for sign, axis in ((-1, 0), (-1, 1), (1, 2)))
    R_K_F = np.stack([back, along, thumb if side == "right" else -thumb], axis=2)
    assert np.allclose(np.linalg.det(R_K_F), 1)
    found = arm_angles(joints, count, R_K_F, side, DOWN, flexion_axis=to_camera(H[:, :, 2]))
    for name, column in (("elbow_flexion", 0), ("carrying", 1), ("pronation", 2)):
        assert np.abs(wrapped_deg(found[name] - bend[:, column])).max() < 1e-7, name
    plane, elevation, axial = R_T_H.as_euler("YXY", degrees=True).T
    # scipy's second angle is positive; ISB's is negative: turn both others by half a turn
    assert np.abs(found["shoulder_elevation"] - elevation).max() < 1e-6
    assert np.abs(wrapped_deg(found["shoulder_plane"] - plane - 180)).max() < 1e-6
    assert np.abs(wrapped_deg(found["shoulder_rotation"] - axial - 180)).max() < 1e-6


def test_flexion_without_epicondyles_is_the_angle_of_the_bones():
    rng = np.random.default_rng(4)
    joints = {name: rng.normal(size=(50, 3)) for name in ("shoulder", "elbow", "wrist")}
    upper, forearm = joints["elbow"] - joints["shoulder"], joints["wrist"] - joints["elbow"]
    cosine = (upper * forearm).sum(1) / np.linalg.norm(upper, axis=1) / np.linalg.norm(forearm, axis=1)
    found = arm_angles(joints, 50, None, "right", DOWN)
    assert np.allclose(found["elbow_flexion"], np.degrees(np.arccos(cosine)))
    assert np.isnan(found["carrying"]).all()


def test_simulated_postures_come_back():
    """The simulation's own flexion and pronation, which its forearm is built from."""
    from smoother.simulation.body import FLEXION, POSTURE_SIZE, PRONATION, arm_chain, draw_measures

    rng = np.random.default_rng(5)
    posture = np.zeros((200, POSTURE_SIZE))
    posture[:, 3:6] = rng.normal(size=(200, 3))
    posture[:, FLEXION], posture[:, PRONATION] = rng.uniform(0.3, 2.3, 200), rng.uniform(0, 2.8, 200)
    measures = draw_measures(rng)
    shoulder, elbow, R_T_F = arm_chain(posture, Rotation.random(rng=rng), measures)
    joints = {"shoulder": shoulder, "elbow": elbow, "wrist": elbow + measures.forearm * R_T_F[:, :, 1]}
    found = arm_angles(joints, 200, R_T_F, "right", DOWN)
    assert np.allclose(found["elbow_flexion"], np.degrees(posture[:, FLEXION]), atol=1e-6)
    assert np.allclose(found["pronation"], np.degrees(posture[:, PRONATION]), atol=1e-6)


def test_forearm_axes_are_the_products_of_rotations():
    rng = np.random.default_rng(6)
    R_K_A, R_F_A = Rotation.random(20, rng=rng), Rotation.random(rng=rng)
    expected = (R_K_A * R_F_A.inv()).as_matrix()
    scaled = R_K_A.as_quat(scalar_first=True) * 1.7
    assert np.allclose(forearm_axes(scaled, R_F_A.as_matrix()), expected)


def test_without_an_orientation_there_are_no_forearm_axes():
    quaternion = np.array([[np.nan] * 4, [1.0, 0.0, 0.0, 0.0], [0.0] * 4])
    axes = forearm_axes(quaternion, np.eye(3))
    assert np.isnan(axes[[0, 2]]).all()
    np.testing.assert_allclose(axes[1], np.eye(3), atol=1e-15)


def test_what_is_missing_is_nan_and_singular_postures_are_told():
    joints = _arm(-UP, -UP)
    found = arm_angles(joints, 1, _forearm(-UP, TO_CAMERA), "right", DOWN)
    good = defined(found)
    assert good["elbow_flexion"][0]
    assert good["shoulder_elevation"][0]
    assert not any(good[name][0] for name in ("pronation", "carrying", "shoulder_plane", "shoulder_rotation"))
    without = arm_angles(joints, 1, None, "right", np.full(3, np.nan))
    assert np.isnan(without["shoulder_elevation"][0])
    assert without["elbow_flexion"][0] == pytest.approx(0, abs=1e-5)
    assert all(np.isnan(value).all() for value in arm_angles({}, 3).values())
    assert tuple(found) == ANGLES


def test_torso_axes_of_every_camera_frame():
    for down in (DOWN, -DOWN, np.array([0.0, 0.0, -1.0]), np.array([0.2, 0.9, 0.3])):
        axes = torso_axes(down)
        assert np.allclose(axes.T @ axes, np.eye(3))
        assert np.linalg.det(axes) == pytest.approx(1)
        assert np.allclose(axes[:, 1], -down / np.linalg.norm(down))
    # a Kinect's x points to the right of a person who faces it, an optical frame's to the left
    assert np.allclose(torso_axes(DOWN)[:, 2], [1, 0, 0])
    assert np.allclose(torso_axes(-DOWN)[:, 2], [-1, 0, 0])
