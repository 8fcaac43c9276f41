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


@dataclass
class JointBias:
    """The errors found, (5, 3) m in {K} in the order of `JOINTS`, free of their common part."""

    found_m: FloatArray = field(default_factory=lambda: np.zeros((len(JOINTS), 3)))
    joints: tuple[str, ...] = ()

    def step(self, windows: Sequence[Window], solutions: Sequence[Solution]) -> None:
        """Move the errors by what the residuals of another round leave."""
        rows: dict[str, list[FloatArray]] = {}
        for window, solution in zip(windows, solutions, strict=True):
            for measured in window.joint_measurements:
                residual = solution.residuals[measured.joint]
                size = np.linalg.norm(residual, axis=1) / measured.sigma_m
                rows.setdefault(measured.joint, []).append(residual[size < 3.0 * window.noise.cauchy])
        self.joints = tuple(joint for joint, each in rows.items() if sum(map(len, each)) >= 10)
        if len(self.joints) < 2:
            return
        mean = np.array([np.vstack(rows[joint]).mean(axis=0) for joint in self.joints])
        mean -= mean.mean(axis=0)
        for joint, each in zip(self.joints, mean, strict=True):
            self.found_m[JOINTS.index(joint)] += GAIN * each

    def corrected(self, segments: Sequence[Segment]) -> list[Segment]:
        """The pieces with the errors taken off the camera's samples."""
        return [replace(segment, position=segment.position - self.found_m) for segment in segments]

    @property
    def sigma_m(self) -> float:
        """How large a joint's constant error is in this recording, m an axis (one sigma)."""
        if len(self.joints) < 2:
            return 0.0
        square = float(np.sum(self.found_m**2)) + PRIOR_WEIGHT * PRIOR_SIGMA_M**2
        return float(np.sqrt(square / (3.0 * (len(self.joints) - 1) + PRIOR_WEIGHT)))
