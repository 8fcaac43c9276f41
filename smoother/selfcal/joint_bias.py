"""Constant errors of the camera's joints in its own frame, as far as they can be told apart.

A skeleton places each joint some millimetres off, always the same way. What elbow, wrist and hand have
apart from each other shows in the residuals once the forearm has turned (a lever arm turns with it, an
error of the camera does not). What they have in common moves the whole arm and cannot be seen: it goes
into the covariance, as large as the differences say that such errors are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ..measurements.segment import Segment
from ..recording import JOINTS, FloatArray
from ..window.problem import Solution, Window

#: Residuals show only a part of an error while the states still follow it: steps are longer by this.
GAIN = 2.0
#: Sigma of an error before the recording speaks, m, and for how many observations that counts.
PRIOR_SIGMA_M = 0.002
PRIOR_WEIGHT = 3.0


@dataclass(frozen=True)
class JointBias:
    """The camera's constant errors, free of their common part.

    Attributes
    ----------
    error_m : ndarray, shape (5, 3), m
        In {K}, in the order of `JOINTS`.
    joints : tuple of str
        Joints with enough samples to tell.
    """

    error_m: FloatArray = field(default_factory=lambda: np.zeros((len(JOINTS), 3)))
    joints: tuple[str, ...] = ()

    def updated(self, windows: Sequence[Window], solutions: Sequence[Solution]) -> JointBias:
        """The errors moved by the mean residuals of another round.

        Parameters
        ----------
        windows, solutions : sequence of Window, sequence of Solution
            Of one round, solved with the errors taken off.
        """
        rows: dict[str, list[FloatArray]] = {}
        for window, solution in zip(windows, solutions, strict=True):
            for measured in window.joint_measurements:
                residual = solution.residuals[measured.joint]
                size = np.linalg.norm(residual, axis=1) / measured.sigma_m
                rows.setdefault(measured.joint, []).append(residual[size < 3.0 * window.noise.cauchy])
        joints = tuple(joint for joint, residuals in rows.items() if sum(map(len, residuals)) >= 10)
        if len(joints) < 2:
            return JointBias(self.error_m, joints)
        mean = np.array([np.vstack(rows[joint]).mean(axis=0) for joint in joints])
        error_m = self.error_m.copy()
        error_m[[JOINTS.index(joint) for joint in joints]] += GAIN * (mean - mean.mean(axis=0))
        return JointBias(error_m, joints)

    def corrected(self, segment: Segment) -> Segment:
        """A segment with the errors taken off the camera's samples."""
        return replace(segment, position=segment.position - self.error_m)

    @property
    def sigma_m(self) -> float:
        """How large a joint's constant error is in this recording, m an axis (one sigma)."""
        if len(self.joints) < 2:
            return 0.0
        square = float(np.sum(self.error_m**2)) + PRIOR_WEIGHT * PRIOR_SIGMA_M**2
        return float(np.sqrt(square / (3.0 * (len(self.joints) - 1) + PRIOR_WEIGHT)))
