"""Baseline `ukf`: after Tian et al. (Neurocomputing 2015), an unscented Kalman filter, here with one IMU.

State position, velocity and orientation; the IMU drives it, the camera's joints are measurements, each at
the end of its own lever arm, which also keeps the heading. Sigma points live in the error of the state (the
orientation's as a rotation vector in {K}), so that quaternions stay of unit length. It has no biases in its
state: the gyroscope's is taken from the scene's orientation before, as a calibration at rest would do, and
what the accelerometer keeps is part of the process noise. It starts from the scene's orientation. It is a
filter: inside a gap it has seen the camera only up to the gap, and it jumps where the camera comes back.

Order of the method: on error-free sensors tenths of a millimetre, what the integration leaves.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from ..measurements.inertial import InertialSignal, Preintegration, integrate
from ..recording import JOINTS, FloatArray
from ..window.nodes import decimate
from ..window.prepare import states_from_camera
from .error_state import INTEGRATION_VARIANCE, joint_sigma, levers_of, orientation_at, seen_joints, turned
from .scene import Path, Scene

#: Process noise: m/s^2/sqrt(Hz) and rad/s/sqrt(Hz); the first holds a bias that nobody took off.
ACC_DENSITY = 0.06
GYRO_DENSITY = 0.004
#: What is known at the first visible frame: m, m/s, rad.
START_SIGMA_M = 0.02
START_SIGMA_SPEED = 0.5
ATTITUDE_SIGMA_RAD = np.radians(3.0)
LEAST_SIGMA_M = 2e-4
P, V, TURN = slice(0, 3), slice(3, 6), slice(6, 9)
SIZE = 9


@dataclass(frozen=True)
class Belief:
    """Position, velocity (3,), `R_K_A` (3, 3), and the covariance (9, 9) of their errors."""

    p: FloatArray
    v: FloatArray
    R: FloatArray
    covariance: FloatArray


def ukf(scene: Scene) -> Path:
    """Recover one stretch; nan before the camera first sees the arm.

    Parameters
    ----------
    scene : one stretch; see `Scene`.
    """
    n = len(scene.t)
    position, velocity = np.full((n, 3), np.nan), np.full((n, 3), np.nan)
    covariance, turning = np.full((n, 3, 3), np.nan), np.full((n, 3, 3), np.nan)
    orientation = scene.R_K_A.copy()
    levers = levers_of(scene)
    first_visible = np.flatnonzero(scene.visible & (scene.frame_t < scene.t[-1]))
    if not levers or len(first_visible) < 2:
        return Path(position, velocity, notes=("The camera saw too little of this stretch.",))
    columns = [JOINTS.index(joint) for joint in levers]
    arms = np.array(list(levers.values()))
    frames = np.flatnonzero(seen_joints(scene)[:, columns].sum(axis=1))
    frames = frames[(frames >= first_visible[0]) & (scene.frame_t[frames] <= scene.t[-1])]
    frames = frames[decimate(scene.frame_t[frames])]
    start_s = float(scene.frame_t[first_visible[0]])
    rows = np.flatnonzero(scene.t >= start_s)
    t = np.union1d(scene.frame_t[frames], scene.t[rows])
    motion = integrate(InertialSignal(scene.imu), t, np.concatenate([np.zeros(3), gyroscope_bias(scene)]))
    noise = process_noise(motion)
    frame_at = dict(zip(np.searchsorted(t, scene.frame_t[frames]).tolist(), frames.tolist(), strict=True))
    row_at = dict(zip(np.searchsorted(t, scene.t[rows]).tolist(), rows.tolist(), strict=True))
    sigma_m = max(joint_sigma(scene), LEAST_SIGMA_M)
    belief = start(scene, start_s)
    for k in range(len(t)):
        if k:
            belief = predicted(belief, motion, k - 1, scene.gravity, noise[k - 1])
        if k in frame_at:
            belief = updated(belief, scene.joints[frame_at[k], columns], arms, sigma_m)
        if k in row_at:
            row = row_at[k]
            position[row], velocity[row], orientation[row] = belief.p, belief.v, belief.R
            covariance[row], turning[row] = belief.covariance[P, P], belief.covariance[TURN, TURN]
    return Path(position, velocity, covariance, orientation, turning)


def gyroscope_bias(scene: Scene) -> FloatArray:
    """(3,) rad/s: what the gyroscope turns more than the scene's orientation does, on average."""
    step = turned(np.swapaxes(scene.R_K_A[:-1], 1, 2) @ scene.R_K_A[1:], np.eye(3))
    measured = 0.5 * (scene.imu.gyro[1:] + scene.imu.gyro[:-1]) * np.diff(scene.t)[:, None]
    return np.asarray((measured - step).sum(axis=0) / (scene.t[-1] - scene.t[0]))


def start(scene: Scene, start_s: float) -> Belief:
    """The first visible frame: the camera's point and its slope, the scene's orientation."""
    at = np.array([start_s])
    seen = scene.visible
    R = orientation_at(scene, at)
    first = states_from_camera(at, R, scene.frame_t[seen], scene.point[seen])
    turn = ATTITUDE_SIGMA_RAD**2 + scene.attitude_sigma_rad**2
    sigma2 = np.repeat([START_SIGMA_M**2, START_SIGMA_SPEED**2, turn], 3)
    return Belief(first.p[0], first.v[0], R[0], np.diag(sigma2))


def process_noise(motion: Preintegration) -> FloatArray:
    """Covariance (n - 1, 9, 9) of what white noise of the IMU adds in each interval."""
    h = motion.dt[:, None, None]
    eye = np.eye(3)
    Q = np.zeros((len(motion.dt), SIZE, SIZE))
    Q[:, P, P] = (ACC_DENSITY**2 * h**3 / 3.0 + INTEGRATION_VARIANCE * h) * eye
    Q[:, P, V] = Q[:, V, P] = 0.5 * ACC_DENSITY**2 * h**2 * eye
    Q[:, V, V], Q[:, TURN, TURN] = ACC_DENSITY**2 * h * eye, GYRO_DENSITY**2 * h * eye
    return Q


def sigma_points(covariance: FloatArray) -> FloatArray:
    """Errors (18, 9) of equal weight with that covariance and mean zero (Julier and Uhlmann, kappa = 0)."""
    root = np.linalg.cholesky(SIZE * covariance).T
    return np.concatenate([root, -root])


def predicted(
    belief: Belief, motion: Preintegration, k: int, gravity: FloatArray, noise: FloatArray
) -> Belief:
    """The belief after interval k of the IMU; the interval's rotation is common to all sigma points."""
    h = motion.dt[k]
    points = sigma_points(belief.covariance)
    gained = belief.R @ np.stack([motion.delta_p[k], motion.delta_v[k]], axis=1)
    gained = Rotation.from_rotvec(points[:, TURN]).as_matrix() @ gained
    ahead = points.copy()
    ahead[:, P] += points[:, V] * h + gained[:, :, 0]
    ahead[:, V] += gained[:, :, 1]
    mean = ahead.mean(axis=0)
    spread = ahead - mean
    return Belief(
        belief.p + belief.v * h + 0.5 * gravity * h**2 + mean[P],
        belief.v + gravity * h + mean[V],
        belief.R @ motion.delta_R[k],
        spread.T @ spread / len(points) + noise,
    )


def updated(belief: Belief, joints: FloatArray, arms: FloatArray, sigma_m: float) -> Belief:
    """The belief with a frame's joints (j, 3) m, nan where not seen, at lever arms (j, 3) m in {A}."""
    seen = np.isfinite(joints[:, 0])
    points = sigma_points(belief.covariance)
    arm_K = belief.R @ arms[seen].T
    turned_arms = Rotation.from_rotvec(points[:, TURN]).as_matrix() @ arm_K
    expected = (points[:, P, None] + turned_arms).transpose(0, 2, 1).reshape(len(points), -1)
    mean = expected.mean(axis=0)
    spread = expected - mean
    S = spread.T @ spread / len(points) + sigma_m**2 * np.eye(len(mean))
    cross = points.T @ spread / len(points)
    gain = np.linalg.solve(S, cross.T).T
    error = gain @ ((joints[seen] - belief.p).ravel() - mean)
    covariance = belief.covariance - gain @ S @ gain.T
    return Belief(
        belief.p + error[P],
        belief.v + error[V],
        Rotation.from_rotvec(error[TURN]).as_matrix() @ belief.R,
        0.5 * (covariance + covariance.T),
    )
