"""Constant errors of the camera's joints in its own frame, as far as they can be told apart.

A skeleton places each joint some millimetres off, always the same way. What elbow, wrist and hand have
apart from each other shows in the residuals once the forearm has turned (a lever arm turns with it, an
error of the camera does not). What they have in common moves the whole arm and cannot be seen: it goes
into the covariance, as large as the differences say that such errors are.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ..array_types import FloatArray
from ..recording import JOINTS


@dataclass(frozen=True)
class JointBias:
    """The camera's constant errors, free of their common part.

    Attributes
    ----------
    error_m : ndarray, shape (5, 3), m
        In {K}, in the order of `JOINTS`.
    joints : tuple of str
        Joints with enough samples to tell.
    sigma_m : float, m
        How large a joint's constant error is in this recording, an axis (one sigma); 0 where nothing tells.
    """

    error_m: FloatArray = field(default_factory=lambda: np.zeros((len(JOINTS), 3)))
    joints: tuple[str, ...] = ()
    sigma_m: float = 0.0
