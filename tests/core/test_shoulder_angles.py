"""The shoulder's angles by an upper-arm IMU: against known postures, and their sigmas against samples."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from arms import make_recording, make_recovery
from scipy.spatial.transform import Rotation

from smoother.calibration import ArmCalibration, SegmentMounting
from smoother.joint_angles import wrapped_deg
from smoother.result import Recovery
from smoother.result.segment_motion import SegmentMotion
from smoother.shoulder_angles import SHOULDER_ANGLES, shoulder_angles

#: A level Kinect (x to its left, y up, z forward) before a person who looks along -z, their right at +x.
DOWN = np.array([0.0, -1.0, 0.0])


def recovery(up: np.ndarray, lateral: np.ndarray, side: str = "right", sigma_rad: float = 0.0) -> Recovery:
    """Samples whose humerus points up along `up` (N, 3), its lateral epicondyle along `lateral`."""
    made = make_recovery(make_recording(), error_m=0.0)
    made = made.rows(slice(0, len(up)))
    x = np.cross(up, lateral)
    R_K_U = np.stack([x, up, lateral], axis=2)
    R_U_B = Rotation.from_rotvec([0.3, -0.8, 0.5]).as_matrix()
    pose = np.zeros((len(up), 6, 6))
    pose[:, 3:, 3:] = sigma_rad**2 * np.eye(3)
    quaternion = Rotation.from_matrix(R_K_U @ R_U_B).as_quat(scalar_first=True)
    upper = SegmentMotion(np.zeros((len(up), 3)), quaternion, pose, np.zeros(3))
    calibration = replace(
        made.calibration or ArmCalibration(), mountings={"upper_arm": SegmentMounting({}, R_bone=R_U_B)}
    )
    return replace(
        made, segments={"upper_arm": upper}, calibration=calibration, gravity_direction=DOWN, side=side
    )


@pytest.mark.parametrize(("side", "lateral_side"), [("right", 1.0), ("left", -1.0)])
def test_postures_with_known_angles(side: str, lateral_side: float) -> None:
    out = np.array([lateral_side, 0.0, 0.0])  # sideways, away from the trunk
    ahead = np.array([0.0, 0.0, -1.0])
    raised_forward = recovery(-np.tile(ahead, (3, 1)), np.tile(out, (3, 1)), side)
    raised_sideways = recovery(-np.tile(out, (3, 1)), np.tile(-ahead, (3, 1)), side)
    forward, _ = shoulder_angles(raised_forward)
    sideways, _ = shoulder_angles(raised_sideways)
    np.testing.assert_allclose(forward["shoulder_elevation"], 90.0)
    np.testing.assert_allclose(sideways["shoulder_elevation"], 90.0)
    np.testing.assert_allclose(np.abs(sideways["shoulder_plane"]), [0.0] * 3, atol=1e-9)
    np.testing.assert_allclose(forward["shoulder_plane"], 90.0)


def test_sigmas_are_the_spread_of_turned_arms() -> None:
    rng = np.random.default_rng(0)
    count, sigma = 600, 0.02
    R = Rotation.from_euler("yxy", [40.0, 70.0, -25.0], degrees=True)
    noise = Rotation.from_rotvec(sigma * rng.normal(size=(count, 3)))
    axes = (noise * R).as_matrix()
    angles, sigmas = shoulder_angles(recovery(axes[:, :, 1], axes[:, :, 2], sigma_rad=sigma))
    exact, _ = shoulder_angles(recovery(R.as_matrix()[None, :, 1], R.as_matrix()[None, :, 2]))
    for name in SHOULDER_ANGLES:
        spread = np.sqrt(np.mean(wrapped_deg(angles[name] - exact[name][0]) ** 2))
        assert np.median(sigmas[name]) == pytest.approx(spread, rel=0.15)  # 600 samples: 3 % one sigma


def test_soft_tissue_widens_them_about_its_own_axis() -> None:
    R = Rotation.from_euler("yxy", [40.0, 70.0, -25.0], degrees=True).as_matrix()
    made = recovery(np.tile(R[:, 1], (2, 1)), np.tile(R[:, 2], (2, 1)))
    assert made.upper is not None
    about_the_bone = replace(
        made, segments={"upper_arm": replace(made.upper, mount_sigma_rad=np.array([0.0, 0.1, 0.0]))}
    )
    _, sigmas = shoulder_angles(about_the_bone)
    np.testing.assert_allclose(sigmas["shoulder_rotation"], np.degrees(0.1), rtol=1e-3)
    np.testing.assert_allclose(sigmas["shoulder_plane"], 0.0, atol=0.01)
    np.testing.assert_allclose(sigmas["shoulder_elevation"], 0.0, atol=0.01)


def test_nothing_is_said_of_what_is_not_known() -> None:
    made = recovery(np.tile([0.0, 0.0, 1.0], (4, 1)), np.tile([1.0, 0.0, 0.0], (4, 1)))
    assert made.upper is not None and made.calibration is not None
    paused = made.upper.quaternion.copy()
    paused[1] = np.nan
    angles, _ = shoulder_angles(replace(made, segments={"upper_arm": replace(made.upper, quaternion=paused)}))
    np.testing.assert_array_equal(np.isnan(angles["shoulder_plane"]), [False, True, False, False])
    for less in (
        replace(made, segments={}),
        replace(made, calibration=replace(made.calibration, mountings={})),
        replace(made, gravity_direction=np.full(3, np.nan)),
    ):
        angles, sigmas = shoulder_angles(less)
        assert all(np.isnan(values).all() for values in (*angles.values(), *sigmas.values()))
