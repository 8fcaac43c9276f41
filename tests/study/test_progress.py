"""Persons over sessions: who takes part, what is called a change; the page over a study, its queries."""

from __future__ import annotations

import json
import math
import re
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import duckdb
import numpy as np
import pyarrow as pa
import pytest
from made_measures import made_measure, made_measures, study_row, write_study

from smoother.cli.run import NOT_TRUSTED, run
from smoother.errors import UnoccludeError
from smoother.evaluation.progress import LESS, MORE, UNCLEAR, UNKNOWN, PersonProgress
from smoother.report.pages import write_study as write_page
from smoother.study.folder import COLUMNS, schema
from smoother.study.inputs import SessionEntry, by_folders, in_order
from smoother.study.progress import progress_of, read_rows, sessions_of
from smoother.study.run import Tally, study_folder

FLEXION = "elbow_flexion_range_deg"


def people(folder: Path, table: Path | None = None, **mdc95: float) -> list[PersonProgress]:
    rows = read_rows(folder)
    return progress_of(rows, sessions_of(folder, rows, table)[0], mdc95)


@pytest.mark.parametrize(
    ("name", "person", "session", "task"),
    [
        ("p1/s1.mcap", "p1", "s1", ""),
        ("p1/2026-01-02/reach.mcap", "p1", "2026-01-02", "reach"),
        ("p1/s1/left/reach.mcap", "p1", "s1", "left/reach"),
    ],
)
def test_folders_say_whose_it_is(name: str, person: str, session: str, task: str):
    found = by_folders(name, 3.0)
    assert found == SessionEntry(name, person, session, task, 3.0)
    assert by_folders("reach.mcap", 3.0) is None


def test_order_of_sessions():
    def order(*sessions: tuple[str, float]) -> list[str]:
        attended = [SessionEntry(name, "p", name, "", day) for name, day in sessions]
        return [each[0].session for each in in_order(attended)]

    assert order(("s10", math.nan), ("s9", math.nan)) == ["s9", "s10"]
    assert order(("after", 30.0), ("before", 2.0)) == ["before", "after"]
    assert order(("b", 30.0), ("a", math.nan)) == ["a", "b"]  # not all days are known


def test_gaps_that_are_not_trusted_are_said_and_do_not_exclude_a_session(tmp_path: Path):
    rows = [
        study_row("p/s1.mcap", [made_measures()], gaps=3, gaps_untrusted=0),
        study_row("p/s2.mcap", [made_measures()], gaps=5, gaps_untrusted=2),
        study_row("p/s3.mcap", [made_measures(trusted=False)], gaps=5, gaps_untrusted=5, trusted=False),
    ]
    (progress,) = people(write_study(tmp_path / "study", rows))
    assert progress.sessions == ("s1", "s2")
    assert [note for note in progress.notes if "gaps" in note] == [
        "session s2 (p/s2.mcap): 2 of 5 gaps are not to be trusted; what was measured in them may be wrong"
    ]
    assert progress.left_out == ("session s3 (p/s3.mcap): the right arm's result is not to be trusted",)


def test_a_known_change_is_found_and_a_null_change_is_not_called(tmp_path: Path):
    """Forty persons: one measure changes by 6 of the difference's sigmas, all others do not."""
    rng = np.random.default_rng(0)
    rows = [
        study_row(
            f"p{person:02d}/s{session}.mcap",
            [made_measures(rng=rng, movements=0, change={FLEXION: 17.0 * session})],
            recorded_day=100.0 + 7 * session,
        )
        for person in range(40)
        for session in range(2)
    ]
    persons = people(write_study(tmp_path / "study", rows))
    assert len(persons) == 40 and all(each.days == (0.0, 7.0) for each in persons)
    words = [{each.key: each.change.word for each in person.main} for person in persons]
    assert sum(each[FLEXION] == MORE for each in words) >= 39
    # measures that are known to a sigma; yes and no have none
    others = [(key, word) for each in words for key, word in each.items() if key != FLEXION]
    null = [word for key, word in others if not key.endswith("_reached")]
    alarms = sum(word in (MORE, LESS) for word in null) / len(null)
    assert len(null) >= 600 and UNKNOWN not in null
    assert alarms == pytest.approx(0.05, abs=0.026)  # 3 sigmas of a share of 0.05 over 640
    for person in persons:  # Holm: all main measures of a person that are known count together
        p, adjusted = np.sort([(each.change.p, each.change.p_together) for each in person.main], axis=0).T
        known = np.isfinite(p).sum()
        step_down = np.maximum.accumulate(np.arange(known, 0, -1) * p[:known])
        np.testing.assert_allclose(adjusted[:known], np.minimum(step_down, 1.0))


def test_what_takes_no_part_is_said(tmp_path: Path):
    twice = [made_measures(body=1), made_measures(body=2)]
    rows = [
        study_row("p/s1.mcap", [made_measures(trusted=False)]),
        study_row("p/s2.mcap", None),
        study_row("p/s3.mcap", None, status="failed", error="it is not a recording"),
        study_row("p/s4.mcap", twice),
        study_row("p/s5.mcap", [made_measures(), made_measures("left", trusted=False)]),
        study_row("p/s6.mcap", [made_measures(draws=False)]),
    ]
    (person,) = people(write_study(tmp_path / "study", rows))
    assert person.sessions == ("s5", "s6")
    said = ("not to be trusted", "without measures", "it failed", "several persons' right", "the left arm's")
    for number, words in enumerate(said):
        assert words in person.left_out[number] and f"s{1 + number}" in person.left_out[number]
    series = next(each for each in person.series if each.key == FLEXION)
    assert series.change.word == UNKNOWN and "without drawn motions" in series.change.limits[0]
    assert person.compared == () and person.clear == ()


def test_other_settings_are_noted(tmp_path: Path):
    rows = [
        study_row("p/s1.mcap", [made_measures()], recorded_day=1.0),
        study_row("p/s2.mcap", [made_measures()], config_hash="other", calibration_hash="x"),
    ]
    (person,) = people(write_study(tmp_path / "study", rows))
    assert any("different settings" in note for note in person.notes)
    assert any("calibration" in note for note in person.notes)
    assert any("days of the sessions are unknown" in note for note in person.notes)
    assert all(math.isnan(day) for day in person.days[1:])


def test_means_over_other_movements_are_not_compared():
    attended = {f"p/s{n}.mcap": SessionEntry(f"p/s{n}.mcap", "p", f"s{n}", "", float(n)) for n in range(2)}
    rows = []
    for number, name in enumerate(attended):
        arm = made_measures(change={"sparc": 0.5 * number, FLEXION: 20.0 * number}, movements=0)
        count = made_measure("movement_count", 6.0 - 3 * number, 0.0)
        rows.append(study_row(name, [replace(arm, rows=(*arm.rows, count))]))
    (person,) = progress_of(rows, attended)
    words = {each.key: each.change.word for each in person.series}
    assert (words["sparc"], words[FLEXION]) == (UNKNOWN, MORE)
    limits = next(each.change.limits for each in person.series if each.key == "sparc")
    assert limits[0] == "sessions s0 and s1 have 6 and 3 movements: their means are not comparable"


def test_tasks_and_arms_are_compared_with_their_own(tmp_path: Path):
    rows = [
        study_row(
            f"p/s{session}/{task}.mcap",
            [made_measures(side, change={FLEXION: change}) for side in ("left", "right")],
            recorded_day=float(session),
        )
        for task, change in (("reach", 0.0), ("drink", 40.0))
        for session in (1, 2)
    ]
    (person,) = people(write_study(tmp_path / "study", rows))
    series = [each for each in person.series if each.key == FLEXION]
    assert {(each.side, each.task) for each in series} == {
        (side, task) for side in ("left", "right") for task in ("reach", "drink")
    }
    assert all(each.change.word == UNCLEAR and each.change.difference == 0 for each in series)


def test_a_table_says_whose_it_is(tmp_path: Path):
    rows = [study_row(f"{name}.mcap", [made_measures()]) for name in ("a", "b", "c")]
    folder = write_study(tmp_path / "study", rows)
    table = tmp_path / "sessions.csv"
    table.write_text(
        "\ufefffile;person;date\r\na.mcap;p1;2026-03-01\r\nb;p1;2026-03-15\r\n", encoding="utf-8"
    )
    (person,) = people(folder, table)
    assert person.sessions == ("2026-03-01", "2026-03-15") and person.days == (0.0, 14.0)
    assert sessions_of(folder, read_rows(folder), table)[1] == ["c.mcap: sessions.csv does not name it"]


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
    write_page(pa.Table.from_pylist(rows, schema=schema()), page, tmp_path / "out")
    text = page.read_text(encoding="utf-8")
    links = [
        text.index(f'href="../out/{name}"') for name in ("day%201/b%26c.mcap", "e.mcap", "a.mcap", "d.mcap")
    ]
    assert links == sorted(links), "by their largest sigma, the one without a gap last"
    assert "4 of 5 recordings were recovered, 1 failed" in text and "f.mcap is &lt;empty&gt;" in text
    assert "4 x: the &lt;b&gt; camera" in text
    with pytest.raises(UnoccludeError, match="force=True"):
        write_page(pa.Table.from_pylist(rows, schema=schema()), page, tmp_path / "out")


def test_a_study_of_failures_alone(tmp_path):
    rows = [row("a.mcap", status="failed", error="it is broken", duration_s=None, sigma_max_m=None)]
    write_page(pa.Table.from_pylist(rows, schema=schema()), tmp_path / "page.html", tmp_path)
    text = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert "0 of 1 recordings were recovered, 1 failed" in text and "it is broken" in text


def test_the_page_of_a_study_with_untrusted_results(tmp_path):
    mirrored = {"trusted": False, "verdict": "Not to be trusted: <mirrored>.", "gaps_untrusted": 2}
    rows = [
        row("a.mcap", sigma_max_m=0.0912, error_95_m=0.0912, trusted=True, gaps_untrusted=0),
        row("b.mcap", sigma_max_m=0.0123, error_95_m=0.0123, **mirrored),
        row("c.mcap", sigma_max_m=0.0456, error_95_m=0.0456, trusted=True, gaps_untrusted=1),
    ]
    write_page(pa.Table.from_pylist(rows, schema=schema()), tmp_path / "page.html", tmp_path)
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
    write_page(pa.Table.from_pylist(sound, schema=schema()), tmp_path / "sound.html", tmp_path)
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
    far, worst, trusted = (duckdb.sql(query).fetchall() for query in QUERIES)
    assert dict((row[0], row[1]) for row in far) == {"done": 4, "failed": 1}
    assert [row[0] for row in worst] == ["3.mcap", "2.mcap", "1.mcap", "0.mcap"]
    assert sum(row[2] for row in trusted) == 4
