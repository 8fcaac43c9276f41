"""What all windows but one say, spread between windows, and the random numbers of draws."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from smoother.array_types import FloatArray
from smoother.window.draw_plan import DrawPlan, samples_apart
from smoother.window.pooling import (
    SLOW_WALK,
    _between_window_variance,
    _Information,
    leave_one_out,
    leave_one_out_priors,
    pooled,
)
from smoother.window.problem import Priors
from smoother.window.shared import Gaussian, SharedLayout, axes_across
from smoother.window.solution import Message


def spd(rng: np.random.Generator, size: int, scale: float = 1.0) -> FloatArray:
    A = rng.normal(size=(size, size + 2))
    return np.asarray(scale * A @ A.T / size)


def posterior(prior: Gaussian, mean: FloatArray, covariance: FloatArray) -> Gaussian:
    """A window's answer: its own data (mean, covariance) together with the prior."""
    before, data = np.linalg.inv(prior.covariance), np.linalg.inv(covariance)
    C = np.linalg.inv(before + data)
    return Gaussian(C @ (before @ prior.mean + data @ mean), C)


def dense_others(
    prior: Gaussian, data: list[Gaussian], t: FloatArray, walk: FloatArray, k: int
) -> tuple[FloatArray, FloatArray]:
    """Leave-one-out by the joint Gaussian of the quantity at all windows' times.

    The prior holds for the quantity at window k; from there it wanders (two-sided random walk), so the
    deviations at two times on one side share the walk up to the nearer.
    """
    size, others = len(prior.mean), [j for j in range(len(t)) if j != k]
    step = t[others] - t[k]
    nearer = np.minimum(np.abs(step)[:, None], np.abs(step))
    shared = np.where(np.sign(step)[:, None] == np.sign(step), nearer, 0.0)
    wander = np.kron(shared, np.diag(walk**2))
    noise = np.zeros_like(wander)
    for row, j in enumerate(others):
        block = slice(row * size, (row + 1) * size)
        noise[block, block] = data[j].covariance
    if not others:
        return prior.mean, prior.covariance
    H = np.tile(np.eye(size), (len(others), 1))
    S = H @ prior.covariance @ H.T + wander + noise
    gain = prior.covariance @ H.T @ np.linalg.inv(S)
    mean = np.concatenate([data[j].mean for j in others])
    return prior.mean + gain @ (mean - H @ prior.mean), prior.covariance - gain @ H @ prior.covariance


@pytest.mark.parametrize("walk", [0.0, 0.3], ids=["constant", "wandering"])
@pytest.mark.parametrize("count", [1, 2])
def test_each_prior_is_the_first_one_and_the_others(count: int, walk: float) -> None:
    """One or two windows: no excess is estimated, so the answer is exact linear algebra."""
    rng = np.random.default_rng(count)
    prior = Gaussian(rng.normal(size=4), spd(rng, 4, 3.0))
    data = [Gaussian(rng.normal(size=4), spd(rng, 4)) for _ in range(count)]
    t, speed = np.array([1.0, 7.0])[:count], np.full(4, walk)
    others = list(leave_one_out([posterior(prior, d.mean, d.covariance) for d in data], prior, t, speed))
    for k in range(count):
        mean, covariance = dense_others(prior, data, t, speed, k)
        np.testing.assert_allclose(others[k].mean, mean, rtol=1e-8, atol=1e-10)
        np.testing.assert_allclose(others[k].covariance, covariance, rtol=1e-8, atol=1e-10)


@pytest.mark.parametrize("seed", range(3))
def test_many_windows_that_agree(seed: int) -> None:
    """Data that scatter less than they state have no excess: a chain of five against the dense Gaussian."""
    rng = np.random.default_rng(seed)
    prior = Gaussian(rng.normal(size=3), spd(rng, 3, 4.0))
    truth = rng.normal(size=3)
    data = [Gaussian(truth + 0.02 * rng.normal(size=3), spd(rng, 3) + 0.3 * np.eye(3)) for _ in range(5)]
    t, walk = np.array([0.0, 3.0, 9.0, 12.0, 30.0]), np.array([0.0, 0.1, 0.4])
    others = list(leave_one_out([posterior(prior, d.mean, d.covariance) for d in data], prior, t, walk))
    for k in range(5):
        mean, covariance = dense_others(prior, data, t, walk, k)
        np.testing.assert_allclose(others[k].mean, mean, rtol=1e-7, atol=1e-9)
        np.testing.assert_allclose(others[k].covariance, covariance, rtol=1e-7, atol=1e-9)


def test_excess_widens_every_prior() -> None:
    """Scalars that differ by far more than they state: mean and variance by the random-effects model."""
    prior = Gaussian(np.zeros(1), np.array([[1e6]]))
    x, variance = np.array([1.0, -1.0, 3.0, -2.0, 0.5]), np.full(5, 0.01)
    answers = [posterior(prior, x[k : k + 1], variance[k : k + 1, None]) for k in range(5)]
    (tau2,) = spread_by_hand(1.0 / variance[:, None, None], (x / variance)[:, None])
    assert tau2 > 3.0
    for k, others in enumerate(leave_one_out(answers, prior, np.arange(5.0), np.zeros(1))):
        rest = np.delete(x, k)
        assert others.mean[0] == pytest.approx(rest.mean(), abs=1e-4)
        # the mean of four, each its own variance and the spread, and the window's own deviation
        assert others.covariance[0, 0] == pytest.approx((0.01 + tau2) / 4 + tau2, rel=1e-4)


def test_axes_across_are_right_handed_with_down() -> None:
    rng = np.random.default_rng(2)
    for down in rng.normal(size=(20, 3)):
        axes, unit = axes_across(down), down / np.linalg.norm(down)
        np.testing.assert_allclose(np.vstack([axes, unit]) @ np.vstack([axes, unit]).T, np.eye(3), atol=1e-12)
        layout = SharedLayout((), False, axes)
        tilted = unit + 0.1 * axes[0] - 0.05 * axes[1]
        tilted /= np.linalg.norm(tilted)
        vector = np.concatenate([np.zeros(6), axes @ tilted])
        np.testing.assert_allclose(layout.down(vector), tilted, atol=1e-12)


LAYOUT = SharedLayout(("elbow", "wrist"), True, axes_across(np.array([0.0, -1.0, 0.0])), ("upper_arm",))


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


def covariance(size: int, seed: int) -> np.ndarray:
    root = np.random.default_rng(seed).normal(size=(size, size))
    unit = np.logspace(0, -4, size)  # metres beside rad/s
    return (root @ root.T + 0.1 * np.eye(size)) * unit * unit[:, None]


PLAN = DrawPlan(count=50, seed=3, arm="left/None", every=4, shared=covariance(5, 0))


def test_a_number_belongs_to_its_draw_its_time_and_its_name() -> None:
    t = np.array([0.1, 0.2, 7.3])
    numbers = PLAN.at_times("node", t, 6)
    assert numbers.shape == (50, 3, 6)
    np.testing.assert_array_equal(PLAN.at_times("node", t[1:] + 1e-9, 6), numbers[:, 1:])
    np.testing.assert_array_equal(replace(PLAN, count=7).at_times("node", t, 6), numbers[:7])
    others = [
        PLAN.at_times("bias", t, 6),
        PLAN.at_times("node", t + 1e-5, 6),
        replace(PLAN, seed=4).at_times("node", t, 6),
        replace(PLAN, arm="right/None").at_times("node", t, 6),
    ]
    for other in others:  # 900 numbers: the correlation of independent ones is 0.033
        assert abs(np.corrcoef(numbers.ravel(), other.ravel())[0, 1]) < 0.15
    assert abs(numbers.mean()) < 0.15 and abs(numbers.std() - 1.0) < 0.1


def test_what_windows_share_has_each_windows_own_covariance_and_is_nearly_the_same() -> None:
    many = replace(PLAN, count=40_000)
    own = covariance(5, 0) + 0.2 * covariance(5, 1)
    errors = many.shared_errors(own)
    scale = np.sqrt(np.diag(own))
    # 40,000 draws: a correlation is known to 0.005
    np.testing.assert_allclose(
        np.cov(errors.T) / scale / scale[:, None], own / scale / scale[:, None], atol=0.03
    )
    pooled = many.shared_errors(many.shared)
    for axis in range(5):
        assert np.corrcoef(errors[:, axis], pooled[:, axis])[0, 1] > 0.9


@pytest.mark.parametrize(("rate", "every"), [(100.0, 4), (25.0, 1), (60.0, 2), (1000.0, 40), (10.0, 1)])
def test_drawn_times_are_25_a_second_or_more(rate: float, every: int) -> None:
    assert samples_apart(np.arange(300) / rate) == every
    assert samples_apart(np.arange(500_000) / rate) == every


def test_one_sample_has_a_drawn_time() -> None:
    assert samples_apart(np.zeros(1)) == 1
