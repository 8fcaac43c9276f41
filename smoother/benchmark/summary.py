"""The benchmark's figures: plain values, a Markdown table, and one row per gap."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from ..evaluation.gap_table import GapFigures, GapTable, spread_by_length
from ..evaluation.hidden_gaps import GapErrors
from .datasets import DATASETS, VERSION
from .run import BenchmarkRun

CSV_COLUMNS = (
    *("dataset", "split", "trial", "length_s", "method", "start_s", "end_s", "samples", "rms_m", "max_m"),
    *("sigma_max_m", "failure"),
)


@dataclass(frozen=True)
class MethodRow:
    """A method over one data set and split.

    Attributes
    ----------
    method : str
    median_m : dict of float to float or None, m
        By length: the median over the gaps of their rms.
    rms_m : dict of float to float or None, m
        By length: over all samples.
    inside_95 : float or None
        Share of all samples inside the stated 95 % region, over all lengths; None where no sigma is stated.
    gaps, failed : int
        That were tried, and those of them without an answer.
    """

    method: str
    median_m: dict[float, float | None]
    rms_m: dict[float, float | None]
    inside_95: float | None
    gaps: int
    failed: int


def method_rows(table: GapTable) -> list[MethodRow]:
    """The methods of a data set, by the sum of their medians, those without an answer last."""
    spreads = spread_by_length(table.rows)
    methods = dict.fromkeys(row.method for row in table.rows)
    rows = []
    for name in methods:
        median = {length: by[name].median_m for length, by in spreads.items() if name in by}
        rms = {length: by[name].figures.position_rms_m for length, by in table.lengths.items() if name in by}
        own = [errors for row, errors in zip(table.rows, table.errors, strict=True) if row.method == name]
        together = GapErrors.pooled(own).figures()
        failed = sum(bool(row.failure) for row in table.rows if row.method == name)
        rows.append(MethodRow(name, median, rms, together.coverage_95, len(own), failed))
    return sorted(rows, key=_rank)


def _rank(row: MethodRow) -> tuple[int, float]:
    known = [value for value in row.median_m.values() if value is not None]
    return len(row.median_m) - len(known), sum(known)


def plain(run: BenchmarkRun, seed: int, version: str) -> dict[str, object]:
    """Plain values by name, as `benchmark.json` holds them; nothing in it changes from run to run."""
    return {
        "benchmark": VERSION,
        "version": version,
        "seed": seed,
        "data_sha256": run.digest,
        "datasets": [
            {
                "dataset": dataset,
                "split": split,
                "trials": run.trials[dataset, split],
                "lengths": [
                    {"length_s": length, "methods": {name: _figures(each) for name, each in by.items()}}
                    for length, by in table.lengths.items()
                ],
                "methods": [
                    {
                        "method": row.method,
                        "median_m": {f"{length:g}": value for length, value in row.median_m.items()},
                        "rms_m": {f"{length:g}": value for length, value in row.rms_m.items()},
                        "inside_95": row.inside_95,
                        "gaps": row.gaps,
                        "failed": row.failed,
                    }
                    for row in method_rows(table)
                ],
            }
            for (dataset, split), table in run.tables.items()
        ],
        "notes": list(all_notes(run)),
    }


def _figures(figures: GapFigures) -> dict[str, object]:
    return {name: value for name, value in figures.to_dict().items() if not name.endswith("_cm")}


def all_notes(run: BenchmarkRun) -> Sequence[str]:
    """What a reader must know, one sentence each, none twice."""
    return list(dict.fromkeys([*run.notes, *(note for table in run.tables.values() for note in table.notes)]))


def columns_of(table: GapTable) -> tuple[str, ...]:
    """The heads of the one table's columns."""
    return ("method", *(f"{length:g} s" for length in table.lengths), "inside 95 %", "gaps")


def cells_of(row: MethodRow, lengths: Iterable[float]) -> tuple[str, ...]:
    """A row of the one table: median / rms in cm by length, the share inside, gaps and failures."""
    errors = [f"{_cm(row.median_m.get(length))} / {_cm(row.rms_m.get(length))}" for length in lengths]
    inside = "-" if row.inside_95 is None else f"{100 * row.inside_95:.0f} %"
    gaps = f"{row.gaps}" if not row.failed else f"{row.gaps} ({row.failed} failed)"
    return (row.method, *errors, inside, gaps)


def _cm(value_m: float | None) -> str:
    return "-" if value_m is None else f"{100 * value_m:.2f}"


def heading(dataset: str, split: str, trials: int) -> str:
    """The title of a data set's table."""
    return f"{DATASETS[dataset].title}, {split}: {trials} trial{'' if trials == 1 else 's'}"


def markdown(run: BenchmarkRun) -> str:
    """The tables in Markdown."""
    parts = []
    for (dataset, split), table in run.tables.items():
        head = columns_of(table)
        lines = [f"### {heading(dataset, split, run.trials[dataset, split])}", ""]
        lines += [f"| {' | '.join(head)} |", f"|{'---|' * len(head)}"]
        lines += [f"| {' | '.join(cells_of(row, table.lengths))} |" for row in method_rows(table)]
        parts.append("\n".join(lines))
    return "\n\n".join(parts) + "\n"


def gap_rows(run: BenchmarkRun) -> Iterable[Sequence[str]]:
    """One row per gap, as in `gaps.csv`; the header first."""
    yield CSV_COLUMNS
    for (dataset, split), table in run.tables.items():
        for row in table.rows:
            numbers = (row.figures.position_rms_m, row.figures.position_max_m, row.sigma_max_m)
            cells = [dataset, split, row.recording, f"{row.length_s:g}", row.method]
            cells += [repr(float(row.gap.start_s)), repr(float(row.gap.end_s)), str(row.figures.samples)]
            cells += ["" if value is None else repr(float(value)) for value in numbers]
            yield [*cells, row.failure or ""]
