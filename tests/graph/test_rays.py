"""Keypoints as factors: points on rays, against GTSAM's reprojection factor and by moving each keypoint."""

from __future__ import annotations

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from small_window import small_window

from smoother.graph.build import build
from smoother.graph.columns import camera_rows
from smoother.graph.factors import robust_across
from smoother.graph.linear_system import Jacobian
from smoother.graph.solved import SolvedWindow
from smoother.measurements.rays import ALONG_M, AT_M, across, linearised, squashed
from smoother.window.problem import Window

ORIGIN = np.array([0.4, -0.2, -1.7])


@pytest.fixture
def window() -> Window:
    """A small window of which one camera sees no depth; losses are nearly square."""
    small = small_window()[0]
    flat = tuple(replace(each, origin_m=ORIGIN) for each in small.joint_measurements)
    return replace(small, joint_measurements=flat, noise=replace(small.noise, cauchy=1e5))


def test_which_point_of_the_ray_it_is_does_not_matter(window: Window) -> None:
    """Of nodes with one sample: those of one node are means of points, which here are centimetres apart."""
    nearer = tuple(
        replace(each, position=ORIGIN + 0.7 * (each.position - ORIGIN)) for each in window.joint_measurements
    )
    one, other = build(window), build(replace(window, joint_measurements=nearer))
    compared = 0
    for group in one.groups:
        if group.kind != "camera" or group.of == "shoulder":
            continue
        measured = next(each for each in window.joint_measurements if each.joint == group.of)
        for k, node in zip(group.factors, group.nodes, strict=True):
            if np.sum(measured.node == node) == 1:
                a, b = one.graph.at(k).error(one.values), other.graph.at(k).error(one.values)
                assert a == pytest.approx(b, rel=1e-3, abs=3e-3)  # but for what ALONG_M weighs
                compared += 1
    assert compared > 10


def test_rows_follow_a_keypoint_that_moves(window: Window) -> None:
    """The columns by which constant errors, clocks and blocks enter, against a moved measurement."""
    built = build(window)
    solved, step = SolvedWindow(window, *built), 1e-6
    for factors in camera_rows(solved):
        if factors.joint == "shoulder":
            continue
        assert factors.roots is not None
        own = factors.whitened(np.tile(np.eye(3), (len(factors.nodes), 1, 1)))
        for axis in range(3):
            shift = step * np.eye(3)[axis]
            moved = tuple(
                replace(each, position=each.position + shift, origin_m=ORIGIN + shift)
                if each.joint == factors.joint
                else each
                for each in window.joint_measurements
            )
            again = Jacobian.of(build(replace(window, joint_measurements=moved)).graph, built.values)
            change = (again.rhs - solved.jacobian.rhs)[factors.rows] / step
            np.testing.assert_allclose(change, own[:, axis], atol=1e-3 * np.abs(own).max())


def test_residuals_across_rays_leave_cameras_with_depth_alone() -> None:
    rng = np.random.default_rng(3)
    residual, position = rng.normal(size=(4, 5, 3)), rng.normal(size=(4, 5, 3)) + np.array([0.0, 0.0, 3.0])
    origin = np.array([[0.0, 0.0, 0.0], [np.nan] * 3, [1.0, 0.0, 0.0], [np.nan] * 3])
    seen = across(residual, position, origin)
    np.testing.assert_array_equal(seen[[1, 3]], residual[[1, 3]])
    for row in (0, 2):
        for joint in range(5):
            ray = position[row, joint] - origin[row]
            assert seen[row, joint] @ ray == pytest.approx(0.0, abs=1e-12)
            np.testing.assert_allclose(np.cross(seen[row, joint], ray), np.cross(residual[row, joint], ray))


def facing(point: np.ndarray) -> gtsam.Pose3:
    """A camera in the origin that looks at a point."""
    z = point / np.linalg.norm(point)
    x = np.cross([0.0, 1.0, 0.0], z)
    x /= np.linalg.norm(x)
    return gtsam.Pose3(gtsam.Rot3(np.stack([x, np.cross(z, x), z], axis=1)), np.zeros(3))


def test_linearised_keypoints_have_the_gradient_of_gtsams_reprojection_factor() -> None:
    """Anywhere in the image, the measured ray elsewhere than the joint: residual and derivative are exact."""
    focal, sigma_px = 900.0, 3.0
    lens = gtsam.Cal3_S2(focal, focal, 0.0, 0.0, 0.0)
    rng = np.random.default_rng(5)
    for _ in range(20):
        point = np.array([*rng.uniform(-1.0, 1.0, 2), rng.uniform(1.0, 4.0)])
        camera, pixel = facing(point), rng.normal(scale=40.0, size=2)
        values = gtsam.Values()
        values.insert(0, camera)
        values.insert(1, point)
        reprojection = gtsam.GenericProjectionFactorCal3_S2(
            pixel, gtsam.noiseModel.Isotropic.Sigma(2, sigma_px), 0, 1, lens
        )
        A, b = reprojection.linearize(values).jacobian()
        ray = camera.rotation().matrix() @ np.append(pixel / focal, 1.0)
        on_ray = rng.uniform(0.3, 5.0) * ray[None]  # any point of it
        at_2_m = np.array([AT_M * sigma_px / focal])
        position, sigma_m, to_joint = linearised(on_ray, at_2_m, np.zeros(3), point[None])
        own = gtsam.PriorFactorPoint3(1, position[0], robust_across(squashed(to_joint, sigma_m)[0], 1e6))
        ours, rhs = own.linearize(values).jacobian()
        weak = 2.0 * 4.2 / ALONG_M**2  # of the sample's own along its ray
        np.testing.assert_allclose(ours.T @ ours, A[:, -3:].T @ A[:, -3:], rtol=1e-9, atol=weak)
        np.testing.assert_allclose(ours.T @ rhs, A[:, -3:].T @ b, rtol=1e-6, atol=weak)
