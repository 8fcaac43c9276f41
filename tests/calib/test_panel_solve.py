"""The graph against a plain dense least-squares solution, and its sigma over many draws."""

from __future__ import annotations

import numpy as np
import pytest
from panel_scene import LENS, PANEL, blobs_of, held, seen_plane
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from calib.panel.definition import Frame
from calib.panel.panel_graph import OFFSET_SIGMA_M, ON_PLANE_SIGMA_M, PRIOR_RESIDUALS, PoseData, solve

TRUTH = Frame(
    Rotation.from_euler("xyz", [100, 20, -40], degrees=True).as_matrix(), np.array([0.1, -0.2, 0.4])
)
SIGMA_PX, SIGMA_E_M = 0.05, 0.0002


def pose(seed: int, number: int, offset_m: float = 0.0, height_m: float = 0.0) -> PoseData:
    """A pose with noise of the stated size; the mocap's origin is 1.1 m from the panel."""
    rng = np.random.default_rng([seed, number])
    place = held(rng.uniform(0, 360), rng.uniform(5, 25), rng.uniform(0, 360), rng.uniform(1.2, 1.9))
    true_K = place.points(PANEL.markers_P) + height_m * place.R[:, 2]
    spots = blobs_of(true_K)
    markers = (true_K - TRUTH.origin) @ TRUTH.R
    return PoseData(
        rays=spots.rays + SIGMA_PX / LENS.focal_px * rng.normal(size=(4, 2)),
        sigmas=np.full(4, SIGMA_PX / LENS.focal_px),
        plane=seen_plane(place, rng, offset_m=offset_m),
        markers_E=markers + SIGMA_E_M * rng.normal(size=(4, 3)),
        sigma_E_m=SIGMA_E_M,
        height_m=height_m,
    )


def dense(poses: list[PoseData], with_offset: bool) -> tuple[np.ndarray, np.ndarray]:
    """The same residuals by scipy with numeric derivatives: (6 or 7,) answer about the truth, covariance."""

    def residuals(x: np.ndarray) -> np.ndarray:
        R = Rotation.from_rotvec(x[:3]).as_matrix() @ TRUTH.R
        t, offset = TRUTH.origin + x[3:6], x[6] if with_offset else 0.0
        rows = [np.array([offset / OFFSET_SIGMA_M])] if with_offset else []
        for number, each in enumerate(poses):
            part = x[6 + with_offset + 15 * number :][:15]
            theta, markers = each.plane.theta + part[:3], each.markers_E + part[3:].reshape(4, 3)
            at = markers @ R.T + t
            rows.append(((at[:, :2] / at[:, 2:] - each.rays) / each.sigmas[:, None]).ravel())
            rows.append(part[3:] / each.sigma_E_m)
            away = (at @ theta - 1) / np.linalg.norm(theta) + each.height_m
            rows.append(away / ON_PLANE_SIGMA_M)
            root = np.linalg.cholesky(np.linalg.inv(each.plane.covariance)).T
            rows.append(root @ (theta - each.plane.at_offset(offset)))
        return np.concatenate(rows)

    size = 6 + with_offset + 15 * len(poses)
    scale = np.concatenate([np.full(6, 1e-3), np.full(size - 6, 1e-4)])
    found = least_squares(residuals, np.zeros(size), x_scale=scale, jac="3-point", xtol=1e-14, ftol=1e-14)
    covariance = np.linalg.inv(found.jac.T @ found.jac)
    keep = 6 + with_offset
    return found.x[:keep], covariance[:keep, :keep]


@pytest.mark.parametrize(("count", "height_m"), [(1, 0.0), (3, 0.0), (2, 0.007)])
def test_graph_is_the_dense_solution(count: int, height_m: float):
    poses = [pose(3, number, 0.003 * (count > 1), height_m) for number in range(count)]
    found = solve(poses)
    with_offset = count > 1
    assert np.isfinite(found.depth_offset_sigma_m) == with_offset
    plain, covariance = dense(poses, with_offset)
    turn = Rotation.from_matrix(found.camera_from_mocap.R @ TRUTH.R.T).as_rotvec()
    # no residual is beyond Huber's bound here; where the optimisers stop: a hundredth of sigma
    np.testing.assert_allclose(turn, plain[:3], atol=3e-6)
    np.testing.assert_allclose(found.camera_from_mocap.origin - TRUTH.origin, plain[3:6], atol=3e-6)
    scale = (PRIOR_RESIDUALS + found.misfit * found.residuals) / (PRIOR_RESIDUALS + found.residuals)
    # the turn in `dense` is about the mocap origin's place in {K}, in the graph about the camera
    x, y, z = TRUTH.origin
    J = np.eye(6)
    J[3:, :3] = -np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    stated = J @ found.covariance @ J.T / scale
    np.testing.assert_allclose(stated, covariance[:6, :6], rtol=0.02, atol=1e-3 * np.abs(covariance).max())
    if with_offset:
        assert found.depth_offset_m == pytest.approx(plain[6], abs=1e-5)
        assert found.depth_offset_sigma_m == pytest.approx(np.sqrt(covariance[6, 6] * scale), rel=0.02)


def test_errors_are_as_large_as_sigma_says():
    squared, offsets = [], []
    for seed in range(25):
        found = solve([pose(seed, number, 0.005) for number in range(2)])
        turn = Rotation.from_matrix(found.camera_from_mocap.R @ TRUTH.R.T).as_rotvec()
        shift = found.camera_from_mocap.origin - TRUTH.origin - np.cross(turn, TRUTH.origin)
        error = np.concatenate([turn, shift])
        squared.append(error @ np.linalg.solve(found.covariance, error) / 6)
        offsets.append((found.depth_offset_m - 0.005) / found.depth_offset_sigma_m)
    assert 0.65 < np.mean(squared) < 1.4  # 150 squared errors scatter by 12 %
    assert 0.4 < np.mean(np.square(offsets)) < 1.9 and abs(np.mean(offsets)) < 0.6


def test_one_pose_tells_a_large_depth_error_and_believes_a_small_one():
    assert not np.isfinite(solve([pose(1, 0, 0.0)]).depth_offset_sigma_m)
    found = solve([pose(1, 0, 0.015)])
    assert found.depth_offset_m == pytest.approx(0.015, abs=4 * found.depth_offset_sigma_m)


@pytest.mark.parametrize("seed", range(4))
def test_one_pose_takes_a_wrong_spot_for_no_depth_error(seed: int):
    # two spots that touch: the end of the longer arm seems 4 mm farther out, which looks like a wrong depth
    one = pose(seed, 0)
    out = one.rays[2] - one.rays[0]
    one.rays[2] += out * 0.004 / 0.5
    found = solve([one])
    assert not np.isfinite(found.depth_offset_sigma_m)
    assert found.misfit > 4
    middle = one.markers_E.mean(axis=0)
    off = (found.camera_from_mocap.R - TRUTH.R) @ middle + found.camera_from_mocap.origin - TRUTH.origin
    assert np.linalg.norm(off) < 0.0015  # with the depth's error believed: 6 to 10 mm


def test_a_wrong_marker_hardly_moves_many_poses():
    poses = [pose(7, number) for number in range(6)]
    clean = solve(poses).camera_from_mocap
    poses[2].markers_E[1] += [0.02, -0.01, 0.01]
    found = solve(poses)
    turn = Rotation.from_matrix(found.camera_from_mocap.R @ clean.R.T).magnitude()
    assert np.degrees(turn) < 0.05  # least squares without Huber: 0.2 degrees
    assert found.misfit > 4
    worst = np.unravel_index(np.argmax(found.marker_residuals_m), (6, 4))
    assert worst == (2, 1)
