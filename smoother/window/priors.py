"""Priors before anything was solved: from calibration, configuration and initial values."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from ..array_types import FloatArray
from ..body import FOREARM
from ..calibration import ArmCalibration, Length, LeverArm
from ..config import Anatomy, ArmPrior, Config
from ..linalg import robust_sigma, unit
from ..measurements.alignment import Alignment
from ..measurements.rays import is_alone
from ..measurements.segment import Segment
from ..recording import JOINTS, ImuStream, JointTracks
from .prepare import PreparedSegment, further_segments
from .problem import NoiseModel, Priors
from .shared import Gaussian, SharedLayout, axes_across

#: How well gravity's direction is known from the initial values, rad.
GRAVITY_SIGMA_RAD = 0.2
#: Sensor noise that was measured counts for no less than this share of the configured one.
LEAST_DENSITY_SHARE = 0.3
#: Forearm and upper arm, joint to joint, as parts of the height (Drillis and Contini, Body Segment
#: Parameters, 1966), how far a person's are from that as a part of themselves, and how far joints are from
#: where networks see them, along the limb, m.
FOREARM_PART, UPPER_ARM_PART = 0.146, 0.186
LIMB_SCATTER, LIMB_JOINTS_M = 0.05, 0.012
#: Height and its standard deviation, m: stated, and where it is not.
HEIGHT_SIGMA_M = 0.01
USUAL_HEIGHT_M = {Anatomy.ADULT: (1.70, 0.10), Anatomy.CHILD: (1.30, 0.20), Anatomy.ANY: (1.60, 0.40)}
#: A length of which nothing is known yet, m.
UNKNOWN_M = 1.0
#: The upper arm's length varies by no more than this, m.
LARGEST_UPPER_ARM_SIGMA_M = 0.04
#: How the shoulder moves is read off means over this time, s, this many of them apart; of the largest moves
#: the share beyond the quantile is treated as jumps of the tracker. Fewer pairs are ignored.
SHOULDER_STEP_S, SHOULDER_APART = 0.2, 2
SHOULDER_QUANTILE, FEWEST_PAIRS = 0.98, 20


@dataclass(frozen=True)
class InitialValues:
    """Initial values of the shared quantities."""

    down: FloatArray  # (3,): direction of gravity in {K}
    down_sigma_rad: float  # How well it is known, per axis
    gyroscope_bias: FloatArray  # (3,) rad/s: in {A}
    has_shoulder: bool  # The camera saw the shoulder
    # dict of (6,) m/s^2 and rad/s: Of IMUs on further segments, by the segment's name
    biases: dict[str, FloatArray] = field(default_factory=dict)
    lone_rays: bool = False  # All that was seen is of one camera without depth


def initial_values(
    prepared_segments: list[PreparedSegment], alignments: list[Alignment], segments: list[Segment]
) -> InitialValues:
    """Initial values from the longest of the segments."""
    longest = int(np.argmax([len(prepared.t) for prepared in prepared_segments]))
    down = -alignments[longest].R_K_E.apply([0.0, 0.0, 1.0]).mean(axis=0)
    sigma_rad = segments[longest].down_sigma_rad
    if sigma_rad is not None:  # a base IMU knows it better than the arm's motion
        down = segments[longest].down
    return InitialValues(
        down=down,
        down_sigma_rad=GRAVITY_SIGMA_RAD if sigma_rad is None else sigma_rad,
        gyroscope_bias=segments[longest].attitude.gyroscope_bias,
        has_shoulder=any(
            prepared.accepted[:, JOINTS.index("shoulder")].any() for prepared in prepared_segments
        ),
        lone_rays=all(is_alone(prepared.ray_origin_m) for prepared in prepared_segments),
    )


def first_priors(initial: InitialValues, calibration: ArmCalibration, config: Config) -> Priors:
    """The prior on what the windows of a recording share."""
    layout = SharedLayout(
        joints=tuple(joint for joint in JOINTS if joint in calibration.lever_arms),
        has_upper_arm=initial.has_shoulder and "elbow" in calibration.lever_arms,
        gravity_axes=axes_across(initial.down),
        further=further_segments(calibration),
    )
    mean, variance = np.zeros(layout.size), np.ones(layout.size)
    mean[:3] = 0.0 if calibration.accelerometer_bias is None else calibration.accelerometer_bias
    mean[3:6] = initial.gyroscope_bias
    variance[:3], variance[3:6] = config.imu.accelerometer_bias_sigma**2, config.imu.gyroscope_bias_sigma**2
    variance[layout.gravity] = initial.down_sigma_rad**2
    if layout.has_upper_arm:
        upper_arm = calibration.upper_arm or Length(config.arm.upper_arm_m, config.arm.upper_arm_sigma_m)
        mean[layout.upper_arm], variance[layout.upper_arm] = upper_arm.value_m, upper_arm.sigma_m**2
    for segment in layout.segments:
        own = calibration.lever_arms if segment == FOREARM.name else calibration.mountings[segment].lever_arms
        for joint, rows in layout.levers(segment).items():
            mean[rows], variance[rows] = own[joint].position_m, own[joint].sigma_m ** 2
    for segment in layout.further:
        mean[layout.bias_of(segment)] = initial.biases.get(segment, 0.0)
        variance[layout.bias_of(segment)] = variance[layout.bias]
    walk = np.repeat([config.imu.accelerometer_bias_walk, config.imu.gyroscope_bias_walk], 3)
    shared = Gaussian(mean, np.diag(variance))
    if initial.lone_rays and {"elbow", "wrist"} <= set(layout.joints):
        shared = with_limb_lengths(shared, layout, limb_lengths(config.arm))
    return Priors(layout, shared, walk)


def limb_lengths(arm: ArmPrior) -> Gaussian:
    """How long forearm and upper arm (2,) m are of a person of some height, or of anybody."""
    known = arm.height_m is not None
    height_m, sigma_m = (arm.height_m or 0.0, HEIGHT_SIGMA_M) if known else USUAL_HEIGHT_M[arm.anatomy]
    parts = np.array([FOREARM_PART, UPPER_ARM_PART])
    own = np.diag((LIMB_SCATTER * height_m * parts) ** 2 + LIMB_JOINTS_M**2)
    return Gaussian(height_m * parts, own + sigma_m**2 * np.outer(parts, parts))


def with_limb_lengths(shared: Gaussian, layout: SharedLayout, lengths: Gaussian) -> Gaussian:
    """A Gaussian on the shared vector that knows how long the limbs of a person are."""
    mean, covariance = shared.mean.copy(), shared.covariance.copy()
    elbow, wrist = layout.lever("elbow"), layout.lever("wrist")
    along = unit(mean[wrist] - mean[elbow])
    rows = np.zeros((1 + int(layout.has_upper_arm), layout.size))
    rows[0, wrist], rows[0, elbow] = along, -along
    if layout.has_upper_arm:
        rows[1, layout.upper_arm] = 1.0
        mean[layout.upper_arm] = lengths.mean[1]
        covariance[layout.upper_arm] = covariance[:, layout.upper_arm] = 0.0
        covariance[layout.upper_arm, layout.upper_arm] = UNKNOWN_M**2
    count, told = len(rows), rows @ covariance
    gain = np.linalg.solve(told @ rows.T + lengths.covariance[:count, :count], told).T
    mean = mean + gain @ (lengths.mean[:count] - rows @ mean)
    covariance = covariance - gain @ told
    return Gaussian(mean, 0.5 * (covariance + covariance.T))


def upper_arm_seen(segments: list[Segment], config: Config) -> Length:
    """Median distance from shoulder to elbow where both are visible; the configured length without any."""
    lengths = _upper_arm_lengths(segments, fewest=1)
    if not lengths:
        return Length(config.arm.upper_arm_m, config.arm.upper_arm_sigma_m)
    return Length(float(np.median(np.concatenate(lengths))), config.arm.upper_arm_sigma_m)


def upper_arm_length_sigma(segments: list[Segment], config: Config, sample_m: float) -> float:
    """How far from constant the upper arm's length is as the camera sees it."""
    lengths = _upper_arm_lengths(segments, fewest=11)
    if not lengths:
        return config.arm.upper_arm_flex_m
    spread = float(robust_sigma(np.concatenate([length - np.median(length) for length in lengths])))
    extra = float(np.sqrt(max(spread**2 - 2.0 * sample_m**2, 0.0)))
    return float(np.clip(extra, config.arm.upper_arm_flex_m, LARGEST_UPPER_ARM_SIGMA_M))


def _upper_arm_lengths(segments: list[Segment], fewest: int) -> list[FloatArray]:
    """Distances from shoulder to elbow, segment by segment; a segment with fewer does not count."""
    lengths = [segment.distances("elbow", "shoulder", segment.accepted) for segment in segments]
    return [each for each in lengths if len(each) >= fewest]


def with_measured_noise(config: Config, imu: ImuStream) -> Config:
    """The configuration with the sensor's own white noise where somebody measured it."""
    measured = {
        name: max(value, LEAST_DENSITY_SHARE * getattr(config.imu, name))
        for name in ("accelerometer_density", "gyroscope_density")
        if (value := getattr(imu, name)) is not None and name not in config.imu.model_fields_set
    }
    return config.model_copy(update={"imu": config.imu.model_copy(update=measured)}) if measured else config


def with_measured_shoulder(config: Config, arm: JointTracks) -> Config:
    """The configuration with a shoulder that wanders as fast as the camera sees it move, if that is
    faster.
    """
    rows = np.flatnonzero(arm.tracked("shoulder"))
    if "shoulder_walk" in config.arm.model_fields_set or len(rows) < 2:
        return config
    step = np.floor((np.asarray(arm.t_s)[rows] - arm.t_s[rows[0]]) / SHOULDER_STEP_S).astype(int)
    first = np.flatnonzero(np.diff(step, prepend=-1))
    count = np.diff(np.append(first, len(rows)))
    mean = np.add.reduceat(arm.joint("shoulder")[rows], first, axis=0) / count[:, None]
    number = step[first]
    later = np.searchsorted(number, number + SHOULDER_APART)
    pairs = np.flatnonzero(later < len(number))
    pairs = pairs[number[later[pairs]] == number[pairs] + SHOULDER_APART]
    if len(pairs) < FEWEST_PAIRS:
        return config
    moved = np.sum((mean[later[pairs]] - mean[pairs]) ** 2, axis=1)
    moved = np.minimum(moved, np.quantile(moved, SHOULDER_QUANTILE))  # a tracker jumps now and then
    walk = round(float(np.sqrt(moved.mean() / 3.0 / (SHOULDER_APART * SHOULDER_STEP_S))), 3)
    if walk <= config.arm.shoulder_walk:
        return config
    return config.model_copy(update={"arm": config.arm.model_copy(update={"shoulder_walk": walk})})


def noise_of(
    config: Config, upper_arm_sigma_m: float, calibration: ArmCalibration | None = None
) -> NoiseModel:
    """The configuration's densities and losses, the upper arm's sigma and soft tissue, for the graph."""
    return NoiseModel(
        accelerometer_density=config.imu.accelerometer_density,
        gyroscope_density=config.imu.gyroscope_density,
        accelerometer_share=config.imu.accelerometer_share,
        gyroscope_share=config.imu.gyroscope_share,
        cauchy=config.camera.cauchy,
        upper_arm_sigma_m=round(upper_arm_sigma_m, 4),
        shoulder_walk=config.arm.shoulder_walk,
        tissue_m=()
        if calibration is None
        else tuple((name, mounting.tissue_m) for name, mounting in calibration.mountings.items()),
    )


def calibration_from(
    constants: Gaussian, layout: SharedLayout, before: ArmCalibration, joint_bias_m: float
) -> ArmCalibration:
    """The arm's calibration from the Gaussian of its constants (`pooling.pooled`)."""
    sigma = np.hypot(np.sqrt(np.diag(constants.covariance)), joint_bias_m)

    def levers(segment: str) -> dict[str, LeverArm]:
        start = layout.constants.start
        rows_of = {
            joint: slice(rows.start - start, rows.stop - start)
            for joint, rows in layout.levers(segment).items()
        }
        return {joint: LeverArm(constants.mean[rows], sigma[rows]) for joint, rows in rows_of.items()}

    upper_arm = before.upper_arm
    if layout.has_upper_arm:
        upper_arm = Length(float(constants.mean[0]), float(sigma[0]))
    further = {name: replace(before.mountings[name], lever_arms=levers(name)) for name in layout.further}
    return replace(
        before,
        lever_arms=before.lever_arms | levers(FOREARM.name),
        upper_arm=upper_arm,
        mountings=before.mountings | further,
    )
