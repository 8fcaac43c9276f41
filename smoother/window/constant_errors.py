"""Errors of IMU and camera that are constant over a recording, as one vector.

The IMU's scales and axes: a sample reads (I + M) times what it should, M (3, 3) for the accelerometer and
for the gyroscope. The camera's joints: each is seen a little off, always the same way in {K}; a tracked strap
that stands for the IMU itself, always the same way in {A}, since the point that is tracked is not the chip.
The strap: skin and muscle turn the sensor on the forearm as the posture changes, by W times the direction of
down in {A}. Not constant, but considered in the same way: the times of frames with synthetic stamps.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..array_types import FloatArray
from ..recording import JOINTS

#: Rows of the vector: accelerometer (9), gyroscope (9), joints in the order of `JOINTS` (15), strap (9).
IMU_ERRORS = slice(0, 18)
JOINT_ERRORS = slice(18, 18 + 3 * len(JOINTS))
STRAP_ERRORS = slice(JOINT_ERRORS.stop, JOINT_ERRORS.stop + 9)
SIZE = STRAP_ERRORS.stop
#: Where the tracked strap is, from the IMU: the joint's rows, in {A}.
STRAP_PLACE = slice(
    JOINT_ERRORS.start + 3 * JOINTS.index("strap"), JOINT_ERRORS.start + 3 * JOINTS.index("strap") + 3
)
#: Errors of synthetic stamps are straight lines between times so far apart, s, and last so long, s: a frame
#: that was dropped shifts all that follow, until the offset that wanders has followed.
STAMP_KNOT_S = 0.5
STAMP_MEMORY_S = 1.0


@dataclass(frozen=True)
class ErrorEvidence:
    """What a window says of the shared constants and the constant errors, its prior on them taken off.

    In information form, about [gravity, upper arm, lever arms (rows 6.. of the shared vector); errors], the
    errors counted from what the window's data were corrected by.

    Attributes
    ----------
    information : ndarray, shape (k, k)
    vector : ndarray, shape (k,)
        Information times mean.
    """

    information: FloatArray
    vector: FloatArray


@dataclass(frozen=True)
class Considered:
    """Constant errors that are left after correction.

    Attributes
    ----------
    covariance : ndarray, shape (SIZE, SIZE)
        Of the errors.
    shared : ndarray, shape (s, SIZE)
        How the recording's estimate of the shared vector follows them.
    stamp_sigma_s : float, s
        How far the frames' times may be off, beyond one offset for all; 0 where they were measured.
    """

    covariance: FloatArray
    shared: FloatArray
    stamp_sigma_s: float = 0.0

    def stamp_knots(self, start_s: float, end_s: float) -> FloatArray:
        """Times (m,) s between which errors of the frames' times are linear, on one grid for all windows."""
        if not self.stamp_sigma_s:
            return np.zeros(0)
        first, last = np.floor(start_s / STAMP_KNOT_S), np.ceil(end_s / STAMP_KNOT_S)
        return np.asarray(STAMP_KNOT_S * np.arange(first, last + 1))

    def stamp_covariance(self, knots: FloatArray) -> FloatArray:
        """Of the errors at knots, (m, m) s^2: a Gauss-Markov process."""
        apart = np.abs(knots[:, None] - knots)
        return np.asarray(self.stamp_sigma_s**2 * np.exp(-apart / STAMP_MEMORY_S))

    @property
    def shared_covariance(self) -> FloatArray:
        """What they add to the covariance of the shared vector, (s, s)."""
        return np.asarray(self.shared @ self.covariance @ self.shared.T)
