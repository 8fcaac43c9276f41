"""How long frames took, counted so that memory does not grow."""

from __future__ import annotations

import numpy as np

#: Bins of 0.25 ms up to 2 s; what takes longer is in the last.
_BIN_S, _BINS = 0.00025, 8000


class DelayCounts:
    """Counts of delays.

    Attributes
    ----------
    count : int
        Delays counted.
    largest_s : float, s
    """

    def __init__(self) -> None:
        self.count = 0
        self.largest_s = float("nan")
        self._counts = np.zeros(_BINS, np.int64)

    def add(self, delay_s: float) -> None:
        """Count one."""
        self.count += 1
        self.largest_s = float(np.fmax(self.largest_s, delay_s))
        self._counts[min(max(int(delay_s / _BIN_S), 0), _BINS - 1)] += 1

    def percentile_s(self, percent: float) -> float:
        """So many percent took at most so long, s; nan without any."""
        if not self.count:
            return float("nan")
        at = int(np.searchsorted(np.cumsum(self._counts), percent / 100 * self.count))
        return min((at + 1) * _BIN_S, self.largest_s)

    def share_within(self, seconds: float) -> float:
        """Share of them that took at most so long; nan without any."""
        if not self.count:
            return float("nan")
        return float(self._counts[: round(seconds / _BIN_S)].sum()) / self.count

    def figures(self) -> dict[str, float | int]:
        """What a summary states of them, ms."""
        return {
            "count": self.count,
            "median_ms": 1e3 * self.percentile_s(50),
            "percentile_99_ms": 1e3 * self.percentile_s(99),
            "largest_ms": 1e3 * self.largest_s,
            "share_within_20_ms": self.share_within(0.020),
        }
