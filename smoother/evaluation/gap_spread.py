"""The spread of errors over the gaps of a length: what a single gap may cost, not only the mean one."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass

import numpy as np

from .gap_table import GapRow


@dataclass(frozen=True)
class GapSpread:
    """Errors gap by gap: quartiles over gaps of the rms inside each.

    Attributes
    ----------
    low_m, median_m, high_m : float, m, or None
        Quartiles (25, 50 and 75 %) of the gaps' rms; None without any.
    rms_m : float, m, or None
        Root mean square over gaps, each weighing the same.
    worst_m : float, m, or None
        The worst gap's rms.
    gaps : int
        Gaps that were tried.
    failed : int
        Those of them without an answer; they are in no other figure.
    """

    low_m: float | None
    median_m: float | None
    high_m: float | None
    rms_m: float | None
    worst_m: float | None
    gaps: int
    failed: int

    def to_dict(self) -> dict[str, float | int | None]:
        """Plain values by name."""
        return asdict(self)


def spread_of(rms_m: Sequence[float | None]) -> GapSpread:
    """The spread of the rms of some gaps, m; None is a gap without an answer."""
    known = np.array([value for value in rms_m if value is not None and np.isfinite(value)])
    failed = len(rms_m) - len(known)
    if not len(known):
        return GapSpread(None, None, None, None, None, len(rms_m), failed)
    low, median, high = (float(value) for value in np.percentile(known, (25, 50, 75)))
    return GapSpread(
        low, median, high, float(np.sqrt(np.mean(known**2))), float(known.max()), len(rms_m), failed
    )


def spread_by_length(rows: Iterable[GapRow]) -> dict[float, dict[str, GapSpread]]:
    """By gap length (s) and method the spread over its gaps; lengths rise, methods in order of appearance."""
    by_length: dict[float, dict[str, list[float | None]]] = {}
    for row in rows:
        error = None if row.failure else row.figures.position_rms_m
        by_length.setdefault(row.length_s, {}).setdefault(row.method, []).append(error)
    return {
        length: {name: spread_of(errors) for name, errors in by_length[length].items()}
        for length in sorted(by_length)
    }
