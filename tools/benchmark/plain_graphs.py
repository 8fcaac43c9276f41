"""The graphs of `plain`: what GTSAM's examples write, and what it takes to do the same as `smooth`."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import gtsam
import numpy as np
from gtsam import Pose3, Rot3, Unit3, noiseModel
from gtsam.symbol_shorthand import B, G, L, S, U, V, X
from scipy.spatial.transform import Rotation, Slerp

from smoother.array_types import FloatArray
from smoother.baselines.scene import Scene
from smoother.config import ArmPrior, CameraNoise, ImuNoise
from smoother.linalg import interpolate
from smoother.measurements.alignment import lever_of
from smoother.measurements.inertial import InertialSignal
from smoother.recording import FOREARM_JOINTS, JOINTS
from smoother.units import GRAVITY
from smoother.window.prepare import states_from_camera

Pim = gtsam.PreintegratedCombinedMeasurements
#: Error of the integration itself, m^2/s, as in `smooth`'s graphs.
INTEGRATION_VARIANCE = 1e-6
#: What is known before the first frame: rad, m, m/s.
START_SIGMAS = np.array([0.2] * 3 + [0.1] * 3)
START_SIGMA_SPEED = 1.0
#: What `same_job` is told of lever arms and upper arm, m; where it starts is what `smooth` found.
LEVER_SIGMA_M = 0.03
UPPER_ARM_SIGMA_M = 0.05


@dataclass(frozen=True)
class Frames:
    """What the graph is built from: camera frames (f,) with joints (f, 5, 3), start values, IMU pieces.

    Piece k belongs to the interval before frame `owner[k]`: acc, gyro (m, 3) over h (m,) s.
    """

    t: FloatArray
    joints: FloatArray
    R: FloatArray
    p: FloatArray
    v: FloatArray
    owner: list[int]
    acc: FloatArray
    gyro: FloatArray
    h: list[float]


def frames_of(scene: Scene, second_order: bool) -> Frames:
    """The camera's frames during the IMU's samples, start values, and the IMU cut at frames and samples."""
    inside = (scene.frame_t >= scene.t[0]) & (scene.frame_t <= scene.t[-1])
    t = scene.frame_t[inside]
    R = Slerp(scene.t, Rotation.from_matrix(scene.R_K_A))(t).as_matrix()
    start = states_from_camera(t, R, scene.frame_t[scene.visible], scene.point[scene.visible])
    between = 0.5 * (scene.t[1:] + scene.t[:-1])  # where one sample's interval ends and the next begins
    edges = np.union1d(between[(between > t[0]) & (between < t[-1])], t)
    middle, h = 0.5 * (edges[1:] + edges[:-1]), np.diff(edges)
    if second_order:
        mean = InertialSignal(scene.imu).mean(edges[:-1], edges[1:])
        gyro = mean[:, 3:]
        # GTSAM takes the orientation at the piece's start for the whole of it; half of its turn mends that
        acc = Rotation.from_rotvec(0.5 * h[:, None] * gyro).apply(mean[:, :3])
    else:
        sample = np.searchsorted(between, middle)
        acc, gyro = scene.imu.acc[sample], scene.imu.gyro[sample]
    owner = np.searchsorted(t, middle).tolist()
    return Frames(t, scene.joints[inside], R, start.p, start.v, owner, acc, gyro, h.tolist())


def examples(scene: Scene, frames: Frames) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
    """Poses, velocities and biases by `CombinedImuFactor` and `GPSFactorArm`; all else is given."""
    graph, values = _motion(frames)
    for i, pim in enumerate(preintegrated(frames, scene.gravity), start=1):
        graph.add(gtsam.CombinedImuFactor(X(i - 1), V(i - 1), X(i), V(i), B(i - 1), B(i), pim))
    for each in _sights(scene, frames):
        for factor in each:
            graph.add(factor)
    return graph, values


def examples_by_frame(
    scene: Scene, frames: Frames
) -> Iterator[tuple[gtsam.NonlinearFactorGraph, Pim | None]]:
    """The same factors, those that come with each frame; and the IMU since the frame before."""
    pims: list[Pim | None] = [None, *preintegrated(frames, scene.gravity)]
    for i, (pim, sights) in enumerate(zip(pims, _sights(scene, frames), strict=True)):
        graph = gtsam.NonlinearFactorGraph()
        if pim is None:
            _add_first(graph, frames)
        else:
            graph.add(gtsam.CombinedImuFactor(X(i - 1), V(i - 1), X(i), V(i), B(i - 1), B(i), pim))
        for factor in sights:
            graph.add(factor)
        yield graph, pim


def _sights(scene: Scene, frames: Frames) -> list[list[gtsam.GPSFactorArm]]:
    """What the camera saw in each frame."""
    model = noiseModel.Isotropic.Sigma(3, _joint_sigma(scene))
    factors: list[list[gtsam.GPSFactorArm]] = [[] for _ in frames.t]
    for joint in FOREARM_JOINTS:
        lever, seen = lever_of(scene.calibration, joint), frames.joints[:, JOINTS.index(joint)]
        if lever is None:
            continue
        for i in np.flatnonzero(np.isfinite(seen[:, 0])).tolist():
            factors[i].append(gtsam.GPSFactorArm(X(i), seen[i], lever, model))
    return factors


def same_job(scene: Scene, frames: Frames) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
    """Gravity, lever arms, upper arm and shoulder solved along, the camera's samples with a robust loss."""
    graph, values = _motion(frames)
    values.insert(G(0), Unit3(scene.gravity))
    for i, pim in enumerate(preintegrated(frames, np.array([0.0, 0.0, -GRAVITY])), start=1):
        graph.add(
            gtsam.CombinedImuFactorWithGravityDirection(
                X(i - 1), V(i - 1), X(i), V(i), B(i - 1), B(i), G(0), pim, GRAVITY
            )
        )
    loss = noiseModel.mEstimator.Cauchy.Create(CameraNoise().cauchy)
    model = noiseModel.Robust.Create(loss, noiseModel.Isotropic.Sigma(3, _joint_sigma(scene)))
    for joint in FOREARM_JOINTS:
        column = JOINTS.index(joint)
        lever, seen = lever_of(scene.calibration, joint), frames.joints[:, column]
        if lever is None:
            continue
        rows = np.flatnonzero(np.isfinite(seen[:, 0])).tolist()
        if joint == "strap":  # the IMU itself
            for i in rows:
                graph.add(gtsam.GPSFactorArm(X(i), seen[i], lever, model))
            continue
        values.insert(L(column), lever)
        graph.add(gtsam.PriorFactorPoint3(L(column), lever, noiseModel.Isotropic.Sigma(3, LEVER_SIGMA_M)))
        for i in rows:
            graph.add(gtsam.GPSFactorArmCalib(X(i), L(column), seen[i], model))
    _add_shoulder(graph, values, scene, frames, model)
    return graph, values


def _add_shoulder(
    graph: gtsam.NonlinearFactorGraph,
    values: gtsam.Values,
    scene: Scene,
    frames: Frames,
    model: noiseModel.Base,
) -> None:
    """A point for every frame that wanders slowly, an upper arm's length from the elbow."""
    seen = frames.joints[:, JOINTS.index("shoulder")]
    rows = np.isfinite(seen[:, 0])
    length, elbow = scene.calibration.upper_arm, lever_of(scene.calibration, "elbow")
    if not rows.any() or length is None or elbow is None:
        return
    arm = ArmPrior()
    start = interpolate(frames.t[rows], seen[rows], frames.t)
    step = float(np.median(np.diff(frames.t)))
    walk = noiseModel.Isotropic.Sigma(3, arm.shoulder_walk * np.sqrt(step))
    flex = noiseModel.Isotropic.Sigma(1, arm.upper_arm_flex_m)
    at_elbow = Pose3(Rot3(), elbow)
    values.insert(U(0), 0.0)
    graph.add(gtsam.PriorFactorDouble(U(0), 0.0, noiseModel.Isotropic.Sigma(1, UPPER_ARM_SIGMA_M)))
    for i in range(len(frames.t)):
        values.insert(S(i), start[i])
        graph.add(gtsam.RangeFactorWithTransformBias3D(X(i), S(i), U(0), length.value_m, flex, at_elbow))
        if rows[i]:
            graph.add(gtsam.PriorFactorPoint3(S(i), seen[i], model))
        if i > 0:
            graph.add(gtsam.BetweenFactorPoint3(S(i - 1), S(i), np.zeros(3), walk))


def _motion(frames: Frames) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
    """Start values of poses, velocities and biases, and what is known of the first."""
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for i in range(len(frames.t)):
        values.insert(X(i), Pose3(Rot3(frames.R[i]), frames.p[i]))
        values.insert(V(i), frames.v[i])
        values.insert(B(i), gtsam.imuBias.ConstantBias())
    _add_first(graph, frames)
    return graph, values


def _add_first(graph: gtsam.NonlinearFactorGraph, frames: Frames) -> None:
    noise, bias = ImuNoise(), gtsam.imuBias.ConstantBias()
    bias_sigmas = np.repeat([noise.accelerometer_bias_sigma, noise.gyroscope_bias_sigma], 3)
    pose = Pose3(Rot3(frames.R[0]), frames.p[0])
    graph.add(gtsam.PriorFactorPose3(X(0), pose, noiseModel.Diagonal.Sigmas(START_SIGMAS)))
    graph.add(gtsam.PriorFactorVector(V(0), frames.v[0], noiseModel.Isotropic.Sigma(3, START_SIGMA_SPEED)))
    graph.add(gtsam.PriorFactorConstantBias(B(0), bias, noiseModel.Diagonal.Sigmas(bias_sigmas)))


def _parameters(gravity: FloatArray) -> gtsam.PreintegrationCombinedParams:
    noise = ImuNoise()
    params = gtsam.PreintegrationCombinedParams(gravity)
    params.setAccelerometerCovariance(np.eye(3) * noise.accelerometer_density**2)
    params.setGyroscopeCovariance(np.eye(3) * noise.gyroscope_density**2)
    params.setIntegrationCovariance(np.eye(3) * INTEGRATION_VARIANCE)
    params.setBiasAccCovariance(np.eye(3) * noise.accelerometer_bias_walk**2)
    params.setBiasOmegaCovariance(np.eye(3) * noise.gyroscope_bias_walk**2)
    return params


def preintegrated(frames: Frames, gravity: FloatArray) -> list[Pim]:
    """The IMU between each frame and the one before."""
    params, bias = _parameters(gravity), gtsam.imuBias.ConstantBias()
    pims = [gtsam.PreintegratedCombinedMeasurements(params, bias) for _ in frames.t[1:]]
    for i, acc, gyro, h in zip(frames.owner, frames.acc, frames.gyro, frames.h, strict=True):
        pims[i - 1].integrateMeasurement(acc, gyro, h)
    return pims


def _joint_sigma(scene: Scene) -> float:
    """Noise of one joint, m an axis; `point_sigma_m` is that of the mean over the joints usually seen."""
    joints = scene.joints[scene.visible]
    usual = [j for j in FOREARM_JOINTS if np.isfinite(joints[:, JOINTS.index(j), 0]).mean() > 0.25]
    return scene.point_sigma_m * float(np.sqrt(max(len(usual), 1)))
