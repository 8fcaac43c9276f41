"""Accuracy of the sensors' calibration on simulated sensors: `imu`.

Accelerometer: offsets of 0.5 m/s^2, scale 3 %, cross-axis 1 %, twelve poses held for two seconds each, turned
by hand between. Magnetometer: hard iron 0.5, soft iron 20 % (of the field), 3,000 samples, noise 1 %.
Noise figures: white noise, and bias that wanders, over a rest.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator

import numpy as np
from scipy.spatial.transform import Rotation

from calib.imu.accelerometer import find_rests, sphere_points
from calib.imu.magnetometer import calibrate_magnetometer
from calib.imu.sensor_calibration import GRAVITY, allan_noise, calibrate_imu
from smoother.errors import CalibrationError
from smoother.simulation.poses import SensorModel, magnetometer_turns, rest_poses
from tools.accuracy.check import Check, seeds_option


def accelerometer(seeds: range, poses: int, noise: float) -> Iterator[str]:
    """Error of the corrected specific force at rest, over all directions."""
    errors, biases, found = [], [], []
    up = sphere_points(500) * GRAVITY
    for seed in seeds:
        model = SensorModel.draw(np.random.default_rng(seed), offset=0.5, scale=0.03, cross=0.01)
        stream, bias = rest_poses(model, poses, seed=seed, acc_noise=noise, gyro_noise=noise / 50.0)
        found.append(find_rests(stream).poses)
        got = calibrate_imu(stream)
        assert got.accelerometer is not None
        errors.append(
            np.sqrt(np.mean(np.sum((got.accelerometer.apply(model.distort(up)) - up) ** 2, axis=1)))
        )
        biases.append(np.abs(got.gyroscope.offset - bias).max())
    yield (
        f"  {poses} poses, noise {noise:g} m/s^2: rms error {np.mean(errors):.4f}, worst of"
        f" {len(seeds)} seeds {max(errors):.4f} m/s^2; poses found {min(found)}..{max(found)};"
        f" gyroscope bias {np.degrees(max(biases)):.4f} deg/s at worst"
    )


def refused(seeds: range) -> Iterator[str]:
    """Eight poses."""
    for seed in seeds:
        model = SensorModel.draw(np.random.default_rng(seed), offset=0.5, scale=0.03, cross=0.01)
        try:
            calibrate_imu(rest_poses(model, 8, seed=seed)[0])
        except CalibrationError as error:
            text = str(error)
        else:
            raise SystemExit(f"eight poses were taken (seed {seed})")
    yield (f"  8 poses: refused for all seeds: {text}")


def magnetometer(seeds: range) -> Iterator[str]:
    """Length of the corrected true field, over the sphere."""
    worst, rms = [], []
    for seed in seeds:
        model = SensorModel.draw(np.random.default_rng(seed), offset=0.5, scale=0.2, cross=0.2)
        got = calibrate_magnetometer(magnetometer_turns(model, 3000, noise=0.01, seed=seed))
        length = np.linalg.norm(got.apply(model.distort(sphere_points(500))), axis=1)
        worst.append(np.abs(length - 1.0).max())
        rms.append(np.sqrt(np.mean((length - 1.0) ** 2)))
    yield (
        f"  3000 samples: radius error rms {100 * np.mean(rms):.3f} %,"
        f" worst direction {100 * max(worst):.3f} %"
    )
    rng = np.random.default_rng(0)
    angle = rng.uniform(0.0, 2.0 * np.pi, 3000)
    plane = Rotation.from_rotvec(angle[:, None] * [0.0, 0.0, 1.0]).apply([0.5, 0.0, -0.86])
    try:
        calibrate_magnetometer(plane + rng.normal(0.0, 0.01, plane.shape))
    except CalibrationError as error:
        yield (f"  planar rotation: refused: {error}")
    else:
        raise SystemExit("a planar rotation was taken")


def noise(seeds: range) -> Iterator[str]:
    """White noise and random walk of a long rest, against those that were drawn."""
    rate, hours = 100.0, 1.0
    ratio = []
    for seed in seeds[:5]:
        rng = np.random.default_rng(seed)
        count = int(3600 * hours * rate)
        white, walk = 2e-3, 1e-4
        samples = white * np.sqrt(rate) * rng.normal(size=(count, 3))
        samples += np.cumsum(walk / np.sqrt(rate) * rng.normal(size=(count, 3)), axis=0)
        got = allan_noise(samples, rate)
        assert got is not None
        ratio.append([np.sqrt(np.mean(got.density**2)) / white, np.sqrt(np.nanmean(got.walk**2)) / walk])
    low, high = np.min(ratio, axis=0), np.max(ratio, axis=0)
    yield (
        f"  {hours:g} h at {rate:g} Hz: white noise {low[0]:.3f}..{high[0]:.3f} of the truth,"
        f" random walk {low[1]:.2f}..{high[1]:.2f}"
    )


def imu(options: argparse.Namespace) -> Iterator[str]:
    """Errors of corrected accelerometers, gyroscopes and magnetometers, and of noise figures."""
    yield "accelerometer"
    for level in (0.005, 0.02, 0.1):
        yield from accelerometer(options.seeds, 12, level)
    yield from refused(options.seeds)
    yield "magnetometer"
    yield from magnetometer(options.seeds)
    yield "noise"
    yield from noise(options.seeds)


CHECKS = (Check("imu", imu, (seeds_option("20"),)),)
