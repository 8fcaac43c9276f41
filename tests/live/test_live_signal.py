"""The IMU of the last moments: one interval at a time, there and back; what is missing is uncertain."""

from __future__ import annotations

import numpy as np
import pytest

from smoother.body import FOREARM
from smoother.live.imu import LiveImu
from smoother.live.signal import LiveSignal, increments_between, propagated
from smoother.measurements.inertial import InertialSignal, integrate, integrate_each
from smoother.recording import ImuStream
from smoother.rotation import Rotation, matrix_of, rotvec_of
from smoother.units import GRAVITY
from smoother.window.solution import NodeState

DOWN = GRAVITY * np.array([0.0, 0.0, -1.0])
T = np.arange(0.0, 2.0, 0.01)
NODE = NodeState(1.0, np.eye(3), np.array([0.1, 0.2, 1.0]), np.array([0.3, 0.0, -0.1]))


def rows(t: np.ndarray) -> ImuStream:
    """A turning, accelerating arm."""
    acc = np.column_stack([np.sin(5.0 * t), np.cos(3.0 * t), GRAVITY + 0.5 * t])
    return ImuStream("", t, acc, np.column_stack([1.5 * np.sin(2.0 * t), np.ones_like(t), 0.3 * t]))


def buffer(t: np.ndarray = T) -> LiveImu:
    made = LiveImu(FOREARM, 10.0)
    made.add(rows(t))
    return made


def live(imu: LiveImu) -> LiveSignal:
    return LiveSignal(imu, np.zeros((2, 3, 3)))


def test_there_and_back_is_where_it_began() -> None:
    signal, bias = live(buffer()).since(0.5), np.zeros(6)
    back = propagated(propagated(NODE, 1.3, signal, bias, DOWN), NODE.t, signal, bias, DOWN)
    for name in "Rpv":
        np.testing.assert_allclose(getattr(back, name), getattr(NODE, name), atol=1e-9)


def test_missing_samples_leave_the_velocity_uncertain() -> None:
    whole = increments_between(live(buffer()).since(0.5), 1.0, 1.1, np.zeros(6))
    some = buffer(T[(T < 1.02) | (T > 1.08)])
    missing = increments_between(live(some).since(0.5), 1.0, 1.1, np.zeros(6))
    # about 6 cs at 4 m/s^2
    assert missing.velocity_error[0] > whole.velocity_error[0] + 0.1
    elsewhere = increments_between(live(some).since(0.5), 1.2, 1.3, np.zeros(6))
    assert elsewhere.velocity_error[0] < 0.1


@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-7, 1e-3, 0.3, 1.5, 2.0, 2.2, 3.1, np.pi - 1e-9])
def test_one_rotation_is_that_of_the_stack(angle):
    rng = np.random.default_rng(3)
    for axis in rng.normal(size=(20, 3)):
        rotvec = angle * axis / np.linalg.norm(axis)
        matrix = matrix_of(rotvec)
        np.testing.assert_allclose(matrix, Rotation.from_rotvec(rotvec).as_matrix(), atol=1e-14)
        np.testing.assert_allclose(rotvec_of(matrix), Rotation.from_matrix(matrix).as_rotvec(), atol=1e-11)


def test_intervals_one_by_one_are_those_of_the_loop():
    rng = np.random.default_rng(5)
    t = np.arange(200) / 100
    smooth = np.cumsum(rng.normal(size=(200, 6)), axis=0) * 0.3
    signal = InertialSignal(ImuStream("imu", t, smooth[:, :3] + [0, 0, 9.8], smooth[:, 3:]))
    bias = rng.normal(scale=0.05, size=6)
    edges = np.array([0.1, 0.101, 0.133, 0.2, 0.75, 1.4])
    expected, found = integrate(signal, edges, bias), integrate_each(signal, edges, bias)
    for name in ("delta_R", "delta_v", "delta_p", "dt"):
        np.testing.assert_allclose(getattr(found, name), getattr(expected, name), atol=1e-12)
