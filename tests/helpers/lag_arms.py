"""Arms for the window of the last moments: exact states with the samples between them, and a window."""

from __future__ import annotations

import gtsam
import numpy as np
from gtsam import Rot3

from smoother.array_types import FloatArray
from smoother.graph.lag_window import LagWindow
from smoother.recording import JOINTS
from smoother.units import GRAVITY
from smoother.window.problem import ImuIncrements, NoiseModel, Priors
from smoother.window.shared import Gaussian, SharedLayout, axes_across
from smoother.window.solution import NodeState

UPPER = "upper_arm"
#: Cauchy's loss so wide that it is none.
NOISE = NoiseModel(0.02, 0.003, 0.0, 0.0, 1e3, 0.01, 0.3, tissue_m=((UPPER, 0.005),))
#: Down of a camera that is tilted.
TILTED = np.array([0.1, -0.4, -0.9]) / np.linalg.norm([0.1, -0.4, -0.9])
LEVERS = {"elbow": np.array([-0.12, 0.01, 0.02]), "wrist": np.array([0.1, 0.0, -0.01])}
UPPER_LEVERS = {"elbow": np.array([0.0, -0.14, 0.03]), "shoulder": np.array([0.01, 0.16, 0.03])}
SIGMA_M, DT = 0.01, 1 / 30


def intervals(
    t: FloatArray, R: list[Rot3], place: list[FloatArray], down: FloatArray, rng: np.random.Generator
) -> tuple[list[NodeState], list[ImuIncrements]]:
    """States that go through places, and noisy samples of the intervals: exact but for the noise.

    The places are those at the beginning; each interval has the one specific force that leads to the next.
    """
    velocity = (place[1] - place[0]) / DT
    states, increments = [NodeState(float(t[0]), R[0].matrix(), place[0], velocity)], []
    for k in range(1, len(t)):
        before = states[-1]
        gyro = Rot3.Logmap(R[k - 1].between(R[k])) / DT
        # what leads there by a constant acceleration, damped: the velocity at both ends is the mean one
        acceleration = 2.0 * (place[k] - before.p - before.v * DT) / DT**2
        acceleration = 0.5 * (acceleration + ((place[k] - place[k - 1]) / DT - before.v) / DT)
        force = R[k - 1].unrotate(acceleration - GRAVITY * down)
        pim = gtsam.PreintegratedImuMeasurements(
            gtsam.PreintegrationParams(GRAVITY * down), gtsam.imuBias.ConstantBias()
        )
        pim.integrateMeasurement(force, gyro, 0.5 * DT)
        pim.integrateMeasurement(force, gyro, 0.5 * DT)
        nav = pim.predict(gtsam.NavState(Rot3(before.R), before.p, before.v), gtsam.imuBias.ConstantBias())
        states.append(NodeState(float(t[k]), nav.attitude().matrix(), nav.position(), nav.velocity()))
        force = force + rng.normal(0.0, NOISE.accelerometer_density / np.sqrt(DT), 3)
        gyro = gyro + rng.normal(0.0, NOISE.gyroscope_density / np.sqrt(DT), 3)
        two = np.stack([force, force])[None]
        increments.append(
            ImuIncrements(two, gyro[None], np.array([0.5 * DT]), np.array([0, 1]), np.zeros(6), np.zeros(1))
        )
    return states, increments


def lag_window(
    down: FloatArray, length_s: float, has_upper_arm: bool = True, further: tuple[str, ...] = ()
) -> LagWindow:
    """Lever arms known to 5 mm, gravity to a degree."""
    joints = tuple(joint for joint in JOINTS if joint in LEVERS)
    layout = SharedLayout(joints, has_upper_arm, axes_across(down), further)
    mean, sigma = np.zeros(layout.size), np.full(layout.size, 0.005)
    sigma[:3], sigma[3:6], sigma[layout.gravity] = 0.05, 0.005, 0.02
    for joint, lever in LEVERS.items():
        mean[layout.lever(joint)] = lever
    for segment in further:
        bias = layout.bias_of(segment)
        sigma[bias.start : bias.start + 3] = 0.05
        for joint, lever in UPPER_LEVERS.items():
            mean[layout.lever(joint, segment)] = lever
    mean[layout.upper_arm], sigma[layout.upper_arm] = 0.3, 0.3
    priors = Priors(layout, Gaussian(mean, np.diag(sigma**2)), np.repeat([1e-3, 1e-4], 3))
    return LagWindow(priors, NOISE, np.full(len(JOINTS), SIGMA_M), length_s)
