"""The measures of a result beside those of its reference, as `validate` prints them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from .output import print_table

if TYPE_CHECKING:
    from ..evaluation.measure_agreement import MeasurePair
    from ..evaluation.validate import Validation


def pooled_measures(paths: Sequence[Path]) -> list[MeasurePair]:
    """The pairs of earlier validations, each once."""
    from ..evaluation.measure_agreement import read_pairs, unique_pairs

    return unique_pairs(pair for path in paths for pair in read_pairs(path))


def print_measures(validation: Validation) -> None:
    """Print the main measures of the session, and how well all that were compared agree."""
    from ..evaluation.measure_agreement import agreement_cells, pair_cells

    comparison = validation.measures
    if comparison is None:
        return
    _print(validation.title("Measures of the session"), *pair_cells(comparison))
    _print(
        validation.title("Agreement of the measures (answer minus truth) over recordings and movements"),
        *agreement_cells(comparison),
    )


def _print(title: str, columns: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    if rows := list(rows):
        print_table(title, columns, rows)
