"""The sensor's orientation by an offline inertial filter (VQF)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..array_types import FloatArray
from ..rotation import Rotation, Slerp
from .inertial import InertialSignal

#: Half width of the time that the acceleration's standard deviation is taken over, s.
ACCELERATION_STD_HALF_S = 0.5


@dataclass(frozen=True)
class InertialAttitude:
    """The sensor's orientation in {E} (z up, heading drifting).

    Attributes
    ----------
    t : ndarray, shape (n,), s
        Increasing, on the IMU's clock.
    R_E_A : Rotation, of n
        Maps a vector from the sensor's axes to {E}.
    gyroscope_bias : ndarray, shape (3,), rad/s
        In {A}.
    """

    t: FloatArray
    R_E_A: Rotation
    gyroscope_bias: FloatArray

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


def inertial_attitude(signal: InertialSignal, rate_hz: float) -> InertialAttitude:
    """Orientation by the offline filter VQF (Laidig and Seel, Information Fusion 2023).

    Parameters
    ----------
    signal : InertialSignal
        Of one segment.
    rate_hz : float, Hz
        The filter runs at this rate, on means of the signal.

    Returns
    -------
    attitude : InertialAttitude
        At the ends of the filter's samples.
    """
    from vqf import offlineVQF

    count = max(int(np.floor((signal.end_s - signal.start_s) * rate_hz)), 2)
    edges = np.linspace(signal.start_s, signal.end_s, count + 1)
    mean = signal.mean(edges[:-1], edges[1:])
    step = float(edges[1] - edges[0])
    acc, gyro = np.ascontiguousarray(mean[:, :3]), np.ascontiguousarray(mean[:, 3:])
    answer = offlineVQF(gyro, acc, None, step)
    quaternion = answer["quat6D"][:, [1, 2, 3, 0]]
    # the filter's answer holds at the end of each sample's interval
    return InertialAttitude(edges[1:], Rotation.from_quat(quaternion), np.median(answer["bias"], axis=0))


def acceleration_std(signal: InertialSignal, attitude: InertialAttitude, t: FloatArray) -> FloatArray:
    """How much the sensor's acceleration varies about each time.

    Standard deviation over `ACCELERATION_STD_HALF_S` on both sides, so that the inertial attitude's slow
    error, which turns gravity into a constant acceleration, does not count.

    Parameters
    ----------
    signal : InertialSignal
    attitude : InertialAttitude
        Of the same segment.
    t : ndarray, shape (n,), s
        Increasing.

    Returns
    -------
    std : ndarray, shape (n,), m/s^2
        One sigma, root mean square over the axes.
    """
    step = 0.02
    around = ACCELERATION_STD_HALF_S + step
    edges = np.arange(max(signal.start_s, t[0] - around), min(signal.end_s, t[-1] + around), step)
    force = signal.mean(edges[:-1], edges[1:])[:, :3]
    acc = attitude.at(0.5 * (edges[1:] + edges[:-1])).apply(force)
    acc -= acc.mean(axis=0)
    lo, hi = np.searchsorted(edges[:-1], [t - ACCELERATION_STD_HALF_S, t + ACCELERATION_STD_HALF_S])
    hi = np.maximum(hi, lo + 1)
    sums = np.vstack([np.zeros(3), np.cumsum(acc, axis=0)])
    squares = np.concatenate([[0.0], np.cumsum(np.sum(acc**2, axis=1))])
    count = (hi - lo).astype(float)
    mean = (sums[hi] - sums[lo]) / count[:, None]
    variance = (squares[hi] - squares[lo]) / count - np.sum(mean**2, axis=1)
    return np.sqrt(np.maximum(variance, 0.0) / 3.0)
