"""The Kalman filter and the smoother against one weighted least-squares problem over all states."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from smoother.baselines.kalman import Chain, kalman_filter, rts_smoother


def a_chain(seed: int, n: int = 9, d: int = 3, columns: int = 2, lead: tuple[int, ...] = ()) -> Chain:
    """A random chain; every third state is not measured."""
    rng = np.random.default_rng(seed)

    def spd(*shape: int) -> np.ndarray:
        half = rng.normal(size=(*shape, d, d))
        return half @ np.swapaxes(half, -1, -2) + 0.1 * np.eye(d)

    H = rng.normal(size=(n, *lead, 2, d))
    R = rng.uniform(0.1, 1.0, (n, *lead, 2))
    z = rng.normal(size=(n, *lead, 2, columns))
    H[::3] = 0.0
    weighted = np.swapaxes(H, -1, -2) / R[..., None, :]
    return Chain(
        F=np.eye(d) + 0.3 * rng.normal(size=(n - 1, *lead, d, d)),
        Q=spd(n - 1, *lead),
        drift=rng.normal(size=(n - 1, *lead, d, columns)),
        information=weighted @ H,
        vector=weighted @ z,
        mean=rng.normal(size=(*lead, d, columns)),
        covariance=spd(*lead),
    )


def batch(chain: Chain, used: int) -> tuple[np.ndarray, np.ndarray]:
    """Normal equations of all states at once, measurements of the first `used` states only."""
    n, d = len(chain.information), chain.covariance.shape[-1]
    A, b = np.zeros((n * d, n * d)), np.zeros((n * d, chain.mean.shape[-1]))
    first = np.linalg.inv(chain.covariance)
    A[:d, :d] += first
    b[:d] += first @ chain.mean
    for k in range(n):
        here = slice(k * d, (k + 1) * d)
        if k < used:
            A[here, here] += chain.information[k]
            b[here] += chain.vector[k]
        if k + 1 < n:
            both = slice(k * d, (k + 2) * d)
            J = np.hstack([-chain.F[k], np.eye(d)])
            W = np.linalg.inv(chain.Q[k])
            A[both, both] += J.T @ W @ J
            b[both] += J.T @ W @ chain.drift[k]
    covariance = np.linalg.inv(A)
    mean = (covariance @ b).reshape(n, d, -1)
    blocks = np.array([covariance[k * d : (k + 1) * d, k * d : (k + 1) * d] for k in range(n)])
    return mean, blocks


@pytest.mark.parametrize("seed", range(5))
def test_smoother_is_least_squares_over_all_states(seed: int):
    chain = a_chain(seed)
    smoothed = rts_smoother(chain)
    mean, covariance = batch(chain, used=len(chain.information))
    np.testing.assert_allclose(smoothed.mean, mean, rtol=1e-8, atol=1e-8)
    np.testing.assert_allclose(smoothed.covariance, covariance, rtol=1e-8, atol=1e-8)


@pytest.mark.parametrize("seed", range(3))
def test_filter_is_least_squares_over_what_was_seen_so_far(seed: int):
    chain = a_chain(seed)
    filtered, predicted = kalman_filter(chain)
    for k in range(len(chain.information)):
        for estimates, used in ((predicted, k), (filtered, k + 1)):
            mean, covariance = batch(chain, used)
            np.testing.assert_allclose(estimates.mean[k], mean[k], rtol=1e-8, atol=1e-8)
            np.testing.assert_allclose(estimates.covariance[k], covariance[k], rtol=1e-8, atol=1e-8)


def test_leading_axes_are_chains_of_their_own():
    together = a_chain(3, lead=(2,))
    smoothed = rts_smoother(together)
    for k in range(2):
        alone = rts_smoother(
            replace(
                together,
                **{
                    name: getattr(together, name)[:, k]
                    for name in ("F", "Q", "drift", "information", "vector")
                },
                mean=together.mean[k],
                covariance=together.covariance[k],
            )
        )
        np.testing.assert_allclose(smoothed.mean[:, k], alone.mean, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(smoothed.covariance[:, k], alone.covariance, rtol=1e-9, atol=1e-9)
