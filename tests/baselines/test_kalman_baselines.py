"""Kalman filters: against least squares over all states, published figures, order, gaps and ends."""

from __future__ import annotations

import numpy as np
import pytest

from smoother.array_types import FloatArray
from smoother.baselines.kalman import (
    FENG_SIGMAS,
    Chain,
    Events,
    deviations_at_rest,
    kalman_filter,
    merge,
    rts_smoother,
    state_model,
)
from smoother.baselines.kalman import multirate_model as wiener_model


def plain_filter(
    t: FloatArray, camera: FloatArray, acc: FloatArray, sigma_m: float, sigma_acc: float
) -> tuple[FloatArray, FloatArray]:
    """Equations 10-15 of Le for one axis, as they are written; infinite R by leaving the row out."""
    x, P = np.array([camera[np.isfinite(camera)][0], 0.0, 0.0]), np.eye(3)
    states, covariances = [], []
    for k in range(len(t)):
        if k:
            h = t[k] - t[k - 1]
            F = np.array([[1, h, 0.5 * h * h], [0, 1, h], [0, 0, 1]])
            Q = np.array(
                [
                    [0.25 * h**4, 0.5 * h**3, 0.5 * h**2],
                    [0.5 * h**3, h**2, h],
                    [0.5 * h**2, h, 1.0],
                ]
            )
            x, P = F @ x, F @ P @ F.T + Q * sigma_acc**2
        seen = np.isfinite(camera[k])
        H = np.array([[1.0, 0, 0], [0, 0, 1.0]])[0 if seen else 1 :]
        R = np.diag([sigma_m**2, sigma_acc**2])[0 if seen else 1 :, 0 if seen else 1 :]
        z = np.array([camera[k], acc[k]])[0 if seen else 1 :]
        K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
        x, P = x + K @ (z - H @ x), (np.eye(3) - K @ H) @ P
        states.append(x)
        covariances.append(P)
    return np.array(states), np.array(covariances)


def test_kalman_is_the_published_recursion():
    rng = np.random.default_rng(1)
    t = np.cumsum(rng.uniform(0.004, 0.006, 300))
    acc = rng.normal(size=(300, 3))
    camera = np.where(np.arange(300)[:, None] % 7 == 0, rng.normal(size=(300, 3)), np.nan)
    sigma_m, sigma_acc = np.array([0.01, 0.02, 0.03]), np.array([0.3, 0.2, 0.1])
    fast, _ = kalman_filter(state_model(t, camera, acc, sigma_m, sigma_acc))
    for axis in range(3):
        states, covariances = plain_filter(t, camera[:, axis], acc[:, axis], sigma_m[axis], sigma_acc[axis])
        np.testing.assert_allclose(fast.mean[:, axis, :, 0], states, rtol=1e-7, atol=1e-9)
        np.testing.assert_allclose(fast.covariance[:, axis], covariances, rtol=1e-6, atol=1e-12)


def test_deviations_come_from_the_samples_at_rest():
    rng = np.random.default_rng(2)
    acc = 0.02 * rng.normal(size=(2000, 3))
    camera = 1.0 + 0.004 * rng.normal(size=(2000, 3))
    moving = slice(0, 1200)
    acc[moving] += np.sin(np.arange(1200) / 20.0)[:, None]
    camera[moving] += np.sin(np.arange(1200) / 20.0)[:, None]
    sigma_m, sigma_acc = deviations_at_rest(camera, acc, 0.05)
    # 200 samples give a standard deviation to 5 %, one sigma
    np.testing.assert_allclose(sigma_m, 0.004, rtol=0.2)
    np.testing.assert_allclose(sigma_acc, 0.02, rtol=0.2)


def feng_move(seed: int) -> tuple[Events, Events, FloatArray]:
    """A hand at rest, moved 30 cm and at rest again within 5 s: both rates, and positions alone (SI)."""
    rng = np.random.default_rng(seed)
    t = np.arange(450) / 90.0

    def path(s: FloatArray) -> FloatArray:
        u = np.clip((s - 2.0) / 1.0, 0.0, 1.0)
        return 0.3 * (10 * u**3 - 15 * u**4 + 6 * u**5)

    h = 1e-4
    acc = (path(t + h) - 2 * path(t) + path(t - h)) / h**2
    acc = np.tile((acc + 0.05 * rng.normal(size=450))[:, None], 3)
    frames = t[::3]
    point = np.tile((path(frames) + 0.008 * rng.normal(size=len(frames)))[:, None], 3)
    nothing = np.zeros((0, 3))
    single = merge(frames, point, np.zeros(0), nothing)
    return merge(frames, point, t, acc), single, np.abs(np.gradient(path(t), t))


def test_multirate_states_smaller_sigmas_as_published():
    """3.18 to 2.08 mm and 12.26 to 4.52 mm/s in the thesis (-34.6 %, -63.1 %).

    With its settings, converged: 3.47 mm and 13.5 mm/s single-rate; at two rates between 1.6 mm and
    1.4 mm/s (still) and 2.8 mm and 7.3 mm/s (moving), so that the mean depends on how long the hand moved.
    """
    both, single, speed = feng_move(0)
    one, _ = kalman_filter(wiener_model(single, np.zeros(len(single.t), dtype=bool), FENG_SIGMAS, 2000e-6))
    moving = np.interp(both.t, np.arange(450) / 90.0, speed) > 0.150
    two, _ = kalman_filter(wiener_model(both, moving, FENG_SIGMAS, 2000e-6))
    # the single-rate filter's sigma is constant once it has converged
    late_one, late_two = single.t > 3.0, (both.t > 0.5) & np.isfinite(both.acceleration[:, 0])
    sigma_one = 1000.0 * np.sqrt(np.einsum("naii->ni", one.covariance[late_one]) / 3.0).mean(axis=0)
    sigma_two = 1000.0 * np.sqrt(np.einsum("naii->ni", two.covariance[late_two]) / 3.0).mean(axis=0)
    assert sigma_one[:2] == pytest.approx([3.18, 12.26], rel=0.15)
    assert sigma_two[0] == pytest.approx(2.08, rel=0.15)
    # the share of time at rest, which the thesis does not give, moves this by some hundredths
    assert 1.0 - sigma_two[0] / sigma_one[0] == pytest.approx(0.346, abs=0.05)
    assert 1.0 - sigma_two[1] / sigma_one[1] > 0.631


def a_chain(seed: int, n: int = 9, d: int = 3, columns: int = 2) -> Chain:
    """A random chain; every third state is not measured."""
    rng = np.random.default_rng(seed)
    half, H, R = rng.normal(size=(n, d, d)), rng.normal(size=(n, 2, d)), rng.uniform(0.1, 1.0, (n, 2))
    H[::3] = 0.0
    spd = half @ np.swapaxes(half, 1, 2) + 0.1 * np.eye(d)
    weighted = np.swapaxes(H, 1, 2) / R[:, None, :]
    return Chain(
        F=np.eye(d) + 0.3 * rng.normal(size=(n - 1, d, d)),
        Q=spd[1:],
        drift=rng.normal(size=(n - 1, d, columns)),
        information=weighted @ H,
        vector=weighted @ rng.normal(size=(n, 2, columns)),
        mean=rng.normal(size=(d, columns)),
        covariance=spd[0],
    )


def batch(chain: Chain) -> tuple[np.ndarray, np.ndarray]:
    """Normal equations of all states at once."""
    n, d = len(chain.information), chain.covariance.shape[-1]
    first = np.linalg.inv(chain.covariance)
    A, b = np.zeros((n * d, n * d)), np.zeros((n * d, chain.mean.shape[-1]))
    A[:d, :d], b[:d] = first, first @ chain.mean
    for k in range(n):
        here, both = slice(k * d, (k + 1) * d), slice(k * d, (k + 2) * d)
        A[here, here] += chain.information[k]
        b[here] += chain.vector[k]
        if k + 1 < n:
            J, W = np.hstack([-chain.F[k], np.eye(d)]), np.linalg.inv(chain.Q[k])
            A[both, both] += J.T @ W @ J
            b[both] += J.T @ W @ chain.drift[k]
    covariance = np.linalg.inv(A)
    blocks = np.array([covariance[k * d : (k + 1) * d, k * d : (k + 1) * d] for k in range(n)])
    return (covariance @ b).reshape(n, d, -1), blocks


@pytest.mark.parametrize("seed", range(3))
def test_smoother_is_least_squares_over_all_states(seed: int):
    chain = a_chain(seed)
    smoothed = rts_smoother(chain)
    mean, covariance = batch(chain)
    np.testing.assert_allclose(smoothed.mean, mean, rtol=1e-8, atol=1e-8)
    np.testing.assert_allclose(smoothed.covariance, covariance, rtol=1e-8, atol=1e-8)
