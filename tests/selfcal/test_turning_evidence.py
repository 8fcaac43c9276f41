"""The evidence of every offset against a slow, plain search; and what it leaves out."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from smoother.array_types import FloatArray
from smoother.filters import gaussian_smoothed
from smoother.selfcal.turning_evidence import CameraTurning, ImuTurning, correlation, turning_evidence


def turning(seed: int, n: int) -> tuple[FloatArray, FloatArray]:
    """Derivatives of a smooth attitude (n, 3, 3), and a rotation that is constant."""
    rng = np.random.default_rng(seed)
    angles = 4.0 * gaussian_smoothed(rng.normal(size=(n, 3)), 8.0)
    matrix = Rotation.from_rotvec(angles).as_matrix().reshape(n, 9)
    rate = gaussian_smoothed(matrix, 3.0, derivative=True) * 25.0
    return rate.reshape(n, 3, 3), Rotation.random(random_state=seed).as_matrix()


def camera_of(rate: FloatArray, known: FloatArray | None = None) -> CameraTurning:
    seen = np.ones(len(rate), bool) if known is None else known
    return CameraTurning(0, np.where(seen[:, None], rate, 0.0), seen, np.zeros(len(rate)))


def slow_power(camera: CameraTurning, Y: FloatArray, lag: int) -> float:
    """The largest explained power at one offset by a general optimiser from many starts."""
    rows = np.flatnonzero(camera.known)
    rows = rows[(rows + lag >= 0) & (rows + lag < len(Y))]
    x, weight, Ys = camera.rate[rows], camera.weight[rows], Y[rows + lag]

    def left(p: FloatArray) -> float:
        a = p[3:] / np.linalg.norm(p[3:])
        residual = x - Ys @ a @ Rotation.from_rotvec(p[:3]).as_matrix().T
        return float(weight @ (residual**2).sum(axis=1))

    rng, best = np.random.default_rng(0), np.inf
    for _ in range(12):
        start = np.append(Rotation.random(random_state=rng.integers(2**31)).as_rotvec(), rng.normal(size=3))
        best = min(best, minimize(left, start).fun)
    return float(weight @ (x**2).sum(axis=1)) - best


def test_the_power_explained_is_that_of_a_slow_search() -> None:
    Y, Q = turning(3, 220)
    rng = np.random.default_rng(3)
    x = Y[40:160] @ np.array([0.9, 0.3, -0.3]) @ Q.T + rng.normal(0, 0.3, (120, 3))
    camera = camera_of(x, np.arange(120) % 50 < 40)
    curve = turning_evidence(camera, [ImuTurning(0, Y)], None)
    assert curve.first + int(curve.evidence.argmax()) == 40
    row = 40 - curve.first
    share = -np.expm1(-curve.evidence[row] / curve.freedom)
    # the alternation stops after a few rounds: a per mille below the optimum
    assert share == pytest.approx(slow_power(camera, Y, 40) / camera.power, rel=2e-3)


def test_a_perfect_pair_and_a_known_down() -> None:
    Y, _ = turning(5, 300)
    up = np.array([0.0, 1.0, 0.0])
    Q = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])  # turns z up into y up
    camera = camera_of(Y[25:275] @ np.array([0.6, 0.0, 0.8]) @ Q.T)
    free, upright = (turning_evidence(camera, [ImuTurning(0, Y)], each) for each in (None, up))
    for curve in (free, upright):
        assert curve.first + int(curve.evidence.argmax()) == 25
        assert -np.expm1(-curve.evidence.max() / curve.freedom) > 0.99
    wrong = turning_evidence(camera, [ImuTurning(0, Y)], -up)
    assert wrong.evidence.max() < 0.7 * upright.evidence.max()


def test_what_lies_outside_the_overlap_is_unexplained() -> None:
    """Half of the camera's motion is there for the IMU: no more than about half is explained."""
    Y, Q = turning(7, 500)
    camera = camera_of(Y @ np.array([0.0, 0.0, 1.0]) @ Q.T)
    curve = turning_evidence(camera, [ImuTurning(250, Y[250:])], None)
    half = float(camera.weight[250:] @ (camera.rate[250:] ** 2).sum(axis=1)) / camera.power
    assert -np.expm1(-curve.evidence.max() / curve.freedom) == pytest.approx(half, abs=0.02)


def test_runs_add() -> None:
    """An IMU that paused: both parts explain, each with a heading of its own."""
    Y, Q = turning(9, 500)
    camera = camera_of(Y @ np.array([0.0, 0.0, 1.0]) @ Q.T)
    turn = Rotation.from_euler("z", 50, degrees=True).as_matrix()
    runs = [ImuTurning(0, Y[:240]), ImuTurning(260, turn @ Y[260:])]
    both = turning_evidence(camera, runs, None)
    assert both.first + int(both.evidence.argmax()) == 0
    assert -np.expm1(-both.evidence.max() / both.freedom) > 0.9


def test_correlation_is_the_sum() -> None:
    rng = np.random.default_rng(0)
    x, y = rng.normal(size=(7, 2)), rng.normal(size=(11, 3))
    found = correlation(x, y)
    for k, lag in enumerate(range(-6, 11)):
        rows = [t for t in range(7) if 0 <= t + lag < 11]
        expected = sum((np.outer(x[t], y[t + lag]) for t in rows), np.zeros((2, 3)))
        np.testing.assert_allclose(found[k], expected, atol=1e-12)
