"""Orientation filters for the baselines: the sensor in a frame {E} with z up, by name.

Every filter gets the same even samples, its gyroscope's bias taken off, and answers with quaternions
qw, qx, qy, qz of `R_E_A` (body to earth, z up: at rest the specific force is +9.81 m/s^2 along z of {E}) at
the ends of the samples' intervals. The heading of {E} drifts, or starts anywhere; {E} is aligned to the
camera's frame by the camera (`smoother.measurements.alignment.align`), for all filters alike.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module

from ...array_types import FloatArray
from ...measurements.inertial import InertialAttitude, InertialSignal
from ...recording import ImuStream
from ...rotation import Rotation
from .samples import EvenSamples, even_samples

#: A filter: even samples in, quaternions (n, 4; qw, qx, qy, qz) of `R_E_A` out.
Filter = Callable[[EvenSamples], FloatArray]


def orientation_filter(name: str) -> Filter:
    """The filter of a name in `baselines.registry.ORIENTATIONS`."""
    function: Filter = getattr(import_module(f".{name}", __name__), name)
    return function


def attitude_by(
    name: str, signal: InertialSignal, imu: ImuStream, rate_hz: float, gyroscope_bias: FloatArray
) -> InertialAttitude:
    """Run a filter over a signal.

    Parameters
    ----------
    name : str
        One of `baselines.registry.ORIENTATIONS`.
    signal, imu : InertialSignal and ImuStream
        A segment, as a signal and as samples.
    rate_hz : float, Hz
        The filter's rate.
    gyroscope_bias : ndarray, shape (3,), rad/s
        Taken off before the filter.

    Returns
    -------
    attitude : InertialAttitude
        `R_E_A` over time.
    """
    samples = even_samples(signal, rate_hz, gyroscope_bias, imu)
    quaternion = orientation_filter(name)(samples)
    return InertialAttitude(samples.t, Rotation.from_quat(quaternion, scalar_first=True), gyroscope_bias)


__all__ = ["EvenSamples", "Filter", "attitude_by", "orientation_filter"]
