"""The IMU as a signal: means, integrals, knocks; initial values of attitude and position with the camera."""

from __future__ import annotations

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from curve import Curve
from scipy.spatial import transform

from smoother.measurements.alignment import (
    FILTER_SIGMA_RAD,
    VectorPairs,
    acceleration_pairs,
    align,
    direction_pairs,
)
from smoother.measurements.inertial import (
    STEP_S,
    InertialAttitude,
    InertialSignal,
    Preintegration,
    _moments_around,
    equivalent_samples,
    split_steps,
)
from smoother.recording import ImuStream
from smoother.rotation import Rotation
from smoother.window.prepare import states_from_camera

NO_BIAS = np.zeros(6)


def test_the_mean_of_uneven_samples_is_weighted_by_their_time() -> None:
    imu = Curve(1).imu(100.0, 3.0)
    uneven = imu.t_s + np.random.default_rng(0).uniform(-0.002, 0.002, len(imu))
    signal, samples = InertialSignal(replace(imu, t_s=uneven)), np.hstack([imu.acc, imu.gyro])
    expected = np.average(samples, axis=0, weights=np.diff(signal.edges))
    mean = signal.mean(np.array([signal.start_s]), np.array([signal.end_s]))[0]
    np.testing.assert_allclose(mean, expected, rtol=1e-12)


@pytest.mark.parametrize("seed", range(4))
def test_equivalent_samples_are_exact_in_gtsam(seed: int) -> None:
    """Six unknowns for six numbers: only rounding may remain, also for wild motion and at rest."""
    rng = np.random.default_rng(seed)
    size = np.append(np.ones(20), 0.0)[:, None]
    motion = Preintegration(
        Rotation.from_rotvec(size * rng.normal(0, 0.5, (21, 3))).as_matrix(),
        size * rng.normal(0, 1.0, (21, 3)),
        size * rng.normal(0, 0.1, (21, 3)),
        rng.uniform(0.003, STEP_S, 21),
    )
    acc, gyro, h = equivalent_samples(motion)
    for k in range(21):
        pim = gtsam.PreintegratedImuMeasurements(gtsam.PreintegrationParams(np.array([0.0, 0.0, -9.81])))
        for force in acc[k]:
            pim.integrateMeasurement(force, gyro[k], h[k])
        assert pim.deltaTij() == pytest.approx(motion.dt[k], rel=1e-12)
        np.testing.assert_allclose(pim.deltaRij().matrix(), motion.delta_R[k], atol=1e-12)
        np.testing.assert_allclose(pim.deltaVij(), motion.delta_v[k], atol=1e-10)
        np.testing.assert_allclose(pim.deltaPij(), motion.delta_p[k], atol=1e-12)
    assert not acc[20].any() and not gyro[20].any()


def test_steps_are_short_and_begin_and_end_at_the_given_times() -> None:
    t = np.append(np.arange(0.5, 4.5, 0.1), [4.5, 4.533, 4.55])
    step_t, first = split_steps(t)
    assert np.diff(step_t).max() <= STEP_S + 1e-9
    np.testing.assert_array_equal(step_t[first], t)
    assert (np.diff(first) == [3] * 40 + [1, 1]).all()


@pytest.mark.parametrize("rate_hz", [80.0, 120.0, 285.714])
def test_a_knock_is_felt_where_it_is_and_smooth_motion_is_none(rate_hz: float) -> None:
    """Brisk smooth motion must not widen the accelerometer's noise: 0.02 m/s^2/sqrt(Hz) is the default."""
    imu, t = Curve(7).imu(rate_hz, 10.0), np.arange(0.1, 9.9, 1 / 30)
    density = InertialSignal(imu).velocity_error(t) / np.sqrt(np.diff(t))
    assert density.max() < 0.02  # added in quadrature: at most 40 % at the briskest moment
    assert np.median(density) < 0.005
    acc, t, at_s = imu.acc.copy(), np.arange(0.1, 9.9, 0.1), imu.t_s[500]
    acc[500, 0] += 0.4 * rate_hz  # one sample: an impulse of 0.4 m/s
    error = InertialSignal(ImuStream("", imu.t_s, acc, imu.gyro)).velocity_error(t)
    struck = (t[:-1] < at_s + 2 / rate_hz) & (t[1:] > at_s - 2 / rate_hz)
    # a fifth of 0.4 m/s by definition, spread over the sample and its two neighbours
    assert error[struck].max() == pytest.approx(0.2 * 0.4 * np.sqrt(1.5), rel=0.3)
    assert error[~struck].max() < 0.01


def test_what_varies_about_a_time_is_the_variance_of_the_samples_near_it() -> None:
    """Sample by sample: a constant, however large, has none; only the first three values count."""
    edges, t = np.arange(0.0, 8.0, 0.05), np.array([0.0, 0.42, 4.0, 7.93])
    values = np.random.default_rng(2).normal(3.0, 1.0, (len(edges) - 1, 4)) + np.array([0.0, 9.8, 0.0, 0.0])
    mean, variance = _moments_around(edges, values, t, 0.5)
    for k, at in enumerate(t):
        own = values[(edges[:-1] >= at - 0.5) & (edges[:-1] < at + 0.5)]
        np.testing.assert_allclose(mean[k], own.mean(axis=0))
        assert variance[k] == pytest.approx(own[:, :3].var(axis=0).sum())


NOTHING = VectorPairs(np.zeros(0), np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0))


@pytest.mark.parametrize("down", [(0, 0, -1), (0, -1, 0), (0, 1, 0), (0.6, 0.0, -0.8)])
def test_the_hint_decides_where_no_pair_does(down: tuple[float, float, float]) -> None:
    """Gravity's direction as hinted; a proper rotation; heading nearly unknown, tilt to 15 degrees."""
    down_K = np.array(down, dtype=float)
    alignment = align([NOTHING], 0.0, 10.0, down_K)
    matrix = alignment.R_K_E.as_matrix()
    np.testing.assert_allclose(matrix @ [0.0, 0.0, -1.0], np.tile(down_K, (len(matrix), 1)), atol=1e-9)
    np.testing.assert_allclose(np.linalg.det(matrix), 1.0, atol=1e-9)
    for covariance in alignment.covariance:
        assert down_K @ covariance @ down_K > 0.5  # about the vertical: the prior's one radian
        across = np.linalg.svd(down_K[None])[2][1:]
        tilt = np.degrees(np.sqrt(np.diag(across @ covariance @ across.T)))
        assert (tilt > 10).all()
        assert (tilt < 20).all()


@pytest.mark.parametrize("count", [30, 300])
def test_align_finds_a_rotation_within_its_covariance(count: int) -> None:
    """Mean squared error in its own sigmas over 20 seeds; the filter's floor of 3 degrees included."""
    squares = []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        truth = Rotation.from_rotvec([0.0, 0.0, rng.uniform(-np.pi, np.pi)])  # heading only: it stands level
        in_E = rng.normal(size=(count, 3))
        in_E /= np.linalg.norm(in_E, axis=1)[:, None]
        in_K = truth.apply(in_E) + 0.2 * rng.normal(size=(count, 3))
        noisy = VectorPairs(np.sort(rng.uniform(0, 40, count)), in_K, in_E, np.full(count, 0.2**-2))
        alignment = align([noisy], 0.0, 40.0, np.array([0.0, 0.0, -1.0]))
        for k in (0, len(alignment.t) // 2, len(alignment.t) - 1):
            error = (alignment.R_K_E[k] * truth.inv()).as_rotvec()
            squares.append(error @ np.linalg.solve(alignment.covariance[k], error) / 3.0)
            data = alignment.covariance[k] - FILTER_SIGMA_RAD**2 * np.eye(3)
            assert (np.linalg.eigvalsh(data) > 0).all()
    # the floor makes it shy; without it the pairs alone would give 1
    assert np.mean(squares) < 1.0 and max(squares) < 4.0


@pytest.mark.parametrize("seed", range(3))
def test_pairs_are_one_vector_from_two_frames(seed: int) -> None:
    """A joint with a lever arm, exact samples: the same functional of the same path, up to interpolation."""
    curve, signal_t = Curve(seed, fastest_hz=1.0, down=np.array([0.0, -1.0, 0.0])), np.arange(0.0, 8.0, 0.01)
    shortest = transform.Rotation.align_vectors([[0, 1.0, 0], [0.6, 0, 0.8]], [[0, 0, 1.0], [1.0, 0, 0]])[0]
    R_K_E = Rotation.from_matrix(shortest.as_matrix())
    R_E_A = R_K_E.inv() * Rotation.from_matrix(curve.rotation(signal_t).as_matrix())
    attitude, signal = InertialAttitude(signal_t, R_E_A, np.zeros(3)), InertialSignal(curve.imu(100.0, 8.0))
    t, lever = np.arange(0.2, 7.8, 1 / 30), np.array([0.02, -0.2, 0.03])
    joint = curve.position(t) + curve.rotation(t).apply(lever)
    accelerations = acceleration_pairs(t, joint, attitude, signal)
    pairs = accelerations.with_lever(lever)
    assert len(pairs.t) > 25
    difference = np.linalg.norm(pairs.in_K - R_K_E.apply(pairs.in_E), axis=1)
    # accelerations of 5 m/s^2; 0.1 m/s^2 is what the pairs are stated to be good to, noise apart
    assert np.linalg.norm(pairs.in_K, axis=1).max() > 2.0 and difference.max() < 0.05
    wrong = accelerations.with_lever(np.zeros(3))
    assert np.linalg.norm(wrong.in_K - R_K_E.apply(wrong.in_E), axis=1).max() > 10 * difference.max()
    # no functional reaches across missing frames of half a second
    seen = (t < 3.0) | (t > 3.5)
    parted = acceleration_pairs(t[seen], joint[seen], attitude, signal)
    assert not ((parted.t > 2.65) & (parted.t < 3.85)).any()
    assert not len(acceleration_pairs(t[:10], joint[:10], attitude, signal).t)
    along = np.array([0.0, 1.0, 0.0])
    pairs = direction_pairs(t, joint, joint + 0.25 * curve.rotation(t).apply(along), attitude, along)
    np.testing.assert_allclose(pairs.in_K, R_K_E.apply(pairs.in_E), atol=5e-3)  # slerp between 10 ms knots
    np.testing.assert_allclose(np.linalg.norm(pairs.in_K, axis=1), 1.0)


@pytest.mark.parametrize("sigma_m", [0.0, 0.008])
def test_states_follow_the_camera_bridge_a_gap_and_stand_still_outside(sigma_m: float) -> None:
    """Local lines over 0.24 s: 8 mm of noise become 4 mm and 0.1 m/s, plus what the curvature costs."""
    curve, t = Curve(4, fastest_hz=0.6), np.arange(0.0, 8.0, 1 / 30)
    t = t[(t < 3.0) | (t > 4.0)]
    position = curve.position(t) + sigma_m * np.random.default_rng(0).normal(size=(len(t), 3))
    nodes = np.linspace(-1.0, 9.0, 2001)
    R = curve.rotation(nodes).as_matrix()
    states = states_from_camera(nodes, R, t, position)
    np.testing.assert_array_equal(states.R, R)
    off, too_fast = states.p - curve.position(nodes), states.v - curve.velocity(nodes)
    seen = ((nodes > 0.3) & (nodes < 2.8)) | ((nodes > 4.2) & (nodes < 7.6))
    assert np.sqrt((off[seen] ** 2).sum(axis=1).mean()) < 0.010
    assert np.sqrt((too_fast[seen] ** 2).sum(axis=1).mean()) < 0.25
    step = np.linalg.norm(np.diff(states.p, axis=0), axis=1) / 0.005
    assert step.max() < 3.0  # no jump: speeds of this path are under 2 m/s
    assert not states.v[(nodes < t[0]) | (nodes > t[-1])].any()
    np.testing.assert_array_equal(states.p[nodes < t[0]], np.tile(states.p[nodes >= t[0]][0], (200, 1)))
    assert np.linalg.norm(off[(nodes > 3.0) & (nodes < 4.0)], axis=1).max() < 0.3
