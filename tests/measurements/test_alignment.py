"""Initial values: the rotation between filter and camera, and positions through the camera's samples."""

from __future__ import annotations

import numpy as np
import pytest
from curve import Curve
from scipy.spatial import transform

from smoother.array_types import FloatArray
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
ZUP = np.array([0.0, 0.0, -1.0])


def noisy_pairs(R_K_E: Rotation, sigma: float, count: int, rng: np.random.Generator) -> VectorPairs:
    """Random unit vectors in both frames with white noise."""
    in_E = rng.normal(size=(count, 3))
    in_E /= np.linalg.norm(in_E, axis=1)[:, None]
    in_K = R_K_E.apply(in_E) + sigma * rng.normal(size=(count, 3))
    return VectorPairs(np.sort(rng.uniform(0, 40, count)), in_K, in_E, np.full(count, sigma**-2))


def upright(rng: np.random.Generator) -> Rotation:
    """A rotation of a camera that stands level: heading only."""
    return Rotation.from_rotvec([0.0, 0.0, rng.uniform(-np.pi, np.pi)])


@pytest.mark.parametrize("count", [30, 300])
def test_align_finds_a_rotation_within_its_covariance(count: int) -> None:
    """Mean squared error in its own sigmas over 20 seeds; the filter's floor of 3 degrees included."""
    squares = []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        truth = upright(rng)
        alignment = align([noisy_pairs(truth, 0.2, count, rng)], 0.0, 40.0, ZUP)
        for k in (0, len(alignment.t) // 2, len(alignment.t) - 1):
            error = (alignment.R_K_E[k] * truth.inv()).as_rotvec()
            squares.append(error @ np.linalg.solve(alignment.covariance[k], error) / 3.0)
            data = alignment.covariance[k] - FILTER_SIGMA_RAD**2 * np.eye(3)
            assert (np.linalg.eigvalsh(data) > 0).all()
    # the floor makes it shy; without it the pairs alone would give 1
    assert np.mean(squares) < 1.0
    assert max(squares) < 4.0


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


def true_attitude(curve: Curve, R_E_K: Rotation, duration_s: float) -> InertialAttitude:
    t = np.arange(0.0, duration_s, 0.01)
    return InertialAttitude(t, R_E_K * Rotation.from_matrix(curve.rotation(t).as_matrix()), np.zeros(3))


@pytest.mark.parametrize("seed", range(3))
def test_acceleration_pairs_are_one_vector_from_two_frames(seed: int) -> None:
    """A joint with a lever arm, exact samples: the same functional of the same path, up to interpolation."""
    curve = Curve(seed, fastest_hz=1.0, down=np.array([0.0, -1.0, 0.0]))
    shortest = transform.Rotation.align_vectors([[0, 1.0, 0], [0.6, 0, 0.8]], [[0, 0, 1.0], [1.0, 0, 0]])[0]
    R_K_E = Rotation.from_matrix(shortest.as_matrix())
    attitude = true_attitude(curve, R_K_E.inv(), 8.0)
    t, lever = np.arange(0.2, 7.8, 1 / 30), np.array([0.02, -0.2, 0.03])
    joint = curve.position(t) + curve.rotation(t).apply(lever)
    accelerations = acceleration_pairs(t, joint, attitude, InertialSignal(curve.imu(100.0, 8.0)))
    pairs = accelerations.with_lever(lever)
    assert len(pairs.t) > 25
    difference = np.linalg.norm(pairs.in_K - R_K_E.apply(pairs.in_E), axis=1)
    # accelerations of 5 m/s^2; 0.1 m/s^2 is what the pairs are stated to be good to, noise apart
    assert np.linalg.norm(pairs.in_K, axis=1).max() > 2.0
    assert difference.max() < 0.05
    wrong = accelerations.with_lever(np.zeros(3))
    assert np.linalg.norm(wrong.in_K - R_K_E.apply(wrong.in_E), axis=1).max() > 10 * difference.max()


def test_acceleration_pairs_leave_gaps_alone() -> None:
    """No functional reaches across missing frames of half a second."""
    curve = Curve(0, fastest_hz=1.0)
    t = np.arange(0.2, 7.8, 1 / 30)
    t = t[(t < 3.0) | (t > 3.5)]
    attitude = true_attitude(curve, Rotation.from_matrix(np.eye(3)), 8.0)
    signal = InertialSignal(curve.imu(100.0, 8.0))
    accelerations = acceleration_pairs(t, curve.position(t), attitude, signal)
    assert not ((accelerations.t > 2.65) & (accelerations.t < 3.85)).any()
    short = acceleration_pairs(t[:10], curve.position(t[:10]), attitude, signal)
    assert len(short.t) == 0


def test_direction_pairs_hold_the_forearm_s_direction() -> None:
    curve, along = Curve(2), np.array([0.0, 1.0, 0.0])
    t = np.arange(0.5, 4.0, 0.05)
    attitude = true_attitude(curve, Rotation.from_matrix(np.eye(3)), 5.0)
    elbow = curve.position(t)
    pairs = direction_pairs(t, elbow, elbow + 0.25 * curve.rotation(t).apply(along), attitude, along)
    np.testing.assert_allclose(pairs.in_K, pairs.in_E, atol=5e-3)  # slerp between 10 ms knots
    np.testing.assert_allclose(np.linalg.norm(pairs.in_K, axis=1), 1.0)


def camera_path(sigma: float, gap: tuple[float, float]) -> tuple[FloatArray, FloatArray, Curve]:
    curve = Curve(4, fastest_hz=0.6)
    t = np.arange(0.0, 8.0, 1 / 30)
    t = t[(t < gap[0]) | (t > gap[1])]
    return t, curve.position(t) + sigma * np.random.default_rng(0).normal(size=(len(t), 3)), curve


def test_states_follow_the_camera() -> None:
    """Local lines over 0.24 s: 8 mm of noise become 4 mm and 0.1 m/s, plus what the curvature costs."""
    t, position, curve = camera_path(0.008, (9.0, 9.0))
    nodes = np.linspace(0.3, 7.6, 400)
    R = curve.rotation(nodes).as_matrix()
    states = states_from_camera(nodes, R, t, position)
    np.testing.assert_array_equal(states.R, R)
    assert np.sqrt(((states.p - curve.position(nodes)) ** 2).sum(axis=1).mean()) < 0.010
    assert np.sqrt(((states.v - curve.velocity(nodes)) ** 2).sum(axis=1).mean()) < 0.25


def test_states_bridge_a_gap_smoothly_and_stand_still_outside() -> None:
    t, position, curve = camera_path(0.0, (3.0, 4.0))
    nodes = np.linspace(-1.0, 9.0, 2001)
    states = states_from_camera(nodes, np.tile(np.eye(3), (2001, 1, 1)), t, position)
    step = np.linalg.norm(np.diff(states.p, axis=0), axis=1) / 0.005
    assert step.max() < 3.0  # no jump: speeds of this path are under 2 m/s
    out = (nodes < t[0]) | (nodes > t[-1])
    assert not states.v[out].any()
    np.testing.assert_array_equal(states.p[nodes < t[0]], np.tile(states.p[nodes >= t[0]][0], (200, 1)))
    inside = (nodes > 3.0) & (nodes < 4.0)
    between = np.linalg.norm(states.p[inside] - curve.position(nodes[inside]), axis=1)
    assert between.max() < 0.3
