"""What a sensor's calibration found, in words: verdict, figures, what to record next. Pure functions."""

from __future__ import annotations

from typing import Any

import numpy as np

from smoother.units import STANDARD_GRAVITY

from ..file import CalibrationFile
from ..protocol import Answer, Verdict
from .accelerometer import DOUBTED_SIGMA
from .magnetometer import LARGE_RESIDUAL, MagnetometerCalibration
from .sensor import sensor_name
from .sensor_calibration import SLOW_S, WHITE_S, ImuCalibration, SensorNoise

#: A better calibration than this is wasted on a wrist: half a milliradian of gravity, m/s^2.
GOOD_SIGMA = 0.005


def imu_answer(calibration: ImuCalibration) -> Answer:
    """Accelerometer and gyroscope in the form that every calibration answers in."""
    acc, gyro, tables = calibration.accelerometer, calibration.gyroscope, calibration.tables()
    sentences, remarks = imu_verdict(calibration), acc.remarks if acc is not None else ()
    figures: dict[str, Any] = {
        "imu": calibration.name,
        "rests": len(calibration.rests),
        "poses": calibration.rests.poses,
        "gravity": calibration.gravity,
        "accelerometer": {**tables.get("accelerometer", {})},
        "gyroscope": {**tables["gyroscope"], "rule": gyro.rule, "samples": gyro.samples},
        "noise": noise_rows(calibration),
    }
    if acc is not None:
        figures["accelerometer"] |= {
            "covariance": acc.covariance,
            "worst_direction": acc.worst_direction,
            "residual": acc.residual,
            "remarks": acc.remarks,
        }
    for name, noise in (
        ("accelerometer", calibration.accelerometer_noise),
        ("gyroscope", calibration.gyroscope_noise),
    ):
        if noise is not None:
            figures[name]["allan"] = {
                "tau_s": noise.tau_s,
                "deviation": noise.deviation,
                "noise_density": noise.density,
                "bias_instability": noise.instability,
                "random_walk": noise.walk,
            }
    advice = [sentence for sentence in imu_next(calibration) if sentence not in remarks]
    good = acc is not None and acc.worst_sigma < DOUBTED_SIGMA
    return Answer(
        Verdict("good" if good else "usable", sentences[0], tuple(sentences[1:]), tuple(advice)),
        tuple(remarks),
        CalibrationFile().with_table("imu", {sensor_name(calibration.name): tables}),
        figures,
    )


def magnetometer_answer(calibration: MagnetometerCalibration, imu_name: str) -> Answer:
    """Hard and soft iron in the form that every calibration answers in."""
    sentences = magnetometer_verdict(calibration)
    table = {
        "offset": calibration.offset.tolist(),
        "matrix": calibration.matrix.tolist(),
        "residual_rms": calibration.residual,
        "samples": calibration.samples,
    }
    figures = {
        **table,
        "radii": calibration.radii,
        "largest_hole_rad": calibration.coverage.hole_rad,
        "covered_share": calibration.coverage.share,
        "remarks": calibration.remarks,
    }
    advice = [sentence for sentence in magnetometer_next(calibration) if sentence not in calibration.remarks]
    grade = "usable" if calibration.remarks else "good"
    return Answer(
        Verdict(grade, sentences[0], tuple(sentences[1:]), tuple(advice)),
        calibration.remarks,
        CalibrationFile().with_table("imu", {sensor_name(imu_name): {"magnetometer": table}}),
        {"imu": imu_name, "magnetometer": figures},
    )


def imu_verdict(calibration: ImuCalibration) -> list[str]:
    """What was found and whether it serves."""
    said = []
    acc = calibration.accelerometer
    if acc is not None:
        word = (
            "very well"
            if acc.worst_sigma < GOOD_SIGMA
            else "well"
            if acc.worst_sigma < DOUBTED_SIGMA
            else "roughly"
        )
        said.append(
            f"{acc.poses} rest poses determine the accelerometer {word}: corrected, gravity's length is known"
            f" to {acc.sigma:.4f} m/s^2 on average and {acc.worst_sigma:.4f} in the worst direction"
        )
        before = float(
            np.sqrt(np.mean((np.linalg.norm(calibration.rests.acc, axis=1) - calibration.gravity) ** 2))
        )
        said.append(
            f"gravity at rest was off by {before:.3f} m/s^2 (root mean square) before the correction, and"
            f" by {acc.rms:.4f} now"
        )
    else:
        said.append(
            "this is one long rest: it gives the noise and the gyroscope's bias, not the accelerometer"
        )
    degrees = np.degrees(calibration.gyroscope.offset)
    source = (
        f"the mean of {calibration.gyroscope.samples} still samples"
        if calibration.gyroscope.rule == "rest"
        else f"the running mean of {calibration.gyroscope.samples} stable samples, as the sensor never"
        " lay still for long"
    )
    said.append(
        f"the gyroscope's bias is {degrees[0]:+.3f}, {degrees[1]:+.3f}, {degrees[2]:+.3f} degrees/s, {source}"
    )
    return said


#: Noise figures in a datasheet's units: sensor, name and unit, attribute, factor.
_DATASHEET = (
    ("accelerometer", "noise density, µg/√Hz", "density", 1e6 / STANDARD_GRAVITY),
    ("accelerometer", "bias instability, µg", "instability", 1e6 / STANDARD_GRAVITY),
    ("accelerometer", "random walk, µg/√s", "walk", 1e6 / STANDARD_GRAVITY),
    ("gyroscope", "noise density, degrees/s/√Hz", "density", np.degrees(1.0)),
    ("gyroscope", "angle random walk, degrees/√h", "density", 60.0 * np.degrees(1.0)),
    ("gyroscope", "bias instability, degrees/h", "instability", 3600.0 * np.degrees(1.0)),
    ("gyroscope", "random walk, degrees/s/√s", "walk", np.degrees(1.0)),
)


def noise_rows(calibration: ImuCalibration) -> list[dict[str, Any]]:
    """Noise figures in a datasheet's units, a row a figure."""
    noises = {
        "accelerometer": calibration.accelerometer_noise,
        "gyroscope": calibration.gyroscope_noise,
    }
    return [
        {"sensor": sensor, "figure": name, "x, y, z": factor * getattr(noises[sensor], attribute)}
        for sensor, name, attribute, factor in _DATASHEET
        if noises[sensor] is not None
    ]


def imu_next(calibration: ImuCalibration) -> list[str]:
    """What to record next time."""
    said = list(calibration.accelerometer.remarks) if calibration.accelerometer is not None else []
    if calibration.accelerometer is None:
        said.append(
            "for offset, scale and cross-axis: twelve rest poses of three seconds each, the sensor on its six"
            " sides and on six edges between them"
        )
    if calibration.gyroscope.rule == "running":
        said.append("for the gyroscope's bias: leave the sensor lying for five seconds while it records")
    noise = calibration.gyroscope_noise
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
            f"bias instability or random walk did not show in {noise.duration_s / 60.0:.0f} minutes; a longer"
            " rest at an even temperature may show them"
        )
    return said


def not_seen(noise: SensorNoise) -> bool:
    """Whether a slow part of the noise stayed hidden."""
    return bool(np.isnan(noise.instability).all() or np.isnan(noise.walk).all())


def magnetometer_verdict(calibration: MagnetometerCalibration) -> list[str]:
    """What was found and whether it serves."""
    mean = float(np.mean(calibration.radii))
    shift = float(np.linalg.norm(calibration.offset)) / mean
    longer = float(calibration.radii[2] / calibration.radii[0]) - 1.0
    word = "well" if not calibration.remarks else "roughly"
    return [
        f"{calibration.samples} samples determine the magnetometer {word}: they lie"
        f" {100 * calibration.residual:.1f} % off the ellipsoid (root mean square)",
        f"hard iron shifts the field by {100 * shift:.0f} % of its strength, soft iron makes it"
        f" {100 * longer:.0f} % longer in one direction than in another",
        f"{100 * calibration.coverage.share:.0f} % of the sphere's cells were covered, the largest hole"
        f" reaches {np.degrees(calibration.coverage.hole_rad):.0f} degrees",
    ]


def magnetometer_next(calibration: MagnetometerCalibration) -> list[str]:
    """What to record next time."""
    said = list(calibration.remarks)
    if calibration.residual > 0.5 * LARGE_RESIDUAL:
        said.append(
            "turn the sensor on one spot rather than carrying it about, half a metre from iron, loudspeakers"
            " and telephones"
        )
    said.append(
        "calibrate again when the sensor's battery, case or strap buckle changes: iron on it moves the field"
    )
    return said
