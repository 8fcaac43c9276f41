"""The queries of docs/scale.md run as they are there."""

from __future__ import annotations

import re
from datetime import UTC, datetime
from pathlib import Path

import duckdb
import pytest

from smoother.study.ledger import Ledger
from smoother.study.run import study_folder

TEXT = (Path(__file__).parents[2] / "docs" / "scale.md").read_text(encoding="utf-8")
QUERIES = re.findall(r"```sql\n(.*?)```", TEXT, re.DOTALL)


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = study_folder(tmp_path_factory.mktemp("study") / "recovered")
    folder.open()
    ledger = Ledger(folder)
    for number in range(5):
        row = {"id": f"{number}", "recording": f"{number}.mcap", "status": "done", "input": f"/{number}.mcap"}
        row |= {"config_hash": "c" * 64, "calibration_hash": "", "version": "1"}
        row |= {"finished": datetime.now(UTC).isoformat(), "seconds": 2.0, "duration_s": 60.0}
        row |= {"sigma_max_m": 0.01 * number, "note_texts": ["the clock drifts"], "notes": 1}
        if number == 4:
            row |= {"status": "failed", "error": "/data/4.mcap: there is no skeleton", "note_texts": None}
        ledger.add(row)
    ledger.add({**row, "id": "again", "status": "done", "finished": datetime.now(UTC).isoformat()})
    ledger.flush()
    return folder.path.parent


@pytest.mark.parametrize("query", QUERIES)
def test_a_query(query, study, monkeypatch):
    monkeypatch.chdir(study)
    assert duckdb.sql(query).fetchall()


def test_their_answers(study, monkeypatch):
    monkeypatch.chdir(study)
    far, worst, trusted, why, latest = (duckdb.sql(query).fetchall() for query in QUERIES)
    assert dict((row[0], row[1]) for row in far) == {"done": 5, "failed": 1}
    assert [row[0] for row in worst] == ["4.mcap", "3.mcap", "2.mcap", "1.mcap", "0.mcap"]
    assert sum(row[2] for row in trusted) == 5
    assert why == [("there is no skeleton", 1, "4.mcap")]
    assert len(latest) == 5
