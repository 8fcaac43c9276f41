"""`batch --measures`: rows hold measures, and say as little of the person as can be."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import duckdb
import pytest
from commands import done
from studies import NAMES, batch, query, state

from smoother.study.folder import MEASURE_FIELDS
from smoother.study.inputs import relative_day
from smoother.study.run import run_job


@pytest.fixture(autouse=True, scope="module")
def here() -> Iterator[None]:
    """Do the work in this process: starting others takes longer than the work."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("smoother.study.run.run_apart", run_job)
        yield


@pytest.fixture(scope="module")
def study(here: None, made: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording, measured with a few draws."""
    out = tmp_path_factory.mktemp("measured") / "out"
    assert batch(made / NAMES[0], "-o", out, "--processes", 1, "--measures", "--draws", 20) == 0
    return out


@pytest.mark.slow
def test_rows_hold_the_measures_of_each_session(study: Path):
    rows = duckdb.sql(
        f"SELECT recording, unnest(measures, recursive := true) FROM '{study}/results/*.parquet'"
    )
    assert rows.columns == ["recording", *(name for name, *_ in MEASURE_FIELDS)]
    found = {(row[0], row[4]): dict(zip(rows.columns, row, strict=True)) for row in rows.fetchall()}
    flexion = found["a.mcap", "elbow_flexion_range_deg"]
    assert flexion["unit"] == "deg" and flexion["side"] == "right" and flexion["n_draws"] == 20
    assert flexion["low"] < flexion["high"] and 0 < flexion["sigma"] < 20
    assert 0 <= flexion["recovered_share"] <= 1
    assert len(query(study, "trusted, recorded_day")) == 1


def test_the_result_is_the_one_without_measures(study: Path, made: Path, tmp_path: Path):
    one = tmp_path / "one.mcap"
    done("smooth", made / NAMES[0], "-o", one, "--processes", "1", "--draws", "0")
    assert one.read_bytes() == state(study)["a.mcap"][1]


def test_measures_that_are_there_are_not_measured_again(study: Path, made: Path, capsys):
    again = [made / NAMES[0], "-o", study, "--processes", 1, "--measures", "--draws", 20]
    assert batch(*again) == 0
    assert "0 recovered now" in capsys.readouterr().out
    assert len(query(study)) == 1


def test_days_are_relative_to_a_secret_one():
    day_ns = 86_400 * 10**9
    origin = 20_000 * day_ns
    first = relative_day("word", "p1", origin)
    assert first is not None and abs(first - 20_000) > 1e-3
    assert relative_day("word", "p1", origin + 14 * day_ns) - first == pytest.approx(14)
    assert relative_day("word", "p2", origin) != first != relative_day("other", "p1", origin)
    assert relative_day("word", "p1", 0) is None  # a clock that knows no date
