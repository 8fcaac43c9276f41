"""The pages of measures and of progress: words that intervals support, nothing obeyed."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from made_measures import made_measure, made_measures, person

from smoother.errors import UnoccludeError
from smoother.evaluation.progress import PersonProgress
from smoother.measures import BothArms
from smoother.report.pages import measures_page, progress_page

BADGES = re.compile(r'<span class="word [a-z]+">(?:\S )?([^<]+)</span>')


def words_of(page: Path) -> list[str]:
    return BADGES.findall(page.read_text(encoding="utf-8"))


def test_words_of_progress_need_an_interval(tmp_path: Path):
    progress_page(person()).write(tmp_path / "a.html")
    words = words_of(tmp_path / "a.html")
    assert words[0] == "clearly more" and words.count("no clear change") > 5
    text = (tmp_path / "a.html").read_text(encoding="utf-8")
    assert "not a diagnosis" in text and "day 14" in text
    assert "by chance alone; clear after correction for that (Holm): elbow flexion, range" in text
    progress_page(person(draws=False)).write(tmp_path / "b.html")
    assert set(words_of(tmp_path / "b.html")) == {"cannot be assessed"}
    assert "without drawn motions" in (tmp_path / "b.html").read_text(encoding="utf-8")


def test_one_session_and_none(tmp_path: Path):
    progress_page(person(1)).write(tmp_path / "one.html")
    text = (tmp_path / "one.html").read_text(encoding="utf-8")
    assert words_of(tmp_path / "one.html") == [] and "one session only" in text
    nothing = PersonProgress("p", (), (), (), ("session 1: the result is not to be trusted",))
    progress_page(nothing).write(tmp_path / "none.html")
    text = (tmp_path / "none.html").read_text(encoding="utf-8")
    assert "No session can be used" in text and "not to be trusted" in text


def test_arms_are_compared_only_where_both_are_to_be_trusted(tmp_path: Path):
    left, right = made_measures("left", change={"elbow_flexion_range_deg": -20.0}), made_measures("right")
    measures_page([left, right]).write(tmp_path / "both.html")
    assert "right against left" not in (tmp_path / "both.html").read_text(encoding="utf-8")
    both = BothArms(left, right, (made_measure("elbow_flexion_range_deg_symmetry_percent", 22.7, 3.0),))
    measures_page([left, right], [both]).write(tmp_path / "indices.html")
    text = (tmp_path / "indices.html").read_text(encoding="utf-8")
    assert text.count("+22.7 (+16.8 to +28.6)\u00a0%") == 1 and "right against left, in percent" in text
    bad = replace(left, trusted=False, verdict="A strap slipped.")
    measures_page([bad, right], [replace(both, left=bad)]).write(tmp_path / "bad.html")
    text = (tmp_path / "bad.html").read_text(encoding="utf-8")
    assert "A strap slipped. Do not use these numbers." in text and "22.7" not in text


def test_what_was_reached_needs_draws_that_agree(tmp_path: Path):
    measures_page([made_measures()]).write(tmp_path / "a.html")
    assert words_of(tmp_path / "a.html") == ["reached", "not reached", "not reached"]
    measures_page([made_measures(draws=False)]).write(tmp_path / "b.html")
    assert words_of(tmp_path / "b.html") == ["cannot be assessed"] * 3
    assert "smooth --draws 64" in (tmp_path / "b.html").read_text(encoding="utf-8")
    unsure = made_measures()
    which, parts = "hand_to_mouth_reached", {"low": 0.0, "high": 1.0, "sigma": 0.4}
    rows = tuple(replace(row, **parts) if row.key == which else row for row in unsure.rows)
    measures_page([replace(unsure, rows=rows)]).write(tmp_path / "c.html")
    assert words_of(tmp_path / "c.html")[0] == "cannot be assessed"


def test_nothing_known_is_said(tmp_path: Path):
    nothing = made_measures(movements=0)
    unknown = dict.fromkeys(("value", "low", "high"), np.nan) | {"note": "The hand is not known."}
    rows = tuple(replace(row, **unknown) for row in nothing.rows)
    measures_page([replace(nothing, rows=rows)]).write(tmp_path / "a.html")
    text = (tmp_path / "a.html").read_text(encoding="utf-8")
    assert "Nothing could be measured" in text and "The hand is not known." in text
    measures_page([]).write(tmp_path / "b.html")
    with pytest.raises(UnoccludeError, match="force=True"):
        measures_page([]).write(tmp_path / "b.html")
