"""Madgwick's gradient descent filter, gyroscope and accelerometer (Madgwick 2010), by the package `ahrs`."""

from __future__ import annotations

import numpy as np

from ...array_types import FloatArray
from .samples import EvenSamples, start_attitude

#: The published gain for gyroscope and accelerometer, rad/s (report of 2010, section 6).
GAIN = 0.033


def madgwick(samples: EvenSamples) -> FloatArray:
    """Quaternions (n, 4; qw, qx, qy, qz) of `R_E_A`, from a start whose tilt is right.

    The package's objective compares the measured force with the third row of the quaternion's matrix, so
    its quaternion maps {A} to an earth frame with z up: `R_E_A`, as it stands.
    """
    from ahrs.filters import Madgwick

    start = start_attitude(samples).as_quat(scalar_first=True)
    answer = Madgwick(gyr=samples.gyro, acc=samples.acc, frequency=1.0 / samples.step_s, gain=GAIN, q0=start)
    return np.asarray(answer.Q, dtype=np.float64)
