"""Baselines with a model of motion: exact where linear, published recursions, on simulated arms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import multivariate_normal
from simulated_scenes import NO_GAPS, arm, errors, rms, scene_of, turned_off

from smoother.array_types import FloatArray
from smoother.baselines import rts as es
from smoother.baselines.gaussian_process import (
    Posterior,
    borders,
    gaussian_process,
    log_likelihood,
    predict,
)
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
from smoother.baselines.rts import linearised, residuals, rts, start, ukf
from smoother.baselines.scene import Baseline
from smoother.evaluation.metrics import lag_s
from smoother.measurements.inertial import InertialSignal
from smoother.measurements.position_process import (
    PUBLISHED,
    STEP_S,
    Kernel,
    Measurements,
    joint_covariance,
)
from smoother.recording import JOINTS


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


def states_of_an_arm(seed: int, rng: np.random.Generator) -> tuple[es.InertialTrajectory, InertialSignal]:
    """Ten nodes of a moving arm, their states off by a little, gravity and biases not zero."""
    scene = scene_of(arm("white", seed, occlusion_lengths_s=NO_GAPS, duration_s=5.0))
    states, _ = start(scene, es.levers_of(scene))
    part = slice(60, 70)
    near = es.InertialTrajectory(states.t[part], states.R[part], states.x[part])
    return near.moved(0.02 * rng.normal(size=(10, es.SIZE))), InertialSignal(scene.imu)


@pytest.mark.parametrize("column", range(es.SIZE))
def test_transition_is_the_derivative_of_the_prediction(column: int):
    rng = np.random.default_rng(5)
    states, signal = states_of_an_arm(3, rng)

    def ahead(at: es.InertialTrajectory) -> np.ndarray:
        """Error of the predicted next state against the unchanged one."""
        after, before = (es.predict(each, es.integrated(signal, each)) for each in (at, states))
        return es.less(after, before)[:, :9]

    step = 1e-5
    error = np.zeros((len(states.t), es.SIZE))
    error[:, column] = step
    numeric = (ahead(states.moved(error)) - ahead(states.moved(-error))) / (2 * step)
    F = es.transition(states, es.integrated(signal, states))
    # biases hold the rotation inside a interval of 33 ms to first order
    np.testing.assert_allclose(F[:, :9, column], numeric, rtol=0.02, atol=2e-4)


def test_measurements_are_the_derivative_of_the_residuals():
    made = arm("white", 2, occlusion_lengths_s=NO_GAPS, duration_s=5.0)
    scene = scene_of(made)
    states, camera = start(scene, es.levers_of(scene))
    rng = np.random.default_rng(0)
    error = 1e-4 * rng.normal(size=(len(states.t), es.SIZE))
    chain = linearised(states, camera, InertialSignal(scene.imu), scene)

    def loss(at: es.InertialTrajectory) -> np.ndarray:
        """Half the weighted squares of a node, the weights those of the linearisation."""
        left, first = residuals(at, camera), residuals(states, camera)
        size = np.linalg.norm(first, axis=2) / camera.sigma_m
        weight = 1.0 / (1.0 + (size / 2.8) ** 2) / camera.sigma_m**2
        total = 0.5 * np.nansum(weight[:, :, None] * left**2, axis=(1, 2))
        elbow = at.x[:, es.P] + at.R @ camera.levers["elbow"]
        off = np.linalg.norm(elbow - at.x[:, es.SHOULDER], axis=1) - camera.upper_arm_m
        share = np.minimum(np.gradient(at.t) / 0.09, 1.0)
        return total + 0.5 * share * (off / es.ARM_PRIOR.upper_arm_flex_m) ** 2

    slope = loss(states.moved(error)) - loss(states.moved(-error))
    expected = -2.0 * np.einsum("ni,ni->n", chain.vector[..., 0], error)
    np.testing.assert_allclose(slope, expected, rtol=0.01, atol=0.01 * np.abs(expected).max())


def test_rts_bears_wrong_samples():
    clean, spoilt = (
        arm("white", 1, occlusion_lengths_s=(1.0,), outliers=part, outlier_m=0.5) for part in (0.0, 0.05)
    )
    before, after = (
        rms(errors(made, rts(scene_of(made)))[scene_of(made).occluded]) for made in (clean, spoilt)
    )
    # Cauchy's loss: a wrong sample pulls a hundredth of what it would
    assert after < before + 0.006


@pytest.mark.parametrize("baseline", [rts, ukf])
def test_strap_alone_is_enough(baseline: Baseline):
    made = arm("white", 3, occlusion_lengths_s=(1.0,), strap=True)
    scene = scene_of(made, tilt_deg=2.0)
    joints = np.full_like(scene.joints, np.nan)
    strap = JOINTS.index("strap")
    joints[:, strap] = made.recording.arm.position[: len(joints), strap]
    point = np.where(scene.visible[:, None], joints[:, strap], np.nan)
    joints[~scene.visible] = np.nan
    bare = replace(made.calibration, lever_arms={}, upper_arm=None)
    path = baseline(replace(scene, joints=joints, point=point, point_sigma_m=0.008, calibration=bare))
    error = errors(made, path)
    assert rms(error[4:][~scene.occluded[4:]]) < 0.012
    assert rms(error[scene.occluded]) < (0.02 if baseline is rts else 0.15)
    assert rms(turned_off(made, path.R_K_A)[200:]) < 3.0


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
