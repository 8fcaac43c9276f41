"""Errors of IMU and camera that are constant over a recording, as one vector.

The IMU's scales and axes: a sample reads (I + M) times what it should, M (3, 3) for the accelerometer and
for the gyroscope. The camera's joints: each is seen a little off, always the same way in {K}. The strap: skin
and muscle turn the sensor on the forearm as the posture changes, by W times the direction of down in {A}.
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
    """

    covariance: FloatArray
    shared: FloatArray

    @property
    def shared_covariance(self) -> FloatArray:
        """What they add to the covariance of the shared vector, (s, s)."""
        return np.asarray(self.shared @ self.covariance @ self.shared.T)
