"""Baselines that see only what has arrived."""

from __future__ import annotations

import numpy as np
import pytest

from smoother.baselines.scene import Scene
from smoother.baselines.simple import autoregressive, constant_velocity
from smoother.calibration import ArmCalibration
from smoother.recording import ImuStream

LATENCY_S = 0.1


def scene(hidden_from_s: float = np.inf, sigma_m: float = 0.003) -> Scene:
    """A point that swings along x, 6 s of it, seen at 30 Hz until it hides."""
    rng = np.random.default_rng(3)
    t, frame_t = np.arange(0.0, 6.0, 0.01), np.arange(0.0, 6.0, 1 / 30)
    amplitude, rate = 0.15, 2.0

    def at(time: np.ndarray) -> np.ndarray:
        return np.outer(amplitude * np.sin(rate * time), [1.0, 0.0, 0.0])

    acceleration = -(rate**2) * at(t)
    point = at(frame_t) + sigma_m * rng.normal(size=(len(frame_t), 3))
    point[frame_t >= hidden_from_s] = np.nan
    joints = np.full((len(frame_t), 5, 3), np.nan)
    return Scene(
        imu=ImuStream("imu", t, acceleration, np.zeros_like(acceleration)),
        R_K_A=np.tile(np.eye(3), (len(t), 1, 1)),
        attitude_sigma_rad=0.01,
        gravity=np.array([0.0, -9.81, 0.0]),
        acceleration=acceleration,
        frame_t=frame_t,
        joints=joints,
        camera_joints=joints,
        point=point,
        point_sigma_m=sigma_m,
        gaps=(),
        calibration=ArmCalibration(),
        point_effective_sigma_m=sigma_m,
    )


def truth(t: np.ndarray) -> np.ndarray:
    return np.outer(0.15 * np.sin(2.0 * t), [1.0, 0.0, 0.0])


@pytest.mark.parametrize("method", [autoregressive, constant_velocity])
def test_it_answers_for_the_present(method):
    moving = scene()
    later = moving.t > 1.0
    error = np.linalg.norm(method(moving, LATENCY_S).position - truth(moving.t), axis=1)[later]
    # what arrived is 0.1 s old: held, it would be off by up to 0.15 x 2 x 0.1 = 3 cm
    held = np.linalg.norm(truth(moving.t - LATENCY_S) - truth(moving.t), axis=1)[later]
    assert np.sqrt(np.mean(error**2)) < 0.6 * np.sqrt(np.mean(held**2))


@pytest.mark.parametrize("method", [autoregressive, constant_velocity])
def test_it_never_sees_what_has_not_arrived(method):
    full, cut = scene(), scene(hidden_from_s=4.0)
    before = full.t < 4.0 + LATENCY_S - 0.04
    if method is autoregressive:  # its hyper-parameters are of the whole segment, by design
        np.testing.assert_allclose(
            method(full, LATENCY_S).position[before], method(cut, LATENCY_S).position[before], atol=2e-3
        )
    else:
        np.testing.assert_array_equal(
            method(full, LATENCY_S).position[before], method(cut, LATENCY_S).position[before]
        )


@pytest.mark.parametrize("method", [autoregressive, constant_velocity])
def test_sigma_grows_in_a_gap(method):
    path = method(scene(hidden_from_s=4.0), LATENCY_S)
    sigma = np.sqrt(np.trace(path.covariance, axis1=1, axis2=2))
    at = [int(np.searchsorted(scene().t, s)) for s in (4.05, 4.5, 5.5)]
    assert sigma[at[0]] < sigma[at[1]] < sigma[at[2]]


@pytest.mark.parametrize("method", [autoregressive, constant_velocity])
def test_nothing_before_the_first_frame_has_arrived(method):
    path = method(scene(), LATENCY_S)
    assert np.isnan(path.position[scene().t < LATENCY_S - 0.05]).all()


@pytest.mark.parametrize("method", [autoregressive, constant_velocity])
def test_a_camera_that_saw_nothing(method):
    path = method(scene(hidden_from_s=0.0), LATENCY_S)
    assert np.isnan(path.position).all() and path.notes
