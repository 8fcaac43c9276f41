"""VQF, offline and without a magnetometer (Laidig and Seel, Information Fusion 2023)."""

from __future__ import annotations

import numpy as np

from ...array_types import FloatArray
from .samples import EvenSamples


def vqf(samples: EvenSamples) -> FloatArray:
    """Quaternions (n, 4; qw, qx, qy, qz) of `R_E_A` by the package `vqf`: forwards and backwards in time.

    Its class `offlineVQF` with the published settings; 6D, without a magnetometer.
    """
    from vqf import offlineVQF

    answer = offlineVQF(
        np.ascontiguousarray(samples.gyro), np.ascontiguousarray(samples.acc), None, samples.step_s
    )
    return np.asarray(answer["quat6D"], dtype=np.float64)
