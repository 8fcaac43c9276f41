"""The last minutes of the IMU's samples, sorted, whatever the order they arrived in."""

from __future__ import annotations

import numpy as np

from ..array_types import FloatArray
from ..recording import ImuStream
from .imu_batch import ImuBatch

#: Samples older than this against the newest are not sorted in, s.
LATE_S = 0.5
#: So much more than its capacity is held before the oldest go (share).
SLACK = 0.25


class ImuBuffer:
    """Samples of the last seconds.

    Parameters
    ----------
    capacity_s : float, s
        How much is held.

    Attributes
    ----------
    late, duplicate, invalid : int
        Samples that were not taken, and why.
    version : int
        Goes up whenever samples come.
    """

    def __init__(self, capacity_s: float) -> None:
        self._capacity_s = capacity_s
        self._rows = np.zeros((1024, 7))
        self._count = self.version = 0
        self.late = self.duplicate = self.invalid = 0

    def __len__(self) -> int:
        return self._count

    @property
    def t(self) -> FloatArray:
        """Times of the samples, s; a view."""
        return self._rows[: self._count, 0]

    @property
    def end_s(self) -> float:
        """Time of the newest sample, s; -inf without any."""
        return float(self._rows[self._count - 1, 0]) if self._count else -np.inf

    def add(self, batch: ImuBatch) -> float | None:
        """Sort samples in.

        Parameters
        ----------
        batch : ImuBatch

        Returns
        -------
        changed_s : float or None
            The earliest sample that came after later ones; None where all are new.
        """
        rows = np.column_stack([batch.t_s, batch.acc, batch.gyro]).astype(float)
        finite = np.isfinite(rows).all(axis=1)
        self.invalid += int((~finite).sum())
        rows = rows[finite]
        rows = rows[np.argsort(rows[:, 0], kind="stable")]
        if not len(rows):
            return None
        newest_s = max(self.end_s, float(rows[-1, 0]))
        late = rows[:, 0] < newest_s - LATE_S
        if self._count:  # a first batch may be as long as it likes
            self.late += int(late.sum())
            rows = rows[~late]
        fresh = np.diff(rows[:, 0], prepend=-np.inf) > 0
        before_s = self.end_s
        inside = rows[:, 0] <= before_s
        if inside.any():
            fresh &= ~np.isin(rows[:, 0], self.t)
        self.duplicate += int((~fresh).sum())
        rows, inside = rows[fresh], inside[fresh]
        if not len(rows):
            return None
        self.version += 1
        self._reserve(len(rows))
        if not inside.any():
            self._rows[self._count : self._count + len(rows)] = rows
            self._count += len(rows)
            return None
        first = int(np.searchsorted(self.t, rows[0, 0]))
        tail = np.concatenate([self._rows[first : self._count], rows])
        self._count += len(rows)
        self._rows[first : self._count] = tail[np.argsort(tail[:, 0], kind="stable")]
        return float(rows[0, 0])

    def since_pause_s(self, longest_s: float, looked_s: float) -> float:
        """Where the samples begin that have no longer pause, within the last `looked_s`; s."""
        t = self.t[int(np.searchsorted(self.t, self.end_s - looked_s)) :]
        pauses = np.flatnonzero(np.diff(t) > longest_s)
        return float(t[pauses[-1] + 1]) if len(pauses) else float(t[0])

    def stream(self, start_s: float, end_s: float = np.inf) -> ImuStream:
        """A copy of the samples from one time to another."""
        rows = self._rows[slice(*np.searchsorted(self.t, [start_s, end_s]).tolist())].copy()
        return ImuStream("live", rows[:, 0], rows[:, 1:4], rows[:, 4:])

    def _reserve(self, more: int) -> None:
        """Make place for more samples: the oldest go, or the array grows."""
        if self._count + more <= len(self._rows):
            return
        keep = int(np.searchsorted(self.t, self.end_s - self._capacity_s))
        held = self._rows[keep : self._count]
        size = max(int((1.0 + SLACK) * (len(held) + more)), 1024)
        rows = np.zeros((size, 7))
        rows[: len(held)] = held
        self._rows, self._count = rows, len(held)
