"""The IMU's last samples as a signal with one calibration, and its integrals."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..array_types import FloatArray
from ..linalg import middle
from ..measurements.inertial import (
    InertialSignal,
    equivalent_samples,
    integrate_each,
    integrate_one,
    split_steps,
)
from ..measurements.segment import without_spikes
from ..recording import ImuStream
from ..window.problem import ImuIncrements
from ..window.solution import NodeState
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
