"""Keypoints as factors: points on rays, against GTSAM's reprojection factor; the probability of a scale."""

from __future__ import annotations

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import G, U, X
from small_window import small_window

from smoother.config import ArmPrior
from smoother.graph import scale
from smoother.graph.build import build
from smoother.graph.columns import camera_rows
from smoother.graph.factors import robust_across
from smoother.graph.linear_system import Jacobian
from smoother.graph.scale import coordinates_by_pixels, with_scale_term
from smoother.graph.shared_prior import lever_keys
from smoother.graph.solved import SolvedWindow
from smoother.measurements.rays import ALONG_M, AT_M, across, linearised, squashed
from smoother.window.priors import limb_lengths, with_limb_lengths
from smoother.window.problem import Window, joints_at_start

ORIGIN = np.array([0.4, -0.2, -1.7])


@pytest.fixture
def window() -> Window:
    """A small window of which one camera sees no depth; losses are nearly square."""
    small = small_window()
    flat = tuple(replace(each, origin_m=ORIGIN) for each in small.joint_measurements)
    return replace(small, joint_measurements=flat, noise=replace(small.noise, cauchy=1e5))


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
    residual, position = rng.normal(size=(3, 5, 3)), rng.normal(size=(3, 5, 3)) + np.array([0.0, 0.0, 3.0])
    origin = np.array([[0.0, 0.0, 0.0], [np.nan] * 3, [1.0, 0.0, 0.0]])
    seen, ray = across(residual, position, origin), position - origin[:, None]
    np.testing.assert_array_equal(seen[1], residual[1])
    np.testing.assert_allclose(np.sum(seen * ray, axis=2)[[0, 2]], 0.0, atol=1e-12)
    np.testing.assert_allclose(np.cross(seen, ray)[[0, 2]], np.cross(residual, ray)[[0, 2]])


def test_linearised_keypoints_have_the_gradient_of_gtsams_reprojection_factor() -> None:
    """Anywhere in the image, the measured ray elsewhere than the joint: residual and derivative are exact."""
    focal, sigma_px = 900.0, 3.0
    lens = gtsam.Cal3_S2(focal, focal, 0.0, 0.0, 0.0)
    rng = np.random.default_rng(5)
    for _ in range(20):
        point, pixel = (
            np.array([*rng.uniform(-1.0, 1.0, 2), rng.uniform(1.0, 4.0)]),
            40.0 * rng.normal(size=2),
        )
        looks = gtsam.PinholeCameraCal3_S2.Lookat(np.zeros(3), point, np.array([0.0, 1.0, 0.0]), lens)
        values = gtsam.Values()
        values.insert(0, looks.pose())
        values.insert(1, point)
        model = gtsam.noiseModel.Isotropic.Sigma(2, sigma_px)
        reprojection = gtsam.GenericProjectionFactorCal3_S2(pixel, model, 0, 1, lens)
        A, b = reprojection.linearize(values).jacobian()
        ray = looks.pose().rotation().matrix() @ np.append(pixel / focal, 1.0)
        on_ray = rng.uniform(0.3, 5.0) * ray[None]  # any point of it
        at_2_m = np.array([AT_M * sigma_px / focal])
        position, sigma_m, to_joint = linearised(on_ray, at_2_m, np.zeros(3), point[None])
        own = gtsam.PriorFactorPoint3(1, position[0], robust_across(squashed(to_joint, sigma_m)[0], 1e6))
        ours, rhs = own.linearize(values).jacobian()
        weak = 2.0 * 4.2 / ALONG_M**2  # of the sample's own along its ray
        np.testing.assert_allclose(ours.T @ ours, A[:, -3:].T @ A[:, -3:], rtol=1e-9, atol=weak)
        np.testing.assert_allclose(ours.T @ rhs, A[:, -3:].T @ b, rtol=1e-6, atol=weak)


def test_coordinates_are_the_slope_of_the_log_determinant(
    window: Window, monkeypatch: pytest.MonkeyPatch
) -> None:
    """-1/2 log det of what is integrated over, by the logarithm of the scale, in finite differences."""
    monkeypatch.setattr(scale, "FREE", 0.0)  # a window of half a second has hardly more
    window = replace(window, bodies=window.bodies[:1], alone=True)
    window = window.linearised(joints_at_start(window))
    built = build(window)
    jacobian, layout = Jacobian.of(built.graph, built.values), window.priors.layout
    every = np.arange(jacobian.width)
    fixed = np.concatenate([every[jacobian.columns[key]] for key in (G(0), U(0), *lever_keys(layout))])
    free = np.setdiff1d(every, fixed)
    of_joints = [each.rows for each in built.groups if each.kind == "camera" and each.of != "shoulder"]
    rows = np.concatenate([np.arange(each.start, each.stop) for each in of_joints])
    positions = np.concatenate([every[jacobian.columns[X(k)]][3:] for k in range(len(window.t))])

    def volume(log_scale: float) -> float:
        scaled = jacobian.toarray()
        scaled[np.ix_(rows, positions)] *= np.exp(-log_scale)
        return float(np.linalg.slogdet(scaled[:, free].T @ scaled[:, free])[1])

    slope = -0.5 * (volume(1e-4) - volume(-1e-4)) / 2e-4
    assert slope > 3.0
    assert coordinates_by_pixels(SolvedWindow(window, *built)) == pytest.approx(slope, rel=1e-4)


def test_scale_term_and_limb_lengths_move_the_forearm(window: Window) -> None:
    """By the slope of the one's logarithm; as the sum of information of the other, one measurement more."""
    priors, layout = window.priors, window.priors.layout
    shared, wrist, elbow = priors.shared, layout.lever("wrist"), layout.lever("elbow")
    apart = shared.mean[wrist] - shared.mean[elbow]
    pull = np.linalg.solve(shared.covariance, with_scale_term(priors, 7.0).shared.mean - shared.mean)
    length, step = np.linalg.norm(apart), 1e-6
    slope = [7.0 * np.log(np.linalg.norm(apart + step * axis) / length) / step for axis in np.eye(3)]
    np.testing.assert_allclose(pull[wrist], slope, rtol=1e-4, atol=1e-4)
    np.testing.assert_allclose(pull[elbow], -np.array(slope), rtol=1e-4, atol=1e-4)

    lengths = limb_lengths(ArmPrior(height_m=1.8))
    known, row = with_limb_lengths(shared, layout, lengths), np.zeros(layout.size)
    row[wrist], row[elbow] = apart / length, -apart / length
    before, after, own = row @ shared.covariance @ row, row @ known.covariance @ row, lengths.covariance[0, 0]
    assert after == pytest.approx(1.0 / (1.0 / before + 1.0 / own), rel=0.05)
    mean = after * (row @ shared.mean / before + lengths.mean[0] / own)
    assert row @ known.mean == pytest.approx(mean, rel=0.05)
    assert np.linalg.eigvalsh(known.covariance).min() > 0.0
    # a height says more than none
    assert lengths.covariance[0, 0] < 0.8 * limb_lengths(ArmPrior()).covariance[0, 0]
