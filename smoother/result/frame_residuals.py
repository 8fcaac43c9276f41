"""Camera minus recovered joint position, frame by frame."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..array_types import BoolArray, FloatArray
from ..measurements.visibility import Reason

#: Samples or frames that are looked at together; what is computed of them passes through the memory.
BATCH_ROWS = 8192


@dataclass(frozen=True)
class FrameResiduals:
    """Camera minus recovered joint position, one row per camera frame.

    Attributes
    ----------
    t_s : ndarray, shape (F,), s
        Frame times on the IMU's clock.
    residual : ndarray, shape (F, 5, 3), m
        In {K}, joints in the order of `JOINTS`; nan where there is no answer.
    used : ndarray of bool, shape (F, 5)
        The sample was used in the solution.
    reason : ndarray of uint8, shape (F, 5)
        Why a tracked sample was rejected: index into `reasons`, 0 where it was not.
    reasons : tuple of Reason
        The first one empty.
    """

    t_s: FloatArray
    residual: FloatArray
    used: BoolArray
    reason: NDArray[np.uint8]
    reasons: tuple[Reason, ...] = (Reason(""),)

    def __len__(self) -> int:
        return len(self.t_s)

    def rows(self, rows: slice) -> FrameResiduals:
        """Some of the frames."""
        return replace(
            self,
            t_s=self.t_s[rows],
            residual=self.residual[rows],
            used=self.used[rows],
            reason=self.reason[rows],
        )

    def batches(self) -> Iterator[FrameResiduals]:
        """All frames, some thousand at a time."""
        for start in range(0, len(self), BATCH_ROWS):
            yield self.rows(slice(start, start + BATCH_ROWS))
