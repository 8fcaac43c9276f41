"""What an IMU on a moving body measures: exact averages over each sample, then the sensor's errors."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.interpolate import BSpline
from scipy.spatial.transform import Rotation

from ..array_types import FloatArray
from ..recording import ImuStream
from .config import SensorErrors
from .motion import BodyMeasures, TrunkTurn, band_noise, ramp

#: Orientations (N, 3, 3) from the IMU's axes and positions (N, 3) m at times (N,).
Pose = Callable[[FloatArray], tuple[FloatArray, FloatArray]]
#: At least this many points per second lie under every sample's average.
FINE_RATE_HZ = 1000.0
#: Samples worked on at a time, so that an hour fits in memory.
_CHUNK = 4000


def ideal_imu(
    imu_pose: Pose,
    duration_s: float,
    rate_hz: float,
    gravity: FloatArray,  # (3,) m/s^2
) -> ImuStream:
    """Error-free samples: the mean over each sample's interval, stamped at its centre."""
    count = int(np.floor(duration_s * rate_hz))
    parts = [
        _averages(imu_pose, begin, min(_CHUNK, count - begin), rate_hz, gravity)
        for begin in range(0, count, _CHUNK)
    ]
    acc, gyro = (np.concatenate(part) for part in zip(*parts, strict=True))
    return ImuStream("simulated", (np.arange(count, dtype=np.float64) + 0.5) / rate_hz, acc, gyro)


def _averages(
    imu_pose: Pose, begin: int, count: int, rate_hz: float, gravity: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Mean specific force and angular velocity (count, 3) in {A} of samples from number `begin` on."""
    fine = 2 * int(np.ceil(FINE_RATE_HZ / rate_hz / 2))  # even, for Simpson's rule
    h = 1.0 / (rate_hz * fine)
    t_s = begin / rate_hz + h * np.arange(-2, count * fine + 3, dtype=np.float64)
    R, p = imu_pose(t_s)
    acceleration = (-p[:-4] + 16 * p[1:-3] - 30 * p[2:-2] + 16 * p[3:-1] - p[4:]) / (12 * h * h)
    R_dot = (R[:-4] - 8 * R[1:-3] + 8 * R[3:-1] - R[4:]) / (12 * h)
    R_A_K = np.swapaxes(R[2:-2], 1, 2)
    spin = R_A_K @ R_dot
    rate = 0.5 * np.stack(
        [spin[:, 2, 1] - spin[:, 1, 2], spin[:, 0, 2] - spin[:, 2, 0], spin[:, 1, 0] - spin[:, 0, 1]], axis=1
    )
    force = np.einsum("nij,nj->ni", R_A_K, acceleration - gravity)
    weights = np.ones(fine + 1)
    weights[1:-1:2], weights[2:-1:2] = 4.0, 2.0
    weights /= weights.sum()
    means = [
        sum(w * values[k : k + count * fine : fine] for k, w in enumerate(weights))
        for values in (force, rate)
    ]
    return np.asarray(means[0]), np.asarray(means[1])


def _sensor(
    sensor: str, true: FloatArray, errors: SensorErrors, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """One triaxial sensor: its samples (N, 3), its bias (N, 3) and its matrix (3, 3) of scale and axes."""
    density, bias, walk = (getattr(errors, f"{sensor}_{error}") for error in ("noise", "bias", "walk"))
    rate_hz = errors.imu_rate_hz
    matrix = np.eye(3) + np.diag(errors.imu_scale * rng.normal(size=3))
    cross = np.radians(errors.imu_misalignment_deg) * rng.normal(size=(3, 3))
    matrix += cross - np.diag(np.diag(cross))
    steps = walk / np.sqrt(rate_hz) * rng.normal(size=true.shape)
    drift = bias * rng.normal(size=3) + np.cumsum(steps, axis=0)
    noise = density * np.sqrt(rate_hz) * rng.normal(size=true.shape)
    return true @ matrix.T + drift + noise, drift, matrix


def measure(
    ideal: ImuStream, errors: SensorErrors, rng: np.random.Generator
) -> tuple[ImuStream, dict[str, Any]]:
    """The samples with the sensor's errors.

    The model is measured = matrix @ true + bias + noise. A noise density d gives samples a
    standard deviation of d * sqrt(rate). What was drawn is returned by name, SI units: biases, their means
    (3,) and their course `..._bias_t` (N, 3), and matrices (3, 3).
    """
    samples, parameters = {}, {}
    for sensor, true in (("accelerometer", ideal.acc), ("gyroscope", ideal.gyro)):
        samples[sensor], bias, matrix = _sensor(sensor, true, errors, rng)
        parameters[f"{sensor}_bias"] = bias.mean(axis=0)
        parameters[f"{sensor}_bias_t"] = bias
        parameters[f"{sensor}_matrix"] = matrix
    imu = ImuStream(ideal.name, ideal.t_s, samples["accelerometer"], samples["gyroscope"])
    return imu, parameters


#: How a hand sways, and by how many metres where it does so by a degree.
_SWAY_HZ, _SWAY_M_A_DEG = (0.5, 3.0), 0.005


@dataclass(frozen=True)
class Held:
    """A body that is held in one pose after the other, and sways a little."""

    R_W: FloatArray  # (n, 3, 3): orientation in each pose, body to world
    p_W: FloatArray  # (n, 3) m
    hold_s: float  # Time in a pose
    move_s: float  # From one to the next
    sway_deg: float = 0.0  # Rms of the sway
    seed: int = 0  # Of the sway

    @property
    def duration_s(self) -> float:
        """From the start of the first hold to the end of the last."""
        return len(self.R_W) * self.hold_s + (len(self.R_W) - 1) * self.move_s

    def imu_pose(self, t_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Orientation (N, 3, 3) and position (N, 3) m in {W}: minimum jerk between the poses."""
        poses, count = Rotation.from_matrix(self.R_W), len(self.R_W)
        step = (poses[:-1].inv() * poses[1:]).as_rotvec()
        middles = (np.arange(count) + 0.5) * self.hold_s + np.arange(count) * self.move_s
        R = np.tile(self.R_W[0], (len(t_s), 1, 1))
        p = np.tile(self.p_W[0], (len(t_s), 1))
        for i, begin in enumerate(middles[:-1] + self.hold_s / 2):
            now = t_s >= begin
            share = ramp(t_s[now], begin, self.move_s)[:, None]
            R[now] = (poses[i] * Rotation.from_rotvec(share * step[i])).as_matrix()
            p[now] = self.p_W[i] + share * (self.p_W[i + 1] - self.p_W[i])
        if self.sway_deg > 0:
            sway = self.sway_deg * band_noise(t_s, *_SWAY_HZ, 6, np.random.default_rng(self.seed))
            R = R @ Rotation.from_rotvec(np.radians(sway[:, :3]) / np.sqrt(3)).as_matrix()
            p = p + _SWAY_M_A_DEG * sway[:, 3:]
        return R, p


#: Where an IMU is in a segment's axes, (3,) m, and (3, 3) from its own axes to the segment's.
Mount = tuple[FloatArray, FloatArray]


def draw_upper_mount(measures: BodyMeasures, rng: np.random.Generator) -> Mount:
    """Somewhere in the middle of the upper arm's outer side, turned as it comes."""
    roll = Rotation.from_euler("y", rng.uniform(-60, 60), degrees=True)
    axes = roll * Rotation.from_euler("z", rng.uniform(-180, 180), degrees=True)
    tilt = Rotation.from_rotvec(rng.normal(0, 5, 3), degrees=True)
    along = -rng.uniform(0.35, 0.6) * measures.upper_arm
    off = roll.apply([0.0, 0.0, rng.uniform(0.040, 0.055)])
    return off + np.array([0.0, along, 0.0]), (axes * tilt).as_matrix()


def draw_hand_mount(measures: BodyMeasures, rng: np.random.Generator) -> Mount:
    """On the back of the hand (x of {F}), about its middle, turned as it comes."""
    face = Rotation.from_matrix([[0, 0, 1], [1, 0, 0], [0, 1, 0]])  # z of the IMU along x
    turn = Rotation.from_euler("z", rng.uniform(-180, 180), degrees=True)
    tilt = Rotation.from_rotvec(rng.normal(0, 6, 3), degrees=True)
    place = np.array([rng.uniform(0.018, 0.026), rng.uniform(0.5, 0.9) * measures.hand, rng.normal(0, 0.006)])
    return place, (face * turn * tilt).as_matrix()


@dataclass(frozen=True)
class SegmentImuMotion:
    """The IMU on a segment of an arm in motion; the tissue turns it about the bone's axis beneath it.

    The segment's y axis lies along it ({U} as in `body` points from the shoulder to the elbow); its origin is
    the joint with the forearm.
    """

    bone: Pose  # Of the segment: its origin (N, 3) m in {K}, and its axes (N, 3, 3)
    mount: Mount
    wobble: BSpline  # (N, 3) rad

    def levers(self, joints: Mapping[str, float]) -> dict[str, FloatArray]:
        """Joints (3,) in the IMU's axes, m, by where they are along y; of an IMU that sits as put on."""
        place, axes = self.mount
        return {joint: axes.T @ (np.array([0.0, along, 0.0]) - place) for joint, along in joints.items()}

    def imu_pose(self, t_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Orientation (N, 3, 3) from the IMU's axes to {K}, and its position (N, 3) m in {K}."""
        (origin, R_K_S), (place, axes) = self.bone(t_s), self.mount
        tissue = Rotation.from_rotvec(self.wobble(t_s)).as_matrix()
        beneath = place * [0.0, 1.0, 0.0]
        in_segment = beneath + tissue @ (place - beneath)
        return R_K_S @ tissue @ axes, origin + np.einsum("nij,nj->ni", R_K_S, in_segment)


#: Where it sits, on the breastbone, m in {T}.
BREASTBONE = np.array([0.0, -0.10, -0.12])
#: {T} of the simulation (x right, y up, z back) to the ISB's thorax (x forward, y up, z right).
R_ISB_T = np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])


@dataclass(frozen=True)
class TrunkImuMotion:
    """The trunk with its IMU."""

    R_K_T: FloatArray  # (3, 3): axes of the upright trunk to the camera's
    origin_K: FloatArray  # (3,) m: origin of {T} in {K}
    turn: TrunkTurn
    axes: FloatArray  # (3, 3): maps a vector from the IMU's axes {D} to {T}

    @property
    def R_T_D(self) -> FloatArray:
        """From {D} to the thorax's axes as the ISB has them, (3, 3)."""
        return R_ISB_T @ self.axes

    def thorax(self, t_s: FloatArray) -> FloatArray:
        """The thorax's axes as the ISB has them, in {K}, (N, 3, 3)."""
        return self.R_K_T @ self.turn.at(t_s) @ R_ISB_T.T

    def imu_pose(self, t_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Orientation (N, 3, 3) from {D} to {K}, and its position (N, 3) m in {K}."""
        place = self.turn.moved(np.tile(BREASTBONE, (len(t_s), 1)), t_s)
        return self.R_K_T @ self.turn.at(t_s) @ self.axes, place @ self.R_K_T.T + self.origin_K


def draw_trunk_axes(rng: np.random.Generator) -> FloatArray:
    """The IMU's orientation on the breastbone: turned at random, a little tilted, (3, 3) from {D} to {T}."""
    turn = Rotation.from_euler("z", rng.uniform(-180, 180), degrees=True)
    tilt = Rotation.from_rotvec(rng.normal(0, 12, 3), degrees=True)
    return np.asarray((tilt * turn).as_matrix())
