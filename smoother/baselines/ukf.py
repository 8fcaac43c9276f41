"""Baseline `ukf`: after Tian et al. (Neurocomputing 2015), an unscented Kalman filter, here with one IMU.

State position, velocity and orientation, driven by the IMU; joints are measured at the ends of their lever
arms. Sigma points live in the error of the state. No biases in the state: the gyroscope's is taken off
before, as a calibration at rest would do; the accelerometer's is part of the process noise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from ..array_types import FloatArray
from ..measurements.inertial import InertialSignal, Preintegration, integrate
from ..recording import JOINTS
from ..window.nodes import decimate
from ..window.prepare import states_from_camera
from .rts import TURN, P, V, joint_sigma, levers_of, orientation_at, seen_joints, turned, white_noise
from .scene import Path, Scene, no_answer, path_at

#: Process noise: m/s^2/sqrt(Hz) and rad/s/sqrt(Hz); the first covers a bias that was not subtracted.
ACC_DENSITY = 0.06
GYRO_DENSITY = 0.004
#: What is known at the first visible frame: m, m/s, rad.
START_SIGMA_M = 0.02
START_SIGMA_SPEED = 0.5
ATTITUDE_SIGMA_RAD = np.radians(3.0)
LEAST_SIGMA_M = 2e-4
#: Of the error state: position, velocity and orientation.
SIZE = 9


@dataclass(frozen=True)
class NavigationState:
    """Where the IMU is, and how well that is known."""

    p: FloatArray  # (3,) m and m/s: in {K}
    v: FloatArray  # (3,) m and m/s: in {K}
    R: FloatArray  # (3, 3): orientation `R_K_A`
    covariance: FloatArray  # (9, 9): of the errors of p, v and the orientation (a rotation vector in {K})


def ukf(scene: Scene) -> Path:
    """Recover one segment; nan before the camera first sees the arm."""
    levers = levers_of(scene)
    visible = np.flatnonzero(scene.visible & (scene.frame_t < scene.t[-1]))
    if not levers or len(visible) < 2:
        return no_answer(scene)
    columns, arms = [JOINTS.index(joint) for joint in levers], np.array(list(levers.values()))
    frames = visible[0] + np.flatnonzero(seen_joints(scene)[visible[0] :, columns].any(axis=1))
    frames = frames[scene.frame_t[frames] <= scene.t[-1]]
    frames = frames[decimate(scene.frame_t[frames])]
    start_s = float(scene.frame_t[visible[0]])
    rows = np.flatnonzero(scene.t >= start_s)
    t = np.union1d(scene.frame_t[frames], scene.t[rows])
    motion = integrate(InertialSignal(scene.imu), t, np.concatenate([np.zeros(3), gyroscope_bias(scene)]))
    noise = white_noise(motion.dt, ACC_DENSITY**2, GYRO_DENSITY**2, SIZE)
    frame_at = dict(zip(np.searchsorted(t, scene.frame_t[frames]).tolist(), frames.tolist(), strict=True))
    sigma_m = max(joint_sigma(scene), LEAST_SIGMA_M)
    states = [start(scene, start_s)]
    for k in range(len(t)):
        state = predicted(states[-1], motion, k - 1, scene.gravity, noise[k - 1]) if k else states.pop()
        if k in frame_at:
            state = updated(state, scene.joints[frame_at[k], columns], arms, sigma_m)
        states.append(state)
    answers = [states[k] for k in np.searchsorted(t, scene.t[rows])]
    p, v, R, covariance = (
        np.array([getattr(s, name) for s in answers]) for name in ("p", "v", "R", "covariance")
    )
    return path_at(scene, rows, p, v, covariance[:, P, P], R, covariance[:, TURN, TURN])


def gyroscope_bias(scene: Scene) -> FloatArray:
    """(3,) rad/s: what the gyroscope turns more than the scene's orientation does, on average."""
    step = turned(np.swapaxes(scene.R_K_A[:-1], 1, 2) @ scene.R_K_A[1:], np.eye(3))
    measured = 0.5 * (scene.imu.gyro[1:] + scene.imu.gyro[:-1]) * np.diff(scene.t)[:, None]
    return np.asarray((measured - step).sum(axis=0) / (scene.t[-1] - scene.t[0]))


def start(scene: Scene, start_s: float) -> NavigationState:
    """The first visible frame: the camera's point and its slope, the scene's orientation."""
    t = np.array([start_s])
    R = orientation_at(scene, t)
    first = states_from_camera(t, R, *scene.visible_points)
    turn = ATTITUDE_SIGMA_RAD**2 + scene.attitude_sigma_rad**2
    sigma2 = np.repeat([START_SIGMA_M**2, START_SIGMA_SPEED**2, turn], 3)
    return NavigationState(first.p[0], first.v[0], R[0], np.diag(sigma2))


def sigma_points(covariance: FloatArray) -> FloatArray:
    """Errors (18, 9) of equal weight with that covariance and mean zero (Julier and Uhlmann, kappa = 0)."""
    root = np.linalg.cholesky(SIZE * covariance).T
    return np.concatenate([root, -root])


def predicted(
    state: NavigationState, motion: Preintegration, k: int, gravity: FloatArray, noise: FloatArray
) -> NavigationState:
    """The state after interval k of the IMU; the interval's rotation is common to all sigma points.

    Julier and Uhlmann, Proc. IEEE 92:401-422 (2004), the time update.
    """
    h = motion.dt[k]
    points = sigma_points(state.covariance)
    gained = state.R @ np.stack([motion.delta_p[k], motion.delta_v[k]], axis=1)
    gained = Rotation.from_rotvec(points[:, TURN]).as_matrix() @ gained
    ahead = points.copy()
    ahead[:, P] += points[:, V] * h + gained[:, :, 0]
    ahead[:, V] += gained[:, :, 1]
    mean = ahead.mean(axis=0)
    spread = ahead - mean
    return NavigationState(
        state.p + state.v * h + 0.5 * gravity * h**2 + mean[P],
        state.v + gravity * h + mean[V],
        state.R @ motion.delta_R[k],
        spread.T @ spread / len(points) + noise,
    )


def updated(
    state: NavigationState,
    joints: FloatArray,  # (j, 3) m
    arms: FloatArray,  # (j, 3) m
    sigma_m: float,
) -> NavigationState:
    """The state with a frame's joints (Julier and Uhlmann 2004, the measurement update)."""
    seen = np.isfinite(joints[:, 0])
    points = sigma_points(state.covariance)
    arm_K = state.R @ arms[seen].T
    turned_arms = Rotation.from_rotvec(points[:, TURN]).as_matrix() @ arm_K
    expected = (points[:, P, None] + turned_arms).transpose(0, 2, 1).reshape(len(points), -1)
    mean = expected.mean(axis=0)
    spread = expected - mean
    S = spread.T @ spread / len(points) + sigma_m**2 * np.eye(len(mean))
    cross = points.T @ spread / len(points)
    gain = np.linalg.solve(S, cross.T).T
    error = gain @ ((joints[seen] - state.p).ravel() - mean)
    covariance = state.covariance - gain @ S @ gain.T
    return NavigationState(
        state.p + error[P],
        state.v + error[V],
        Rotation.from_rotvec(error[TURN]).as_matrix() @ state.R,
        0.5 * (covariance + covariance.T),
    )
