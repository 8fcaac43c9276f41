"""IMU samples as a continuous signal, and its integrals over any intervals.

A sample is the mean over its interval, so the cumulative sum of the samples is exact at the
interval's edges; a cubic spline through it gives the mean rate over any other interval. Holding
samples constant instead shifts a 40 Hz sensor by half a sample (12.5 ms).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from ..array_types import BoolArray, FloatArray, IntArray
from ..recording import ImuStream
from ..rotation import Rotation, Slerp, chained
from ..splines import natural_spline

#: Longest fine step of the integration, s.
FINE_STEP_S = 1.0 / 240.0
#: Intervals are done together when their step counts differ by less than this; the finer count counts.
STEP_FACTOR = 1.42
#: Longest step that one pair of equivalent samples represents, s (see `equivalent_samples`).
STEP_S = 0.036
#: Share of an impact's impulse that the samples may have missed.
IMPACT_SHARE = 0.2


class InertialSignal:
    """The specific force and angular rate between samples."""

    def __init__(self, imu: ImuStream) -> None:
        self._imu = imu
        half = 0.5 * float(np.median(np.diff(imu.t_s)))
        middle = 0.5 * (imu.t_s[1:] + imu.t_s[:-1])
        self.edges = np.concatenate(([imu.t_s[0] - half], middle, [imu.t_s[-1] + half]))
        samples = np.hstack([imu.acc, imu.gyro])
        integral = np.zeros((len(self.edges), 6))
        np.cumsum(samples * np.diff(self.edges)[:, None], axis=0, out=integral[1:])
        self._integral = natural_spline(self.edges, integral)
        # how far each sample's specific force is from its neighbours' mean, m/s^2
        impact = np.zeros(len(imu))
        impact[1:-1] = np.linalg.norm(imu.acc[1:-1] - 0.5 * (imu.acc[:-2] + imu.acc[2:]), axis=1)
        self._impacts = np.concatenate(([0.0], np.cumsum((impact * np.diff(self.edges)) ** 2)))

    def __reduce__(self) -> tuple[type[InertialSignal], tuple[ImuStream]]:
        return InertialSignal, (self._imu,)  # the samples are an eighth of the spline

    def scaled(self, accelerometer: FloatArray, gyroscope: FloatArray) -> InertialSignal:
        """The signal of samples times a matrix (3, 3) of each sensor."""
        imu = self._imu
        return InertialSignal(replace(imu, acc=imu.acc @ accelerometer.T, gyro=imu.gyro @ gyroscope.T))

    @property
    def start_s(self) -> float:
        """Beginning of the first sample's interval, s."""
        return float(self.edges[0])

    @property
    def end_s(self) -> float:
        """End of the last sample's interval, s."""
        return float(self.edges[-1])

    def velocity_error(self, t: FloatArray) -> FloatArray:
        """`velocity_error_between` of each interval of consecutive times (n + 1,), s: (n,), m/s."""
        return self.velocity_error_between(t[:-1], t[1:])

    def velocity_error_between(self, start_s: FloatArray, end_s: FloatArray) -> FloatArray:
        """Velocity (n,) m/s that intervals may have lost to impacts, by their ends (n,) s."""
        start, end = (np.interp(t, self.edges, self._impacts) for t in (start_s, end_s))
        return np.asarray(IMPACT_SHARE * np.sqrt(np.maximum(end - start, 0.0)))

    def mean(self, start_s: FloatArray, end_s: FloatArray) -> FloatArray:
        """Mean of the signal (..., 6), m/s^2 and rad/s, over any intervals, by their ends (...) s."""
        return (self._integral(end_s) - self._integral(start_s)) / (end_s - start_s)[..., None]

    def means(self, edges_s: FloatArray) -> FloatArray:
        """Mean of the signal between neighbouring times (..., n + 1): (..., n, 6), as `mean` has it."""
        return np.asarray(np.diff(self._integral(edges_s), axis=-2) / np.diff(edges_s)[..., None])


@dataclass(frozen=True)
class Preintegration:
    """Motion between consecutive times, seen from the earlier one, free of gravity and start velocity."""

    delta_R: FloatArray  # (n, 3, 3): rotation of the later axes in the earlier ones
    delta_v: FloatArray  # (n, 3) m/s: velocity increments in the earlier axes
    delta_p: FloatArray  # (n, 3) m: position increments in the earlier axes
    dt: FloatArray  # (n,) s: lengths

    def rows(self, rows: IntArray) -> Preintegration:
        """Of some of the intervals (k,), a copy."""
        return Preintegration(self.delta_R[rows], self.delta_v[rows], self.delta_p[rows], self.dt[rows])

    def lengthen(self, rows: IntArray, more: Preintegration) -> None:
        """Lengthen some of the intervals (k,), in place, each by the one that follows it."""
        R, dt = self.delta_R[rows], more.dt[:, None]
        self.delta_p[rows] += self.delta_v[rows] * dt + np.einsum("nij,nj->ni", R, more.delta_p)
        self.delta_v[rows] += np.einsum("nij,nj->ni", R, more.delta_v)
        self.delta_R[rows] = R @ more.delta_R
        self.dt[rows] += more.dt


def integrate(signal: InertialSignal, t: FloatArray, bias: FloatArray) -> Preintegration:
    """Integrate between n + 1 times, with the bias (6,) or (n, 6) (Forster et al., TRO 2017, eq 33-35)."""
    return integrate_between(signal, t[:-1], t[1:], bias)


def integrate_between(
    signal: InertialSignal, start_s: FloatArray, end_s: FloatArray, bias: FloatArray
) -> Preintegration:
    """Integrate the signal over any intervals; as `integrate`."""
    dt = end_s - start_s
    bias = np.broadcast_to(bias, (len(dt), 6))
    delta_R = np.tile(np.eye(3), (len(dt), 1, 1))
    delta_v, delta_p = np.zeros((len(dt), 3)), np.zeros((len(dt), 3))
    steps = np.ceil(dt / FINE_STEP_S - 1e-6)
    group = np.maximum(np.ceil(np.log(np.maximum(steps, 1.0)) / np.log(STEP_FACTOR) - 1e-9), 0.0)
    for number in np.unique(group):  # intervals of about equal step count go together
        rows = np.flatnonzero(group == number)
        count = int(np.ceil(STEP_FACTOR**number - 1e-9))
        h = dt[rows] / count
        edges = start_s[rows, None] + h[:, None] * np.arange(count + 1)
        rate = signal.means(edges) - bias[rows, None]
        turns = (0.5 * h[:, None, None] * rate[..., 3:]).reshape(-1, 3)
        halves = Rotation.from_rotvec(turns).as_matrix().reshape(len(rows), count, 3, 3)
        R, v, p = np.tile(np.eye(3), (len(rows), 1, 1)), np.zeros((len(rows), 3)), np.zeros((len(rows), 3))
        for k in range(count):
            middle = R @ halves[:, k]
            a = np.einsum("nij,nj->ni", middle, rate[:, k, :3])
            p += h[:, None] * v + 0.5 * h[:, None] ** 2 * a
            v += h[:, None] * a
            R = middle @ halves[:, k]
        delta_R[rows], delta_v[rows], delta_p[rows] = R, v, p
    return Preintegration(delta_R, delta_v, delta_p, dt)


def integrate_one(
    signal: InertialSignal,
    start_s: float,
    end_s: float,
    bias: FloatArray,  # (6,) m/s^2 and rad/s
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Integrate the signal over one interval: `integrate_between` without a loop over its steps."""
    steps = max(math.ceil((end_s - start_s) / FINE_STEP_S - 1e-6), 1)
    group = max(math.ceil(math.log(steps) / math.log(STEP_FACTOR) - 1e-9), 0)
    count = math.ceil(STEP_FACTOR**group - 1e-9)
    h = (end_s - start_s) / count
    rate = signal.means(start_s + h * np.arange(count + 1, dtype=float)) - bias
    halves = Rotation.from_rotvec(0.5 * h * rate[:, 3:]).as_matrix()
    R = chained(halves @ halves)
    a = (R[:-1] @ halves @ rate[:, :3, None])[..., 0]
    v = h * np.cumsum(a, axis=0)
    # each step: p += h v + h^2 a / 2 with the v before it
    p = h * (v.sum(axis=0) - v[-1]) + 0.5 * h**2 * a.sum(axis=0)
    return R[-1], v[-1], p


def integrate_each(signal: InertialSignal, t: FloatArray, bias: FloatArray) -> Preintegration:
    """`integrate` of a few intervals with one bias (6,), each by `integrate_one`."""
    parts = [integrate_one(signal, a, b, bias) for a, b in pairwise(t.tolist())]
    delta_R, delta_v, delta_p = (np.stack(each) for each in zip(*parts, strict=True))
    return Preintegration(delta_R, delta_v, delta_p, t[1:] - t[:-1])


def split_steps(t: FloatArray) -> tuple[FloatArray, IntArray]:
    """Cut intervals between times (n + 1,) into steps no longer than `STEP_S`: times, each first step."""
    count = np.maximum(np.ceil(np.diff(t) / STEP_S - 1e-9).astype(int), 1)
    first = np.concatenate(([0], np.cumsum(count)))
    inside = np.arange(first[-1]) - np.repeat(first[:-1], count)
    start = np.repeat(t[:-1], count)
    step_t = start + np.repeat(np.diff(t) / count, count) * inside
    return np.append(step_t, t[-1]), first


def equivalent_samples(motion: Preintegration) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Two constant samples a step whose simple integration gives the step's motion exactly."""
    h = 0.5 * motion.dt
    gyro = Rotation.from_matrix(motion.delta_R).as_rotvec() / motion.dt[:, None]
    # delta_v = (a1 + b) h and delta_p = (3 a1 + b) h^2/2 with b = R1 a2
    total = motion.delta_v / h[:, None]
    a1 = motion.delta_p / h[:, None] ** 2 - 0.5 * total
    R1 = Rotation.from_rotvec(gyro * h[:, None]).as_matrix()
    a2 = np.einsum("nji,nj->ni", R1, total - a1)
    return np.stack([a1, a2], axis=1), gyro, h


#: Half width of the time that the acceleration's standard deviation is taken over, s.
ACCELERATION_STD_HALF_S = 0.5


@dataclass(frozen=True)
class InertialAttitude:
    """The sensor's orientation in {E} (z up, heading drifting)."""

    t: FloatArray  # (n,) s: increasing, on the IMU's clock
    R_E_A: Rotation  # Maps a vector from the sensor's axes to {E}
    gyroscope_bias: FloatArray  # (3,) rad/s: in {A}

    def __getstate__(self) -> dict[str, object]:
        return {
            name: value for name, value in self.__dict__.items() if name != "_curve"
        }  # cheap to build anew

    @cached_property
    def _curve(self) -> Slerp:
        return Slerp(self.t, self.R_E_A)

    def at(self, t: FloatArray) -> Rotation:
        """`R_E_A` at the given times, held beyond the ends."""
        return self._curve(np.clip(t, self.t[0], self.t[-1]))


#: The inertial filter runs no faster than this, Hz.
FILTER_RATE_HZ = 120.0


def inertial_attitude(signal: InertialSignal, rate_hz: float) -> InertialAttitude:
    """Orientation by the offline filter VQF (Laidig and Seel, Information Fusion 2023)."""
    from vqf import offlineVQF

    rate_hz = min(rate_hz, FILTER_RATE_HZ)
    count = max(int(np.floor((signal.end_s - signal.start_s) * rate_hz)), 2)
    edges = np.linspace(signal.start_s, signal.end_s, count + 1)
    mean = signal.mean(edges[:-1], edges[1:])
    acc, gyro = np.ascontiguousarray(mean[:, :3]), np.ascontiguousarray(mean[:, 3:])
    answer = offlineVQF(gyro, acc, None, float(edges[1] - edges[0]))
    attitude = Rotation.from_quat(answer["quat6D"][:, [1, 2, 3, 0]])
    # the filter's result is valid at the end of each sample's interval
    return InertialAttitude(edges[1:], attitude, np.median(answer["bias"], axis=0))


def _moments_around(
    edges: FloatArray, values: FloatArray, t: FloatArray, half_s: float
) -> tuple[FloatArray, FloatArray]:
    """Mean (n, k) of values (m, k) within a time of each t, and the variance (n,) of the first three."""
    lo, hi = np.searchsorted(edges[:-1], [t - half_s, t + half_s])
    hi = np.maximum(hi, lo + 1)
    sums = np.vstack([np.zeros(values.shape[1]), np.cumsum(values, axis=0)])
    squares = np.concatenate([[0.0], np.cumsum(np.sum(values[:, :3] ** 2, axis=1))])
    count = (hi - lo).astype(float)
    mean = (sums[hi] - sums[lo]) / count[:, None]
    return mean, (squares[hi] - squares[lo]) / count - np.sum(mean[:, :3] ** 2, axis=1)


#: A sensor is still where over this long on both sides of a moment, s, its specific force varies by less than
#: the first, m/s^2, and it turns by less than the second, rad/s rms: a person's arm that moves at all
#: turns, and trembles more; by its mean rate a sway, which turns back twice a period, would pass for rest.
STILL_HALF_S, STILL_FORCE, STILL_RATE = 0.5, 0.1, 0.03


def is_still(signal: InertialSignal, attitude: InertialAttitude, t: FloatArray) -> BoolArray:
    """Whether the sensor lies still about each time, (n,)."""
    edges = np.arange(max(signal.start_s, t[0] - 1.0), min(signal.end_s, t[-1] + 1.0), 0.05)
    if len(edges) < 2:
        return np.zeros(len(t), dtype=bool)
    values = signal.means(edges) - np.concatenate([np.zeros(3), attitude.gyroscope_bias])
    _, force = _moments_around(edges, values, t, STILL_HALF_S)
    rate, turning = _moments_around(edges, values[:, 3:], t, STILL_HALF_S)
    turning = turning + np.sum(rate**2, axis=1)
    return np.asarray((force < 3.0 * STILL_FORCE**2) & (turning < STILL_RATE**2))


def acceleration_std(signal: InertialSignal, attitude: InertialAttitude, t: FloatArray) -> FloatArray:
    """How much the sensor's acceleration varies about each time, (n,) m/s^2."""
    step = 0.02
    around = ACCELERATION_STD_HALF_S + step
    edges = np.arange(max(signal.start_s, t[0] - around), min(signal.end_s, t[-1] + around), step)
    force = signal.mean(edges[:-1], edges[1:])[:, :3]
    acc = attitude.at(0.5 * (edges[1:] + edges[:-1])).apply(force)
    _, variance = _moments_around(edges, acc - acc.mean(axis=0), t, ACCELERATION_STD_HALF_S)
    return np.sqrt(np.maximum(variance, 0.0) / 3.0)


@dataclass(frozen=True)
class ImuRun:
    """The IMU on a segment beyond the forearm, between two of its pauses."""

    segment: str  # Name of the segment (`body.SEGMENTS`)
    signal: InertialSignal  # Its samples, on the forearm IMU's clock
    attitude: InertialAttitude  # Its orientation in a frame of its own with z up, heading drifting


def imu_run(segment: str, imu: ImuStream) -> ImuRun:
    """The samples (without a pause, on the forearm IMU's clock) with their inertial attitude."""
    signal = InertialSignal(imu)
    return ImuRun(segment, signal, inertial_attitude(signal, imu.rate_hz))
