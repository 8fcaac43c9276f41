"""The linear Kalman filter and the Rauch-Tung-Striebel smoother, for the baselines that stand on them.

Measurements come in their information form, so that a step takes any number of them at one price.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..array_types import FloatArray


@dataclass(frozen=True)
class Chain:
    """A Gauss-Markov chain of n states of dimension d, and what was measured of it.

    x[k + 1] = F[k] x[k] + drift[k] + w, w ~ N(0, Q[k]); measurements z = H x + N(0, R) of state k enter
    as sums of H' R^-1 H and H' R^-1 z. States are (..., d, c): the c columns share all covariances
    (the axes of one motion), the leading axes have their own.

    Attributes
    ----------
    F, Q : ndarray, shape (n - 1, ..., d, d)
        Transitions and covariances of the process noise.
    drift : ndarray, shape (n - 1, ..., d, c) or what broadcasts to it
    information : ndarray, shape (n, ..., d, d)
        Sum of H' R^-1 H; zero where nothing was measured.
    vector : ndarray, shape (n, ..., d, c)
        Sum of H' R^-1 z.
    mean : ndarray, shape (..., d, c)
        Of the first state before it is measured.
    covariance : ndarray, shape (..., d, d)
        Likewise.
    """

    F: FloatArray
    Q: FloatArray
    drift: FloatArray
    information: FloatArray
    vector: FloatArray
    mean: FloatArray
    covariance: FloatArray


@dataclass(frozen=True)
class FilterEstimates:
    """What is known of a chain's states.

    Attributes
    ----------
    mean : ndarray, shape (n, ..., d, c)
    covariance : ndarray, shape (n, ..., d, d)
    """

    mean: FloatArray
    covariance: FloatArray


def constant_acceleration(dt: FloatArray) -> FloatArray:
    """Transitions (k, 3, 3) of position, velocity and acceleration over times (k,) s."""
    F = np.tile(np.eye(3), (len(dt), 1, 1))
    F[:, 0, 1] = F[:, 1, 2] = dt
    F[:, 0, 2] = 0.5 * dt**2
    return F


def kalman_filter(chain: Chain) -> tuple[FilterEstimates, FilterEstimates]:
    """Each state from the measurements so far (Kalman, J. Basic Engineering 82:35-45, 1960).

    Parameters
    ----------
    chain : Chain

    Returns
    -------
    filtered : Estimates
        With the state's own measurements.
    predicted : Estimates
        Without them.
    """
    n, size = len(chain.information), chain.covariance.shape[-1]
    shape = np.broadcast_shapes(chain.mean.shape[:-2], chain.information.shape[1:-2])
    columns = chain.mean.shape[-1]
    mean, covariance = np.empty((n, *shape, size, columns)), np.empty((n, *shape, size, size))
    mean_before, covariance_before = np.empty_like(mean), np.empty_like(covariance)
    measured = np.abs(chain.information.reshape(n, -1)).max(axis=1) > 0.0
    identity = np.eye(size)
    x = np.broadcast_to(chain.mean, mean.shape[1:])
    P = np.broadcast_to(chain.covariance, covariance.shape[1:])
    F_turned = np.swapaxes(chain.F, -1, -2)
    for k in range(n):
        if k:
            x = chain.F[k - 1] @ x + chain.drift[k - 1]
            P = chain.F[k - 1] @ P @ F_turned[k - 1] + chain.Q[k - 1]
        mean_before[k], covariance_before[k] = x, P
        if measured[k]:
            A = chain.information[k]
            P = np.linalg.solve(identity + P @ A, P)  # (P^-1 + A)^-1
            P = 0.5 * (P + np.swapaxes(P, -1, -2))
            x = x + P @ (chain.vector[k] - A @ x)
        mean[k], covariance[k] = x, P
    return FilterEstimates(mean, covariance), FilterEstimates(mean_before, covariance_before)


def rts_smoother(chain: Chain) -> FilterEstimates:
    """Each state from all measurements (Rauch, Tung and Striebel, AIAA Journal 3:1445-1450, 1965).

    Parameters
    ----------
    chain : Chain

    Returns
    -------
    smoothed : Estimates
    """
    filtered, predicted = kalman_filter(chain)
    mean, covariance = filtered.mean.copy(), filtered.covariance.copy()
    for k in range(len(mean) - 2, -1, -1):
        back = np.linalg.solve(predicted.covariance[k + 1], chain.F[k] @ covariance[k])
        gain = np.swapaxes(back, -1, -2)
        mean[k] += gain @ (mean[k + 1] - predicted.mean[k + 1])
        covariance[k] += gain @ (covariance[k + 1] - predicted.covariance[k + 1]) @ back
    return FilterEstimates(mean, covariance)
