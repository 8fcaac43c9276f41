"""The figures' own program in miniature: jobs run, are kept, summed up and drawn."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tools.figures import curves
from tools.figures.curves import WITHOUT, tables

SHORT_S = 12.0


@pytest.fixture
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    """Simulated recordings of twelve seconds."""
    monkeypatch.setattr(curves, "DURATION_S", SHORT_S)


def test_a_job_has_a_row_a_gap_and_method(short):
    rows = curves.run_job(curves.Job("realistic", "500", 0.5, ("graph", "hold")))
    assert {row["method"] for row in rows} == {"graph", "hold"}
    assert len(rows) % 2 == 0 and all(row["failure"] == "" and 0 < row["rms_m"] < 0.5 for row in rows)
    assert json.loads(json.dumps(rows)) == rows


def test_every_ingredient_can_be_taken_away(short):
    whole = curves.run_job(curves.Job("realistic", "500", 1.0, ("graph",)))
    without = curves.run_job(curves.Job("ingredients", "500", 1.0, tuple(WITHOUT)))
    assert {row["method"] for row in without} == set(WITHOUT)
    assert all(row["failure"] == "" for row in without)
    # the very gaps of the whole graph, so that they can stand side by side
    assert {row["start_s"] for row in without} == {row["start_s"] for row in whole}
    by_name = {name: max(row["rms_m"] for row in without if row["method"] == name) for name in WITHOUT}
    # three degrees of gravity are 0.5 m/s^2: over 1 s seen from both sides up to 6 cm
    assert by_name["gravity 3 degrees off"] > 1.5 * max(row["rms_m"] for row in whole)


def test_jobs_that_say_most_come_first():
    todo = list(curves.jobs(["realistic", "clean", "ingredients"], seeds=2))
    assert len({job.name for job in todo}) == len(todo)
    assert {job.length_s for job in todo if job.data == "realistic"} == set(curves.LENGTHS_S)
    lengths = [job.length_s for job in todo if job.data != "ingredients"]
    assert lengths == sorted(lengths, key=curves.LENGTHS_S.index)


def row(method: str, length_s: float, start_s: float, rms_m: float | None, recording: str = "a") -> dict:
    failure = "" if rms_m is not None else "no answer"
    figures = {"rms_m": rms_m, "nees": rms_m and 1.0, "samples": 10 if rms_m else 0}
    return (
        {"recording": recording, "method": method, "length_s": length_s, "start_s": start_s}
        | figures
        | {"failure": failure}
    )


def test_summed_up_and_drawn(tmp_path: Path):
    pytest.importorskip("matplotlib")
    from tools.figures.curves import draw

    kept = tmp_path / "rows.jsonl"
    seen = [
        row(m, x, at, e * x)
        for x in (0.5, 2.0)
        for at in (1.0, 9.0)
        for m, e in (("graph", 0.01), ("hold", 0.2))
    ]
    entries = [
        {"job": "1", "data": "realistic", "rows": seen},
        {
            "job": "2",
            "data": "broad",
            "rows": [row("graph", 1.0, 2.0, None), {"recording": "b", "skipped": "short"}],
        },
        {"job": "3", "data": "ingredients", "rows": [row("no wrist", 2.0, 9.0, 0.05)]},
    ]
    kept.write_text("".join(json.dumps(entry) + "\n" for entry in entries))
    found = curves.summed_up(curves.read_rows(kept))
    first, second = found["realistic"]["lengths"]
    assert (first["length_s"], second["length_s"]) == (0.5, 2.0)
    assert first["methods"]["graph"]["median_m"] == 0.005 and first["methods"]["graph"]["gaps"] == 2
    assert second["methods"]["hold"]["samples_rms_m"] == 0.4
    assert found["broad"]["lengths"][0]["methods"]["graph"]["failed"] == 1
    # the graph is beside its ingredients in the gaps that they share alone
    (beside,) = found["ingredients"]["lengths"]
    assert beside["methods"]["graph"]["gaps"] == 1 and beside["methods"]["no wrist"]["median_m"] == 0.05
    lines = list(tables(found))
    assert "| graph | 0.50 / 0.50 (0.50 .. 0.50) | 2.00 / 2.00 (2.00 .. 2.00) |" in lines
    assert lines.index("| gap | 0.5 s | 2 s |") + 2 == lines.index(next(x for x in lines if "| graph" in x))
    draw(found, tmp_path / "curves.svg")
    drawn = (tmp_path / "curves.svg").read_text()
    assert "graph (unocclude)" in drawn and "without an answer" not in drawn and "no wrist" in drawn
    draw(found, tmp_path / "again.svg")
    assert (tmp_path / "again.svg").read_text() == drawn  # no date, no chance


def test_what_is_done_is_not_done_again(tmp_path: Path, capsys):
    kept = tmp_path / "rows.jsonl"
    todo = [curves.Job("realistic", "500", 0.5)]
    kept.write_text(json.dumps({"job": todo[0].name, "data": "realistic", "rows": []}) + "\n")
    curves.measure(todo, kept, processes=1)
    assert len(curves.read_rows(kept)) == 1 and capsys.readouterr().out == ""
