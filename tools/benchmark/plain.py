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
from dataclasses import dataclass, field

import gtsam
import numpy as np
from gtsam import Pose3, Rot3
from gtsam.symbol_shorthand import B, V, X
from scipy.interpolate import CubicHermiteSpline
from scipy.spatial.transform import Rotation, Slerp

from smoother.array_types import FloatArray
from smoother.baselines.scene import Path, Scene
from smoother.linalg import interpolate, rotate_covariance

from .plain_graphs import Frames, examples, examples_by_frame, frames_of, same_job

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
