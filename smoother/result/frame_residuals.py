"""Camera minus recovered joint position, frame by frame."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..array_types import BoolArray, FloatArray
from ..linalg import rows_of
from ..measurements.visibility import Reason

#: Samples or frames that are looked at together; what is computed of them passes through the memory.
BATCH_ROWS = 8192


@dataclass(frozen=True)
class FrameResiduals:
    """Camera minus recovered joint position, one row per camera frame."""

    t_s: FloatArray  # (F,), s: Frame times on the IMU's clock
    # (F, 5, 3), m: In {K}, joints in the order of `JOINTS`; nan where there is no answer
    residual: FloatArray
    used: BoolArray  # (F, 5): The sample was used in the solution
    # (F, 5): Why a tracked sample was rejected: index into `reasons`, 0 where it was not
    reason: NDArray[np.uint8]
    reasons: tuple[Reason, ...] = (Reason(""),)  # The first one empty

    def __len__(self) -> int:
        return len(self.t_s)

    def rows(self, rows: slice) -> FrameResiduals:
        """Some of the frames."""
        return rows_of(self, rows, "t_s", "residual", "used", "reason")

    def batches(self) -> Iterator[FrameResiduals]:
        """All frames, some thousand at a time."""
        for start in range(0, len(self), BATCH_ROWS):
            yield self.rows(slice(start, start + BATCH_ROWS))
