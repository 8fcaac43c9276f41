"""Camera from base IMU and the mounting of the panel's IMU, by least squares over all poses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from smoother.array_types import FloatArray

from .chain import BIAS_M_S2, Attitudes, Problem, WorldPose

_ROUNDS = 60
#: A gain smaller than this share of the sum of squares ends the iteration.
_SMALL = 1e-8


@dataclass(frozen=True)
class WorldSolution:
    """Attitudes and how well they are known.

    Attributes
    ----------
    at : Attitudes
        The solution.
    covariance : ndarray, shape (9, 9)
        Of `R_K_B` in {K} (rad), the base accelerometer's bias (m/s^2), `R_P_I` in {I} (rad).
    camera_rad : ndarray, shape (n, 3), rad
        What is left of `R_K_P`, in {K}.
    worst_sigma : ndarray, shape (n,)
        The largest misfit of a pose in sigmas.
    cost : float
        Sum of squares of all misfits.
    """

    at: Attitudes
    covariance: FloatArray
    camera_rad: FloatArray
    worst_sigma: FloatArray
    cost: float


def solve(
    poses: list[WorldPose],
    start: Attitudes,
    mounting_sigma_rad: float | None,
    bias_m_s2: float = BIAS_M_S2,
) -> WorldSolution:
    """Solve the chain over all poses, by Gauss and Newton with Levenberg's damping.

    Parameters
    ----------
    start : Attitudes
        See `first_guesses`.
    mounting_sigma_rad : float, rad, optional
        How far `R_P_I` may lie from no rotation at all: the IMU was lined up with the panel by eye. None
        where the poses alone decide.
    bias_m_s2 : float, m/s^2
        Sigma of the accelerometers' biases, an axis.

    Returns
    -------
    WorldSolution
    """
    problem = Problem(poses, start, mounting_sigma_rad, bias_m_s2)
    at, damping = start, 1e-6
    misfit, jacobian = problem.linearise(at)
    for _ in range(_ROUNDS):
        normal = jacobian.T @ jacobian
        step = -np.linalg.solve(normal + damping * np.diag(np.diag(normal)), jacobian.T @ misfit)
        trial = at.moved(np.asarray(step, dtype=np.float64))
        tried, slope = problem.linearise(trial)
        gain = float(misfit @ misfit - tried @ tried)
        if gain >= 0:
            at, misfit, jacobian, damping = trial, tried, slope, damping / 10
            if gain < _SMALL * (1 + tried @ tried):
                break
        else:
            damping = max(damping, 1e-8) * 10
    covariance = np.linalg.inv(jacobian.T @ jacobian) * problem.spread(misfit)
    bias = 6 + 6 * len(poses)
    kept = np.r_[0:3, bias : bias + 3, 3:6]
    by_pose = np.linalg.norm(misfit[: 9 * len(poses)].reshape(len(poses), 3, 3), axis=2)
    left, cost = problem.camera_left(at), float(misfit @ misfit)
    return WorldSolution(at, covariance[np.ix_(kept, kept)], left, by_pose.max(axis=1), cost)
