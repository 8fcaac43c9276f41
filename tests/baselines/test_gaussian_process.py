"""The baseline `gaussian-process`: the textbook's conditional on a grid, Feng's reach, lag, gaps and ends."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import multivariate_normal
from simulated_scenes import arm, scene_of

from smoother.array_types import FloatArray
from smoother.baselines.gaussian_process import (
    Posterior,
    borders,
    gaussian_process,
    log_likelihood,
    predict,
)
from smoother.evaluation.metrics import lag_s
from smoother.measurements.position_process import (
    PUBLISHED,
    STEP_S,
    Kernel,
    Measurements,
    joint_covariance,
)


def on_a_grid(seed: int) -> tuple[FloatArray, FloatArray, FloatArray, Measurements]:
    """A 90 Hz grid, K_p and K_a (4.17, 4.13) as matrices on it, and measurements at its times."""
    rng = np.random.default_rng(seed)
    grid = np.arange(60) * STEP_S
    K_p = np.eye(60)[4:50:3]
    K_a = (np.eye(60)[:-2] - 2.0 * np.eye(60)[1:-1] + np.eye(60)[2:])[::2] / STEP_S**2
    seen = Measurements(
        grid[4:50:3], 0.1 * rng.normal(size=(len(K_p), 2)), grid[1:-1:2], rng.normal(size=(len(K_a), 2))
    )
    return grid, K_p, K_a, seen


def dense(kernel: Kernel, grid: FloatArray) -> FloatArray:
    return np.array([[kernel.variance * np.exp(-kernel.rate * (a - b) ** 2) for b in grid] for a in grid])


@pytest.mark.parametrize("kernel", [PUBLISHED, Kernel(0.01, 20.0, 0.003, 0.4)])
def test_conditional_is_the_dense_one(kernel: Kernel):
    grid, K_p, K_a, seen = on_a_grid(0)
    Sigma, K = dense(kernel, grid), np.vstack([K_p, K_a])
    noise = np.diag([kernel.position_sigma**2] * len(K_p) + [kernel.acceleration_sigma**2] * len(K_a))
    C = K @ Sigma @ K.T + noise
    np.testing.assert_allclose(joint_covariance(kernel, seen.frame_t, seen.acc_t), C, rtol=1e-6, atol=1e-7)
    gain = Sigma @ K.T @ np.linalg.inv(C)  # 4.24
    mean, covariance = gain @ seen.targets, Sigma - gain @ K @ Sigma  # 4.23 with the noise
    posterior = Posterior(kernel, seen)
    np.testing.assert_allclose(posterior.position(grid), mean, rtol=1e-6, atol=1e-8)
    np.testing.assert_allclose(posterior.variance(grid), np.diag(covariance), rtol=1e-5, atol=1e-9)
    # K_v (4.12) between the grid's times
    between = posterior.velocity(grid[:-1] + 0.5 * STEP_S)
    np.testing.assert_allclose(between, np.diff(mean, axis=0) / STEP_S, rtol=1e-5, atol=1e-6)
    density = multivariate_normal(np.zeros(len(C)), C, allow_singular=False)
    expected = sum(density.logpdf(column) for column in seen.targets.T)
    assert log_likelihood(kernel, seen) == pytest.approx(expected, rel=1e-6)


def reach(seed: int, seconds: float = 1.0) -> tuple[FloatArray, FloatArray, Measurements]:
    """Feng 4.5: a hand moves 20 cm within 2 s; camera 30 Hz, 8 mm; accelerations 90 Hz, 0.1 m/s^2."""
    rng = np.random.default_rng(seed)
    t = np.arange(180) / 90.0

    def path(s: FloatArray) -> FloatArray:
        u = np.clip((s - 1.0 + 0.5 * seconds) / seconds, 0.0, 1.0)
        return 0.2 * (10 * u**3 - 15 * u**4 + 6 * u**5)

    h = 1e-3
    acc = (path(t + h) - 2 * path(t) + path(t - h)) / h**2 + 0.1 * rng.normal(size=len(t))
    frames = t[::3]
    point = path(frames) + 0.008 * rng.normal(size=len(frames))
    return t, path(t), Measurements(frames, point[:, None], t, acc[:, None])


@pytest.mark.slow
def test_fused_prediction_beats_position_only_and_takes_the_cameras_lag_away_as_published():
    """Table 4.1, frames 0.1 s late: -35.8 % rms, -59.7 % stated sigma, lag -0.11 s; here over 12 reaches."""
    squares, sigmas, lags = np.zeros(2), np.zeros(2), []
    for seed in range(12):
        t, path, seen = reach(seed)
        alone = replace(seen, acc_t=np.zeros(0), acceleration=np.zeros((0, 1)))
        for k, measured in enumerate((alone, seen)):
            mean, sigma = predict(PUBLISHED, measured, t)
            known = np.isfinite(sigma)
            assert not known[t < 0.099].any() and known[t > 0.101].all()
            squares[k] += np.sum((mean[known, 0] - path[known]) ** 2)
            sigmas[k] += np.mean(sigma[t > 0.5])
        shown = np.interp(t - 0.1, seen.frame_t, seen.position[:, 0])[:, None]
        lags.append([lag_s(t[known], each[known], path[known, None]) for each in (shown, mean)])
    assert 1.0 - np.sqrt(squares[1] / squares[0]) > 0.35 and 1.0 - sigmas[1] / sigmas[0] > 0.55
    np.testing.assert_allclose(np.mean(lags, axis=0), [0.1, 0.0], atol=0.011)  # a sample


def test_windows_cover_everything_once_and_leave_gaps_whole():
    made = arm("white", 4, duration_s=40.0)
    scene = scene_of(made)
    edges = borders(scene)
    assert edges[0] == scene.t[0] and edges[-1] == scene.t[-1]
    assert (np.diff(edges) > 0).all() and np.diff(edges).max() <= 20.0
    for edge in edges[1:-1]:
        assert not any(gap.start_s < edge < gap.end_s for gap in scene.gaps)
    # neighbouring windows agree where they meet: the prior forgets within the margins
    path = gaussian_process(scene, PUBLISHED)
    row = np.searchsorted(scene.t, edges[1:-1])
    step = np.linalg.norm(np.diff(path.position, axis=0), axis=1)
    expected = np.linalg.norm(path.velocity[row], axis=1) * np.diff(scene.t)[row - 1]
    np.testing.assert_allclose(step[row - 1], expected, atol=0.002)
