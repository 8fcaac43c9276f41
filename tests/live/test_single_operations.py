"""What a live step does with one vector, matrix or interval at a time, against the operations on stacks."""

from __future__ import annotations

import numpy as np
import pytest

from smoother.measurements.inertial import InertialSignal, integrate, integrate_each, integrate_one
from smoother.recording import ImuStream
from smoother.rotation import Rotation, matrix_of, rotvec_of


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
    one = integrate_one(signal, 0.2, 0.75, bias)
    np.testing.assert_allclose(one[2], expected.delta_p[3], atol=1e-12)
