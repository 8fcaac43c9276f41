"""An upper-arm IMU between two of its pauses, on the forearm IMU's clock."""

from __future__ import annotations

from dataclasses import dataclass

from ..recording import ImuStream
from .attitude import InertialAttitude, inertial_attitude
from .inertial import InertialSignal

#: The inertial filter runs no faster than this, Hz.
FILTER_RATE_HZ = 120.0


@dataclass(frozen=True)
class UpperRunSamples:
    """An upper-arm IMU between two of its pauses.

    Attributes
    ----------
    signal : InertialSignal
        Its samples, on the forearm IMU's clock.
    attitude : InertialAttitude
        Its orientation in a frame of its own with z up, heading drifting.
    """

    signal: InertialSignal
    attitude: InertialAttitude


def upper_run_samples(imu: ImuStream) -> UpperRunSamples:
    """The samples (without a pause, on the forearm IMU's clock) with their inertial attitude."""
    signal = InertialSignal(imu)
    return UpperRunSamples(signal, inertial_attitude(signal, min(imu.rate_hz, FILTER_RATE_HZ)))
