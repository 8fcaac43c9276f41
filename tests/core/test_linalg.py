"""Small functions that are in for a library's, against it: algebra, filters, rotations, splines."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage
from scipy.interpolate import CubicHermiteSpline, CubicSpline
from scipy.optimize import nnls
from scipy.signal import find_peaks
from scipy.spatial import transform

from smoother.array_types import FloatArray
from smoother.error_radius import error_radius, pooled_radius
from smoother.filters import gaussian_smoothed, moving_mean, moving_median
from smoother.linalg import by_columns, largest_trace, nearest_rotation, nonnegative_pair, peaks
from smoother.rotation import Rotation, Slerp, chained
from smoother.splines import PiecewiseCubic, natural_spline


@pytest.mark.parametrize("width", [1, 2, 3, 8, 25])
def test_means_medians_and_gaussians_are_scipys(width: int) -> None:
    x = np.random.default_rng(width).normal(5.0, 1.0, (60, 3))
    mean = ndimage.uniform_filter1d(x[:, 0], width, mode="nearest")
    np.testing.assert_allclose(moving_mean(x[:, 0], width), mean, atol=1e-12)
    for sigma, order in ((0.31 * width, 0), (0.31 * width, 1)):
        theirs = ndimage.gaussian_filter1d(x, sigma, axis=0, order=order)
        np.testing.assert_allclose(gaussian_smoothed(x, sigma, bool(order)), theirs, atol=1e-12)
    if width % 2:
        median = ndimage.median_filter(x, size=(width, 1), mode="nearest")
        np.testing.assert_array_equal(moving_median(x, width), median)


def test_peaks_and_nonnegative_pairs_are_scipys() -> None:
    rng = np.random.default_rng(0)
    for _ in range(40):
        y = np.convolve(rng.normal(size=400), np.ones(5), "valid")
        rows, _ = find_peaks(y, height=1.0, distance=12)
        highest = rows[np.argsort(-y[rows], kind="stable")]
        np.testing.assert_array_equal(peaks(y, 1.0, 12, 8), highest[:8])
        A, y = rng.normal(size=(12, 2)), rng.normal(size=12)
        x, misfit = nonnegative_pair(A, y)
        theirs, their_misfit = nnls(A, y)
        np.testing.assert_allclose(x, theirs, atol=1e-10)
        assert misfit == pytest.approx(their_misfit)
    for ends, found in ((np.arange(9.0), []), (np.zeros(9), []), (np.array([0.0, 1, 1, 0]), [1])):
        assert peaks(ends, 0.0, 1, 5).tolist() == found


def test_the_largest_trace_is_that_of_the_nearest_rotation() -> None:
    rng = np.random.default_rng(8)
    general = rng.normal(size=(300, 3, 3))
    lines = rng.normal(size=(100, 3, 1)) @ rng.normal(size=(100, 1, 3))  # one direction only: a double root
    planes = general[:100] @ np.diag([1.0, 1.0, 0.0])
    for matrices, tolerance in ((general, 1e-11), (100.0 * planes, 1e-11), (lines, 1e-7)):
        expected = np.einsum("nij,nij->n", nearest_rotation(matrices), matrices)
        np.testing.assert_allclose(
            largest_trace(matrices), expected, atol=tolerance * np.abs(matrices).max(), rtol=0
        )
    assert largest_trace(np.zeros((3, 3))) == 0.0
    # no reflection, half a turn about any axis: a triple root, which keeps a third of the digits
    np.testing.assert_allclose(largest_trace(-np.eye(3)), 1.0, atol=1e-4)


#: Products of numbers up to one; near a half turn an angle loses half of the digits.
ROUNDING, NEAR_PI = 1e-14, 1e-7

RNG = np.random.default_rng(5)
AXES = RNG.normal(size=(40, 3))
AXES /= np.linalg.norm(AXES, axis=1, keepdims=True)
ANGLES = np.concatenate([[0.0, 1e-12, 1e-7, 0.9e-3, 1.1e-3, np.pi - 1e-9, np.pi], RNG.uniform(0, np.pi, 33)])
ROTVECS = ANGLES[:, None] * AXES


@pytest.mark.parametrize("rows", [slice(None), 0, 3, 20], ids=["stack", "none", "small", "one"])
def test_every_form_is_that_of_scipy(rows: int | slice) -> None:
    ours, theirs = Rotation.from_rotvec(ROTVECS[rows]), transform.Rotation.from_rotvec(ROTVECS[rows])
    np.testing.assert_allclose(ours.as_matrix(), theirs.as_matrix(), atol=ROUNDING)
    again = transform.Rotation.from_matrix(theirs.as_matrix())
    np.testing.assert_allclose(
        ours.as_quat(scalar_first=True), again.as_quat(scalar_first=True), atol=1e-8
    )  # the sign too, where no two parts are equal
    np.testing.assert_allclose(np.abs(np.sum(ours.as_quat() * theirs.as_quat(), axis=-1)), 1.0, atol=ROUNDING)
    back, angle = ours.as_rotvec(), ANGLES[rows]
    np.testing.assert_allclose(np.linalg.norm(back, axis=-1), angle, atol=NEAR_PI)
    np.testing.assert_allclose(ours.magnitude(), angle, atol=NEAR_PI)
    sharp = angle < np.pi - 1e-3
    np.testing.assert_allclose(back[sharp], ROTVECS[rows][sharp], atol=1e-12)
    canonical = ours.as_quat(canonical=True)
    assert (canonical[..., 3] >= 0).all()
    np.testing.assert_allclose(Rotation.from_quat(canonical).as_matrix(), theirs.as_matrix(), atol=ROUNDING)


def test_products_and_application() -> None:
    ours, theirs = Rotation.from_rotvec(ROTVECS), transform.Rotation.from_rotvec(ROTVECS)
    vectors, q = RNG.normal(size=(40, 3)), RNG.normal(size=(32, 4))
    q[:2] = [[1.0, 0, 0, 0], [0, 0, -2.0, 0]]  # quaternions of any length
    pairs = [
        (ours.apply(vectors), theirs.apply(vectors)),
        (ours.apply(vectors[3]), theirs.apply(vectors[3])),
        (ours[3].apply(vectors), theirs[3].apply(vectors)),
        (ours.inv().apply(vectors), theirs.inv().apply(vectors)),
        ((ours * ours[::-1].inv()).as_matrix(), (theirs * theirs[::-1].inv()).as_matrix()),
        ((ours[2] * ours).as_matrix(), (theirs[2] * theirs).as_matrix()),
        (
            Rotation.about_z(ANGLES).as_matrix(),
            transform.Rotation.from_euler("z", ANGLES[:, None]).as_matrix(),
        ),
        (
            Rotation.from_quat(q, scalar_first=True).as_matrix(),
            transform.Rotation.from_quat(q, scalar_first=True).as_matrix(),
        ),
    ]
    for mine, reference in pairs:
        np.testing.assert_allclose(mine, reference, atol=4 * ROUNDING)
    assert len(ours) == 40
    with pytest.raises(ValueError, match="length zero"):
        Rotation.from_quat(np.zeros(4))


def test_between_two_at_a_constant_rate() -> None:
    t = np.cumsum(RNG.uniform(0.1, 1.0, 40))
    at = np.sort(np.append(RNG.uniform(t[0], t[-1], 200), [t[0], t[7], t[-1]]))
    vectors = np.minimum(ANGLES, 1.2)[:, None] * AXES  # two neighbours are less than half a turn apart
    ours = Slerp(t, Rotation.from_rotvec(vectors))(at)
    theirs = transform.Slerp(t, transform.Rotation.from_rotvec(vectors))(at)
    np.testing.assert_allclose(ours.as_matrix(), theirs.as_matrix(), atol=1e-12)


@pytest.mark.parametrize("count", [0, 1, 2, 3, 8, 9, 10, 40])
def test_turns_one_after_the_other(count: int) -> None:
    turns = Rotation.from_rotvec(ROTVECS[:count]).as_matrix() if count else np.empty((0, 3, 3))
    expected = [np.eye(3)]
    for turn in turns:
        expected.append(expected[-1] @ turn)
    np.testing.assert_allclose(chained(turns), expected, atol=1e-13)


@pytest.mark.parametrize("count", [2, 3, 4, 5, 12, 13, 14, 50, 333])
def test_splines_are_scipys(count: int) -> None:
    rng = np.random.default_rng(count)
    t = np.cumsum(rng.uniform(0.01, 0.4, count))
    value, slope = rng.normal(size=(2, count, 3))
    at = rng.uniform(t[0], t[-1], (7, 43))
    for ours, theirs in (
        (natural_spline(t, value), CubicSpline(t, value, bc_type="natural")),
        (PiecewiseCubic(t, value, slope), CubicHermiteSpline(t, value, slope)),
    ):
        scale = np.abs(theirs(at, 1)).max() + 1.0  # rounding, of values and slopes of this size
        np.testing.assert_allclose(ours(at), theirs(at), atol=1e-11 * scale)
        np.testing.assert_allclose(ours(at, 1), theirs(at, 1), atol=1e-10 * scale)
    with pytest.raises(ValueError, match="knots"):
        natural_spline(np.zeros(5), np.zeros((5, 1)))


def test_columns_that_are_known_differently() -> None:
    """Each array is treated as alone: where one is unknown, the others are not."""
    rng = np.random.default_rng(5)
    arrays = {name: rng.normal(size=(20, width)) for name, width in (("a", 3), ("b", 4), ("c", 3), ("d", 3))}
    arrays["c"][4:9] = np.nan
    arrays["d"][4:9, 1] = np.nan  # a row of which a part is unknown is unknown

    def known_sums(columns: np.ndarray) -> np.ndarray:
        return np.cumsum(columns[np.isfinite(columns).all(axis=1)], axis=0)

    together = by_columns(known_sums, arrays)
    assert list(together) == list(arrays)
    for name, array in arrays.items():
        np.testing.assert_array_equal(together[name], known_sums(array))


def rotation(seed: int) -> FloatArray:
    q, r = np.linalg.qr(np.random.default_rng(seed).standard_normal((3, 3)))
    return np.asarray(q * np.sign(np.diag(r)))


@pytest.mark.parametrize(
    "shares", [(1, 1, 1), (1, 1, 0), (1, 0, 0), (1, 0.5, 0.5), (1, 0.3, 0.02), (1, 0.8, 0.1)]
)
def test_a_share_of_random_errors_lies_within_a_radius(shares: tuple[float, float, float]) -> None:
    """Of errors of one covariance, and of several together."""
    rng, turns = np.random.default_rng(1), [rotation(k) for k in range(3)]
    several = [turn @ np.diag(shares) @ turn.T * s * 1e-4 for turn, s in zip(turns, (1, 2, 9), strict=True)]
    errors = [rng.multivariate_normal(np.zeros(3), each, 200_000) for each in several]
    distance = np.linalg.norm(errors, axis=2)
    assert error_radius(several[0]) == pytest.approx(np.quantile(distance[0], 0.95), rel=0.01)
    assert error_radius(several[0], 0.5) == pytest.approx(np.quantile(distance[0], 0.5), rel=0.03)
    unknown = np.full((1, 3, 3), np.nan)
    together = pooled_radius(np.concatenate([several, unknown]))
    assert together == pytest.approx(np.quantile(distance, 0.95), rel=0.03)
    assert pooled_radius(unknown) is None


def test_a_radius_is_exact_where_one_two_or_three_axes_are_equal_none_is_known_or_all_are() -> None:
    exact = [1.959964, np.sqrt(-2 * np.log(0.05)), 2.795483, np.nan, 0.0]
    unknown = np.full((3, 3), np.nan)
    covariance = np.stack([np.diag([1.0, 0, 0]), np.diag([1.0, 1, 0]), np.eye(3), unknown, 0 * np.eye(3)])
    assert error_radius(covariance) == pytest.approx(exact, rel=1e-5, nan_ok=True)
