"""Reach volumes of bodies whose volume is known."""

from __future__ import annotations

import numpy as np
import pytest

from smoother.measures.hand import alpha_volume, reach_figures, voxel_means


def ball(radius: float, count: int, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    way = rng.normal(size=(count, 3))
    return radius * rng.uniform(size=(count, 1)) ** (1 / 3) * way / np.linalg.norm(way, axis=1, keepdims=True)


def sphere(radius: float, count: int) -> np.ndarray:
    """Fibonacci's points on a sphere."""
    k = np.arange(count) + 0.5
    polar, turn = np.arccos(1 - 2 * k / count), np.pi * (1 + 5**0.5) * k
    return radius * np.stack(
        [np.cos(turn) * np.sin(polar), np.sin(turn) * np.sin(polar), np.cos(polar)], axis=1
    )


def test_a_sphere_has_the_volume_of_a_ball():
    points = sphere(0.5, 600)
    figures = reach_figures(points, np.zeros(len(points), bool), 0.5, 0.02, 1.0)
    # a polyhedron with 600 corners fills all but a hundredth or two of the ball
    assert figures["hand_reach_hull_l"].value == pytest.approx(4e3 / 3 * np.pi * 0.125, rel=0.025)
    assert figures["hand_reach_sphere_percent"].value == pytest.approx(100.0, rel=0.025)


def test_a_cube():
    corners = np.array(list(np.ndindex(2, 2, 2)), float)
    figures = reach_figures(corners, np.arange(8) < 2, 1.0, 0.02, 10.0)
    assert figures["hand_reach_hull_l"] == pytest.approx((1000.0, 0.25))  # two of eight corners are recovered
    assert figures["hand_reach_alpha_l"].value == pytest.approx(1000.0)
    # the ball through a cube's corners has half its diagonal as radius
    assert alpha_volume(corners, 0.99 * np.sqrt(3) / 2) == 0.0


def test_alpha_shape_leaves_out_what_lies_between():
    apart = np.array([2.0, 0.0, 0.0])
    both = np.vstack([ball(0.5, 1500), ball(0.5, 1500, 1) + apart])
    hull = reach_figures(both, np.zeros(len(both), bool), 1.0, 0.001, 0.3)
    two = 2 * 4e3 / 3 * np.pi * 0.125
    assert hull["hand_reach_alpha_l"].value == pytest.approx(two, rel=0.15)  # rough surface of 1500 points
    assert hull["hand_reach_hull_l"].value > 1.8 * two


def test_alpha_shape_is_open3d_s():
    """Open3D closes its alpha shape's surface; a ball filled evenly has no holes in it."""
    from smoother.runtime.packages import load_open3d

    o3d = load_open3d()
    points = ball(0.5, 3000, 2)
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
    mesh = o3d.geometry.TriangleMesh.create_from_point_cloud_alpha_shape(cloud, 0.25)
    assert mesh.is_watertight()
    assert alpha_volume(points, 0.25) == pytest.approx(mesh.get_volume(), rel=1e-6)


def test_what_has_no_volume():
    line = np.linspace(0, 1, 50)[:, None] * np.ones(3)
    for points in (line, np.zeros((2, 3)), np.full((30, 3), np.nan)):
        figures = reach_figures(points, np.zeros(len(points), bool), 0.5, 0.02, 0.3)
        assert all(np.isnan(figure.value) for figure in figures.values())


def test_one_place_in_a_cube():
    places = voxel_means(np.array([[0.001, 0, 0], [0.003, 0, 0], [0.05, 0, 0]]), 0.02)
    np.testing.assert_allclose(places, [[0.002, 0, 0], [0.05, 0, 0]])
