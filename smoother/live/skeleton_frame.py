"""One frame of the camera's skeleton as it arrives."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..array_types import FloatArray


@dataclass(frozen=True)
class SkeletonFrame:
    """One arm in one frame of the camera.

    Attributes
    ----------
    t_s : float, s
        Its stamp, on the camera's clock.
    arrival_s : float, s
        When it arrived here, on the clock that `LiveSmoother.step` is told the time of (the IMU's).
    position : ndarray, shape (5, 3), m
        In {K}, joints in the order of `JOINTS`; nan where there is none.
    state : ndarray of int8, shape (5,)
        `JointState` values.
    """

    t_s: float
    arrival_s: float
    position: FloatArray
    state: NDArray[np.int8]
