"""The arm's IMU as an inertial navigation state with errors to estimate: what `rts` linearises.

State at a node: position p, velocity v (m, m/s in {K}), `R_K_A`, accelerometer and gyroscope bias in {A},
gravity g and the shoulder s in {K}. The error is additive, of the orientation a rotation vector in {K}:
R = Exp(theta) R_hat.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from .. import units
from ..array_types import BoolArray, FloatArray
from ..config import ImuNoise
from ..linalg import skew
from ..measurements.alignment import lever_of
from ..measurements.inertial import InertialSignal, Preintegration
from ..recording import FOREARM_JOINTS, JOINTS
from ..window.problem import States
from ..window.trajectory import SegmentTrajectory, at_times
from .scene import Scene

#: Rows of the error state.
P, V, TURN, ACC_BIAS, GYRO_BIAS, GRAVITY, SHOULDER = (slice(3 * k, 3 * k + 3) for k in range(7))
SIZE = 21
#: Error of the integration itself, m^2/s.
INTEGRATION_VARIANCE = 1e-6


@dataclass(frozen=True)
class InertialTrajectory:
    """States at the nodes.

    Attributes
    ----------
    t : ndarray, shape (n,), s
    p, v : ndarray, shape (n, 3), m and m/s
        Of the IMU in {K}.
    R : ndarray, shape (n, 3, 3)
        Orientation `R_K_A`.
    bias : ndarray, shape (n, 6), m/s^2 and rad/s
        Of accelerometer and gyroscope in {A}.
    gravity : ndarray, shape (n, 3), m/s^2
        In {K}.
    shoulder : ndarray, shape (n, 3), m
        In {K}.
    """

    t: FloatArray
    p: FloatArray
    v: FloatArray
    R: FloatArray
    bias: FloatArray
    gravity: FloatArray
    shoulder: FloatArray

    def moved(self, error: FloatArray) -> InertialTrajectory:
        """The states with errors (n, 21) added."""
        return InertialTrajectory(
            self.t,
            self.p + error[:, P],
            self.v + error[:, V],
            Rotation.from_rotvec(error[:, TURN]).as_matrix() @ self.R,
            self.bias + error[:, ACC_BIAS.start : GYRO_BIAS.stop],
            self.gravity + error[:, GRAVITY],
            self.shoulder + error[:, SHOULDER],
        )


def orientation_at(scene: Scene, t: FloatArray) -> FloatArray:
    """The scene's `R_K_A` (k, 3, 3) at times (k,) s, held beyond its ends."""
    curve = Slerp(scene.t, Rotation.from_matrix(scene.R_K_A))
    return curve(np.clip(t, scene.t[0], scene.t[-1])).as_matrix()


def seen_joints(scene: Scene) -> BoolArray:
    """(f, 5) joints that have an accepted position."""
    return np.isfinite(scene.joints[:, :, 0])


def levers_of(scene: Scene) -> dict[str, FloatArray]:
    """Lever arms (3,) m in {A} of the forearm's joints that have one and are seen in the scene."""
    ever_seen = seen_joints(scene).sum(axis=0) > 0
    levers = {joint: lever_of(scene.calibration, joint) for joint in FOREARM_JOINTS}
    return {
        joint: lever
        for joint, lever in levers.items()
        if lever is not None and ever_seen[JOINTS.index(joint)]
    }


def turned(R: FloatArray, reference: FloatArray) -> FloatArray:
    """Rotation vectors (..., 3) in {K} that take the reference to R, both (..., 3, 3)."""
    return np.asarray(Rotation.from_matrix(R @ np.swapaxes(reference, -1, -2)).as_rotvec())


def white_sigma(scene: Scene) -> float:
    """Noise of the scene's point for a method of independent samples, m an axis."""
    effective = scene.point_effective_sigma_m
    return float(effective) if np.isfinite(effective) else scene.point_sigma_m


def joint_sigma(scene: Scene) -> float:
    """The same of one joint, where the point is the mean of those that are usually seen."""
    columns = [JOINTS.index(joint) for joint in levers_of(scene)]
    usual = int((seen_joints(scene)[scene.visible][:, columns].mean(axis=0) > 0.25).sum())
    return white_sigma(scene) * float(np.sqrt(max(usual, 1)))


def predict(states: InertialTrajectory, motion: Preintegration) -> tuple[FloatArray, FloatArray, FloatArray]:
    """p, v (n - 1, 3) and R (n - 1, 3, 3) of the next nodes by the IMU from each node's state.

    Forster et al., IEEE Trans. Robotics 33:1-21 (2017), eq 33.
    """
    h, g, R = motion.dt[:, None], states.gravity[:-1], states.R[:-1]
    p = states.p[:-1] + states.v[:-1] * h + 0.5 * g * h**2 + np.einsum("nij,nj->ni", R, motion.delta_p)
    v = states.v[:-1] + g * h + np.einsum("nij,nj->ni", R, motion.delta_v)
    return p, v, R @ motion.delta_R


def transition(states: InertialTrajectory, motion: Preintegration) -> FloatArray:
    """Jacobian (n - 1, 21, 21) of the next node's error to this one's, over a whole interval.

    Sola, Quaternion kinematics for the error-state Kalman filter (arXiv 1711.02508, 2017), section 7 (global
    angular errors). Bias derivatives hold the rotation inside an interval to first order.
    """
    h, R = motion.dt[:, None, None], states.R[:-1]
    eye = np.eye(3)
    middle = 0.5 * (R + R @ motion.delta_R)
    F = np.tile(np.eye(SIZE), (len(motion.dt), 1, 1))
    F[:, P, V], F[:, V, GRAVITY], F[:, P, GRAVITY] = h * eye, h * eye, 0.5 * h**2 * eye
    F[:, P, TURN] = -skew(np.einsum("nij,nj->ni", R, motion.delta_p))
    F[:, V, TURN] = -skew(np.einsum("nij,nj->ni", R, motion.delta_v))
    F[:, P, ACC_BIAS], F[:, V, ACC_BIAS] = -0.5 * h**2 * middle, -h * middle
    F[:, P, GYRO_BIAS] = h / 3.0 * R @ skew(motion.delta_p)
    F[:, V, GYRO_BIAS] = 0.5 * h * R @ skew(motion.delta_v)
    F[:, TURN, GYRO_BIAS] = -h * middle
    return F


def defects(states: InertialTrajectory, motion: Preintegration) -> FloatArray:
    """What the IMU predicts less what the next node has, (n - 1, 21)."""
    p, v, R = predict(states, motion)
    out = np.zeros((len(motion.dt), SIZE))
    out[:, P], out[:, V] = p - states.p[1:], v - states.v[1:]
    out[:, TURN] = turned(R, states.R[1:])
    steps = [(ACC_BIAS, states.bias[:, :3]), (GYRO_BIAS, states.bias[:, 3:])]
    for rows, values in [*steps, (GRAVITY, states.gravity), (SHOULDER, states.shoulder)]:
        out[:, rows] = -np.diff(values, axis=0)
    return out


def white_noise(
    h: FloatArray, acc: FloatArray | float, gyro: FloatArray | float, size: int = SIZE
) -> FloatArray:
    """Covariance (k, size, size) of what white noise of the IMU adds to p, v and the orientation.

    Parameters
    ----------
    h : ndarray, shape (k,), s
        Lengths of the intervals.
    acc, gyro : ndarray, shape (k,), or float, (m/s^2)^2/Hz and (rad/s)^2/Hz
        Squares of the densities.
    size : int
        Of the state, which begins with `P`, `V` and `TURN`.
    """
    Q = np.zeros((len(h), size, size))
    for rows, columns, value in (
        (P, P, acc * h**3 / 3.0 + INTEGRATION_VARIANCE * h),
        (P, V, 0.5 * acc * h**2),
        (V, P, 0.5 * acc * h**2),
        (V, V, acc * h),
        (TURN, TURN, gyro * h),
    ):
        Q[:, rows, columns] = value[:, None, None] * np.eye(3)
    return Q


def process_noise(
    signal: InertialSignal, t: FloatArray, motion: Preintegration, noise: ImuNoise, shoulder_walk: float
) -> FloatArray:
    """Covariance (n - 1, 21, 21) of what happens between nodes; the densities grow with the motion.

    Parameters
    ----------
    signal : InertialSignal
    t : ndarray, shape (n,), s
        Times of the nodes.
    motion : Preintegration
        The signal integrated between the nodes.
    noise : ImuNoise
        Densities, their share of the motion, and the biases' walks.
    shoulder_walk : float, m/sqrt(s)
    """
    h = motion.dt
    force = np.linalg.norm(motion.delta_v, axis=1) / h - units.GRAVITY
    rate = Rotation.from_matrix(motion.delta_R).magnitude() / h
    acc = np.hypot(noise.accelerometer_density, noise.accelerometer_share * force) ** 2
    acc = acc + signal.velocity_error(t) ** 2 / h
    gyro = np.hypot(noise.gyroscope_density, noise.gyroscope_share * rate) ** 2
    Q = white_noise(h, acc, gyro)
    for rows, walk in (
        (ACC_BIAS, noise.accelerometer_bias_walk),
        (GYRO_BIAS, noise.gyroscope_bias_walk),
        (SHOULDER, shoulder_walk),
    ):
        Q[:, rows, rows] = (walk**2 * h)[:, None, None] * np.eye(3)
    return Q


def at_samples(states: InertialTrajectory, signal: InertialSignal, t: FloatArray) -> States:
    """Pose and velocity at times (k,) s between the nodes, by the IMU (`window.trajectory.at_times`)."""
    no_covariance = np.zeros((len(states.t), 3, 3))
    states_at_nodes = States(states.R, states.p, states.v)
    motion = SegmentTrajectory(
        states.t, states_at_nodes, no_covariance, no_covariance, states.bias, states.gravity
    )
    return at_times(motion, signal, t)
