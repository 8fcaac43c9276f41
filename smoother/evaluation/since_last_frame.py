"""Error of what is shown now against the time since the last frame that showed the forearm."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from .gap_score import GapErrors
from .gap_table import GapTable
from .metrics import Figures, summarise

#: Borders of the times, s; a gap's last part may be shorter.
BORDERS_S = (0.0, 0.25, 0.5, 1.0, 2.0, 3.0, 5.0, 10.0, 30.0)


@dataclass(frozen=True)
class SinceFigures:
    """A method's errors at some time since the last frame.

    Attributes
    ----------
    from_s, to_s : float, s
        The time since the last frame.
    method : str
    figures : Figures
    """

    from_s: float
    to_s: float
    method: str
    figures: Figures

    def to_dict(self) -> dict[str, object]:
        """Plain values by name, as `--json` writes them."""
        return {
            "from_s": self.from_s,
            "to_s": self.to_s,
            "method": self.method,
            "rms_m": self.figures.position_rms_m,
            "median_m": self.figures.position_median_m,
            "p95_m": self.figures.position_p95_m,
            "nees": self.figures.nees,
            "samples": self.figures.samples,
        }


def since_last_frame(table: GapTable, methods: Sequence[str]) -> list[SinceFigures]:
    """Errors in hidden gaps by the time since each began.

    Parameters
    ----------
    table : GapTable
    methods : sequence of str
        In the order wanted.

    Returns
    -------
    rows : list of SinceFigures
        By time, then by method; times that no gap reaches are left out.
    """
    rows = []
    for from_s, to_s in pairwise(BORDERS_S):
        for method in methods:
            errors = [
                errors
                for row, errors in zip(table.rows, table.errors, strict=True)
                if row.method == method and len(errors.since_s)
            ]
            if not errors:
                continue
            together = GapErrors.pooled(errors)
            inside = (together.since_s >= from_s) & (together.since_s < to_s)
            inside &= np.isfinite(together.distance_m)
            if inside.any():
                figures = summarise(
                    together.distance_m[inside],
                    together.angle_deg[inside],
                    together.squared_sigmas[inside],
                    0,
                )
                rows.append(SinceFigures(from_s, to_s, method, figures))
    return rows
