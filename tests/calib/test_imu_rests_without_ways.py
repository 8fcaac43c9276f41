"""Rest poses that were cut out and put one behind the other: nothing but a jump parts them."""

from __future__ import annotations

import numpy as np
import pytest

from calib.imu.accelerometer import find_rests, sphere_points
from calib.imu.sensor_calibration import GRAVITY, calibrate_imu
from smoother.recording import ImuStream
from smoother.simulation.poses import SensorModel

RATE_HZ = 100.0


def put_together(model: SensorModel, noise: float) -> tuple[ImuStream, list[int]]:
    """Twelve poses of 1 to 4 s without a way between them, and where each begins."""
    rng = np.random.default_rng(5)
    lengths = rng.integers(100, 400, 12)
    up = np.repeat(GRAVITY * sphere_points(12), lengths, axis=0)
    acc = model.distort(up) + noise * rng.normal(size=up.shape)
    gyro = 0.1 * noise * rng.normal(size=up.shape)
    stream = ImuStream("/imu", np.arange(len(up)) / RATE_HZ, acc, gyro, None)
    return stream, np.concatenate([[0], np.cumsum(lengths)]).tolist()


@pytest.mark.parametrize("noise", [0.0, 0.02, 0.1])
def test_poses_parted_by_a_jump_are_poses_of_their_own(noise):
    model = SensorModel.draw(np.random.default_rng(3), offset=0.5, scale=0.03, cross=0.01)
    stream, begins = put_together(model, noise)
    rests = find_rests(stream)
    assert len(rests) == rests.poses == 12
    for (first, last), begin, end in zip(rests.ranges, begins[:-1], begins[1:], strict=True):
        assert begin <= first < begin + 20 and end - 20 < last <= end
    found = calibrate_imu(stream).accelerometer
    up = GRAVITY * sphere_points(300)
    # the shortest rest has 100 samples: a tenth of the noise, spread over nine unknowns
    assert np.sqrt(np.mean((found.apply(model.distort(up)) - up) ** 2)) < 0.0002 + 0.1 * noise


def test_a_knock_does_not_part_a_rest():
    rng = np.random.default_rng(1)
    acc = np.array([0.0, 0.0, GRAVITY]) + 0.02 * rng.normal(size=(4000, 3))
    acc[2000:2004] += 3.0
    stream = ImuStream("/imu", np.arange(4000) / RATE_HZ, acc, 0.002 * rng.normal(size=(4000, 3)), None)
    assert find_rests(stream).ranges.tolist() == [[0, 4000]]
