"""What `unocclude gaps` prints and writes as JSON."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from .output import centimetres, percent, print_table

if TYPE_CHECKING:
    from ..evaluation.gap_table import GapTable, RealGaps, SinceFigures
    from ..evaluation.sigma_factor import LengthFactor
    from ..recording import Recording


def gap_figures(table: GapTable, real: RealGaps | None = None) -> dict[str, Any]:
    """All figures as plain values; `spread` has the quartiles over the gaps of a length."""
    from ..evaluation.gap_table import spread_by_length

    spread = [
        {"length_s": length, "methods": {name: each.to_dict() for name, each in methods.items()}}
        for length, methods in spread_by_length(table.rows).items()
    ]
    figures = table.to_dict() | {"spread": spread}
    return figures if real is None else figures | {"real_gaps": real.to_dict() | {"sentence": real.sentence}}


def tables_by_arm(
    recordings: Sequence[Recording], tables: Sequence[GapTable]
) -> dict[tuple[str, int | None], GapTable]:
    """The gaps of each side (and body), of all recordings together."""
    from ..evaluation.gap_table import pooled

    arms = sorted({(recording.side, recording.body) for recording in recordings}, key=str)
    return {
        arm: pooled(
            [table for one, table in zip(recordings, tables, strict=True) if (one.side, one.body) == arm]
        )
        for arm in arms
    }


def print_gaps(table: GapTable, whose: str = "") -> None:
    """Print error against gap length; `whose` goes into the title."""
    reference = next((row.reference for row in table.rows if row.reference), "truth")
    against = "truth" if reference == "truth" else f"camera's hidden samples of the {reference}"
    rows = []
    for length, methods in table.lengths.items():
        for name, result in methods.items():
            figures = result.figures
            distances = (
                figures.position_rms_m,
                figures.position_median_m,
                figures.position_p95_m,
                figures.position_max_m,
            )
            rows.append(
                (
                    f"{length:g}",
                    name,
                    *[None if value is None else f"{100 * value:.2f}" for value in distances],
                    figures.nees,
                    percent(figures.coverage_95),
                    f"{result.gaps}" if not result.failed else f"{result.gaps} ({result.failed} failed)",
                )
            )
    columns = ("gap, s", "method", "rms, cm", "median", "95 %", "max", "NEES", "inside 95 %", "gaps")
    print_table(f"Error in hidden gaps against the {against}{whose}", columns, rows)


def print_since(rows: Sequence[SinceFigures]) -> None:
    """Print what each method has at a time since the last frame."""
    if not rows:
        return
    columns = ("since the last frame, s", "method", "rms, cm", "median", "95 %", "NEES")
    cells = [
        (
            f"{row.from_s:g} to {row.to_s:g}",
            row.method,
            centimetres(row.figures.position_rms_m),
            centimetres(row.figures.position_median_m),
            centimetres(row.figures.position_p95_m),
            row.figures.nees,
        )
        for row in rows
    ]
    print_table("Error by the time since the last frame that showed the forearm", columns, cells)


def print_factors(factors: Sequence[LengthFactor]) -> None:
    """Print by what sigma would have to grow, by length of gap."""
    if not factors:
        return
    columns = ("gap, s", "for 50 %", "for 95 %", "to be applied", "gaps behind it")
    rows = [
        (
            f"{row.length_s:g}",
            f"{row.factor_50:.2f}",
            f"{row.factor_95:.2f}",
            f"{row.factor:.2f}",
            f"{row.count} of all lengths" if row.pooled else f"{row.count}",
        )
        for row in factors
    ]
    print_table("Factor by which sigma would have to grow to hold", columns, rows)
