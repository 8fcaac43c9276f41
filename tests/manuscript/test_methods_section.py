"""The methods section of a paper: every figure is the result's, and nothing is named that was not done."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from commands import done
from results import made

from smoother import __version__
from smoother.baselines.registry import BASELINES, ORIENTATIONS
from smoother.calibration import ArmCalibration
from smoother.config import Config
from smoother.error_radius import error_radius
from smoother.io import read_recovery, write_recording, write_recovery
from smoother.io.result.read import read_origin
from smoother.manuscript import MARKUPS, arm_facts, methods_document, rendered
from smoother.manuscript.document import CITATION
from smoother.manuscript.references import ORIENTATION_WORDS, REFERENCES
from smoother.measurements.clock import constant_clock
from smoother.result import Estimates, Pairing, Recovery, SelfCheck, UntrustedInterval
from smoother.simulation import ArmSimulation, simulate_arm
from smoother.smoothing import smooth

NUMBER = re.compile(r"[+-]?\d+(?:\.\d+)?")


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A simulated arm recovered with a clock, the upper arm and a setting that were given."""
    place = tmp_path_factory.mktemp("methods")
    config = ArmSimulation.preset("white", protocol="random", duration_s=10.0, occlusion_lengths_s=(0.8,))
    arm = simulate_arm(config, 3)
    write_recording(arm.recording, place / "rec.mcap")
    known = ArmCalibration(side="right", upper_arm=arm.calibration.upper_arm)
    settings = Config.model_validate({"windows": {"processes": 1}, "arm": {"shoulder_walk": 0.2}})
    recovery = smooth(
        replace(arm.recording, truth=None), known, settings, clock=constant_clock(0.004, 0.003), draws=3
    )
    recovery = replace(recovery, estimates=replace(recovery.estimates, given=("upper_arm",)))
    write_recovery(recovery, place / "out.mcap", source=place / "rec.mcap")
    return place / "out.mcap"


def paragraph(recovery: Recovery, version: str = "") -> str:
    return " ".join(methods_document([arm_facts(recovery, version)]).arms[0].sentences)


def said(recovery: Recovery) -> str:
    """Everything that a section says of a result itself, without what is to be filled in."""
    arm = methods_document([arm_facts(recovery)]).arms[0]
    return " ".join([*arm.sentences, *[f"{label}: {value}" for label, value in arm.rows]])


def test_each_figure_of_the_paragraph_is_the_results(result: Path):
    """Sentence by sentence, from the file's own values by plain arithmetic."""
    [recovery] = read_recovery(result)
    text = paragraph(recovery, read_origin(result).version)
    t, frames = recovery.t_s, np.asarray(recovery.arm.t_s)
    lengths = [gap.end_s - gap.start_s for gap in recovery.gaps]
    inside = np.zeros(len(t), bool)
    for gap in recovery.gaps:
        inside |= (t >= gap.start_s) & (t <= gap.end_s)
    covariance = np.asarray(recovery.pose_covariance)[inside]
    worst_cm = 100 * np.nanmax(error_radius(covariance[:, :3, :3]))
    turned = np.degrees(np.sqrt(np.nanmax(np.trace(covariance[:, 3:, 3:], axis1=1, axis2=2))))
    check = recovery.estimates.self_check
    assert check is not None and check.stretches and len(recovery.gaps) > 0
    rejected = int((np.asarray(recovery.residuals.reason) != 0).sum())
    tracked = rejected + int(np.asarray(recovery.residuals.used).sum())
    expected = [
        f"for {t[-1] - t[0]:.1f} s by a camera with skeleton tracking ({len(frames)} frames,"
        f" median rate {1 / np.median(np.diff(frames)):.1f} Hz)",
        f"on the forearm ({len(t)} samples, median rate {1 / np.median(np.diff(t)):.1f} Hz).",
        *[
            f"the {joint} in {100 * np.mean(recovery.arm.tracked(joint)):.0f} %"
            for joint in ("shoulder", "elbow", "wrist", "hand")
        ],
        f"with unocclude {__version__} [@unocclude]",
        "windows of about 12 s, with 2.5 s of visible time",
        "starting from a measured +4.0 ms with 3.0 ms,",
        f"{1e3 * recovery.clock_offset_s:+.1f} ms (standard deviation"
        f" {1e3 * recovery.clock_offset_sigma_s:.1f} ms)",
        f"for {sum(lengths):.1f} s in total ({100 * sum(lengths) / (t[-1] - t[0]):.0f} % of the recording),"
        f" at most for {max(lengths):.1f} s",
        f"is known within {worst_cm:.1f} cm in 95 of 100 cases, and its orientation with a standard deviation"
        f" of {turned:.1f} degrees",
        f"for {check.length_s:.1f} s (median) where it was visible, and recovered within"
        f" {100 * check.error_95_m:.1f} cm in 95 of 100 cases (stated: {100 * check.stated_95_m:.1f} cm;",
        f"{100 * check.inside_95:.0f} % of the samples inside the stated 95 % region",
        "The result contains 3 motions drawn from the posterior",
        "other than the program's defaults were arm.shoulder_walk = 0.2.",
        "Given beforehand was the upper arm's length; places and lengths entered with standard deviations and"
        " were adjusted by the estimate.",
    ]
    if rejected:
        expected.append(f"Of {tracked} joint samples that the camera called tracked, {rejected} w")
    for part in expected:
        assert part in text, part
    # and no other figure: what is left of the text when these are taken out has none but known words
    for part in expected:
        text = text.replace(part, "")
    text = CITATION.sub("", text)
    text = re.sub(r"unrelated streams agree as well with a probability of at most [\d.]+", "", text)
    text = re.sub(r"(occluded|hidden) (once|\d+ times)", "", text)
    assert not NUMBER.findall(text), NUMBER.findall(text)


def test_counts_and_chances(result: Path):
    [recovery] = read_recovery(result)
    text = paragraph(recovery)
    times = {1: "once"}.get(len(recovery.gaps), f"{len(recovery.gaps)} times")
    assert f"was occluded {times}," in text
    assert f"hidden {recovery.estimates.self_check.stretches} times" in text
    found = re.search(r"a probability of at most ([\d.]+\d)", text)
    chance = recovery.estimates.pairing.chance
    assert found and chance <= float(found[1]) <= 2.0 * chance  # rounded up, to one digit


def test_rows_are_the_results(result: Path):
    [recovery] = read_recovery(result)
    rows = dict(methods_document([arm_facts(recovery, "9.9")]).arms[0].rows)
    lever = recovery.calibration.lever_arms["wrist"]
    place = zip(lever.position_m, lever.sigma_m, strict=True)
    text = ", ".join(f"{1e3 * value:.1f} ± {1e3 * sigma:.1f}" for value, sigma in place)
    assert rows["Place of the wrist in the IMU's axes, mm"] == f"{text} (estimated)"
    upper = recovery.calibration.upper_arm
    assert rows["Upper arm's length, mm"] == (
        f"{1e3 * upper.value_m:.1f} ± {1e3 * upper.sigma_m:.1f} (given beforehand, adjusted)"
    )
    bias = np.degrees(recovery.estimates.gyroscope_bias)
    assert rows["Gyroscope's bias, degrees/s"] == ", ".join(f"{value:+.3f}" for value in bias)
    assert rows["Forearm's axes in the IMU"] == "not determined"
    assert rows["Program, method"] == "unocclude 9.9, graph"
    assert rows["Setting arm.shoulder_walk"] == "0.2 (default 0.1, set or adapted to the recording)"
    assert rows["Self-check"] == recovery.estimates.self_check.sentence.rstrip(".")


#: What a sentence says, and the result of which it may say it; every other one below may not.
CHECK = SelfCheck(8, 1, 1.7, 0.011, 0.010, 0.96, 1.4, 1.1)
DONE = {
    "As a check inside the recording": {"self_check": CHECK},
    "multiplied by 1.30": {"sigma_factors": (1.0, 1.3)},
    "The magnetometer's direction was used": {"magnetometer_blocks": 9, "magnetometer_blocks_used": 7},
    "Given beforehand": {"given": ("elbow",)},
    "starting from a measured": {"clock_given_s": (0.01, 0.002)},
    "of one motion was tested: unrelated": {"pairing": Pairing(True, 1e-4, 120.0)},
    "tested and not proved": {"pairing": Pairing(False, 0.4, 3.0)},
    "The program's verdict": {"trusted": True},
    "not to be trusted.": {"trusted": True, "untrusted": (UntrustedInterval(9.0, 12.0, ("a push",)),)},
    "biases of gyroscope": {"gyroscope_bias": (0.01, 0.0, 0.0), "accelerometer_bias": (0.1, 0.0, 0.0)},
    "Marked as not to be used": {"max_sigma_m": 0.05},
}


@pytest.mark.parametrize("words", DONE)
def test_what_was_done_is_named_and_nothing_else(words: str):
    arm = made()
    facts = said(replace(arm, estimates=Estimates(**DONE[words])))
    assert words in facts
    alike = [other for other in DONE if DONE[other].items() <= DONE[words].items()]
    assert [other for other in DONE if other in facts] == [other for other in DONE if other in alike]
    assert not [other for other in DONE if other in said(replace(arm, estimates=Estimates()))]


def test_a_result_without_calibration_clock_or_gaps_claims_none():
    bare = replace(
        made(), calibration=None, gaps=(), clock_offset_s=float("nan"), residuals=None, estimates=Estimates()
    )
    text = said(bare)
    for words in (
        "Estimated from the motion",
        "clocks",
        "Clock",
        "rejected",
        "At the least certain",
        "Place of",
    ):
        assert words not in text
    assert "The forearm was never occluded." in text


def test_a_simulation_asks_for_no_participants():
    asked = methods_document([arm_facts(made(), simulation="simulated arm, seed 1")]).to_fill_in
    assert not any(word in item for item in asked for word in ("Participants", "IMU", "camera")) and asked
    assert any("Participants" in item for item in methods_document([arm_facts(made())]).to_fill_in)


def test_a_strap_alone_is_no_skeleton():
    text = paragraph(made(strap=True))
    assert "a camera that tracked the strap of the IMU" in text
    assert "skeleton" not in text and "elbow" not in text and "[@wu2005]" not in text


def test_untrusted_gaps_are_left_to_the_authors_to_explain():
    bad = Estimates(trusted=True, untrusted=(UntrustedInterval(9.0, 12.0, ("a push",)),))
    document = methods_document([arm_facts(replace(made(), estimates=bad))])
    assert "It marks 1 of 2 gaps as not to be trusted." in " ".join(document.arms[0].sentences)
    assert any("1 gap that the program does not trust" in item for item in document.to_fill_in)
    assert not any("does not trust" in item for item in methods_document([arm_facts(made())]).to_fill_in)


@pytest.mark.parametrize("method", BASELINES)
def test_a_baseline_is_not_called_the_graph(method: str):
    estimates = Estimates(self_check=CHECK, further={"orientation": "madgwick"}, trusted=True)
    text = paragraph(replace(made(), method=method, estimates=estimates))
    assert f"by the method '{method}': {BASELINES[method].words}" in text
    assert "Its orientation filter was Madgwick's" in text and "verdict on its own estimate" in text
    for words in ("jointly from both sensors", "[@forster2017]", "As a check", "No magnetometer"):
        assert words not in text


def test_every_method_and_filter_has_words_and_every_source_is_known():
    words = [entry.words for entry in BASELINES.values()]
    assert all(words) and ORIENTATION_WORDS.keys() == set(ORIENTATIONS)
    texts = [*words, *ORIENTATION_WORDS.values(), paragraph(made())]
    cited = {key for text in texts for key in CITATION.findall(text)}
    assert cited <= REFERENCES.keys() and cited | {"cereatti2024"} >= REFERENCES.keys() - {"unocclude"}


def test_references_are_those_that_are_cited():
    document = methods_document([arm_facts(made(), "1.2.3")])
    cited = {key for sentence in document.arms[0].sentences for key in CITATION.findall(sentence)}
    assert {each.key for each in document.references} == cited | {"cereatti2024"}
    assert document.references[0].text == "the unocclude contributors. unocclude (software), version 1.2.3."


HOSTILE = "a_b%c&d$e#f{g}h~i^j\\k|l<m>[@gtsam].mcap"


def test_latex_holds_a_hostile_name_and_balances():
    document = methods_document([arm_facts(replace(made(), name=HOSTILE))])
    text = rendered(document, "latex")
    heading = next(line for line in text.splitlines() if line.startswith(r"\subsection*"))
    assert heading.startswith(
        r"\subsection*{Methods: a\_b\%c\&d\$e\#f\{g\}h\textasciitilde{}i\textasciicircum{}j\textbackslash{}k"
    )
    body = "\n".join(line for line in text.splitlines() if not line.startswith("% "))
    plain = body.replace("\\\\", "").replace(r"\{", "").replace(r"\}", "")
    assert plain.count("{") == plain.count("}")
    assert body.count(r"\begin{") == body.count(r"\end{") > 3
    assert set(re.findall(r"\\cite\{(\w+)\}", body)) == set(re.findall(r"\\bibitem\{(\w+)\}", body))
    assert not re.findall(
        r"(?<!\\)[%#$~^_]", body.replace(r"$\pm$", "").replace("$<$", "").replace("$>$", "")
    )
    body.encode("ascii")  # no letter that needs a package


def test_markdown_tables_have_two_cells_a_row():
    text = rendered(methods_document([arm_facts(replace(made(), name=HOSTILE))]), "markdown")
    table = [line for line in text.splitlines() if line.startswith("|")]
    assert len(table) > 8 and all(len(re.findall(r"(?<!\\)\|", line)) == 3 for line in table)
    assert "[1]" in text and "[@forster2017]" not in text


def test_the_three_markups_say_the_same(result: Path):
    [recovery] = read_recovery(result)
    document = methods_document([arm_facts(recovery, "0.1")])
    figures = {}
    for markup in MARKUPS:
        text = rendered(document, markup).split("fill")[0]
        if markup == "latex":
            text = text.partition("fontenc}.")[2].replace(r"{p{0.36\linewidth}p{0.56\linewidth}}", "")
            text = re.sub(r"\\cite\{\w+\}", "", text)
        figures[markup] = sorted(NUMBER.findall(re.sub(r"\[\d\]|\\textasciicircum\{\}2|\^2", "", text)))
    assert figures["text"] == figures["markdown"] == figures["latex"] and len(figures["text"]) > 50


def test_the_command(result: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    done("methods", result)
    printed = capsys.readouterr().out
    assert (
        printed.startswith("METHODS: ")
        and "The recording is a simulation ('simulated arm, seed 3')" in printed
    )
    for ending, begins in ((".tex", r"% \input"), (".md", "## Methods: "), (".txt", "METHODS: ")):
        path = tmp_path / f"m{ending}"
        done("methods", result, "-o", path, "--json", tmp_path / f"m{ending}.json")
        assert path.read_text().startswith(begins)
    figures = json.loads((tmp_path / "m.tex.json").read_text())
    [recovery] = read_recovery(result)
    assert figures["arms"][0]["imu_samples"] == len(recovery)
    assert figures["arms"][0]["clock_given_s"] == [0.004, 0.003]
    assert figures["arms"][0]["version"] == __version__ == read_origin(result).version
    assert figures["text"] == (tmp_path / "m.tex").read_text()


def test_both_arms_have_a_section_each(tmp_path: Path):
    write_recovery([made("left"), made("right")], tmp_path / "out.mcap")
    done("methods", tmp_path / "out.mcap", "-o", tmp_path / "m.md")
    text = (tmp_path / "m.md").read_text()
    assert text.count("## Methods: ") == 2 and text.count("### References") == 1
    assert ", left arm" in text and ", right arm" in text
    done("methods", tmp_path / "out.mcap", "--side", "left", "-o", tmp_path / "l.md")
    assert ", right arm" not in (tmp_path / "l.md").read_text()
