"""Errors in hidden gaps: gap by gap, by method and length, and as a table of all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from .gap_score import GapErrors
from .metrics import Figures
from .placement import HiddenGap
from .sigma_factor import LengthFactor, length_factors


@dataclass(frozen=True)
class GapRow:
    """One hidden gap and what a method made of it.

    Attributes
    ----------
    length_s : float, s
        Length asked for.
    method : str
        Name of the method.
    run : int
        Which copy of the recording the gap was hidden in.
    gap : HiddenGap
        Where it was hidden, on the camera's clock.
    reference : str
        "truth", "wrist", "strap" ..: what the answer was compared with.
    figures : Figures
        Errors inside the gap.
    sigma_max_m : float, m, or None
        Largest stated standard deviation inside the gap, on one axis.
    path_m : float, m, or None
        Length of the hidden path.
    failure : str
        Why there is no answer, "" where there is one.
    recording : str
        Name of the recording.
    """

    length_s: float
    method: str
    run: int
    gap: HiddenGap
    reference: str
    figures: Figures
    sigma_max_m: float | None = None
    path_m: float | None = None
    failure: str = ""
    recording: str = ""

    def to_dict(self) -> dict[str, object]:
        """Plain values by name."""
        figures = self.figures
        return {
            "length_s": self.length_s,
            "method": self.method,
            "run": self.run,
            "start_s": self.gap.start_s,
            "end_s": self.gap.end_s,
            "reference": self.reference,
            "rms_m": figures.position_rms_m,
            "max_m": figures.position_max_m,
            "orientation_rms_deg": figures.orientation_rms_deg,
            "nees": figures.nees,
            "samples": figures.samples,
            "sigma_max_m": self.sigma_max_m,
            "path_m": self.path_m,
            "failure": self.failure,
            "recording": self.recording,
        }


@dataclass(frozen=True)
class GapFigures:
    """A method's errors in all gaps of one length."""

    figures: Figures
    gaps: int
    failed: int

    def to_dict(self) -> dict[str, float | int | None]:
        """Plain values by name, distances in m and in cm."""
        f = self.figures
        metres = {
            "rms": f.position_rms_m,
            "median": f.position_median_m,
            "p95": f.position_p95_m,
            "max": f.position_max_m,
        }
        result: dict[str, float | int | None] = {f"{name}_m": value for name, value in metres.items()}
        for name, value in metres.items():
            result[f"{name}_cm"] = None if value is None else 100.0 * value
        result |= {
            "orientation_rms_deg": f.orientation_rms_deg,
            "orientation_max_deg": f.orientation_max_deg,
            "nees": f.nees,
            "coverage_95": f.coverage_95,
            "gaps": self.gaps,
            "failed": self.failed,
            "samples": f.samples,
            "unanswered": f.unanswered,
        }
        return result


@dataclass(frozen=True)
class GapTable:
    """Error against gap length.

    Attributes
    ----------
    lengths : dict[float, dict[str, GapFigures]]
        By gap length (s), by method, its figures over all gaps of that length.
    rows : tuple of GapRow
        Each gap by itself.
    notes : tuple of str
        What a reader must know, one sentence each.
    errors : tuple of GapErrors
        Of each row, sample by sample.
    """

    lengths: dict[float, dict[str, GapFigures]]
    rows: tuple[GapRow, ...]
    notes: tuple[str, ...] = ()
    errors: tuple[GapErrors, ...] = ()

    def sigma_factors(self, method: str = "graph") -> tuple[LengthFactor, ...]:
        """By what a method's sigma would have to be multiplied to hold; empty without its answers."""
        return length_factors(
            [
                (row.length_s, errors.needed_factors)
                for row, errors in zip(self.rows, self.errors, strict=True)
                if row.method == method
            ]
        )

    def to_dict(self) -> dict[str, object]:
        """Plain values, as `--json` writes them."""
        return {
            "lengths": [
                {"length_s": length, "methods": {name: f.to_dict() for name, f in methods.items()}}
                for length, methods in self.lengths.items()
            ],
            "rows": [row.to_dict() for row in self.rows],
            "notes": list(self.notes),
            "sigma_factors": [row.to_dict() for row in self.sigma_factors()],
        }


def table_of(rows: Sequence[GapRow], errors: Sequence[GapErrors], notes: Sequence[str]) -> GapTable:
    """The gaps by length and method.

    Parameters
    ----------
    rows : sequence of GapRow
    errors : sequence of GapErrors
        Of each row, sample by sample.
    notes : sequence of str
        None is stated twice.
    """
    lengths: dict[float, dict[str, GapFigures]] = {}
    for length in dict.fromkeys(row.length_s for row in rows):
        for name in dict.fromkeys(row.method for row in rows):
            chosen = [
                (row, hidden)
                for row, hidden in zip(rows, errors, strict=True)
                if row.length_s == length and row.method == name
            ]
            if chosen:
                samples = GapErrors.pooled([hidden for _, hidden in chosen])
                failed = sum(bool(row.failure) for row, _ in chosen)
                figures = GapFigures(samples.figures(), gaps=len(chosen), failed=failed)
                lengths.setdefault(float(length), {})[name] = figures
    return GapTable(lengths, tuple(rows), tuple(dict.fromkeys(notes)), tuple(errors))


def pooled(tables: Sequence[GapTable]) -> GapTable:
    """The gaps of several recordings as one table."""
    notes = [note for table in tables for note in table.notes]
    rows = [row for table in tables for row in table.rows]
    errors = [each for table in tables for each in table.errors]
    return table_of(rows, errors, notes)
