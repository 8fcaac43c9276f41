"""Pages of results that are not to be trusted, or not in all gaps: red, cause first, figures withdrawn."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from arms import make_recording
from results import made

from smoother.evaluation.advice import advice
from smoother.report import write_arms_report, write_report
from smoother.report.player import MOST_BYTES, played_arm
from smoother.report.traces import UNTRUSTED, coordinates, uncertainty
from smoother.result import Estimates, Pairing, Recovery, SelfCheck, UntrustedInterval

BODY = UntrustedInterval(9.0, 12.0, ("another <person's> joints",))
CHECK = SelfCheck(8, 1, 1.7, 0.011, 0.010, 0.96, 1.4, 1.1)
CAUSE = "the skeleton seems mirrored (x); run again with --mirror x"
SOUND = Estimates(trusted=True, self_check=CHECK, pairing=Pairing(True, 1e-4, 120.0))
PARTLY = replace(SOUND, cautions=("gap 2 is not to be trusted",), untrusted=(BODY,))
WRONG = Estimates(
    trusted=False,
    reasons=(CAUSE, "gravity is 80 degrees off"),
    cause=CAUSE,
    remedies=("--mirror x",),
    self_check=replace(CHECK, rms_m=0.21),
    pairing=Pairing(False, 0.2, 12.0),
)


def page(folder: Path, estimates: Estimates) -> str:
    recovery = replace(made(), estimates=estimates)
    write_report(recovery, folder / "page.html", recording=make_recording(), force=True)
    text = (folder / "page.html").read_text(encoding="utf-8")
    return re.sub(r"<script>.*?</script>|<style>.*?</style>", "", text, flags=re.DOTALL)


def first_sentences(text: str) -> list[str]:
    block = re.search(r'<div class="summary[^"]*">(.*?)</div>', text, re.DOTALL)
    assert block is not None
    return re.findall('<p(?: class="large")?>(.*?)</p>', block[1])


def test_a_sound_page_is_calm_and_has_the_self_check(tmp_path: Path) -> None:
    text = page(tmp_path, SOUND)
    assert '<div class="summary good">' in text
    assert first_sentences(text) == ["✓ Usable", CHECK.sentence], "one figure of the error"
    assert text.index("The arm in motion") < text.index("The recording lasts"), "all else is below"
    assert "not to be trusted" not in text.replace("samples that are not to be trusted", "")
    assert "How certain the answer is" in text and "For the next recording" in text
    assert "<td>pairing, proved</td><td>true</td>" in text
    assert "<td>self check, inside 95</td><td>0.96</td>" in text


def test_an_untrusted_page_is_red_and_withdraws_its_figures(tmp_path: Path) -> None:
    text = page(tmp_path, WRONG)
    assert '<div class="summary alarm">' in text
    said = first_sentences(text)
    assert said[0] == "✕ Not to be trusted" and said[1].lower() == f"{CAUSE}.".lower()
    assert "not shown" in said[-1] and not any(" cm" in each for each in said)
    below = text[text.index("The arm in motion") :]
    assert "<p>Evidence: gravity is 80 degrees off.</p>" in below
    assert WRONG.self_check is not None and f"<p>{WRONG.self_check.sentence}</p>" in below
    for heading in ("How certain the answer is", "Whether sigma is consistent", "For the next recording"):
        assert heading not in text
    assert "is known to about" not in text and "standard deviations, the shaded band" not in text
    rows = re.findall("<tr>(.*?)</tr>", text[text.index(">Gaps</h2>") :], re.DOTALL)[1:3]
    assert all(row.count("<td>–</td>") == 3 and "not to be trusted" in row for row in rows)
    assert text.count("withdrawn: the result is not to be trusted") == 3
    told = text[text.index(">What to do</h2>") :]
    assert re.findall("<li>(.*?)</li>", told)[0] == f"Correct the set-up first: {CAUSE}."
    for word in ("even light", "sleeves", "20 s of lively motion"):
        assert word not in text


def test_a_partly_untrusted_page_names_the_gap(tmp_path: Path) -> None:
    text = page(tmp_path, PARTLY)
    assert '<div class="summary care">' in text
    said = first_sentences(text)
    assert said[0] == "! Usable with care"
    named = next(each for each in said if each.startswith("Not to be trusted, and red on this page: gap 2 ("))
    assert "another &lt;person&#39;s&gt; joints" in named
    assert "<p>In the other gaps the sensor" in text
    first, second = re.findall("<tr>(.*?)</tr>", text[text.index(">Gaps</h2>") :], re.DOTALL)[1:3]
    assert "not to be trusted" not in first and "<td>–</td>" not in first
    assert "not to be trusted</span>" in second and "another &lt;person&#39;s&gt; joints" in second
    assert second.count("<td>–</td>") == 3
    assert "How certain the answer is" in text and "For the next recording" in text


def red(figure) -> list[np.ndarray]:
    return [np.array(trace.x)[np.isfinite(trace.y)] for trace in figure.data if trace.line.color == UNTRUSTED]


def test_curves_are_red_there_and_have_no_band() -> None:
    from smoother.report.player import points

    recovery = replace(made(), estimates=PARTLY)
    figure = coordinates(recovery, points(recovery, None), None)
    assert red(figure)
    for x in red(figure):
        assert x.min() + 0.1 >= 9.0 and x.max() <= 12.0 + 0.1
    for trace in figure.data:
        if trace.fill == "toself":
            x = np.array(trace.x, float)
            assert not ((x > 9.05) & (x < 11.95)).any()
    assert len(figure.layout.shapes) == 2, "gaps, and what is not to be trusted"
    whole = replace(recovery, estimates=WRONG)
    lines = [
        t.name for t in coordinates(whole, points(whole, None), None).data if t.mode == "lines" and t.name
    ]
    assert set(lines) == {"not to be trusted"}
    assert not red(coordinates(replace(recovery, estimates=SOUND), points(recovery, None), None))
    assert uncertainty(replace(recovery, estimates=WRONG), None) is None


def test_the_player_is_told() -> None:
    sound, partly, wrong = (
        played_arm(replace(made(), estimates=each), None, MOST_BYTES) for each in (SOUND, PARTLY, WRONG)
    )
    assert sound["untrusted"] == [] and partly["untrusted"] == [[9.0, 12.0]]
    assert wrong["untrusted"] == [[wrong["start"], pytest.approx(19.9875)]]
    assert "sigma" in partly and "sigma" not in wrong
    assert json.dumps(wrong)


def test_several_arms_begin_with_the_one_that_is_wrong(tmp_path: Path) -> None:
    arms: list[tuple[None, Recovery]] = [
        (None, replace(made("left"), estimates=SOUND)),
        (None, replace(made("right"), estimates=WRONG)),
    ]
    write_arms_report(arms, tmp_path / "arms.html")
    text = (tmp_path / "arms.html").read_text(encoding="utf-8")
    assert '<div class="summary alarm">' in text
    assert first_sentences(text)[0].startswith("✕ Right arm: not to be trusted")
    assert '<span class="word wrong">' in text


def test_advice_of_a_partly_untrusted_result_names_what_to_avoid() -> None:
    sentences = advice(replace(made(), estimates=PARTLY), None)
    assert (
        sentences[0] == "Avoid the causes of the parts that are not to be trusted: another <person's> joints."
    )
    assert not any("record the next one in the same way" in each for each in sentences)


def test_advice_of_an_untrusted_result_is_about_its_set_up_alone() -> None:
    assert advice(replace(made(), estimates=WRONG), None) == [f"Correct the set-up first: {CAUSE}."]
    open_ended = Estimates(trusted=False, reasons=("a", "b"), remedies=("--swap left,right",))
    assert advice(replace(made(), estimates=open_ended), None) == [
        "Correct the set-up first: a; b.",
        "Run `unocclude smooth` again with --swap left,right.",
    ]
