"""A window made by hand, without a recording: ten nodes with everything that a graph can hold.

Two bias variables, samples that share a node, a joint without a lever arm, a shoulder that is hidden at some
knots, a gap, a magnetometer, an IMU on the upper arm that begins late and ends early. It takes milliseconds
where a window of a simulated recording takes seconds.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from smoother.array_types import FloatArray
from smoother.body import FOREARM, UPPER_ARM
from smoother.units import GRAVITY
from smoother.window.problem import (
    FieldMeasurements,
    ImuIncrements,
    JointMeasurements,
    NoiseModel,
    Priors,
    SegmentRun,
    ShoulderMeasurements,
    States,
    Window,
)
from smoother.window.shared import SIZE, Considered, Gaussian, SharedLayout, axes_across

NODES, STEP_S, SUBSTEPS, NOISE_M = 10, 0.06, 3, 0.004
DOWN = np.array([0.1, -0.95, 0.2]) / np.linalg.norm([0.1, -0.95, 0.2])
#: The nodes of the upper-arm IMU.
UPPER_FIRST, UPPER_NODES = 2, 6
#: A bias variable for so long, s: two of them in the window.
BIAS_LENGTH_S = 0.3
LEVERS = {"elbow": np.array([-0.22, 0.01, 0.02]), "wrist": np.array([0.05, -0.01, 0.015])}
UPPER_LEVERS = {"elbow": np.array([0.15, 0.01, -0.02]), "shoulder": np.array([-0.14, 0.0, 0.03])}
UPPER_ARM_M = 0.3
NOISE = NoiseModel(
    accelerometer_density=0.02,
    gyroscope_density=0.002,
    accelerometer_share=0.004,
    gyroscope_share=0.003,
    cauchy=2.5,
    upper_arm_sigma_m=0.012,
    shoulder_walk=0.05,
    tissue_m=(("upper_arm", 0.01),),
)


def covariance(rng: np.random.Generator, sigmas: FloatArray) -> FloatArray:
    """Correlated, with about these standard deviations."""
    A = rng.normal(size=(len(sigmas), len(sigmas)))
    A = np.eye(len(sigmas)) + 0.3 * A / np.sqrt(len(sigmas))
    return np.asarray((sigmas[:, None] * (A @ A.T)) * sigmas)


def moving(rng: np.random.Generator, t: FloatArray, origin: FloatArray) -> tuple[States, ImuIncrements]:
    """A motion of piecewise constant force and rate, and the samples of an IMU on it without its bias."""
    n, m = len(t), SUBSTEPS * (len(t) - 1)
    shares = np.array([0.2, 0.5, 0.3])
    h = 0.5 * (np.diff(t)[:, None] * shares).ravel()
    R, p, v = Rotation.from_rotvec(rng.normal(size=3)).as_matrix(), origin.copy(), 0.3 * rng.normal(size=3)
    acc, gyro = np.zeros((m, 2, 3)), np.zeros((m, 3))
    size = np.repeat(np.linspace(0.2, 6.0, n - 1), SUBSTEPS)  # so that intervals differ in their noise
    states = [(R, p, v)]
    for k in range(m):
        gyro[k] = 0.25 * size[k] * rng.normal(size=3)
        for half in range(2):
            acc[k, half] = R.T @ (-GRAVITY * DOWN + size[k] * rng.normal(size=3))
            a = R @ acc[k, half] + GRAVITY * DOWN
            p, v = p + v * h[k] + 0.5 * a * h[k] ** 2, v + a * h[k]
            R = R @ Rotation.from_rotvec(gyro[k] * h[k]).as_matrix()
        if k % SUBSTEPS == SUBSTEPS - 1:
            states.append((R, p, v))
    bias = np.concatenate([0.1 * rng.normal(size=3), 0.01 * rng.normal(size=3)])
    first = SUBSTEPS * np.arange(n)
    increments = ImuIncrements(acc, gyro, h, first, bias, 0.02 * rng.uniform(size=n - 1))
    return States(*(np.array([state[k] for state in states]) for k in range(3))), increments


def small_window(seed: int = 0, upper: bool = True) -> Window:
    """A window of a forearm's and an upper arm's IMU; its initial values are a little off."""
    rng = np.random.default_rng(seed)
    t = 20.0 + STEP_S * np.arange(NODES) + 0.01 * rng.uniform(size=NODES)
    states, increments = moving(rng, t, np.array([0.1, 0.2, 1.9]))
    covered = slice(UPPER_FIRST, UPPER_FIRST + UPPER_NODES)
    upper_states, upper_increments = moving(rng, t[covered], np.array([0.0, 0.3, 1.8]))
    further = (UPPER_ARM.name,) if upper else ()
    layout = SharedLayout(("elbow", "wrist"), True, axes_across(DOWN), further)
    parts = [increments.bias, np.zeros(2), [UPPER_ARM_M], *LEVERS.values()]
    parts += [*UPPER_LEVERS.values(), upper_increments.bias] if upper else []
    mean = np.concatenate(parts)
    bias_sigmas = np.repeat([0.05, 0.004], 3)
    sigmas = [bias_sigmas, np.full(2, 0.02), np.full(7, 0.01)]
    sigmas += [np.full(6, 0.015), bias_sigmas] if upper else []
    prior = Gaussian(mean, covariance(rng, np.concatenate(sigmas)))
    shared = mean + 0.3 * np.concatenate(sigmas) * rng.normal(size=len(mean))
    elbow = states.p + states.R @ shared[layout.lever("elbow")]
    if upper:  # the arm hangs together: the upper IMU is where elbow and orientation put it
        on_upper = shared[layout.lever("elbow", UPPER_ARM.name)]
        upper_states = replace(upper_states, p=elbow[covered] - upper_states.R @ on_upper)
    node = np.array([0, 2, 4, 6, 7, 9])
    across = rng.normal(size=3)
    shoulder = elbow[node] + shared[layout.upper_arm] * across / np.linalg.norm(across)
    levers = {joint: shared[layout.lever(joint)] for joint in LEVERS} | {"strap": np.zeros(3)}
    measured = tuple(_joint(rng, joint, t, states, lever) for joint, lever in levers.items())
    position = shoulder + NOISE_M * rng.normal(size=shoulder.shape)
    position[[1, 4]] = np.nan
    change = np.full(NODES - 1, np.inf)
    change[3:6] = [0.4, 0.5, 0.6]
    in_K = np.array([0.3, -0.4, np.sqrt(0.75)])
    at = np.array([1, 5, 8])
    in_A = np.einsum("nji,j->ni", states.R[at], in_K) + 0.02 * rng.normal(size=(3, 3))
    field = FieldMeasurements(at, in_A / np.linalg.norm(in_A, axis=1)[:, None], in_K, 0.03)
    run = SegmentRun(
        segment=UPPER_ARM.name,
        first=UPPER_FIRST,
        start=_shaken(rng, upper_states),
        increments=upper_increments,
        attitude_node=4,
        attitude=upper_states.R[4] @ Rotation.from_rotvec([0.02, -0.03, 0.01]).as_matrix(),
        attitude_covariance=covariance(rng, np.full(3, 0.05)),
    )
    seen_shoulder = ShoulderMeasurements(
        node, position, np.linspace(0.006, 0.016, len(node)), shoulder + 0.01 * rng.normal(size=(6, 3))
    )
    forearm = SegmentRun(
        segment=FOREARM.name,
        first=0,
        start=_shaken(rng, states),
        increments=increments,
        attitude_node=3,
        attitude=states.R[3] @ Rotation.from_rotvec([-0.03, 0.02, 0.04]).as_matrix(),
        attitude_covariance=covariance(rng, np.array([0.05, 0.06, 0.04])),
    )
    # errors that are left, and how the recording's estimate of what all share follows them
    considered = Considered(
        covariance(rng, np.full(SIZE, 0.003)), 0.05 * rng.normal(size=(layout.size, SIZE))
    )
    return Window(
        t=t,
        core_start_s=float(t[1]),
        core_end_s=float(t[-2]),
        bodies=(forearm, run) if upper else (forearm,),
        joint_measurements=measured,
        shoulder=seen_shoulder,
        velocity_change=change,
        still=np.zeros(0, int),
        priors=Priors(layout, prior, np.repeat([0.02, 0.001], 3) * np.linspace(1.0, 2.0, 6)),
        noise=NOISE,
        field=field,
        considered=considered,
    )


def _joint(
    rng: np.random.Generator, joint: str, t: FloatArray, states: States, lever: FloatArray
) -> JointMeasurements:
    """One to four samples at each node outside the gap; the wrist has one everywhere."""
    nodes = np.array([0, 1, 2, 3, 6, 7, 8, 9])
    counts = np.ones(8, dtype=int) if joint == "wrist" else np.array([1, 2, 4, 1, 3, 1, 5, 2])
    node = np.repeat(nodes, counts)
    shift, velocity = 0.02 * rng.normal(size=(len(node), 3)), 0.2 * rng.normal(size=(len(node), 3))
    sigma = NOISE_M * np.linspace(1.0, 2.0, len(node))
    position = (
        states.p[node] + states.R[node] @ lever + shift + sigma[:, None] * rng.normal(size=(len(node), 3))
    )
    if joint == "elbow":
        position[5] += [0.05, -0.02, 0.0]  # one of four is wrong
    t_s = t[node] + 0.3 * STEP_S * rng.uniform(size=len(node))
    return JointMeasurements(joint, t_s, node, position, sigma, shift, velocity)


def _shaken(rng: np.random.Generator, states: States) -> States:
    turn = Rotation.from_rotvec(0.01 * rng.normal(size=states.p.shape)).as_matrix()
    return States(
        states.R @ turn,
        states.p + 0.005 * rng.normal(size=states.p.shape),
        states.v + 0.02 * rng.normal(size=states.v.shape),
    )
