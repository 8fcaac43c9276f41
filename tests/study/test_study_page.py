"""The page over a study, the table while it runs, and the queries of docs/scale.md."""

from __future__ import annotations

import csv
import json
import re
from datetime import UTC, datetime
from pathlib import Path

import duckdb
import numpy as np
import pyarrow as pa
import pytest

from smoother.cli.run import NOT_TRUSTED, run
from smoother.errors import UnoccludeError
from smoother.evaluation.progress import group_measures
from smoother.report.pages import write_study
from smoother.study.folder import COLUMNS, schema
from smoother.study.progress import long_rows, persons_of
from smoother.study.run import Tally, study_folder


def row(name: str, **more: object) -> dict:
    empty = {column: None for column, *_ in COLUMNS}
    done = {"recording": name, "output": name, "status": "done", "duration_s": 60.0, "seconds": 2.0}
    figures = {"gaps": 2, "gap_longest_s": 1.5, "occluded_s": 2.0, "sigma_max_m": 0.02, "sigma_max_deg": 1.0}
    rest = {"clock_offset_s": 0.03, "notes": 1, "note_texts": ["the <b> camera"], "finished": datetime.now()}
    return empty | done | figures | rest | more


def test_worst_first_and_links(tmp_path):
    names = ["a.mcap", "day 1/b&c.mcap", "d.mcap", "e.mcap"]
    sigmas = [0.01, 0.09, None, 0.03]
    rows = [row(name, sigma_max_m=sigma) for name, sigma in zip(names, sigmas, strict=True)]
    rows.append(row("f.mcap", status="failed", error="f.mcap is <empty>", output=None))
    (tmp_path / "pages").mkdir()
    page = tmp_path / "pages" / "study.html"
    write_study(pa.Table.from_pylist(rows, schema=schema()), page, tmp_path / "out")
    text = page.read_text(encoding="utf-8")
    links = [
        text.index(f'href="../out/{name}"') for name in ("day%201/b%26c.mcap", "e.mcap", "a.mcap", "d.mcap")
    ]
    assert links == sorted(links), "by their largest sigma, the one without a gap last"
    assert "4 of 5 recordings were recovered, 1 failed" in text and "f.mcap is &lt;empty&gt;" in text
    assert "4 x: the &lt;b&gt; camera" in text and "30 times real time" in text
    with pytest.raises(UnoccludeError, match="force=True"):
        write_study(pa.Table.from_pylist(rows, schema=schema()), page, tmp_path / "out")


def test_a_study_of_failures_alone(tmp_path):
    rows = [row("a.mcap", status="failed", error="it is broken", duration_s=None, sigma_max_m=None)]
    write_study(pa.Table.from_pylist(rows, schema=schema()), tmp_path / "page.html", tmp_path)
    text = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert "0 of 1 recordings were recovered, 1 failed" in text and "it is broken" in text


def test_the_page_of_a_study_with_untrusted_results(tmp_path):
    mirrored = {"trusted": False, "verdict": "Not to be trusted: <mirrored>.", "gaps_untrusted": 2}
    rows = [
        row("a.mcap", sigma_max_m=0.0912, error_95_m=0.0912, trusted=True, gaps_untrusted=0),
        row("b.mcap", sigma_max_m=0.0123, error_95_m=0.0123, **mirrored),
        row("c.mcap", sigma_max_m=0.0456, error_95_m=0.0456, trusted=True, gaps_untrusted=1),
    ]
    write_study(pa.Table.from_pylist(rows, schema=schema()), tmp_path / "page.html", tmp_path)
    text = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert '<div class="summary alarm">' in text
    assert "Not to be trusted: 1 of them; do not use these figures." in text
    assert "Gaps that are not to be trusted: in 1 of the others" in text
    table = text[text.index("<tbody>") : text.index("</tbody>")]
    links = [table.index(f'href="{name}.mcap"') for name in "bca"]
    assert links == sorted(links)
    assert "not to be trusted</span> &lt;mirrored&gt;." in table and "1 of 2 gaps not</span>" in table
    assert "9.12" in table and "4.56" in table and "1.23" not in table, "its sigma is withdrawn"
    sound = [row("a.mcap", trusted=True, gaps_untrusted=0)]
    write_study(pa.Table.from_pylist(sound, schema=schema()), tmp_path / "sound.html", tmp_path)
    assert '<div class="summary">' in (tmp_path / "sound.html").read_text(encoding="utf-8")


def test_the_end_of_batch_names_them_first(tmp_path, monkeypatch, capsys):
    rows = [
        row("a.mcap", sigma_max_m=0.09, trusted=True, gaps_untrusted=0),
        row(
            "b.mcap",
            sigma_max_m=0.01,
            trusted=False,
            verdict="Not to be trusted: mirrored.",
            gaps_untrusted=2,
        ),
    ]

    def end(rows: list[dict], *options: str) -> tuple[int, dict, str]:
        table = pa.Table.from_pylist(rows, schema=schema())
        monkeypatch.setattr("smoother.study.run.run_study", lambda *rest: (Tally(len(rows)), table))
        monkeypatch.setattr("smoother.study.inputs.find_entries", lambda *rest: [])
        capsys.readouterr()
        code = run(["batch", "x", "-o", str(tmp_path), "--json", str(tmp_path / "j.json"), *options])
        return code, json.loads((tmp_path / "j.json").read_text()), capsys.readouterr().out

    code, figures, said = end(rows)
    assert code == 0 and figures["not_trusted"] == 1 and figures["partly_trusted"] == 0
    assert figures["untrusted"] == [{"recording": "b.mcap", "verdict": "Not to be trusted: mirrored."}]
    assert said.index("b.mcap") < said.index("a.mcap")
    assert (
        "1 of 2 results are not to be trusted\n" in said and said.count("Not to be trusted: mirrored.") == 1
    )
    assert end(rows, "--strict")[0] == NOT_TRUSTED
    assert end(rows[:1], "--strict")[0] == 0
    failed = row("c.mcap", status="failed", error="it is broken", output=None, sigma_max_m=None)
    assert end([*rows, failed], "--strict")[0] == 1, "what failed counts first"


def measured(value: float | None, trusted: bool = True, key: str = "elbow_flexion_range_deg") -> list[dict]:
    about = {"side": "right", "body": None, "trusted": trusted, "key": key, "name": "elbow flexion, range"}
    low = None if value is None else value - 2
    high = None if value is None else value + 2
    rest = {"sigma": 1.0, "recovered_share": 0.2, "n_draws": 64, "note": ""}
    return [about | {"unit": "deg", "value": value, "low": low, "high": high} | rest]


def persons_rows() -> list[dict]:
    """Three persons; the changes are 10, 14 and, not to be trusted, 500."""
    sessions = {"p1": (100.0, 110.0), "p2": (90.0, 104.0), "p3": (80.0, 580.0)}
    rows = []
    for person, values in sessions.items():
        for number, value in enumerate(values, start=1):
            trusted = value < 500
            about = {"arms": 1, "trusted": trusted, "gaps_untrusted": 0, "verdict": "Usable."}
            about |= {"measures": measured(value, trusted)}
            about |= {"self_check": "Hidden 8 times.", "error_95_m": 0.02}
            about |= {"self_check_95_m": 0.031, "self_check_stated_95_m": 0.042}
            rows.append(row(f"{person}/s{number}.mcap", **about))
    return rows


def test_a_groups_means_and_changes_are_those_of_what_is_to_be_trusted():
    (found,) = group_measures(long_rows(persons_rows()))
    assert found["first"] == (3, pytest.approx(90.0), pytest.approx(10.0))
    assert (*found["last"][:2], found["change"]) == (2, pytest.approx(107.0), pytest.approx(12.0))
    # Student's t of one degree of freedom at 0.975 is 12.706; 10 and 14 have a standard error of 2
    assert (found["low"], found["high"]) == pytest.approx((12 - 25.41, 12 + 25.41), abs=0.01)


def test_the_page_of_persons_has_the_group_links_and_a_file_for_statistics(tmp_path):
    (tmp_path / "p1").mkdir()
    (tmp_path / "p1" / "s1.html").write_text("a report")
    rows = persons_rows()
    table = pa.Table.from_pylist(rows, schema=schema())
    own = {"persons": persons_of(rows), "long": long_rows(rows)}
    write_study(table, tmp_path / "study.html", tmp_path, **own)
    text = (tmp_path / "study.html").read_text(encoding="utf-8")
    table = text[text.index(">Recordings</h2>") : text.index("</tbody>")]
    rows = table.split("<tr>")[2:]
    assert "p3/s2" in rows[0] and "580" not in rows[0], "untrusted first, without its measures"
    assert 'href="p1/s1.html"' in table and 'href="p1/s2.mcap"' in table
    for words in ('title="Hidden 8 times.">3.1 cm (stated: 4.2)', "100 (98 to 102)", "<td>p2</td>"):
        assert words in table
    group = text[text.index(">The group</h2>") :]
    assert "<td>90 (10)</td>" in group and "<td>+12 (-13.4 to +37.4)</td>" in group
    assert 'href="study_measures.csv"' in group
    with open(tmp_path / "study_measures.csv", newline="", encoding="utf-8") as file:
        long = list(csv.DictReader(file))
    assert len(long) == 6
    assert ",".join(long[0]) == (
        "person,session,session_number,day,task,recording,side,trusted,"
        "measure,name,unit,value,low,high,sigma,recovered_share"
    )
    assert [line["trusted"] for line in long] == ["1", "1", "1", "1", "1", "0"]
    assert long[3]["person"] == "p2" and long[3]["session_number"] == "2" and float(long[3]["value"]) == 104.0


def test_recordings_without_folders_are_a_person_each_and_have_no_change():
    rows = [row(f"{name}.mcap", measures=measured(value)) for name, value in (("a", 1.0), ("b", 3.0))]
    (found,) = group_measures(long_rows(rows))
    assert found["first"][0] == 2 and found["last"][0] == 0 and np.isnan(found["change"])


TEXT = (Path(__file__).parents[2] / "docs" / "scale.md").read_text(encoding="utf-8")
QUERIES = re.findall(r"```sql\n(.*?)```", TEXT, re.DOTALL)


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = study_folder(tmp_path_factory.mktemp("study") / "recovered")
    folder.open()
    for number in range(5):
        row = {"id": f"{number}", "recording": f"{number}.mcap", "status": "done", "input": f"/{number}.mcap"}
        row |= {"config_hash": "c" * 64, "calibration_hash": "", "version": "1"}
        row |= {"finished": datetime.now(UTC).replace(tzinfo=None), "seconds": 2.0, "duration_s": 60.0}
        row |= {"sigma_max_m": 0.01 * number, "note_texts": ["the clock drifts"], "notes": 1}
        if number == 4:
            row |= {"status": "failed", "error": "/data/4.mcap: there is no skeleton", "note_texts": None}
        folder.write_row(row)
    return folder.path.parent


def test_their_answers(study, monkeypatch):
    monkeypatch.chdir(study)
    far, worst, trusted, why = (duckdb.sql(query).fetchall() for query in QUERIES)
    assert dict((row[0], row[1]) for row in far) == {"done": 4, "failed": 1}
    assert [row[0] for row in worst] == ["3.mcap", "2.mcap", "1.mcap", "0.mcap"]
    assert sum(row[2] for row in trusted) == 4
    assert why == [("there is no skeleton", 1, "4.mcap")]
