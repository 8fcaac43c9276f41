"""The magnetometer's ellipsoid."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.imu.accelerometer import sphere_points
from calib.imu.magnetometer import calibrate_magnetometer, fit_ellipsoid
from smoother.errors import CalibrationError
from smoother.simulation.poses import SensorModel, magnetometer_turns


def model(seed: int) -> SensorModel:
    return SensorModel.draw(np.random.default_rng(seed), offset=0.5, scale=0.2, cross=0.2)


@pytest.mark.parametrize("seed", range(20))
def test_radius_to_half_a_percent(seed):
    sensor = model(seed)
    found = calibrate_magnetometer(magnetometer_turns(sensor, 3000, noise=0.01, seed=seed))
    length = np.linalg.norm(found.apply(sensor.distort(sphere_points(400))), axis=1)
    assert np.abs(length - 1.0).max() < 0.005
    assert found.residual == pytest.approx(0.01, rel=0.2)


def test_any_unit_gives_the_unit_sphere():
    sensor = model(1)
    raw = magnetometer_turns(sensor, 3000, noise=0.0, seed=1)
    for unit in (1.0, 48.0, 4.8e-5):
        found = calibrate_magnetometer(unit * raw)
        assert np.linalg.norm(found.apply(unit * raw), axis=1) == pytest.approx(1.0, abs=1e-6)
        assert found.offset == pytest.approx(unit * sensor.offset, rel=1e-4)


def test_linear_fit_finds_the_ellipsoid_exactly():
    sensor = model(2)
    centre, matrix = fit_ellipsoid(sensor.distort(sphere_points(200)))
    assert centre == pytest.approx(sensor.offset, abs=1e-9)
    assert matrix == pytest.approx(np.linalg.inv(sensor.matrix), abs=1e-9)


@pytest.mark.parametrize("wobble_deg", [0.0, 5.0, 15.0])
def test_a_rotation_about_one_axis_is_refused(wobble_deg):
    angle = np.linspace(0.0, 40.0, 3000)
    tip = np.radians(wobble_deg) * np.sin(1.7 * angle)
    R = Rotation.from_euler("ZX", np.stack([angle, tip], axis=1)).inv()
    raw = R.apply([0.5, 0.0, -0.86]) + np.random.default_rng(0).normal(0.0, 0.01, (3000, 3))
    with pytest.raises(CalibrationError, match=r"one axis only|sphere open"):
        calibrate_magnetometer(48.0 * raw)


def test_half_a_sphere_is_refused_and_says_where_to_go_on():
    points = sphere_points(3000)
    half = points[points[:, 0] > -0.1]
    with pytest.raises(CalibrationError, match="around the sensor's -x"):
        calibrate_magnetometer(half)


def test_few_samples_a_dead_sensor_and_no_ellipsoid():
    with pytest.raises(CalibrationError, match="200 are needed"):
        calibrate_magnetometer(sphere_points(50))
    with pytest.raises(CalibrationError, match="always reads the same"):
        calibrate_magnetometer(np.ones((500, 3)))
    cube = np.random.default_rng(0).uniform(-1.0, 1.0, (3000, 3)) ** 3
    with pytest.raises(CalibrationError, match=r"ellipsoid"):
        calibrate_magnetometer(cube)


def test_a_magnet_that_passes_by_does_not_pull():
    sensor = model(4)
    raw = magnetometer_turns(sensor, 3000, noise=0.005, seed=4)
    raw[500:620] += [0.4, -0.3, 0.2]
    found = calibrate_magnetometer(raw)
    length = np.linalg.norm(found.apply(sensor.distort(sphere_points(400))), axis=1)
    assert np.sqrt(np.mean((length - 1.0) ** 2)) < 0.01
    assert found.remarks
