"""Angles of elbow and shoulder: known postures, and what soft tissue adds to their sigmas."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from arms import make_recording, make_recovery
from scipy.spatial.transform import Rotation

from smoother.angles import shoulder_angles
from smoother.angles.definitions import (
    ANGLES,
    arm_angles,
    defined,
    forearm_axes,
    torso_axes,
)
from smoother.calibration import SegmentMounting
from smoother.result import SegmentMotion

DOWN = np.array([0.0, -1.0, 0.0])  # a level Kinect: x to the camera's left, y up, z away from it
RIGHT_OF_PERSON, UP, TO_CAMERA = np.eye(3)[0], np.eye(3)[1], -np.eye(3)[2]


def _arm(upper: np.ndarray, forearm: np.ndarray) -> dict[str, np.ndarray]:
    shoulder = np.array([[0.2, 0.3, 2.0]])
    elbow = shoulder + 0.3 * upper
    return {"shoulder": shoulder, "elbow": elbow, "wrist": elbow + 0.25 * forearm}


def _forearm(along: np.ndarray, back_of_hand: np.ndarray) -> np.ndarray:
    return np.column_stack([back_of_hand, along, np.cross(back_of_hand, along)])[None]


@pytest.mark.parametrize("side", ["right", "left"])
def test_postures_with_known_angles(side: str) -> None:
    out = RIGHT_OF_PERSON if side == "right" else -RIGHT_OF_PERSON
    lean = Rotation.from_rotvec(np.radians(30) * RIGHT_OF_PERSON)
    ahead = max((lean.apply(-UP), lean.inv().apply(-UP)), key=lambda upper: upper @ TO_CAMERA)
    for upper, forearm, back, angles in (
        # arm hangs, elbow bent by 90, hand to the camera, thumb up: halfway between supine and prone
        (-UP, TO_CAMERA, out, {"elbow_flexion": 90, "pronation": 90, "shoulder_elevation": 0}),
        (-UP, TO_CAMERA, -UP, {"pronation": 0}),  # palm up: fully supine
        # abducted to the level, forearm forward
        (out, TO_CAMERA, None, {"shoulder_plane": 0, "shoulder_elevation": 90, "pronation": np.nan}),
        # raised forwards, forearm straight up
        (TO_CAMERA, UP, None, {"shoulder_plane": 90, "elbow_flexion": 90}),
        # arm hangs a little forward, forearm across the belly: turned inwards; ISB's zero of axial rotation
        # goes with the plane of elevation: from the belly forwards is outwards
        (ahead, -out, None, {"shoulder_plane": 90, "shoulder_rotation": 0}),
        (ahead, np.cross(RIGHT_OF_PERSON, ahead), None, {"shoulder_rotation": -90}),
    ):
        axes = None if back is None else _forearm(forearm, back)
        found = arm_angles(_arm(upper, forearm), 1, axes, side, DOWN)
        for name, angle in angles.items():
            assert found[name][0] == pytest.approx(angle, abs=1e-6, nan_ok=True), name


def test_what_is_missing_is_nan_and_singular_postures_are_marked():
    joints = _arm(-UP, -UP)
    angles = arm_angles(joints, 1, _forearm(-UP, TO_CAMERA), "right", DOWN)
    good = defined(angles)
    assert good["elbow_flexion"][0]
    assert good["shoulder_elevation"][0]
    assert not any(good[name][0] for name in ("pronation", "carrying", "shoulder_plane", "shoulder_rotation"))
    without = arm_angles(joints, 1, None, "right", np.full(3, np.nan))
    assert np.isnan(without["shoulder_elevation"][0])
    assert without["elbow_flexion"][0] == pytest.approx(0, abs=1e-5)
    assert all(np.isnan(value).all() for value in arm_angles({}, 3).values())
    assert tuple(angles) == ANGLES
    for down in (DOWN, -DOWN, np.array([0.0, 0.0, -1.0]), np.array([0.2, 0.9, 0.3])):
        axes = torso_axes(down)
        assert np.allclose(axes.T @ axes, np.eye(3)) and np.linalg.det(axes) == pytest.approx(1)
        assert np.allclose(axes[:, 1], -down / np.linalg.norm(down))
    # a Kinect's x points to the right of a person who faces it, an optical frame's to the left
    assert np.allclose([torso_axes(DOWN)[:, 2], torso_axes(-DOWN)[:, 2]], [[1, 0, 0], [-1, 0, 0]])
    R_K_A, R_F_A = (
        Rotation.random(3, rng=np.random.default_rng(6)),
        Rotation.random(rng=np.random.default_rng(7)),
    )
    scaled = R_K_A.as_quat(scalar_first=True) * 1.7
    scaled[1], scaled[2] = np.nan, 0.0  # without an orientation there are none
    axes = forearm_axes(scaled, R_F_A.as_matrix())
    assert np.allclose(axes[0], (R_K_A[0] * R_F_A.inv()).as_matrix()) and np.isnan(axes[1:]).all()


def test_soft_tissue_widens_the_shoulders_angles_and_what_is_not_known_is_not_said() -> None:
    made = make_recovery(make_recording()).rows(slice(0, 3))
    R = Rotation.from_euler("yxy", [40.0, 70.0, -25.0], degrees=True)
    R_bone = Rotation.from_rotvec([0.3, -0.8, 0.5])
    quaternion = np.tile((R * R_bone).as_quat(scalar_first=True), (3, 1))
    quaternion[1] = np.nan
    # rad: about the bone alone
    upper = SegmentMotion(np.zeros((3, 3)), quaternion, np.zeros((3, 6, 6)), np.array([0.0, 0.1, 0.0]))
    mountings = {"upper_arm": SegmentMounting({}, R_bone=R_bone.as_matrix())}
    made = replace(
        made,
        segments={"upper_arm": upper},
        calibration=replace(made.calibration, mountings=mountings),
        gravity_direction=DOWN,
    )
    angles, sigmas = shoulder_angles(made)
    np.testing.assert_array_equal(np.isnan(angles["shoulder_plane"]), [False, True, False])
    for name, expected in (("rotation", np.degrees(0.1)), ("plane", 0.0), ("elevation", 0.0)):
        np.testing.assert_allclose(sigmas[f"shoulder_{name}"][[0, 2]], expected, rtol=1e-3, atol=0.01)
    for less in (
        replace(made, segments={}),
        replace(made, calibration=replace(made.calibration, mountings={})),
        replace(made, gravity_direction=np.full(3, np.nan)),
    ):
        angles, sigmas = shoulder_angles(less)
        assert all(np.isnan(values).all() for values in (*angles.values(), *sigmas.values()))
