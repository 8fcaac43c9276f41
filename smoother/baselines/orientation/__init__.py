"""Orientation filters for the baselines: the sensor in a frame {E} with z up, by name.

Every filter gets the same even samples, its gyroscope's bias taken off, and answers with quaternions
qw, qx, qy, qz of `R_E_A` (body to earth, z up: at rest the specific force is +9.81 m/s^2 along z of {E}) at
the ends of the samples' intervals. The heading of {E} drifts, or starts anywhere; where {E} lies in the
camera's frame is found from the camera (`smoother.measurements.alignment.align`), for all filters alike.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module

from scipy.spatial.transform import Rotation

from ...measurements.attitude import InertialAttitude
from ...measurements.inertial import InertialSignal
from ...recording import FloatArray, ImuStream
from .samples import EvenSamples, even_samples

#: A filter: even samples in, quaternions (n, 4; qw, qx, qy, qz) of `R_E_A` out.
Filter = Callable[[EvenSamples], FloatArray]


def orientation_filter(name: str) -> Filter:
    """The filter of a name."""
    found: Filter = getattr(import_module(f".{name}", __name__), name)
    return found


def attitude_by(
    name: str, signal: InertialSignal, imu: ImuStream, rate_hz: float, gyroscope_bias: FloatArray
) -> InertialAttitude:
    """Run a filter over a signal.

    Parameters
    ----------
    name : one of `baselines.registry.ORIENTATIONS`.
    signal, imu : a stretch without a pause, as a signal and as samples.
    rate_hz : the filter's rate.
    gyroscope_bias : (3,) rad/s, taken off before the filter.
    """
    samples = even_samples(signal, rate_hz, gyroscope_bias, imu)
    quaternion = orientation_filter(name)(samples)
    return InertialAttitude(samples.t, Rotation.from_quat(quaternion[:, [1, 2, 3, 0]]), gyroscope_bias)


__all__ = ["EvenSamples", "Filter", "attitude_by", "orientation_filter"]
