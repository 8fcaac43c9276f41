"""The plain way: ONE graph over the whole recording, a node for every camera frame.

Three ways, all written plainly and none made slow on purpose:

`batch` is what GTSAM's own examples write (`CombinedImuFactorsExample`: IMU and position fixes). A pose, a
velocity and a bias for every camera frame; every IMU sample through `integrateMeasurement`, held constant
over its interval; one `CombinedImuFactor` between neighbouring frames, which carries the bias' random walk
too; one `GPSFactorArm` for every forearm joint that the camera saw. It solves the motion alone, by
Levenberg-Marquardt with GTSAM's default parameters.

`isam2` is the same graph solved as the examples do that grow it (`IMUKittiExampleGPS`,
`ImuFactorISAM2Example`): frame by frame through `ISAM2`, each frame started from the IMU's prediction.

`same job` is one graph that finds what `smooth` finds: gravity's direction, the lever arms and the upper
arm's length are variables, the shoulder is a point for every frame, the camera's samples have `smooth`'s
robust loss, and the IMU's pieces are integrated to second order. That is what it takes for answers as good.

Each gives the pose's covariance at every frame by marginals (`smooth` states one at every sample).

In the plain graphs' favour: like baselines, they get what `smooth` found: clock, the camera's noise, which
samples to believe, the gaps; the first two also gravity and the lever arms, `same job` has their values as
start values. `batch` and `same job` start from the house's own values: orientation by the inertial filter
aligned to the camera, positions from the camera with cubic bridges over the gaps. (From the IMU's prediction
alone, half a million metres off after six minutes, Levenberg-Marquardt ends in a wrong minimum there: 12 cm
rms in the gaps, 1 m at most.) None of that is in their time. Nodes in gaps are as many as frames, since the
answer is wanted there. GTSAM from PyPI solves one graph on one core.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, field

import gtsam
import numpy as np
from gtsam import Pose3, Rot3, Unit3, noiseModel
from gtsam.symbol_shorthand import B, G, L, S, U, V, X
from scipy.interpolate import CubicHermiteSpline
from scipy.spatial.transform import Rotation, Slerp

from smoother.array_types import FloatArray
from smoother.baselines.scene import Path, Scene
from smoother.config import ArmPrior, CameraNoise, ImuNoise
from smoother.linalg import interpolate, rotate_covariance
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
#: What `same_job` is given of lever arms and upper arm, m; where it starts is what `smooth` found.
LEVER_SIGMA_M = 0.03
UPPER_ARM_SIGMA_M = 0.05


@dataclass(frozen=True)
class Frames:
    """What the graph is built from: camera frames (f,) with joints (f, 5, 3), start values, IMU pieces."""

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
        # GTSAM takes the orientation at the piece's start for the whole of it; half of its turn corrects that
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
    """Noise of one joint, m per axis; `point_sigma_m` is that of the mean over the joints usually seen."""
    joints = scene.joints[scene.visible]
    usual = [j for j in FOREARM_JOINTS if np.isfinite(joints[:, JOINTS.index(j), 0]).mean() > 0.25]
    return scene.point_sigma_m * float(np.sqrt(max(len(usual), 1)))


WAYS = ("batch", "isam2", "same job")


@dataclass
class Timed:
    """Seconds by step, and the optimiser's iterations, summed over stretches."""

    seconds: dict[str, float] = field(default_factory=dict)
    iterations: int = 0
    nodes: int = 0

    @property
    def total_s(self) -> float:
        """All steps together, s."""
        return sum(self.seconds.values())

    def add(self, step: str, since: float) -> float:
        """Count the time since then; now."""
        now = time.perf_counter()
        self.seconds[step] = self.seconds.get(step, 0.0) + now - since
        return now


def solve_plainly(scene: Scene, way: str, timed: Timed) -> Path:
    """Recover one stretch by one graph; `timed` takes the seconds of its steps."""
    frames = frames_of(scene, second_order=way == "same job")
    values, covariance = (
        _incremental(scene, frames, timed) if way == "isam2" else _batch(scene, frames, way, timed)
    )
    now = time.perf_counter()
    path = _path(scene, frames.t, values, covariance)
    timed.add("read the answer", now)
    timed.nodes += len(frames.t)
    return path


def _batch(scene: Scene, frames: Frames, way: str, timed: Timed) -> tuple[gtsam.Values, FloatArray]:
    """Values and pose covariances (f, 6, 6) by Levenberg-Marquardt."""
    now = time.perf_counter()
    graph, values = same_job(scene, frames) if way == "same job" else examples(scene, frames)
    now = timed.add("build", now)
    optimizer = gtsam.LevenbergMarquardtOptimizer(graph, values, gtsam.LevenbergMarquardtParams())
    values = optimizer.optimize()
    timed.iterations += optimizer.iterations()
    now = timed.add("optimise", now)
    marginals = gtsam.Marginals(graph, values)
    covariance = np.array([marginals.marginalCovariance(X(i)) for i in range(len(frames.t))])
    timed.add("marginals", now)
    return values, covariance


def _incremental(scene: Scene, frames: Frames, timed: Timed) -> tuple[gtsam.Values, FloatArray]:
    """Values and pose covariances (f, 6, 6) by ISAM2, a frame at a time."""
    now = time.perf_counter()
    params = gtsam.ISAM2Params()
    params.relinearizeSkip = 10
    solver = gtsam.ISAM2(params)
    pose, velocity = Pose3(Rot3(frames.R[0]), frames.p[0]), frames.v[0]
    bias = gtsam.imuBias.ConstantBias()
    for i, (graph, pim) in enumerate(examples_by_frame(scene, frames)):
        if pim is not None:
            predicted = pim.predict(gtsam.NavState(pose, velocity), bias)
            pose, velocity = predicted.pose(), predicted.velocity()
        values = gtsam.Values()
        values.insert(X(i), pose)
        values.insert(V(i), velocity)
        values.insert(B(i), bias)
        solver.update(graph, values)
        timed.iterations += 1
        pose, velocity = solver.calculateEstimatePose3(X(i)), solver.calculateEstimateVector(V(i))
        bias = solver.calculateEstimateConstantBias(B(i))
    values = solver.calculateBestEstimate()
    now = timed.add("build and update", now)
    covariance = np.array([solver.marginalCovariance(X(i)) for i in range(len(frames.t))])
    timed.add("marginals", now)
    return values, covariance


def _path(scene: Scene, t: FloatArray, values: gtsam.Values, covariance: FloatArray) -> Path:
    """The answer at the IMU's samples; GTSAM's covariances are of (rotation, translation) in {A}."""
    poses = [values.atPose3(X(i)) for i in range(len(t))]
    R = np.array([pose.rotation().matrix() for pose in poses])
    p = np.array([pose.translation() for pose in poses])
    v = np.array([values.atVector(V(i)) for i in range(len(t))])
    inside = np.clip(scene.t, t[0], t[-1])
    return Path(
        position=CubicHermiteSpline(t, p, v)(inside),
        velocity=interpolate(t, v, inside),
        covariance=interpolate(t, rotate_covariance(R, covariance[:, 3:, 3:]), inside),
        R_K_A=Slerp(t, Rotation.from_matrix(R))(inside).as_matrix(),
        attitude_covariance=interpolate(t, rotate_covariance(R, covariance[:, :3, :3]), inside),
    )
