"""Baseline `rts`: an error-state Kalman filter with Rauch-Tung-Striebel smoothing over the whole segment.

The strongest thing short of the graph: the IMU integrated between camera frames, every accepted joint as a
measurement of its own lever arm's end, the shoulder and the upper arm's length, biases, gravity and shoulder
as states. Each round linearises about the last one's answer and weighs the camera's samples by Cauchy's
loss: Gauss-Newton on the whole segment (Bell, SIAM J. Optimization 1994, for the iterated smoother; Sola
2017 for the error state). What the graph has beyond it: lever arms solved along, and a quiet arm's prior.

Order of the method: on error-free sensors tenths of a millimetre, what the integration leaves.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..array_types import FloatArray
from ..config import ArmPrior, CameraNoise, ImuNoise
from ..linalg import interpolate, robust_sigma, skew
from ..measurements.inertial import InertialSignal, integrate
from ..recording import FOREARM_JOINTS, JOINTS
from ..window.nodes import decimate, insert_nodes
from ..window.prepare import states_from_camera
from . import error_state as es
from .error_state import InertialTrajectory
from .linear import Chain, FilterEstimates, rts_smoother
from .scene import Path, Scene, no_answer

#: Rounds end when no node moved more than this, m, and at the latest after so many.
SETTLED_M = 0.0005
MOST_ROUNDS = 6
#: What is known before the first frame: m, m/s, rad beside the filter's own, and of gravity across and along.
START_SIGMA_M = 1.0
START_SIGMA_SPEED = 3.0
ATTITUDE_SIGMA_RAD = np.radians(2.0)
GRAVITY_SIGMA_RAD = np.radians(1.0)
GRAVITY_SIZE_SIGMA = 0.01
#: The upper arm's length counts as measured anew no more often than this, s, and varies at most so much, m.
RANGE_EVERY_S = 0.09
LARGEST_FLEX_M = 0.04
#: The least noise of a joint, m.
LEAST_SIGMA_M = 2e-4
#: The sensor and the arm, as in the graph by default.
IMU_NOISE, ARM_PRIOR = ImuNoise(), ArmPrior()
SHOULDER = JOINTS.index("shoulder")


@dataclass(frozen=True)
class CameraAtNodes:
    """What the camera saw at the nodes.

    Attributes
    ----------
    joints : ndarray, shape (n, 5, 3), m
        In {K}; nan where nothing was seen.
    sigma_m : ndarray, shape (5,), m
        Noise of the joints, an axis.
    levers : dict of ndarray, shape (3,), m
        Lever arms in {A}, by joint.
    upper_arm_m, upper_arm_sigma_m : float, m
        Length shoulder to elbow and how it varies; nan where unknown.
    """

    joints: FloatArray
    sigma_m: FloatArray
    levers: dict[str, FloatArray]
    upper_arm_m: float
    upper_arm_sigma_m: float


def rts(scene: Scene) -> Path:
    """Recover one segment from all that was seen in it, before and after.

    Parameters
    ----------
    scene : Scene
        One segment.

    Returns
    -------
    path : Path
        Position, velocity and orientation, with the covariances of position and orientation.
    """
    levers = es.levers_of(scene)
    if not levers or scene.visible.sum() < 2:
        return no_answer(scene)
    signal = InertialSignal(scene.imu)
    states, camera = start(scene, levers)
    for round_ in range(MOST_ROUNDS):
        error = rts_smoother(linearised(states, camera, signal, scene))
        states = states.moved(error.mean[..., 0])
        if round_ == 0:
            camera = with_noise_of(camera, states, scene)
        elif np.abs(error.mean[:, es.P, 0]).max() < SETTLED_M:
            break
    return _path(scene, states, signal, error)


def start(scene: Scene, levers: dict[str, FloatArray]) -> tuple[InertialTrajectory, CameraAtNodes]:
    """Nodes at the frames with a joint and between them; start values from camera and filter."""
    any_joint = np.flatnonzero(es.seen_joints(scene).sum(axis=1))
    frames = any_joint[decimate(scene.frame_t[any_joint])]
    t = insert_nodes(scene.frame_t[frames], float(scene.t[0]), float(scene.t[-1]))
    joints = np.full((len(t), len(JOINTS), 3), np.nan)
    node = np.clip(np.searchsorted(t, scene.frame_t[frames] - 1e-9), 0, len(t) - 1)
    on = np.abs(t[node] - scene.frame_t[frames]) < 1e-9
    joints[node[on]] = scene.joints[frames[on]]
    R = es.orientation_at(scene, t)
    first = states_from_camera(t, R, *scene.visible_points)
    shoulder = interpolate(scene.t, scene.shoulder, t)
    has_shoulder = bool(np.isfinite(shoulder).all())
    states = InertialTrajectory(
        t,
        first.p,
        first.v,
        R,
        np.zeros((len(t), 6)),
        np.tile(scene.gravity, (len(t), 1)),
        shoulder if has_shoulder else np.zeros((len(t), 3)),
    )
    length = scene.calibration.upper_arm
    known = has_shoulder and length is not None and "elbow" in levers
    sigmas = np.full(len(JOINTS), max(es.joint_sigma(scene), LEAST_SIGMA_M))
    return states, CameraAtNodes(
        joints,
        sigmas,
        levers,
        length.value_m if known and length is not None else float("nan"),
        _flex(joints, float(sigmas[0])) if known else float("nan"),
    )


def _flex(joints: FloatArray, sigma_m: float) -> float:
    """How much more the upper arm's length varies, as it is seen, than the joints' noise explains, m."""
    length = np.linalg.norm(joints[:, SHOULDER] - joints[:, JOINTS.index("elbow")], axis=1)
    length = length[np.isfinite(length)]
    if len(length) < 10:
        return ARM_PRIOR.upper_arm_flex_m
    spread = float(robust_sigma(length - np.median(length)))
    extra = float(np.sqrt(max(spread**2 - 2.0 * sigma_m**2, 0.0)))
    return float(np.clip(extra, ARM_PRIOR.upper_arm_flex_m, LARGEST_FLEX_M))


def residuals(states: InertialTrajectory, camera: CameraAtNodes) -> FloatArray:
    """Camera minus state (n, 5, 3) m, nan where nothing was seen or the joint has no lever arm."""
    out = np.full_like(camera.joints, np.nan)
    for joint, lever in camera.levers.items():
        column = JOINTS.index(joint)
        out[:, column] = camera.joints[:, column] - states.p - states.R @ lever
    out[:, SHOULDER] = camera.joints[:, SHOULDER] - states.shoulder
    return out


def with_noise_of(camera: CameraAtNodes, states: InertialTrajectory, scene: Scene) -> CameraAtNodes:
    """The same with each joint's noise from its residuals, widened by the memory of the scene's noise."""
    residual = residuals(states, camera)
    memory = es.white_sigma(scene) / max(scene.point_sigma_m, 1e-9)
    sigma = camera.sigma_m.copy()
    for joint in camera.levers:
        own = residual[:, JOINTS.index(joint)]
        own = own[np.isfinite(own[:, 0])]
        if len(own) >= 30:
            sigma[JOINTS.index(joint)] = max(memory * float(robust_sigma(own)), LEAST_SIGMA_M)
    forearm = [JOINTS.index(joint) for joint in FOREARM_JOINTS if joint in camera.levers]
    sigma[SHOULDER] = sigma[forearm].max()
    return replace(camera, sigma_m=sigma)


def linearised(
    states: InertialTrajectory, camera: CameraAtNodes, signal: InertialSignal, scene: Scene
) -> Chain:
    """The chain of the errors of the states: transitions, what the IMU and the camera state of them.

    Parameters
    ----------
    states : InertialTrajectory
        Where to linearise.
    camera : CameraAtNodes
        What the camera saw at the states' nodes.
    signal : InertialSignal
        The IMU.
    scene : Scene
        For the prior of the first node.

    Returns
    -------
    chain : Chain
        Of the error states of dimension 21, see `error_state`.
    """
    motion = integrate(signal, states.t, states.bias[:-1])
    information, vector = _measured(states, camera)
    mean, covariance = _prior(states, scene)
    return Chain(
        F=es.transition(states, motion),
        Q=es.process_noise(signal, states.t, motion, IMU_NOISE, ARM_PRIOR.shoulder_walk),
        drift=es.defects(states, motion)[..., None],
        information=information,
        vector=vector[..., None],
        mean=mean[:, None],
        covariance=covariance,
    )


def _prior(states: InertialTrajectory, scene: Scene) -> tuple[FloatArray, FloatArray]:
    """Error of the first node before anything is measured: what was known less what the states hold."""
    R = es.orientation_at(scene, states.t[:1])[0]
    mean = np.zeros(es.SIZE)
    mean[es.TURN] = es.turned(R, states.R[0])
    mean[es.ACC_BIAS], mean[es.GYRO_BIAS] = -states.bias[0, :3], -states.bias[0, 3:]
    mean[es.GRAVITY] = scene.gravity - states.gravity[0]
    down = scene.gravity / np.linalg.norm(scene.gravity)
    across = (GRAVITY_SIGMA_RAD * np.linalg.norm(scene.gravity)) ** 2
    covariance = np.zeros((es.SIZE, es.SIZE))
    for rows, variance in (
        (es.P, START_SIGMA_M**2),
        (es.V, START_SIGMA_SPEED**2),
        (es.TURN, ATTITUDE_SIGMA_RAD**2 + scene.attitude_sigma_rad**2),
        (es.ACC_BIAS, IMU_NOISE.accelerometer_bias_sigma**2),
        (es.GYRO_BIAS, IMU_NOISE.gyroscope_bias_sigma**2),
        (es.SHOULDER, START_SIGMA_M**2),
    ):
        covariance[rows, rows] = variance * np.eye(3)
    covariance[es.GRAVITY, es.GRAVITY] = across * np.eye(3) + (GRAVITY_SIZE_SIGMA**2 - across) * np.outer(
        down, down
    )
    return mean, covariance


def _measured(states: InertialTrajectory, camera: CameraAtNodes) -> tuple[FloatArray, FloatArray]:
    """Sums of H' R^-1 H (n, 21, 21) and H' R^-1 z (n, 21) over what the camera saw of each node."""
    n = len(states.t)
    information, vector = np.zeros((n, es.SIZE, es.SIZE)), np.zeros((n, es.SIZE))
    residual = residuals(states, camera)

    def add(H: FloatArray, z: FloatArray, weight: FloatArray) -> None:
        nonlocal information, vector
        weighted = H * weight[:, None, None]
        information += np.swapaxes(weighted, 1, 2) @ H
        vector += np.einsum("nij,ni->nj", weighted, z)

    for joint in (*camera.levers, "shoulder"):
        column = JOINTS.index(joint)
        z, seen = residual[:, column], np.isfinite(residual[:, column, 0])
        H = np.zeros((n, 3, es.SIZE))
        if joint == "shoulder":
            H[:, :, es.SHOULDER] = np.eye(3)
        else:
            H[:, :, es.P] = np.eye(3)
            H[:, :, es.TURN] = -skew(states.R @ camera.levers[joint])
        size = np.linalg.norm(z, axis=1) / camera.sigma_m[column]
        cauchy = 1.0 / (1.0 + (size / CameraNoise().cauchy) ** 2)
        weight = np.where(seen, cauchy, 0.0) / camera.sigma_m[column] ** 2
        add(H, np.where(seen[:, None], z, 0.0), np.where(seen, weight, 0.0))
    if np.isfinite(camera.upper_arm_m):
        arm = states.R @ camera.levers["elbow"]
        upper = states.p + arm - states.shoulder
        length = np.linalg.norm(upper, axis=1)
        along = upper / length[:, None]
        H = np.zeros((n, 1, es.SIZE))
        H[:, 0, es.P], H[:, 0, es.SHOULDER] = along, -along
        H[:, 0, es.TURN] = np.cross(arm, along)
        share = np.minimum(np.gradient(states.t) / RANGE_EVERY_S, 1.0)
        add(H, (camera.upper_arm_m - length)[:, None], share / camera.upper_arm_sigma_m**2)
    return information, vector


def _path(scene: Scene, states: InertialTrajectory, signal: InertialSignal, error: FilterEstimates) -> Path:
    """The answer at the IMU's samples."""
    answer = es.at_samples(states, signal, scene.t)
    return Path(
        position=answer.p,
        velocity=answer.v,
        covariance=interpolate(states.t, error.covariance[:, es.P, es.P], scene.t),
        R_K_A=answer.R,
        attitude_covariance=interpolate(states.t, error.covariance[:, es.TURN, es.TURN], scene.t),
    )
