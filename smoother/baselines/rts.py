"""Baselines `rts`, an error-state Kalman filter with Rauch-Tung-Striebel smoothing, and `ukf`, unscented.

`rts` goes over the whole segment: the IMU integrated between camera frames, joints as measurements of their
lever arms' ends, the upper arm's length; each round linearises about the last one's answer and weighs the
camera's samples by Cauchy's loss: Gauss-Newton on the whole segment (Bell, SIAM J. Optimization 1994, for the
iterated smoother; Sola 2017 for the error state, additive but for R = Exp(theta) R_hat). The graph also
solves lever arms, and has a quiet arm's prior.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from .. import units
from ..array_types import BoolArray, FloatArray
from ..body import FOREARM
from ..config import ArmPrior, CameraNoise, ImuNoise
from ..linalg import interpolate, robust_sigma, skew
from ..measurements.alignment import lever_of
from ..measurements.inertial import InertialSignal, Preintegration, integrate
from ..recording import FOREARM_JOINTS, JOINTS
from ..window.nodes import decimate, insert_nodes
from ..window.prepare import states_from_camera
from ..window.problem import States
from ..window.solution import SegmentSolution
from ..window.trajectory import at_times
from .kalman import Chain, rts_smoother
from .scene import Path, Scene, no_answer, path_at

#: Rows of the error state.
P, V, TURN, ACC_BIAS, GYRO_BIAS, GRAVITY, SHOULDER = (slice(3 * k, 3 * k + 3) for k in range(7))
BIAS = slice(ACC_BIAS.start, GYRO_BIAS.stop)
SIZE = 21
#: Error of the integration itself, m^2/s.
INTEGRATION_VARIANCE = 1e-6


@dataclass(frozen=True)
class InertialTrajectory:
    """States at the nodes."""

    t: FloatArray  # (n,) s
    R: FloatArray  # (n, 3, 3): orientation `R_K_A` of the IMU
    # (n, 21) SI: its position and velocity in {K}, nothing, biases of accelerometer and gyroscope in {A},
    # gravity and the shoulder in {K}
    x: FloatArray

    def moved(self, error: FloatArray) -> InertialTrajectory:
        """The states with errors (n, 21) added."""
        x = self.x + error
        x[:, TURN] = 0.0
        return InertialTrajectory(self.t, Rotation.from_rotvec(error[:, TURN]).as_matrix() @ self.R, x)


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
    """Noise of the scene's point for a method of independent samples, m per axis."""
    effective = scene.point_effective_sigma_m
    return float(effective) if np.isfinite(effective) else scene.point_sigma_m


def joint_sigma(scene: Scene) -> float:
    """The same of one joint, where the point is the mean of those that are usually seen."""
    columns = [JOINTS.index(joint) for joint in levers_of(scene)]
    usual = int((seen_joints(scene)[scene.visible][:, columns].mean(axis=0) > 0.25).sum())
    return white_sigma(scene) * float(np.sqrt(max(usual, 1)))


def integrated(signal: InertialSignal, states: InertialTrajectory) -> Preintegration:
    """The IMU between the nodes."""
    return integrate(signal, states.t, states.x[:-1, BIAS])


def predict(states: InertialTrajectory, motion: Preintegration) -> InertialTrajectory:
    """The next nodes by the IMU (Forster et al., IEEE Trans. Robotics 33:1-21, 2017, eq 33)."""
    h, R, x = motion.dt[:, None], states.R[:-1], states.x[:-1].copy()
    x[:, P] += x[:, V] * h + 0.5 * x[:, GRAVITY] * h**2 + np.einsum("nij,nj->ni", R, motion.delta_p)
    x[:, V] += x[:, GRAVITY] * h + np.einsum("nij,nj->ni", R, motion.delta_v)
    return InertialTrajectory(states.t[1:], R @ motion.delta_R, x)


def less(states: InertialTrajectory, others: InertialTrajectory) -> FloatArray:
    """Errors (n, 21) that take the others to some states."""
    error = states.x - others.x
    error[:, TURN] = turned(states.R, others.R)
    return error


def transition(states: InertialTrajectory, motion: Preintegration) -> FloatArray:
    """Jacobian (n - 1, 21, 21) of the next node's error to this one's (Sola, arXiv 1711.02508, section 7)."""
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


def white_noise(
    h: FloatArray, acc: FloatArray | float, gyro: FloatArray | float, size: int = SIZE
) -> FloatArray:
    """Covariance (k, size, size) of what white noise of the IMU adds to p, v and the orientation."""
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
    """Covariance (n - 1, 21, 21) of what happens between nodes; the densities grow with the motion."""
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


#: Rounds end when no node moved more than this, m, and at the latest after this many.
SETTLED_M = 0.0005
MOST_ROUNDS = 6
#: What is known before the first frame: m, m/s, rad beside the filter's own, and of gravity across and along.
START_SIGMA_M = 1.0
START_SIGMA_SPEED = 3.0
ATTITUDE_SIGMA_RAD = np.radians(2.0)
GRAVITY_SIGMA_RAD = np.radians(1.0)
GRAVITY_SIZE_SIGMA = 0.01
#: The upper arm's length is measured anew no more often than this, s.
RANGE_EVERY_S = 0.09
#: Node spacing where the camera gives nothing, s.
GAP_NODE_S = 0.2
#: The least noise of a joint, m.
LEAST_SIGMA_M = 2e-4
#: The sensor and the arm, as in the graph by default.
IMU_NOISE, ARM_PRIOR = ImuNoise(), ArmPrior()
SHOULDER_JOINT = JOINTS.index("shoulder")


@dataclass(frozen=True)
class CameraAtNodes:
    """What the camera saw at the nodes."""

    joints: FloatArray  # (n, 5, 3) m: in {K}; nan where nothing was seen
    sigma_m: FloatArray  # (5,) m: noise of the joints, per axis
    levers: dict[str, FloatArray]  # dict of (3,) m: lever arms in {A}, by joint
    upper_arm_m: float  # Length shoulder to elbow; nan where unknown


def rts(scene: Scene) -> Path:
    """Recover one segment from all that was seen in it, before and after."""
    levers = levers_of(scene)
    if not levers or scene.visible.sum() < 2:
        return no_answer(scene)
    signal = InertialSignal(scene.imu)
    states, camera = start(scene, levers)
    for round_ in range(MOST_ROUNDS):
        error = rts_smoother(linearised(states, camera, signal, scene))
        states = states.moved(error.mean[..., 0])
        if round_ == 0:
            camera = with_noise_of(camera, states, scene)
        elif np.abs(error.mean[:, P, 0]).max() < SETTLED_M:
            break
    x, nodes = states.x, States(states.R, states.x[:, P], states.x[:, V])
    solution = SegmentSolution(FOREARM.name, states.t, nodes, x[:, BIAS], x[:, GRAVITY])
    answer = at_times(solution, signal, scene.t)
    place, turn = (interpolate(states.t, error.covariance[:, rows, rows], scene.t) for rows in (P, TURN))
    return Path(answer.p, answer.v, place, answer.R, turn)


def start(scene: Scene, levers: dict[str, FloatArray]) -> tuple[InertialTrajectory, CameraAtNodes]:
    """Nodes at the frames with a joint and between them; start values from camera and filter."""
    any_joint = np.flatnonzero(seen_joints(scene).sum(axis=1))
    frames = any_joint[decimate(scene.frame_t[any_joint])]
    t = insert_nodes(scene.frame_t[frames], float(scene.t[0]), float(scene.t[-1]), GAP_NODE_S)
    joints = np.full((len(t), len(JOINTS), 3), np.nan)
    node = np.clip(np.searchsorted(t, scene.frame_t[frames] - 1e-9), 0, len(t) - 1)
    on = np.abs(t[node] - scene.frame_t[frames]) < 1e-9
    joints[node[on]] = scene.joints[frames[on]]
    R, x = orientation_at(scene, t), np.zeros((len(t), SIZE))
    first, shoulder = states_from_camera(t, R, *scene.visible_points), interpolate(scene.t, scene.shoulder, t)
    has_shoulder = bool(np.isfinite(shoulder).all())
    x[:, P], x[:, V], x[:, GRAVITY] = first.p, first.v, scene.gravity
    x[:, SHOULDER] = shoulder if has_shoulder else 0.0
    length, sigma_m = scene.calibration.upper_arm, max(joint_sigma(scene), LEAST_SIGMA_M)
    has_arm = has_shoulder and "elbow" in levers
    known_m = length.value_m if length is not None and has_arm else float("nan")
    camera = CameraAtNodes(joints, np.full(len(JOINTS), sigma_m), levers, known_m)
    return InertialTrajectory(t, R, x), camera


def residuals(states: InertialTrajectory, camera: CameraAtNodes) -> FloatArray:
    """Camera minus state (n, 5, 3) m, nan where nothing was seen or the joint has no lever arm."""
    out = np.full_like(camera.joints, np.nan)
    for joint, lever in camera.levers.items():
        column = JOINTS.index(joint)
        out[:, column] = camera.joints[:, column] - states.x[:, P] - states.R @ lever
    out[:, SHOULDER_JOINT] = camera.joints[:, SHOULDER_JOINT] - states.x[:, SHOULDER]
    return out


def with_noise_of(camera: CameraAtNodes, states: InertialTrajectory, scene: Scene) -> CameraAtNodes:
    """The same with each joint's noise from its residuals, widened by the memory of the scene's noise."""
    residual = residuals(states, camera)
    memory = white_sigma(scene) / max(scene.point_sigma_m, 1e-9)
    sigma = camera.sigma_m.copy()
    for joint in camera.levers:
        own = residual[:, JOINTS.index(joint)]
        own = own[np.isfinite(own[:, 0])]
        if len(own) >= 30:
            sigma[JOINTS.index(joint)] = max(memory * float(robust_sigma(own)), LEAST_SIGMA_M)
    forearm = [JOINTS.index(joint) for joint in FOREARM_JOINTS if joint in camera.levers]
    sigma[SHOULDER_JOINT] = sigma[forearm].max()
    return replace(camera, sigma_m=sigma)


def linearised(
    states: InertialTrajectory, camera: CameraAtNodes, signal: InertialSignal, scene: Scene
) -> Chain:
    """The chain of the errors of the states: transitions, what the IMU and the camera state of them."""
    motion = integrated(signal, states)
    information, vector = _measured(states, camera)
    mean, covariance = _prior(states, scene)
    Q = process_noise(signal, states.t, motion, IMU_NOISE, ARM_PRIOR.shoulder_walk)
    after = InertialTrajectory(states.t[1:], states.R[1:], states.x[1:])
    drift = less(predict(states, motion), after)[..., None]  # what the IMU predicts less what is there
    F = transition(states, motion)
    return Chain(F, Q, information, vector[..., None], mean[:, None], covariance, drift)


def _prior(states: InertialTrajectory, scene: Scene) -> tuple[FloatArray, FloatArray]:
    """Error of the first node before anything is measured: prior minus the current states."""
    x = states.x[0].copy()
    x[BIAS], x[GRAVITY] = 0.0, scene.gravity
    first = InertialTrajectory(states.t[:1], orientation_at(scene, states.t[:1]), x[None])
    mean = less(first, InertialTrajectory(states.t[:1], states.R[:1], states.x[:1]))[0]
    down = scene.gravity / np.linalg.norm(scene.gravity)
    across = (GRAVITY_SIGMA_RAD * np.linalg.norm(scene.gravity)) ** 2
    covariance = np.zeros((SIZE, SIZE))
    for rows, variance in (
        (P, START_SIGMA_M**2),
        (V, START_SIGMA_SPEED**2),
        (TURN, ATTITUDE_SIGMA_RAD**2 + scene.attitude_sigma_rad**2),
        (ACC_BIAS, IMU_NOISE.accelerometer_bias_sigma**2),
        (GYRO_BIAS, IMU_NOISE.gyroscope_bias_sigma**2),
        (SHOULDER, START_SIGMA_M**2),
    ):
        covariance[rows, rows] = variance * np.eye(3)
    covariance[GRAVITY, GRAVITY] = across * np.eye(3) + (GRAVITY_SIZE_SIGMA**2 - across) * np.outer(
        down, down
    )
    return mean, covariance


def _measured(states: InertialTrajectory, camera: CameraAtNodes) -> tuple[FloatArray, FloatArray]:
    """Sums of H' R^-1 H (n, 21, 21) and H' R^-1 z (n, 21) over what the camera saw of each node."""
    n = len(states.t)
    information, vector = np.zeros((n, SIZE, SIZE)), np.zeros((n, SIZE))
    residual = residuals(states, camera)

    def add(H: FloatArray, z: FloatArray, weight: FloatArray) -> None:
        nonlocal information, vector
        weighted = H * weight[:, None, None]
        information += np.swapaxes(weighted, 1, 2) @ H
        vector += np.einsum("nij,ni->nj", weighted, z)

    for joint in (*camera.levers, "shoulder"):
        column = JOINTS.index(joint)
        z, seen = residual[:, column], np.isfinite(residual[:, column, 0])
        H = np.zeros((n, 3, SIZE))
        if joint == "shoulder":
            H[:, :, SHOULDER] = np.eye(3)
        else:
            H[:, :, P] = np.eye(3)
            H[:, :, TURN] = -skew(states.R @ camera.levers[joint])
        size = np.linalg.norm(z, axis=1) / camera.sigma_m[column]
        cauchy = 1.0 / (1.0 + (size / CameraNoise().cauchy) ** 2)
        weight = np.where(seen, cauchy, 0.0) / camera.sigma_m[column] ** 2
        add(H, np.where(seen[:, None], z, 0.0), np.where(seen, weight, 0.0))
    if np.isfinite(camera.upper_arm_m):
        arm = states.R @ camera.levers["elbow"]
        upper = states.x[:, P] + arm - states.x[:, SHOULDER]
        length = np.linalg.norm(upper, axis=1)
        along = upper / length[:, None]
        H = np.zeros((n, 1, SIZE))
        H[:, 0, P], H[:, 0, SHOULDER] = along, -along
        H[:, 0, TURN] = np.cross(arm, along)
        share = np.minimum(np.gradient(states.t) / RANGE_EVERY_S, 1.0)
        add(H, (camera.upper_arm_m - length)[:, None], share / ARM_PRIOR.upper_arm_flex_m**2)
    return information, vector


#: Process noise: m/s^2/sqrt(Hz) and rad/s/sqrt(Hz); the first covers a bias that was not subtracted.
ACC_DENSITY = 0.06
GYRO_DENSITY = 0.004
#: What is known at the first visible frame: m, m/s, rad.
FIRST_SIGMAS = (0.02, 0.5, np.radians(3.0))
#: Of the filter's error state: position, velocity and orientation.
FILTER_SIZE = 9


@dataclass(frozen=True)
class NavigationState:
    """Where the IMU is, and how well that is known."""

    p: FloatArray  # (3,) m and m/s: in {K}
    v: FloatArray  # (3,) m and m/s: in {K}
    R: FloatArray  # (3, 3): orientation `R_K_A`
    covariance: FloatArray  # (9, 9): of the errors of p, v and the orientation (a rotation vector in {K})


def ukf(scene: Scene) -> Path:
    """Recover one segment by an unscented Kalman filter; nan before the camera first sees the arm.

    After Tian et al. (Neurocomputing 2015), here with one IMU. State position, velocity and orientation,
    driven by the IMU; joints are measured at the ends of their lever arms. Sigma points live in the error of
    the state. No biases in the state: the gyroscope's is taken off before, as a calibration at rest would do;
    the accelerometer's is part of the process noise.
    """
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
    noise = white_noise(motion.dt, ACC_DENSITY**2, GYRO_DENSITY**2, FILTER_SIZE)
    frame_at = dict(zip(np.searchsorted(t, scene.frame_t[frames]).tolist(), frames.tolist(), strict=True))
    sigma_m = max(joint_sigma(scene), LEAST_SIGMA_M)
    states = [first_state(scene, start_s)]
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


def first_state(scene: Scene, start_s: float) -> NavigationState:
    """The first visible frame: the camera's point and its slope, the scene's orientation."""
    t = np.array([start_s])
    R = orientation_at(scene, t)
    first = states_from_camera(t, R, *scene.visible_points)
    sigma2 = np.repeat(np.hypot(FIRST_SIGMAS, [0.0, 0.0, scene.attitude_sigma_rad]) ** 2, 3)
    return NavigationState(first.p[0], first.v[0], R[0], np.diag(sigma2))


def sigma_points(covariance: FloatArray) -> FloatArray:
    """Errors (18, 9) of equal weight with that covariance and mean zero (Julier and Uhlmann, kappa = 0)."""
    root = np.linalg.cholesky(FILTER_SIZE * covariance).T
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
