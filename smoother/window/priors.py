"""What a window is told before anything was solved: from calibration, configuration and start values."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..calibration import ArmCalibration, Length, LeverArm
from ..config import Config
from ..linalg import robust_sigma
from ..measurements.alignment import Alignment
from ..measurements.segment import Segment
from ..recording import JOINTS, FloatArray, ImuStream
from .cut import PreparedSegment
from .problem import NoiseModel, Priors
from .shared import Gaussian, SharedLayout, axes_across

#: How well gravity's direction is known from the start values, rad.
GRAVITY_SIGMA_RAD = 0.2
#: Sensor noise that was measured counts for no less than this part of the configured one.
LEAST_DENSITY_SHARE = 0.3
#: The upper arm's length is never believed to vary more than this, m.
LARGEST_UPPER_ARM_SIGMA_M = 0.04


@dataclass(frozen=True)
class Start:
    """What start values say of the shared quantities.

    Attributes
    ----------
    down : (3,) direction of gravity in {K}, and how well it is known, rad.
    gyroscope_bias : (3,) rad/s.
    has_shoulder : the camera saw the shoulder.
    """

    down: FloatArray
    down_sigma_rad: float
    gyroscope_bias: FloatArray
    has_shoulder: bool


def start_of(
    prepared_segments: list[PreparedSegment], alignments: list[Alignment], segments: list[Segment]
) -> Start:
    """Start values from the longest of the stretches."""
    longest = int(np.argmax([len(prepared.t) for prepared in prepared_segments]))
    down = -alignments[longest].R_K_E.apply([0.0, 0.0, 1.0]).mean(axis=0)
    sigma_rad = segments[longest].down_sigma_rad
    if sigma_rad is not None:  # a base IMU knows it better than the arm's motion
        down = segments[longest].down
    return Start(
        down=down,
        down_sigma_rad=GRAVITY_SIGMA_RAD if sigma_rad is None else sigma_rad,
        gyroscope_bias=segments[longest].attitude.gyroscope_bias,
        has_shoulder=any(
            prepared.accepted[:, JOINTS.index("shoulder")].any() for prepared in prepared_segments
        ),
    )


def first_priors(start: Start, calibration: ArmCalibration, config: Config) -> Priors:
    """The same priors for every window of a first pass."""
    layout = SharedLayout(
        joints=tuple(joint for joint in JOINTS if joint in calibration.lever_arms),
        has_upper_arm=start.has_shoulder and "elbow" in calibration.lever_arms,
        gravity_axes=axes_across(start.down),
    )
    mean, variance = np.zeros(layout.size), np.ones(layout.size)
    mean[:3] = 0.0 if calibration.accelerometer_bias is None else calibration.accelerometer_bias
    mean[3:6] = start.gyroscope_bias
    variance[:3], variance[3:6] = (
        config.imu.accelerometer_bias_sigma**2,
        config.imu.gyroscope_bias_sigma**2,
    )
    variance[layout.gravity] = start.down_sigma_rad**2
    if layout.has_upper_arm:
        known = calibration.upper_arm or Length(config.arm.upper_arm_m, config.arm.upper_arm_sigma_m)
        mean[layout.upper_arm], variance[layout.upper_arm] = known.value_m, known.sigma_m**2
    for joint in layout.joints:
        lever = calibration.lever_arms[joint]
        mean[layout.lever(joint)], variance[layout.lever(joint)] = lever.position_m, lever.sigma_m**2
    walk = np.repeat([config.imu.accelerometer_bias_walk, config.imu.gyroscope_bias_walk], 3)
    return Priors(layout, Gaussian(mean, np.diag(variance)), walk)


def upper_arm_seen(segments: list[Segment], config: Config) -> Length:
    """Median distance from shoulder to elbow while both are seen; the configured length without any."""
    shoulder, elbow = JOINTS.index("shoulder"), JOINTS.index("elbow")
    lengths = [
        np.linalg.norm(segment.position[both, elbow] - segment.position[both, shoulder], axis=1)
        for segment in segments
        if (both := segment.accepted[:, shoulder] & segment.accepted[:, elbow]).any()
    ]
    if not lengths:
        return Length(config.arm.upper_arm_m, config.arm.upper_arm_sigma_m)
    return Length(float(np.median(np.concatenate(lengths))), config.arm.upper_arm_sigma_m)


def upper_arm_length_sigma(segments: list[Segment], config: Config, sample_m: float) -> float:
    """How far from constant the upper arm's length is as the camera sees it, m (one sigma).

    The shoulder's joint moves in a real arm, and a skeleton follows it badly: what the visible lengths
    vary more than the joints' noise explains (`sample_m`, m an axis).
    """
    shoulder, elbow = JOINTS.index("shoulder"), JOINTS.index("elbow")
    lengths = [
        np.linalg.norm(segment.position[both, elbow] - segment.position[both, shoulder], axis=1)
        for segment in segments
        if (both := segment.accepted[:, shoulder] & segment.accepted[:, elbow]).sum() > 10
    ]
    if not lengths:
        return config.arm.upper_arm_flex_m
    spread = float(robust_sigma(np.concatenate([length - np.median(length) for length in lengths])))
    extra = float(np.sqrt(max(spread**2 - 2.0 * sample_m**2, 0.0)))
    return float(np.clip(extra, config.arm.upper_arm_flex_m, LARGEST_UPPER_ARM_SIGMA_M))


def with_measured_noise(config: Config, imu: ImuStream) -> Config:
    """The configuration with the sensor's own white noise where somebody measured it.

    What a configuration states itself counts more. The default stands for a consumer device with all that
    a model of it lacks; of a quiet sensor a part of that stays (`LEAST_DENSITY_SHARE`).
    """
    measured = {
        name: max(value, LEAST_DENSITY_SHARE * getattr(config.imu, name))
        for name in ("accelerometer_density", "gyroscope_density")
        if (value := getattr(imu, name)) is not None and name not in config.imu.model_fields_set
    }
    return config.model_copy(update={"imu": config.imu.model_copy(update=measured)}) if measured else config


def noise_of(config: Config, upper_arm_sigma_m: float) -> NoiseModel:
    """The configuration's densities and losses, and the upper arm's flex, as the graph takes them."""
    return NoiseModel(
        accelerometer_density=config.imu.accelerometer_density,
        gyroscope_density=config.imu.gyroscope_density,
        accelerometer_share=config.imu.accelerometer_share,
        gyroscope_share=config.imu.gyroscope_share,
        cauchy=config.camera.cauchy,
        upper_arm_sigma_m=round(upper_arm_sigma_m, 4),
        shoulder_walk=config.arm.shoulder_walk,
    )


def calibration_from(
    found: Gaussian, layout: SharedLayout, before: ArmCalibration, joint_bias_m: float
) -> ArmCalibration:
    """The arm's calibration from the constants' Gaussian (`firstpass.combine`).

    Parameters
    ----------
    joint_bias_m : constant error of the camera's joints, m an axis; what all have in common goes into
        the lever arms and lengths and shows in no residual, so it widens their sigmas.
    """
    sigma = np.hypot(np.sqrt(np.diag(found.covariance)), joint_bias_m)
    start = layout.constants.start
    levers = dict(before.lever_arms)
    for joint in layout.joints:
        rows = slice(layout.lever(joint).start - start, layout.lever(joint).stop - start)
        levers[joint] = LeverArm(found.mean[rows], sigma[rows])
    upper_arm = before.upper_arm
    if layout.has_upper_arm:
        upper_arm = Length(float(found.mean[0]), float(sigma[0]))
    return replace(before, lever_arms=levers, upper_arm=upper_arm)
