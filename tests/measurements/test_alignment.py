"""Initial values: the rotation between filter and camera, and positions through the camera's samples."""

from __future__ import annotations

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
from smoother.measurements.inertial import InertialAttitude, InertialSignal
from smoother.rotation import Rotation
from smoother.window.prepare import states_from_camera

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
