"""A solved moment propagated by the IMU, with its covariance."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ..array_types import FloatArray
from ..linalg import length, skew_of
from ..measurements.inertial import integrate_one
from ..rotation import matrix_of, rotvec_of
from ..window.problem import NoiseModel
from ..window.solution import LagSolution, NodeState
from .signal import DoubtfulSignal, LiveSignal

#: The IMU's last rate holds for no longer than this beyond its last sample, s.
BEYOND_S = 0.05


@dataclass(frozen=True)
class Prediction:
    """A state, and how it follows what the window has solved."""

    solution: LagSolution
    start: str  # "" or "settled_": the node that it begins at
    state: NodeState
    follows: FloatArray  # (9, 18)
    noise: FloatArray  # (9, 9): what the IMU's white noise adds to the covariance

    def covariance(self, names: Sequence[str]) -> FloatArray:
        """Of (turn, position, velocity) and of what is named, 3 each."""
        start = [self.start + name for name in ("turn", "position", "velocity")]
        before = self.solution.block(*start, "bias", "gravity", *names)
        follows = np.zeros((9 + 3 * len(names), len(before)))
        follows[:9, :18] = self.follows
        follows[9:, 18:] = np.eye(3 * len(names))
        covariance = follows @ before @ follows.T
        covariance[:9, :9] += self.noise
        return np.asarray(covariance)


def joint_at(
    R: FloatArray, p: FloatArray, lever: FloatArray, number: int, covariance: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """A joint's place and its covariance, of that of (turn, position, velocity, lever arms)."""
    arm = R @ lever
    jacobian = np.concatenate([-skew_of(arm), _ONE, R], axis=1)
    rows = np.r_[0:6, 9 + 3 * number : 12 + 3 * number]
    return p + arm, jacobian @ covariance[np.ix_(rows, rows)] @ jacobian.T


def predict(
    solution: LagSolution, live: LiveSignal, t_s: float, noise: NoiseModel, settled: bool = False
) -> Prediction:
    """Propagate the newest or settled node to a time (Forster, TRO 2017, eq 32; first-order covariance)."""
    start = solution.settled if settled else solution.newest
    gravity, signal, (t, R, p, v) = (
        solution.gravity,
        live.since(start.t),
        (start.t, start.R, start.p, start.v),
    )
    follows, white = np.eye(9, 18), np.zeros((9, 9))
    for dt, (delta_R, delta_v, delta_p) in _intervals(t, t_s, signal, solution.bias):
        dv, dp, turned = R @ delta_v, R @ delta_p, rotvec_of(delta_R)
        middle = R @ matrix_of(0.5 * turned)
        more = np.eye(9, 18)  # how the state after follows (the state before, biases, gravity)
        more[_TURN, _GYRO] = -middle * dt
        more[_PLACE, _TURN], more[_PLACE, _SPEED] = -skew_of(dp), _ONE * dt
        more[_PLACE, _ACC], more[_PLACE, _DOWN] = -0.5 * dt**2 * middle, 0.5 * dt**2 * _ONE
        more[_SPEED, _TURN] = -skew_of(dv)
        more[_SPEED, _ACC], more[_SPEED, _DOWN] = -dt * middle, dt * _ONE
        beyond = abs(length(delta_v) / dt - length(gravity))
        q_acc = noise.accelerometer_density**2 + (noise.accelerometer_share * beyond) ** 2
        q_gyro = noise.gyroscope_density**2 + (noise.gyroscope_share * length(turned) / dt) ** 2
        own = more[:, :9]
        white = own @ white @ own.T
        white[_TURN, _TURN] += _ONE * (q_gyro * dt)
        white[_SPEED, _SPEED] += _ONE * (q_acc * dt)
        white[_PLACE, _PLACE] += _ONE * (q_acc * dt**3 / 3.0)
        white[_PLACE, _SPEED] += _ONE * (q_acc * dt**2 / 2.0)
        white[_SPEED, _PLACE] += _ONE * (q_acc * dt**2 / 2.0)
        whole = np.eye(18)
        whole[:9] = follows
        follows = more @ whole
        t, R, p, v = t + dt, R @ delta_R, p + v * dt + 0.5 * gravity * dt**2 + dp, v + gravity * dt + dv
    if t > start.t:
        white = white + _lost(signal, start.t, t)
    return Prediction(solution, "settled_" if settled else "", NodeState(t, R, p, v), follows, white)


def _intervals(
    start_s: float, end_s: float, signal: DoubtfulSignal, bias: FloatArray
) -> Iterator[tuple[float, tuple[FloatArray, FloatArray, FloatArray]]]:
    """Length, turn, change of velocity and place by the samples, then by the last rate going on."""
    inside_s = min(end_s, signal.end_s)
    if inside_s > start_s + 1e-9:
        yield inside_s - start_s, integrate_one(signal, start_s, inside_s, bias)
        start_s = inside_s
    beyond_s = min(end_s - start_s, BEYOND_S)
    if beyond_s > 1e-4:
        last = signal.mean(np.array([signal.end_s - 0.02]), np.array([signal.end_s]))[0] - bias
        dv = last[:3] * beyond_s
        yield beyond_s, (matrix_of(last[3:] * beyond_s), dv, 0.5 * beyond_s * dv)


_ONE = np.eye(3)
_TURN, _PLACE, _SPEED, _ACC, _GYRO, _DOWN = (slice(k, k + 3) for k in range(0, 18, 3))


def _lost(signal: DoubtfulSignal, start_s: float, end_s: float) -> FloatArray:
    """What impacts and replaced samples add to the covariance (9, 9) of turn, position and velocity."""
    t, length_s = np.array([start_s, end_s]), end_s - start_s
    speed, turn = float(signal.velocity_error(t)[0]) ** 2, float(signal.turn_error(t)[0]) ** 2
    added = np.zeros((9, 9))
    added[:3, :3] = turn * _ONE
    added[3:6, 3:6] = speed * length_s**2 / 3.0 * _ONE
    added[3:6, 6:] = added[6:, 3:6] = 0.5 * speed * length_s * _ONE
    added[6:, 6:] = speed * _ONE
    return added
