"""One window of the recording as plain arrays: what is asked of a graph, and what it answers.

Both travel between processes, so they hold arrays and numbers only.
"""

from __future__ import annotations

from dataclasses import dataclass

from ..recording import FloatArray, IntArray
from .shared import Gaussian, SharedLayout


@dataclass(frozen=True)
class Priors:
    """What a window is told about the quantities that it shares with the rest of the recording.

    Attributes
    ----------
    layout : where each stands in the vector.
    shared : the vector, bias at the window's middle.
    bias_walk : (6,) how far the bias wanders inside the window, unit/sqrt(s).
    """

    layout: SharedLayout
    shared: Gaussian
    bias_walk: FloatArray


@dataclass(frozen=True)
class ImuIncrements:
    """Equivalent IMU samples of the window's intervals (see `inertial.equivalent_samples`).

    Attributes
    ----------
    acc : (m, 2, 3), gyro : (m, 3), h : (m,) of the blocks, bias taken off already.
    first : (n,) index of each interval's first block and, last, m.
    bias : (6,) the bias that was taken off.
    velocity_error : (n - 1,) what knocks may have cost in each interval, m/s.
    """

    acc: FloatArray
    gyro: FloatArray
    h: FloatArray
    first: IntArray
    bias: FloatArray
    velocity_error: FloatArray


@dataclass(frozen=True)
class JointMeasurements:
    """A forearm joint's accepted camera samples.

    Attributes
    ----------
    joint : its name.
    t_s : (k,) frame times on the IMU's clock, s.
    node : (k,) index of the node each belongs to, increasing.
    position : (k, 3) m in {K}.
    sigma_m : (k,) standard deviation an axis, m.
    shift : (k, 3) joint at the frame less joint at the node, m in {K}, as the IMU has it; zero for a frame
        that is a node.
    velocity : (k, 3) joint's velocity at the frame less the IMU's at the node, m/s in {K}.
    """

    joint: str
    t_s: FloatArray
    node: IntArray
    position: FloatArray
    sigma_m: FloatArray
    shift: FloatArray
    velocity: FloatArray


@dataclass(frozen=True)
class ShoulderMeasurements:
    """The shoulder's knots: where the smooth shoulder has a variable.

    Attributes
    ----------
    node : (k,) node whose time the knot shares.
    position : (k, 3) m in {K}, nan where the camera saw none.
    sigma_m : (k,) m an axis.
    start : (k, 3) start value, m in {K}.
    """

    node: IntArray
    position: FloatArray
    sigma_m: FloatArray
    start: FloatArray


@dataclass(frozen=True)
class States:
    """Pose and velocity at the nodes: R_K_A (n, 3, 3), position (n, 3) m, velocity (n, 3) m/s in {K}."""

    R: FloatArray
    p: FloatArray
    v: FloatArray


@dataclass(frozen=True)
class FieldMeasurements:
    """A calibrated magnetometer's directions (see `magnetic`).

    Attributes
    ----------
    node : (k,) index of the node each belongs to.
    in_A : (k, 3) unit vectors in {A}.
    in_K : (3,) unit vector of the field in {K}.
    sigma_rad : of each, rad an axis.
    """

    node: IntArray
    in_A: FloatArray
    in_K: FloatArray
    sigma_rad: float


@dataclass(frozen=True)
class NoiseModel:
    """Densities and losses that all windows share.

    The `..._share` grow with the motion: what scale and mounting errors of the sensor cost, as a part of
    the specific force beyond gravity and of the angular rate, sqrt(s).
    """

    accelerometer_density: float
    gyroscope_density: float
    accelerometer_share: float
    gyroscope_share: float
    cauchy: float
    upper_arm_sigma_m: float
    shoulder_walk: float


@dataclass(frozen=True)
class Window:
    """A piece of the recording to solve: nodes t (n,), of which [core_start_s, core_end_s] is its own.

    `attitude` (3, 3) and its covariance, rad^2 in {K}, are a weak prior at one node: it keeps a direction
    which the data leave free from being free. `velocity_change` (n - 1,) m/s: how much the velocity may
    change in an interval, inf where nothing is said.
    """

    index: int
    t: FloatArray
    core_start_s: float
    core_end_s: float
    increments: ImuIncrements
    joint_measurements: tuple[JointMeasurements, ...]
    shoulder: ShoulderMeasurements | None
    start: States
    velocity_change: FloatArray
    attitude_node: int
    attitude: FloatArray
    attitude_covariance: FloatArray
    priors: Priors
    noise: NoiseModel
    gravity_magnitude: float
    field: FieldMeasurements | None = None


@dataclass(frozen=True)
class Message:
    """What a window found of the shared quantities: posterior, prior still inside, bias at t_s."""

    t_s: float
    shared: Gaussian


@dataclass(frozen=True)
class Solution:
    """A window's answer.

    Attributes
    ----------
    index : of the window.
    states : at the window's nodes.
    pose_covariance : (n, 6, 6) of (position, rotation vector) in {K}; None where not asked for.
    velocity_covariance : (n, 3, 3); None where not asked for.
    shoulder : (k, 3) knots, and shoulder_covariance (k, 3, 3).
    message : the shared quantities.
    bias : (n, 6) at the nodes.
    residuals : by joint, camera minus answer (k, 3) in the order of `JointMeasurements`.
    iterations, error : of the optimiser; `error` is half the weighted squared sum.
    offset_information : on a clock offset of the window's own, 1/s^2; 0 where not asked for.
    """

    index: int
    states: States
    pose_covariance: FloatArray | None
    velocity_covariance: FloatArray | None
    shoulder: FloatArray | None
    shoulder_covariance: FloatArray | None
    message: Message
    bias: FloatArray
    residuals: dict[str, FloatArray]
    iterations: int
    error: float
    offset_information: float = 0.0
