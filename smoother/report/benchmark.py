"""The benchmark's page: one table per data set, error against gap length, and how to add a method."""

from __future__ import annotations

from collections.abc import Iterator

from ..benchmark.datasets import DATASETS
from ..benchmark.run import BenchmarkRun
from ..benchmark.summary import all_notes, cells_of, columns_of, heading, method_rows
from ..evaluation.gap_table import GapTable, spread_by_length
from .method_comparison import curves
from .sheet import Page, figure, listing, tabulated


def benchmark_page(run: BenchmarkRun, subtitle: str) -> Page:
    """The benchmark on one page.

    Parameters
    ----------
    run : BenchmarkRun
    subtitle : str
        The line under its heading.
    """
    return Page("Benchmark of occluded arms", subtitle, list(_verdict(run)), _sections(run))


def _verdict(run: BenchmarkRun) -> Iterator[str]:
    """Where ours stands, in a sentence a data set."""
    for (dataset, split), table in run.tables.items():
        rows = method_rows(table)
        if not rows:
            yield f"{DATASETS[dataset].title}, {split}: nothing could be scored."
            continue
        names = [row.method for row in rows]
        sentence = f"{DATASETS[dataset].title}, {split}: {names[0]} has the smallest median error"
        if "graph" in names[1:]:
            sentence += f"; graph is number {names.index('graph') + 1} of {len(names)}"
        yield sentence


def _sections(run: BenchmarkRun) -> Iterator[str]:
    for (dataset, split), table in run.tables.items():
        data = DATASETS[dataset]
        title = heading(dataset, split, run.trials[dataset, split])
        rows = [cells_of(row, table.lengths) for row in method_rows(table)]
        yield tabulated(
            title, f"Scored: {data.point}. {_TABLE} Data: {data.source}.", columns_of(table), rows
        )
        if len(table.lengths) > 1:
            spreads = spread_by_length(table.rows)
            yield figure(f"{data.title}, {split}: error against gap length", _CURVES, curves(spreads))
        yield tabulated(
            f"{data.title}, {split}: share inside the stated 95 %",
            _INSIDE,
            ("method", *(f"{length:g} s" for length in table.lengths)),
            _inside(table),
        )
    yield listing("Notes", all_notes(run), "There is nothing to note.")


def _inside(table: GapTable) -> Iterator[tuple[object, ...]]:
    for row in method_rows(table):
        figures = [by.get(row.method) for by in table.lengths.values()]
        shares = [None if each is None else each.figures.coverage_95 for each in figures]
        if any(share is not None for share in shares):
            yield (row.method, *(None if share is None else f"{100 * share:.0f} %" for share in shares))


_TABLE = (
    "Each cell: median over gaps of the error in a gap (rms), and rms over all samples, cm. Inside 95 %: how"
    " many of 100 samples are in the region that the method states for 95; a dash where it states none."
)
_CURVES = (
    "Lines join the medians over the gaps of a length; bars (for the graph a band) reach from the 25 % to the"
    " 75 % quartile. Click a name to hide its line."
)
_INSIDE = (
    "By length of gap. 95 % is consistent; less is over-confident, more under-confident. Against hidden"
    " camera samples the camera's noise, as it shows where the arm is seen, counts beside sigma: the same for"
    " all methods."
)
