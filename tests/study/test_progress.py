"""Persons over sessions: whose a recording is, what takes part, what is called a change."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from made_measures import made_measure, made_measures, study_row, write_study

from smoother.errors import UnoccludeError
from smoother.evaluation.progress import LESS, MORE, UNCLEAR, UNKNOWN, PersonProgress
from smoother.study.inputs import SessionEntry, by_folders, in_order
from smoother.study.progress import progress_of, read_rows, sessions_of

FLEXION = "elbow_flexion_range_deg"


def persons_of(folder: Path, table: Path | None = None, **mdc95: float) -> list[PersonProgress]:
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
    (progress,) = persons_of(write_study(tmp_path / "study", rows))
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
    persons = persons_of(write_study(tmp_path / "study", rows))
    assert len(persons) == 40 and all(each.days == (0.0, 7.0) for each in persons)
    words = [{each.key: each.change.word for each in person.main} for person in persons]
    assert sum(each[FLEXION] == MORE for each in words) >= 39
    # measures that are known to a sigma; yes and no have none
    others = [(key, word) for each in words for key, word in each.items() if key != FLEXION]
    null = [word for key, word in others if not key.endswith("_reached")]
    alarms = sum(word in (MORE, LESS) for word in null) / len(null)
    assert len(null) >= 600 and UNKNOWN not in null
    assert alarms == pytest.approx(0.05, abs=0.026)  # 3 sigmas of a share of 0.05 over 640


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
    (person,) = persons_of(write_study(tmp_path / "study", rows))
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
    (person,) = persons_of(write_study(tmp_path / "study", rows))
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
    (person,) = persons_of(write_study(tmp_path / "study", rows))
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
    (person,) = persons_of(folder, table)
    assert person.sessions == ("2026-03-01", "2026-03-15") and person.days == (0.0, 14.0)
    assert sessions_of(folder, read_rows(folder), table)[1] == ["c.mcap: sessions.csv does not name it"]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "its columns are none"),
        ("file,who\na.mcap,p1\n", "expected the columns file, person"),
        ("file,person\na.mcap,p1\n", "session or date"),
        ("file,person,session\n", "names no recording"),
        ("file,person,session\na.mcap,,1\n", "line 2: there is no person"),
        ("file,person,session\n,p1,1\n", "line 2: there is no file"),
        ("file,person,session\na.mcap,p1,\n", "neither session nor date"),
        ("file,person,session\nz.mcap,p1,1\n", "z.mcap is not a recording of this study; its names are as a"),
        ("file,person,session\na.mcap,p1,1\na,p1,2\n", "line 3: a.mcap is there twice"),
        ("file,person,date\na.mcap,p1,31.3.2026\n", "'31.3.2026' is not a date"),
        ("file,person,session\na.mcap,p1,1\nb.mcap,p1,1\n", "both session 1 of p1"),
        ('file,person,session\n"a.mcap', "there is no person"),
    ],
)
def test_tables_that_cannot_be_used(text: str, words: str, tmp_path: Path):
    rows = [study_row(f"{name}.mcap", [made_measures()]) for name in "ab"]
    folder = write_study(tmp_path / "study", rows)
    table = tmp_path / "sessions.csv"
    table.write_text(text)
    with pytest.raises(UnoccludeError, match=r"^[^\n]*$") as refused:
        persons_of(folder, table)
    assert words in str(refused.value)


def test_studies_that_cannot_be_used(tmp_path: Path):
    (tmp_path / "empty").mkdir()
    with pytest.raises(UnoccludeError, match="is not a study with results"):
        read_rows(tmp_path / "empty")
    flat = write_study(tmp_path / "flat", [study_row("a.mcap", [made_measures()])])
    with pytest.raises(UnoccludeError, match="are not in folders"):
        sessions_of(flat, read_rows(flat))
    bare = write_study(tmp_path / "bare", [study_row("p/a.mcap", None)])
    with pytest.raises(UnoccludeError, match="has no measures"):
        persons_of(bare)
    (bare / "results" / "rows-2.parquet").write_bytes(b"cut off")
    with pytest.raises(UnoccludeError, match="cannot be read"):
        read_rows(bare)
