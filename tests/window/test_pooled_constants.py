"""The arm's constants of all windows together, and the spread between windows, axis by axis."""

from __future__ import annotations

import numpy as np
import pytest

from smoother.array_types import FloatArray
from smoother.window.pooling import (
    SLOW_WALK,
    _between_window_variance,
    _Information,
    _positive,
    leave_one_out_priors,
    pooled,
)
from smoother.window.problem import Priors
from smoother.window.shared import Gaussian, SharedLayout, axes_across
from smoother.window.solution import Message

LAYOUT = SharedLayout(("elbow", "wrist"), True, axes_across(np.array([0.0, -1.0, 0.0])), ("upper_arm",))


def spd(rng: np.random.Generator, size: int, scale: float = 1.0) -> FloatArray:
    A = rng.normal(size=(size, size + 2))
    return np.asarray(scale * A @ A.T / size)


def spread_by_hand(matrix: FloatArray, vector: FloatArray) -> FloatArray:
    """DerSimonian and Laird (1986) on each axis, the others held at the common mean; window by window."""
    mean = np.linalg.solve(sum(matrix), sum(vector))
    size = len(mean)
    out = np.zeros(size)
    for axis in range(size):
        w, x = [], []
        largest = max(each[axis, axis] for each in matrix)
        for H, v in zip(matrix, vector, strict=True):
            if H[axis, axis] > 1e-6 * largest:
                others = sum(H[axis, j] * mean[j] for j in range(size) if j != axis)
                w.append(H[axis, axis])
                x.append((v[axis] - others) / H[axis, axis])
        if len(w) < 3:
            continue
        centre = np.average(x, weights=w)
        q = sum(a * (b - centre) ** 2 for a, b in zip(w, x, strict=True))
        out[axis] = max(0.0, (q - (len(w) - 1)) / (sum(w) - sum(a**2 for a in w) / sum(w)))
    return out


@pytest.mark.parametrize("scale", [1e-4, 1.0, 1e5])
@pytest.mark.parametrize("count", [3, 7])
def test_the_spread_of_correlated_windows(count: int, scale: float) -> None:
    """Whatever the unit, also of data that say little."""
    rng = np.random.default_rng(count)
    matrix = np.array([scale * spd(rng, 3) for _ in range(count)])
    vector = np.array([H @ (2.0 + 3.0 / np.sqrt(scale) * rng.normal(size=3)) for H in matrix])
    found = _between_window_variance(_Information(matrix, vector))
    expected = spread_by_hand(matrix, vector)
    assert expected.max() > 0.1 / scale
    np.testing.assert_allclose(found, expected, rtol=1e-3, atol=1e-6 / scale)


def test_two_windows_have_no_spread() -> None:
    matrix = np.tile(np.eye(2), (2, 1, 1))
    assert _between_window_variance(_Information(matrix, np.array([[0.0, 0], [9, 9]]))).tolist() == [0.0, 0.0]


def test_windows_that_say_nothing_of_an_axis_do_not_count() -> None:
    """On the second axis two of five know something: no spread can be told; on the first, three do."""
    diagonals = np.array([[1.0, 1.0], [1.0, 1.0], [1.0, 0.9e-6], [1e-7, 0.0], [0.0, 1e-9]])
    matrix = np.array([np.diag(each) for each in diagonals])
    vector = matrix @ np.array([5.0, 7.0]) + np.array([[-4.0, 3], [0, -3], [4, 0], [0, 0], [0, 0]])
    found = _between_window_variance(_Information(matrix, vector))
    np.testing.assert_allclose(found, [(32.0 - 2.0) / 2.0, 0.0], rtol=1e-6)
    diagonals[2, 1] = 1.1e-6
    again = np.array([np.diag(each) for each in diagonals])
    vector = again @ np.array([5.0, 7.0]) + np.array([[0, 9.0], [0, -9.0], [0, 0], [0, 0], [0, 0]])
    assert _between_window_variance(_Information(again, vector))[1] > 80.0  # three that know it


def messages(rng: np.random.Generator, prior: Gaussian, count: int) -> list[Message]:
    """Posteriors of windows whose own data scatter more than they state."""
    made = []
    before = np.linalg.inv(prior.covariance)
    for k in range(count):
        H = np.linalg.inv(spd(rng, LAYOUT.size, 0.02) + 0.01 * np.eye(LAYOUT.size))
        data = 0.3 * rng.normal(size=LAYOUT.size)
        C = np.linalg.inv(before + H)
        made.append(Message(7.0 * k, Gaussian(C @ (before @ prior.mean + H @ data), C)))
    return made


@pytest.mark.parametrize("count", [1, 2, 6])
def test_constants_of_all_windows(count: int) -> None:
    """The prior's rows and each window's own part of them, widened by the spread."""
    rng = np.random.default_rng(count)
    prior = Gaussian(0.1 * rng.normal(size=LAYOUT.size), spd(rng, LAYOUT.size) + 0.1 * np.eye(LAYOUT.size))
    answers = messages(rng, prior, count)
    rows = np.arange(8, LAYOUT.size - 6)
    before = np.linalg.inv(prior.covariance[np.ix_(rows, rows)])
    matrix, vector = [], []
    for answer in answers:
        H = np.linalg.inv(answer.shared.covariance[np.ix_(rows, rows)])
        matrix.append(H - before)
        vector.append(H @ answer.shared.mean[rows] - before @ prior.mean[rows])
    spread = spread_by_hand(np.array(matrix), np.array(vector)) if count > 2 else np.zeros(len(rows))
    assert (spread.max() > 0.01) == (count > 2)
    total, pull = before, before @ prior.mean[rows]
    for H, v in zip(matrix, vector, strict=True):
        widened = np.linalg.inv(np.linalg.inv(H) + np.diag(spread))
        total, pull = total + widened, pull + widened @ np.linalg.solve(H, v)
    found = pooled(answers, Priors(LAYOUT, prior, np.zeros(6)))
    np.testing.assert_allclose(found.covariance, np.linalg.inv(total), rtol=1e-4, atol=1e-7)
    np.testing.assert_allclose(found.mean, np.linalg.solve(total, pull), rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("upper", [True, False])
def test_both_imus_biases_wander(upper: bool) -> None:
    """Of two windows the later one's prior: the first's own part, widened by the time between them."""
    layout = LAYOUT if upper else SharedLayout(("elbow",), True, LAYOUT.gravity_axes)
    rng = np.random.default_rng(3)
    prior = Gaussian(np.zeros(layout.size), 4.0 * np.eye(layout.size))
    data = 1e-4 * spd(rng, layout.size) + 1e-4 * np.eye(layout.size)
    C = np.linalg.inv(np.linalg.inv(data) + 0.25 * np.eye(layout.size))
    answers = [
        Message(t, Gaussian(C @ np.linalg.solve(data, np.full(layout.size, 0.3)), C)) for t in (2.0, 90.0)
    ]
    walk = np.zeros(layout.size)
    walk[:6] = [2e-3] * 3 + [5e-5] * 3
    if upper:
        walk[-6:] = walk[:6]
    assert (walk[:6] == SLOW_WALK).all()
    wide = np.linalg.inv(data + np.diag(walk**2) * 88.0)
    total = np.linalg.inv(wide + 0.25 * np.eye(layout.size))
    priors = Priors(layout, prior, np.ones(6))
    found = list(leave_one_out_priors(answers, priors))
    assert len(found) == 2
    for each in found:
        assert each.layout is layout and each.bias_walk is priors.bias_walk
        np.testing.assert_allclose(each.shared.covariance, total, rtol=1e-6, atol=1e-10)
        np.testing.assert_allclose(each.shared.mean, total @ wide @ np.full(layout.size, 0.3), rtol=1e-6)


def test_the_nearest_matrix_without_negative_eigenvalues() -> None:
    rng = np.random.default_rng(5)
    axes, _ = np.linalg.qr(rng.normal(size=(2, 3, 3)))
    values = np.array([[2.0, -1.0, 0.5], [-3.0, 4.0, -0.1]])
    matrix = (axes * values[:, None]) @ np.swapaxes(axes, 1, 2)
    uneven = matrix + np.array([[0, 1e-3, 0], [-1e-3, 0, 0], [0, 0, 0]])  # only its even part counts
    expected = (axes * np.maximum(values, 0)[:, None]) @ np.swapaxes(axes, 1, 2)
    np.testing.assert_allclose(_positive(uneven), expected, atol=1e-12)


def test_informations_add_up() -> None:
    stack = _Information(np.array([np.eye(2), 3 * np.eye(2)]), np.array([[1.0, 2.0], [3.0, 6.0]]))
    assert len(stack) == 2
    both = stack[0] + stack[1]
    np.testing.assert_array_equal(both.matrix, stack.sum().matrix)
    np.testing.assert_array_equal(both.vector, stack.sum().vector)
    np.testing.assert_allclose(both.gaussian().mean, [1.0, 2.0])
    np.testing.assert_allclose(both.gaussian().covariance, np.eye(2) / 4)
