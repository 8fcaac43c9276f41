"""What a sensor's calibration found, in words: verdict, figures, what to record next. Pure functions."""

from __future__ import annotations

import numpy as np

from smoother.recording import FloatArray

from .accelerometer import DOUBTED_SIGMA
from .allan import SLOW_S, WHITE_S, SensorNoise
from .magnetometer import LARGE_RESIDUAL, MagnetometerCalibration
from .sensor_calibration import ImuCalibration

#: m/s^2 that a datasheet calls g.
STANDARD_GRAVITY = 9.80665
#: A better calibration than this is wasted on a wrist: half a milliradian of gravity, m/s^2.
GOOD_SIGMA = 0.005


def imu_verdict(found: ImuCalibration) -> list[str]:
    """What was found and whether it serves."""
    said = []
    acc = found.accelerometer
    if acc is not None:
        word = (
            "very well"
            if acc.worst_sigma < GOOD_SIGMA
            else "well"
            if acc.worst_sigma < DOUBTED_SIGMA
            else "roughly"
        )
        said.append(
            f"{acc.poses} rest poses determine the accelerometer {word}: corrected, gravity's length is"
            " known to"
            f" {acc.sigma:.4f} m/s^2 on average and {acc.worst_sigma:.4f} in the worst direction"
        )
        before = float(np.sqrt(np.mean((np.linalg.norm(found.rests.acc, axis=1) - found.gravity) ** 2)))
        said.append(
            f"the rests missed gravity by {before:.3f} m/s^2 (root mean square) and miss it by"
            f" {acc.rms:.4f} now"
        )
    else:
        said.append(
            "this is one long rest: it tells the noise and the gyroscope's bias, not the accelerometer"
        )
    degrees = np.degrees(found.gyroscope.offset)
    source = (
        f"the mean of {found.gyroscope.samples} still samples"
        if found.gyroscope.rule == "rest"
        else f"the running mean of {found.gyroscope.samples} stable samples, as the sensor never lay still"
        " for long"
    )
    said.append(
        f"the gyroscope's bias is {degrees[0]:+.3f}, {degrees[1]:+.3f}, {degrees[2]:+.3f} degrees/s, {source}"
    )
    return said


def noise_rows(found: ImuCalibration) -> list[tuple[str, str, str, str]]:
    """Noise figures in a datasheet's units, a row a figure: name, x, y, z."""
    rows = []
    if found.accelerometer_noise is not None:
        noise, g = found.accelerometer_noise, STANDARD_GRAVITY
        rows += [
            ("accelerometer, noise density, µg/√Hz", *_three(1e6 / g * noise.density)),
            ("accelerometer, bias instability, µg", *_three(1e6 / g * noise.instability)),
            ("accelerometer, random walk, µg/√s", *_three(1e6 / g * noise.walk)),
        ]
    if found.gyroscope_noise is not None:
        noise = found.gyroscope_noise
        rows += [
            ("gyroscope, noise density, degrees/s/√Hz", *_three(np.degrees(noise.density))),
            ("gyroscope, angle random walk, degrees/√h", *_three(60.0 * np.degrees(noise.density))),
            ("gyroscope, bias instability, degrees/h", *_three(3600.0 * np.degrees(noise.instability))),
            ("gyroscope, random walk, degrees/s/√s", *_three(np.degrees(noise.walk))),
        ]
    return rows


def imu_next(found: ImuCalibration) -> list[str]:
    """What to record next time."""
    said = list(found.accelerometer.remarks) if found.accelerometer is not None else []
    if found.accelerometer is None:
        said.append(
            "for offset, scale and cross-axis: twelve rest poses of three seconds each, the sensor on its"
            " six sides"
            " and on six edges between them"
        )
    if found.gyroscope.rule == "running":
        said.append("for the gyroscope's bias: leave the sensor lying for five seconds while it records")
    noise = found.gyroscope_noise
    if noise is None:
        said.append(
            f"for the noise: one rest of {WHITE_S:.0f} s at least; bias instability takes an hour or more"
        )
    elif noise.duration_s < SLOW_S:
        said.append(
            f"for bias instability and random walk: one rest of an hour or more (the longest was"
            f" {noise.duration_s:.0f} s)"
        )
    elif not_seen(noise):
        said.append(
            f"bias instability or random walk did not show in {noise.duration_s / 60.0:.0f} minutes; a"
            " longer rest"
            " at an even temperature may show them"
        )
    return said


def not_seen(noise: SensorNoise) -> bool:
    """Whether a slow part of the noise stayed hidden."""
    return bool(np.isnan(noise.instability).all() or np.isnan(noise.walk).all())


def magnetometer_verdict(found: MagnetometerCalibration) -> list[str]:
    """What was found and whether it serves."""
    mean = float(np.mean(found.radii))
    shift = float(np.linalg.norm(found.offset)) / mean
    stretch = float(found.radii[2] / found.radii[0]) - 1.0
    word = "well" if not found.remarks else "roughly"
    return [
        f"{found.samples} samples determine the magnetometer {word}: they lie {100 * found.residual:.1f} %"
        " off"
        " the ellipsoid (root mean square)",
        f"hard iron shifts the field by {100 * shift:.0f} % of its strength, soft iron makes it"
        f" {100 * stretch:.0f} % longer in one direction than in another",
        f"{100 * found.coverage.share:.0f} % of the sphere's cells were covered, the largest hole reaches"
        f" {np.degrees(found.coverage.hole_rad):.0f} degrees",
    ]


def magnetometer_next(found: MagnetometerCalibration) -> list[str]:
    """What to record next time."""
    said = list(found.remarks)
    if found.residual > 0.5 * LARGE_RESIDUAL:
        said.append(
            "turn the sensor on one spot rather than carrying it about, half a metre from iron,"
            " loudspeakers and"
            " telephones"
        )
    said.append(
        "calibrate again when the sensor's battery, case or strap buckle changes: iron on it moves the field"
    )
    return said


def _three(values: FloatArray) -> tuple[str, str, str]:
    x, y, z = ("-" if not np.isfinite(value) else f"{value:.3g}" for value in values)
    return x, y, z
