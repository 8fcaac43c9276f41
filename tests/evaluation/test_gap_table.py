"""Errors of hidden gaps as a table: by length and method, of one recording and of several."""

from __future__ import annotations

import numpy as np
import pytest

from calib.sigma_factor import LEVELS
from smoother.evaluation.gap_table import GapRow, GapTable, pooled, table_of
from smoother.evaluation.hidden_gaps import GapErrors, HiddenGap


def errors(*metres: float) -> GapErrors:
    """Samples with these errors; nan where there is no answer."""
    distance = np.array(metres)
    missing = int(np.isnan(distance).sum())
    angle = np.where(np.isnan(distance), np.nan, 2.0)
    factors = np.full((len(metres), len(LEVELS)), 1.5)
    return GapErrors("truth", distance, angle, (distance / 0.01) ** 2, missing, needed_factors=factors)


def row(length_s: float, method: str, of: GapErrors, recording: str = "a", failure: str = "") -> GapRow:
    gap = HiddenGap(5.0, 5.0 + length_s)
    return GapRow(length_s, method, 0, gap, of.reference, of.figures(), 0.01, 0.4, failure, recording)


def table(recording: str, *entries: tuple[float, str, GapErrors], notes: tuple[str, ...] = ()) -> GapTable:
    rows = [row(length, method, of, recording) for length, method, of in entries]
    return table_of(rows, [of for *_, of in entries], notes)


FIRST = table(
    "a",
    (1.0, "graph", errors(0.01, 0.03)),
    (1.0, "hold", errors(0.2)),
    (2.0, "graph", errors(0.04)),
    notes=("once",),
)
SECOND = table("b", (1.0, "graph", errors(0.05)), (2.0, "graph", errors(np.nan)), notes=("once", "twice"))


def test_samples_count_not_gaps() -> None:
    both = pooled([FIRST, SECOND])
    figures = both.lengths[1.0]["graph"]
    assert (figures.gaps, figures.failed, figures.figures.samples) == (2, 0, 3)
    assert figures.figures.position_rms_m == pytest.approx(np.sqrt((0.01**2 + 0.03**2 + 0.05**2) / 3))
    assert figures.figures.position_max_m == pytest.approx(0.05)
    assert both.lengths[1.0]["hold"].gaps == 1
    # what is not answered is counted, and spoils no figure
    assert both.lengths[2.0]["graph"].figures.unanswered == 1
    assert both.lengths[2.0]["graph"].figures.position_rms_m == pytest.approx(0.04)


def test_rows_keep_their_recording_and_notes_stand_once() -> None:
    both = pooled([FIRST, SECOND])
    assert [one.recording for one in both.rows] == ["a", "a", "a", "b", "b"]
    assert both.notes == ("once", "twice")
    assert len(both.errors) == len(both.rows)
    assert pooled([FIRST]).to_dict() == FIRST.to_dict()


def test_a_failed_gap_is_counted() -> None:
    of = errors(np.nan, np.nan)
    failed = table_of([row(1.0, "graph", of, failure="no answer inside the gap")], [of], [])
    entry = failed.to_dict()["lengths"][0]["methods"]["graph"]
    assert (entry["gaps"], entry["failed"], entry["unanswered"], entry["rms_m"]) == (1, 1, 2, None)
    assert entry["rms_cm"] is None


def test_sigma_factors_are_of_one_method() -> None:
    assert [factor.length_s for factor in FIRST.sigma_factors()] == [1.0, 2.0]
    assert [factor.length_s for factor in FIRST.sigma_factors("hold")] == [1.0]
    assert FIRST.sigma_factors("nothing") == ()


def test_errors_must_be_those_of_the_rows() -> None:
    with pytest.raises(ValueError, match="zip"):
        table_of(FIRST.rows, FIRST.errors[:-1], ())
