"""Every factor of a small window's graph: its error against the formula, written out sample by sample."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import B, C, D, E, F, G, L, M, N, Q, S, U, V, W, X, Y, Z
from scipy.spatial.transform import Rotation
from small_window import BIAS_LENGTH_S, LEVERS, UPPER_FIRST, UPPER_NODES, small_window

import smoother.graph.build
from smoother.array_types import FloatArray
from smoother.graph.build import REST_SPEED, bias_of_intervals, build, upper_arm_sigmas
from smoother.graph.factors import DENSITY_STEP, INTEGRATION_VARIANCE, PARENT_TIE_M, TISSUE_S
from smoother.graph.variables import DIMENSION, sizes_of, values_of
from smoother.recording import JOINTS
from smoother.units import GRAVITY
from smoother.window.problem import ImuIncrements, JointMeasurements, NoiseModel, Window

ELBOW, SHOULDER = JOINTS.index("elbow"), JOINTS.index("shoulder")


def log(R: FloatArray) -> FloatArray:
    return np.asarray(Rotation.from_matrix(R).as_rotvec())


def exp(w: FloatArray) -> FloatArray:
    return np.asarray(Rotation.from_rotvec(w).as_matrix())


def cross(w: FloatArray) -> FloatArray:
    return np.array([[0.0, -w[2], w[1]], [w[2], 0.0, -w[0]], [-w[1], w[0], 0.0]])


def moved(values: gtsam.Values, seed: int = 5) -> gtsam.Values:
    """Somewhere near: every coordinate by some thousandths."""
    rng = np.random.default_rng(seed)
    delta = gtsam.VectorValues()
    size = {"x": 6, "y": 6, "v": 3, "w": 3, "b": 6, "c": 6, "g": 2, "u": 1, "l": 3, "m": 3, "s": 3, "e": 3}
    for key in sorted(values.keys()):
        delta.insert(key, 0.004 * rng.normal(size=size[chr(gtsam.Symbol(key).chr())]))
    return values.retract(delta)


def errors_by_class(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> dict[str, list[float]]:
    errors: dict[str, list[float]] = {}
    for i in range(graph.size()):
        errors.setdefault(type(graph.at(i)).__name__, []).append(graph.at(i).error(values))
    return errors


def gaussian(residual: FloatArray, sigma: float | FloatArray) -> float:
    return 0.5 * float(np.sum((residual / sigma) ** 2))


def cauchy(residual: FloatArray, sigma: float, k: float) -> float:
    return 0.5 * k**2 * float(np.log1p(residual @ residual / sigma**2 / k**2))


def full(residual: FloatArray, covariance: FloatArray) -> float:
    return 0.5 * float(residual @ np.linalg.solve(covariance, residual))


def matrix(pose: gtsam.Pose3) -> tuple[FloatArray, FloatArray]:
    return pose.rotation().matrix(), np.array(pose.translation())


def node_by_node(measured: JointMeasurements, k: float) -> Iterator[tuple[int, FloatArray, float]]:
    """(node, position, sigma): means; three or more weighted by how far they are from their median."""
    for node in sorted(set(measured.node.tolist())):
        rows = [row for row in range(len(measured.node)) if measured.node[row] == node]
        at = [measured.position[row] - measured.shift[row] for row in rows]
        lower = (len(rows) - 1) // 2
        median = np.array([sorted(x[axis] for x in at)[lower] for axis in range(3)])
        weights = []
        for row, x in zip(rows, at, strict=True):
            off = np.linalg.norm(x - median) / measured.sigma_m[row] if len(rows) > 2 else 0.0
            weights.append(1.0 / (1.0 + (off / k) ** 2) / measured.sigma_m[row] ** 2)
        mean = sum(w * x for w, x in zip(weights, at, strict=True)) / sum(weights)
        yield node, mean, 1.0 / np.sqrt(sum(weights))


def levels(increments: ImuIncrements, dt: FloatArray, noise: NoiseModel) -> Iterator[tuple[float, float]]:
    """Densities of accelerometer and gyroscope, interval by interval, in whole steps above the still ones."""
    for i, (a, b) in enumerate(zip(increments.first[:-1], increments.first[1:], strict=True)):
        rows = range(a, b)
        force = [abs(np.linalg.norm(increments.acc[row].mean(axis=0)) - GRAVITY) for row in rows]
        rate = [np.linalg.norm(increments.gyro[row]) for row in rows]
        impact = increments.velocity_error[i] / np.sqrt(dt[i])
        still = noise.accelerometer_density
        acc = np.sqrt(still**2 + (noise.accelerometer_share * np.mean(force)) ** 2 + impact**2) / still
        still = noise.gyroscope_density
        gyro = np.sqrt(still**2 + (noise.gyroscope_share * np.mean(rate)) ** 2) / still
        yield tuple(DENSITY_STEP ** round(np.log(ratio) / np.log(DENSITY_STEP)) for ratio in (acc, gyro))


def inertial(
    window: Window,
    increments: ImuIncrements,
    t: FloatArray,
    state: Callable[[int], tuple[FloatArray, FloatArray, FloatArray]],
    bias: Callable[[int], FloatArray],
    down: FloatArray,
) -> list[float]:
    """Error of each interval: what the samples predict of the next state, against that state."""
    errors = []
    g = GRAVITY * down
    for i, (acc_level, gyro_level) in enumerate(levels(increments, np.diff(t), window.noise)):
        (R, p, v), (Rj, pj, vj) = state(i), state(i + 1)
        covariance, turn = np.zeros((9, 9)), np.eye(3)
        known = increments.bias - bias(i)
        acc_density = acc_level * window.noise.accelerometer_density
        gyro_density = gyro_level * window.noise.gyroscope_density
        for row in range(increments.first[i], increments.first[i + 1]):
            h = increments.h[row]
            for half in range(2):
                force, rate = increments.acc[row, half] + known[:3], increments.gyro[row] + known[3:]
                F, by_acc, by_gyro = np.eye(9), np.zeros((9, 3)), np.zeros((9, 3))
                F[:3, :3], F[3:6, 6:] = exp(rate * h).T, np.eye(3) * h
                F[3:6, :3], F[6:, :3] = -0.5 * turn @ cross(force) * h**2, -turn @ cross(force) * h
                by_acc[3:6], by_acc[6:], by_gyro[:3] = 0.5 * turn * h**2, turn * h, np.eye(3) * h
                covariance = F @ covariance @ F.T + by_acc @ by_acc.T * acc_density**2 / h
                covariance += by_gyro @ by_gyro.T * gyro_density**2 / h
                covariance[3:6, 3:6] += np.eye(3) * INTEGRATION_VARIANCE * h
                a = R @ force + g
                p, v, R = p + v * h + 0.5 * a * h**2, v + a * h, R @ exp(rate * h)
                turn = turn @ exp(rate * h)
        errors.append(full(np.concatenate([log(Rj.T @ R), Rj.T @ (p - pj), Rj.T @ (v - vj)]), covariance))
    return errors


def test_each_factor_has_the_error_of_its_formula(monkeypatch: pytest.MonkeyPatch) -> None:
    """All of them at values that are a little off; the IMU's to what its linearised bias leaves."""
    monkeypatch.setattr(smoother.graph.build, "BIAS_LENGTH_S", BIAS_LENGTH_S)  # two of them
    window = replace(small_window(), still=np.array([4, 5]))
    graph, start, _ = build(window)
    values = moved(start)
    errors = errors_by_class(graph, values)
    layout, mean, noise = window.priors.layout, window.priors.shared.mean, window.noise
    R, p = zip(*(matrix(values.atPose3(X(i))) for i in range(len(window.t))), strict=True)
    v = [values.atVector(V(i)) for i in range(len(window.t))]
    levers = {joint: values.atPoint3(L(JOINTS.index(joint))) for joint in LEVERS} | {"strap": np.zeros(3)}
    camera: dict[str, list[float]] = {"elbow": [], "wrist": [], "strap": []}
    for measured in window.joint_measurements:
        for node, at, sigma in node_by_node(measured, noise.cauchy):
            off = p[node] + R[node] @ levers[measured.joint] - at
            sigma = sigma if measured.joint == "wrist" else round(sigma, 6)  # only means are rounded
            camera[measured.joint].append(cauchy(off, sigma, noise.cauchy))
    np.testing.assert_allclose(errors.pop("GPSFactorArmCalib"), camera["elbow"] + camera["wrist"], rtol=1e-7)
    np.testing.assert_allclose(errors.pop("GPSFactorArm"), camera["strap"], rtol=1e-7)

    nodes, knots = window.shoulder.node, [values.atPoint3(S(k)) for k in range(6)]
    expected = [
        cauchy(knots[k] - window.shoulder.position[k], window.shoulder.sigma_m[k], noise.cauchy)
        for k in (0, 2, 3, 5)
    ]
    np.testing.assert_allclose(errors.pop("PriorFactorPoint3"), expected, rtol=1e-7)
    # nobody saw it: its first knot is held where it begins, to a metre
    nowhere = replace(window.shoulder, position=np.full((6, 3), np.nan))
    unseen = errors_by_class(build(replace(window, shoulder=nowhere)).graph, values)
    first = gaussian(knots[0] - window.shoulder.start[0], 1.0)
    np.testing.assert_allclose(unseen["PriorFactorPoint3"], [first])
    expected = [
        gaussian(knots[k + 1] - knots[k], round(noise.shoulder_walk * np.sqrt(dt), 6))
        for k, dt in enumerate(np.diff(window.t[nodes]))
    ]
    np.testing.assert_allclose(errors.pop("BetweenFactorPoint3"), expected, rtol=1e-7)
    expected = []
    for k, node in enumerate(nodes):
        elbow = p[node] + R[node] @ mean[layout.lever("elbow")]
        off = np.linalg.norm(elbow - knots[k]) + values.atDouble(U(0)) - mean[layout.upper_arm]
        expected.append(gaussian(off, upper_arm_sigmas(window)[k]))
    np.testing.assert_allclose(errors.pop("RangeFactorWithTransformBias3D"), expected, rtol=1e-7)

    expected = [gaussian(v[i + 1] - v[i], window.velocity_change[i]) for i in (3, 4, 5)]
    np.testing.assert_allclose(errors.pop("BetweenFactorVector"), expected, rtol=1e-7)
    expected = [cauchy(v[i], REST_SPEED, noise.cauchy) for i in (4, 5)]
    np.testing.assert_allclose(errors.pop("PriorFactorVector"), expected, rtol=1e-7)
    expected = []
    for node, in_A in zip(window.field.node, window.field.in_A, strict=True):
        off = np.cross(R[node] @ in_A, window.field.in_K)
        expected.append(cauchy(off, round(window.field.sigma_rad, 5), noise.cauchy))
    np.testing.assert_allclose(errors.pop("AttitudeFactorPose3"), expected, rtol=1e-7)

    (run,) = window.further
    upper = range(UPPER_FIRST, UPPER_FIRST + UPPER_NODES)
    at_upper = {i: (*matrix(values.atPose3(Y(i))), values.atVector(W(i))) for i in upper}
    expected = []
    for i, given, covariance in (
        (window.forearm.attitude_node, window.forearm.attitude, window.forearm.attitude_covariance),
        (UPPER_FIRST + run.attitude_node, run.attitude, run.attitude_covariance),
    ):
        turned = R[i] if given is window.forearm.attitude else at_upper[i][0]
        expected.append(full(given @ log(given.T @ turned), covariance))
    np.testing.assert_allclose(errors.pop("PoseRotationPrior3D"), expected, rtol=1e-6)
    ties, ends = [], []
    gaps = np.gradient(window.t[list(upper)])
    for i, gap_s in zip(upper, gaps, strict=True):
        elbow = values.atPoint3(E(i))
        ties.append(gaussian(p[i] + R[i] @ levers["elbow"] - elbow, PARENT_TIE_M))
        tissue = round(dict(noise.tissue_m)["upper_arm"] * np.sqrt(TISSUE_S / gap_s), 3)
        on_upper = at_upper[i][1] + at_upper[i][0] @ values.atPoint3(M(ELBOW))
        ties.append(gaussian(on_upper - elbow, tissue))
    for k, gap_s in enumerate(np.gradient(window.t[nodes])):
        if nodes[k] in upper:
            Ru, pu, _ = at_upper[nodes[k]]
            tissue = round(dict(noise.tissue_m)["upper_arm"] * np.sqrt(TISSUE_S / gap_s), 3)
            ends.append(gaussian(pu + Ru @ values.atPoint3(M(SHOULDER)) - knots[k], tissue))
    np.testing.assert_allclose(errors.pop("ReferenceFrameFactorPoint3Pose3"), ties + ends, rtol=1e-7)

    biases = bias_of_intervals(window)
    assert biases.tolist() == [0] * 5 + [1] * 4 or biases.tolist() == [0] * 4 + [1] * 5
    wrist_bias, upper_bias = ([values.atConstantBias(key(k)).vector() for k in (0, 1)] for key in (B, C))
    walk = window.priors.bias_walk * np.sqrt((window.t[-1] - window.t[0]) / 2)
    expected = [gaussian(bias[1] - bias[0], walk) for bias in (wrist_bias, upper_bias)]
    np.testing.assert_allclose(errors.pop("BetweenFactorConstantBias"), expected, rtol=1e-6)
    down = values.atUnit3(G(0)).point3()
    parts = [wrist_bias[1], layout.gravity_axes @ down, mean[layout.upper_arm] - values.atDouble(U(0))]
    parts += [levers["elbow"], levers["wrist"], *(values.atPoint3(M(j)) for j in (ELBOW, SHOULDER))]
    off = np.concatenate([*parts, upper_bias[1]]) - mean
    (prior,) = errors.pop("LinearContainerFactor")
    # gravity's tangent is flat to the square of its 4 mrad
    assert prior == pytest.approx(full(off, window.priors.shared.covariance), rel=1e-4)

    expected = inertial(
        window,
        window.forearm.increments,
        window.t,
        lambda i: (R[i], p[i], v[i]),
        lambda i: wrist_bias[biases[i]],
        down,
    )
    expected += inertial(
        window,
        run.increments,
        window.t[list(upper)],
        lambda i: at_upper[UPPER_FIRST + i],
        lambda i: upper_bias[biases[UPPER_FIRST + i]],
        down,
    )
    # to what the bias moves beyond first order: 6e-4
    np.testing.assert_allclose(errors.pop("ImuFactorWithGravityDirection"), expected, rtol=0.002)
    assert not errors


def test_sizes_and_values_of_all_that_windows_have() -> None:
    """As GTSAM counts and holds them, of every letter."""
    kinds = {gtsam.Pose3(gtsam.Rot3.RzRyRx(0.1, -0.2, 0.3), np.array([1.0, 2.0, 3.0])): (X, Y, Z)}
    kinds |= {gtsam.imuBias.ConstantBias(np.full(3, 0.1), np.full(3, 0.01)): (B, C, D), 0.25: (U,)}
    of_key = {letter(7): value for value, letters in kinds.items() for letter in letters}
    of_key |= {letter(7): np.array([0.4, 0.5, 0.6]) for letter in (V, W, Q, L, S, E, F, M, N)}
    of_key[G(7)] = gtsam.Unit3(np.array([0.1, -0.9, 0.2]))
    assert {chr(gtsam.Symbol(key).chr()) for key in of_key} == set(DIMENSION)
    everything = gtsam.Values()
    for key, value in of_key.items():
        everything.insert(key, value)
    for key, size in zip(of_key, sizes_of(np.array(list(of_key), np.uint64)), strict=True):
        alone = gtsam.Values()
        alone.insert(key, of_key[key])
        assert size == DIMENSION[chr(gtsam.Symbol(key).chr())] == alone.dim()
        assert values_of(everything, [key]).equals(alone, 1e-12)
    assert values_of(everything, list(of_key)).equals(everything, 1e-12)
