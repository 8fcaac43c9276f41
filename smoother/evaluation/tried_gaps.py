"""What a recording allows, in one line: how long a gap may be, and what its motion leaves open."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ..errors import RecordingError
from ..recording import Recording
from ..result import Recovery
from .gap_table import GapTable
from .gaps import evaluate_gaps

#: Gaps of these lengths are hidden, s; what lies between is read off the line through them.
LENGTHS_S = (1.0, 3.0, 10.0)
GAPS = 3
#: What a gap is to stay within, m.
WITHIN_M = 0.02


@dataclass(frozen=True)
class TriedGaps:
    """How uncertain hidden gaps are by their length.

    Attributes
    ----------
    length_s, sigma_m : tuple of float, s and m
        Of the gaps that could be hidden: the median of the largest sigma on an axis, widened where the errors
        against what was hidden are larger than stated.
    not_determined : tuple of str
        What the motion left open.
    """

    length_s: tuple[float, ...]
    sigma_m: tuple[float, ...]
    not_determined: tuple[str, ...] = ()

    @property
    def longest_s(self) -> float:
        """Gaps up to about this are within `WITHIN_M`; 0 where none is, nan where none could be hidden."""
        if not self.length_s:
            return float("nan")
        sigma = np.maximum.accumulate(self.sigma_m)
        if sigma[0] > WITHIN_M:
            return 0.0
        if sigma[-1] <= WITHIN_M:
            return self.length_s[-1]
        return float(np.exp(np.interp(np.log(WITHIN_M), np.log(sigma), np.log(self.length_s))))

    @property
    def sentence(self) -> str:
        """What is allowed, and what is not determined."""
        return "; ".join(self.sentences)

    @property
    def sentences(self) -> tuple[str, ...]:
        """What is allowed, then what is not determined, one each."""
        within = f"within {100 * WITHIN_M:.0f} cm"
        longest_s = self.longest_s
        if np.isnan(longest_s):
            allowed = "the forearm was never visible for long enough to try a gap"
        elif longest_s == 0.0:
            shortest = f"{self.length_s[0]:g} s are known to {100 * self.sigma_m[0]:.0f} cm"
            allowed = f"no gap stays {within}: those of {shortest}"
        else:
            more = " and more" if longest_s == self.length_s[-1] else ""
            allowed = f"gaps up to about {longest_s:.2g} s{more} {within}"
        return (allowed, *self.not_determined)

    def to_dict(self) -> dict[str, object]:
        """Plain values by name."""
        return {
            "sentence": self.sentence,
            "longest_gap_s": None if np.isnan(self.longest_s) else self.longest_s,
            "within_m": WITHIN_M,
            "gaps": [
                {"length_s": length_s, "sigma_m": sigma_m}
                for length_s, sigma_m in zip(self.length_s, self.sigma_m, strict=True)
            ],
            "not_determined": list(self.not_determined),
        }


def try_gaps(
    recording: Recording,
    recover: Callable[[Recording], Recovery],
    not_determined: Sequence[str] = (),
    progress: Callable[[float, str], None] | None = None,
) -> TriedGaps:
    """Hide visible seconds and see how uncertain they become.

    Parameters
    ----------
    recording : Recording
        A short one: it is recovered once a length.
    recover : callable
        The method.
    not_determined : sequence of str
        What its motion left open.
    progress : callable, optional
        Called with (part done, what is being done).
    """
    try:
        table = evaluate_gaps(recording, LENGTHS_S, {"graph": recover}, gaps_per_run=GAPS, progress=progress)
    except RecordingError:  # never visible for long enough
        return TriedGaps((), (), tuple(not_determined))
    rows = [(length_s, _sigma_m(table, length_s)) for length_s in table.lengths]
    known = [(length_s, sigma_m) for length_s, sigma_m in rows if np.isfinite(sigma_m)]
    return TriedGaps(tuple(row[0] for row in known), tuple(row[1] for row in known), tuple(not_determined))


def _sigma_m(table: GapTable, length_s: float) -> float:
    """Median over the gaps of a length, widened where errors exceed what is stated; nan without any."""
    sigmas = [
        row.sigma_max_m for row in table.rows if row.length_s == length_s and row.sigma_max_m is not None
    ]
    nees = table.lengths[length_s]["graph"].figures.nees
    widened = float(np.sqrt(max(nees, 1.0))) if nees is not None and np.isfinite(nees) else 1.0
    return widened * float(np.median(sigmas)) if sigmas else float("nan")
