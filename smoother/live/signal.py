"""The IMU's last samples as a signal with one calibration, its integrals, and states propagated by it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..array_types import FloatArray
from ..linalg import length, middle, skew_of
from ..measurements.inertial import (
    InertialSignal,
    equivalent_samples,
    integrate_each,
    integrate_one,
    split_steps,
)
from ..measurements.segment import without_spikes
from ..recording import ImuStream
from ..rotation import matrix_of, rotvec_of
from ..window.problem import ImuIncrements, NoiseModel
from ..window.solution import LagSolution, NodeState
from .imu import LiveImu

#: The signal begins this long before what is integrated, s: the spline's end has no effect there.
BEFORE_S = 0.1
#: ... and is read this far back at least, so that one serves a whole step, s.
CACHED_S = 0.8
#: An arm's acceleration where samples are missing, m/s^2.
MISSED_ACCELERATION = 4.0
#: .. and its angular acceleration, rad/s^2: between two samples the rate is interpolated.
MISSED_TURNING = 10.0


class DoubtfulSignal(InertialSignal):
    """A signal of which some samples were replaced."""

    def __init__(self, imu: ImuStream, doubt: FloatArray) -> None:
        super().__init__(imu)
        self._doubt = np.zeros((len(self.edges), 2))
        self.is_doubtful = bool(doubt.any())
        self.usual_s = middle(self.edges[1:] - self.edges[:-1])
        np.cumsum(doubt, axis=0, out=self._doubt[1:])

    def velocity_error(self, t: FloatArray) -> FloatArray:
        """As of a sound signal, and what replaced samples may have cost."""
        impacts = super().velocity_error(t)
        return np.hypot(impacts, self._lost(t, 0)) if self.is_doubtful else impacts

    def turn_error(self, t: FloatArray) -> FloatArray:
        """Turn that each interval of consecutive times (n + 1,) may have lost, rad, one sigma per axis."""
        return self._lost(t, 1) if self.is_doubtful else np.zeros(len(t) - 1)

    def _lost(self, t: FloatArray, column: int) -> FloatArray:
        variance = np.diff(np.interp(t, self.edges, self._doubt[:, column]))
        # what is beyond the last sample goes on as that did
        beyond = np.maximum(t[1:] - np.maximum(t[:-1], self.end_s), 0.0)
        last = (self._doubt[-1, column] - self._doubt[-2, column]) / (self.edges[-1] - self.edges[-2])
        return np.asarray(np.sqrt(np.maximum(variance, 0.0) + last * beyond))


class LiveSignal:
    """The IMU's samples as a signal with one calibration; made anew when samples have come."""

    def __init__(self, imu: LiveImu, errors: FloatArray, shift_s: float = 0.0) -> None:
        self._imu, self._shift_s = imu, shift_s
        self._scale = tuple(np.eye(3) - matrix for matrix in errors)
        self._cached: tuple[int, float, DoubtfulSignal] | None = None

    def since(self, start_s: float) -> DoubtfulSignal:
        """The signal from some time on."""
        cached = self._cached
        if cached is None or cached[0] != self._imu.version or cached[1] > start_s:
            first_s = min(start_s, self.end_s - CACHED_S)
            own_s = first_s - BEFORE_S - self._shift_s
            imu = without_spikes(self._imu.stream(own_s))
            acc, gyro = imu.acc @ self._scale[0].T, imu.gyro @ self._scale[1].T
            imu = replace(imu, t_s=imu.t_s + self._shift_s, acc=acc, gyro=gyro)
            cached = self._imu.version, first_s, DoubtfulSignal(imu, self._imu.doubt(own_s))
            self._cached = cached
        return cached[2]

    @property
    def end_s(self) -> float:
        """Time of the newest sample, s; -inf without any."""
        return self._imu.end_s + self._shift_s

    def pause_s(self, since_s: float) -> float:
        """Longest time without samples since some time, s."""
        t = self._imu.t + self._shift_s
        t = t[np.searchsorted(t, since_s) - 1 :] if len(t) else t
        return float(np.diff(t).max(initial=0.0))


def increments_between(
    signal: DoubtfulSignal,
    start_s: float,
    end_s: float,
    bias: FloatArray,  # (6,) m/s^2 and rad/s
) -> ImuIncrements:
    """One interval for the window; where samples are missing, velocity and direction are uncertain."""
    t = np.array([start_s, end_s])
    step_t, first = split_steps(t)
    acc, gyro, h = equivalent_samples(integrate_each(signal, step_t, bias))
    error, turn = signal.velocity_error(t), signal.turn_error(t)
    inside = slice(
        int(np.searchsorted(signal.edges[1:], start_s, "right")), int(np.searchsorted(signal.edges, end_s))
    )
    length_s = signal.edges[1:] - signal.edges[:-1]
    missing_s = float(np.maximum(length_s[inside] - 2.0 * signal.usual_s, 0.0).sum())
    if missing_s > 0:
        error = np.hypot(error, MISSED_ACCELERATION * missing_s)
        turn = np.hypot(turn, 0.5 * MISSED_TURNING * missing_s**2)
    return ImuIncrements(acc, gyro, h, first, bias, error, turn if turn.any() else None)


def propagated(
    node: NodeState, t_s: float, signal: InertialSignal, bias: FloatArray, gravity: FloatArray
) -> NodeState:
    """Where the IMU leads from a node to a time after it, or led from a time before it."""
    first_s, last_s = min(node.t, t_s), max(node.t, t_s)
    delta_R, delta_v, delta_p = integrate_one(signal, first_s, last_s, bias)
    dt = last_s - first_s
    if t_s < node.t:
        R = node.R @ delta_R.T
        v = node.v - gravity * dt - R @ delta_v
        return NodeState(t_s, R, node.p - (v * dt + 0.5 * gravity * dt**2 + R @ delta_p), v)
    p = node.p + node.v * dt + 0.5 * gravity * dt**2 + node.R @ delta_p
    v = node.v + gravity * dt + node.R @ delta_v
    return NodeState(t_s, node.R @ delta_R, p, v)


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
