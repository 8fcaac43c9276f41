"""`unocclude progress`: tables, files, and what a person gets wrong."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest
from made_measures import made_measures, study_row, write_study

from smoother.cli.run import run

FLEXION = "elbow_flexion_range_deg"
Capture = pytest.CaptureFixture[str]


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two persons with three sessions; the elbow of the first bends more each time."""
    rng = np.random.default_rng(3)
    rows = [
        study_row(
            f"{person}/s{n}.mcap",
            [made_measures(rng=rng, movements=0, change={FLEXION: gain * n})],
            recorded_day=50.0 + 7 * n,
        )
        for person, gain in (("p1", 15.0), ("=p2", 0.0))
        for n in range(3)
    ]
    return write_study(tmp_path_factory.mktemp("study") / "out", rows)


def command(*arguments: object) -> int:
    return run(["progress", *map(str, arguments)])


def test_what_changed_is_printed_and_written(study: Path, tmp_path: Path, capsys: Capture):
    files = ["--json", tmp_path / "p.json", "--csv", tmp_path / "p.csv", "--report", tmp_path / "p.html"]
    assert command(study, "--person", "p1", *files) == 0
    printed = capsys.readouterr().out
    assert "clearly more" in printed and "no clear change" in printed
    assert "would be called so by chance" in printed and "This is not a diagnosis" in printed
    (person,) = json.loads((tmp_path / "p.json").read_text())["persons"]
    assert person["days"] == [0, 7, 14] and person["clear"] >= 1
    flexion = next(each for each in person["measures"] if each["key"] == FLEXION)
    first, last = flexion["changes"]
    assert (first["to"], last["to"]) == ("s1", "s2") and last["word"] == "clearly more"
    assert last["low"] < last["difference"] < last["high"] and last["mdc95"] is None
    with open(tmp_path / "p.csv", encoding="utf-8", newline="") as file:
        rows = [row for row in csv.DictReader(file) if row["key"] == FLEXION]
    assert [row["session"] for row in rows] == ["s0", "s1", "s2"]
    assert rows[0]["change"] == "" and float(rows[2]["change"]) == pytest.approx(last["difference"], rel=1e-5)
    assert "p1" in (tmp_path / "p.html").read_text(encoding="utf-8")


def test_all_persons_and_a_cell_that_is_no_formula(study: Path, tmp_path: Path, capsys: Capture):
    assert command(study, "--csv", tmp_path / "p.csv") == 0
    printed = capsys.readouterr().out
    assert "--- p1: 3 sessions" in printed and "--- =p2: 3 sessions" in printed
    with open(tmp_path / "p.csv", encoding="utf-8", newline="") as file:
        persons = {row["person"] for row in csv.DictReader(file)}
    assert persons == {"p1", "'=p2"}


def test_only_some_measures(study: Path, tmp_path: Path):
    options = ["--measure", FLEXION, "--measure", "sparc", "--json", tmp_path / "p.json"]
    assert command(study, "--person", "p1", *options) == 0
    (person,) = json.loads((tmp_path / "p.json").read_text())["persons"]
    assert {each["key"] for each in person["measures"]} == {FLEXION, "sparc"}


def test_a_minimal_detectable_change_of_the_user(study: Path, tmp_path: Path, capsys: Capture):
    (tmp_path / "mdc.toml").write_text(f"[mdc95]\n{FLEXION} = 60\n")
    options = ["--measure", FLEXION, "--mdc", tmp_path / "mdc.toml"]
    assert command(study, "--person", "p1", *options) == 0
    printed = capsys.readouterr().out
    assert "clearly more" not in printed
    assert "larger than its interval but not than the minimal detectable change" in " ".join(printed.split())


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--person", "p3"], "the study has no person p3; it has: =p2, p1"),
        (["--report", "p.html"], "a page is of one person; choose one with --person: =p2, p1"),
        (["--report", "p.pdf"], "a report is an HTML page"),
        (["--measure", "elbow"], "has no measure elbow; measures are as"),
        (["--sessions", "none.csv"], "none.csv"),
        (["--mdc", "none.toml"], "none.toml"),
        (["--mdc", "bad.toml"], "is not TOML"),
        (["--mdc", "empty.toml"], "has no table [mdc95]"),
        (["--mdc", "zero.toml"], "it must be a number above 0"),
        (["--mdc", "bad.json"], "is not JSON"),
        (["--mdc", "other.json"], "has no measures"),
        (["--mdc", "few.json"], "it takes three recordings with motion capture"),
        (["--json", "there.json"], "--force"),
        (["--json", "a.json", "--csv", "a.json"], "named for two outputs"),
    ],
)
def test_wrong_uses(
    arguments: list[str],
    words: str,
    study: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: Capture,
):
    monkeypatch.chdir(tmp_path)
    Path("bad.toml").write_text("[mdc95\n")
    Path("empty.toml").write_text("[other]\nx = 1\n")
    Path("zero.toml").write_text(f"[mdc95]\n{FLEXION} = 0\n")
    Path("bad.json").write_text("{")
    Path("other.json").write_text('{"all": {}}')
    few = {"measures": {"agreement": {"session": {FLEXION: {"mdc95": None, "pairs": 1}}}, "pairs": []}}
    Path("few.json").write_text(json.dumps(few))
    Path("there.json").write_text("{}")
    before = sorted(tmp_path.iterdir())
    assert command(study, *arguments) in (1, 2)
    said = capsys.readouterr()
    assert words in " ".join(said.err.split())
    assert "Traceback" not in said.err and len(said.err.strip().splitlines()) <= 4
    assert sorted(tmp_path.iterdir()) == before


def test_what_is_no_study(tmp_path: Path, capsys: Capture):
    assert command(tmp_path / "none") == 1
    assert "is not a folder; name the one that `unocclude batch` wrote" in capsys.readouterr().err
    assert command(tmp_path) == 1
    assert "is not a study with results" in capsys.readouterr().err


def test_a_study_in_which_nothing_can_be_compared(tmp_path: Path, capsys: Capture):
    rows = [study_row("p/s1.mcap", [made_measures(trusted=False)]), study_row("p/s2.mcap", [made_measures()])]
    folder = write_study(tmp_path / "out", rows)
    assert command(folder, "--report", tmp_path / "p.html") == 0
    printed = capsys.readouterr().out
    assert "One session only" in printed and "not to be trusted" in printed


@pytest.fixture(scope="module")
def repeated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Six persons with two sessions of six repetitions; the elbow's curve of all of them changes at 60 %."""
    rng = np.random.default_rng(4)
    share = np.linspace(0, 1, 51)
    rows = []
    for person in range(6):
        for session in range(2):
            noise = rng.normal(size=(6, 4)) @ np.stack([np.cos(k * np.pi * share) for k in range(4)])
            bump = (12.0 + person) * session * np.exp(-((share - 0.6) ** 2) / 0.01)
            curves = 60 + 40 * np.sin(np.pi * share) + noise + bump
            wave = {"side": "right", "angle": "elbow_flexion", "repetitions": 6, "trusted": True}
            wave |= {"mean": curves.mean(0).tolist(), "sd": curves.std(0).tolist()}
            wave |= {"curves": curves.tolist(), "errors": [[0.5] * 51]}
            measures = made_measures(rng=rng, movements=0, change={FLEXION: 3.0 * person})
            rows.append(
                study_row(f"p{person}/s{session}.mcap", [measures], waveforms=json.dumps([wave]))
                | {"recorded_day": 7.0 * session}
            )
    return write_study(tmp_path_factory.mktemp("repeated") / "out", rows)


def test_curves_reliability_and_plots(repeated: Path, tmp_path: Path, capsys: Capture):
    files = ["--json", tmp_path / "r.json", "--plots", tmp_path / "plots"]
    assert command(repeated, "--reliability", *files) == 0
    printed = capsys.readouterr().out
    assert "Curve of elbow flexion, right: differs at" in printed and "ICC(3,1)" in printed
    figures = json.loads((tmp_path / "r.json").read_text())
    (wave,) = figures["persons"][0]["waveforms"]
    assert wave["p"] < 0.01 and wave["repetitions"] == [6, 6] and not wave["exact"]
    (stretch,) = wave["stretches"]
    assert stretch["start_percent"] < 60 < stretch["end_percent"] and 8 < stretch["difference"] < 16
    (group,) = figures["group_waveforms"]
    assert group["persons"] == 6 and group["p"] == pytest.approx(2 / 64) and group["exact"]
    flexion = next(each for each in figures["reliability"] if each["key"] == FLEXION)
    assert flexion["persons"] == 6 and flexion["icc_31_low"] < flexion["icc_31"] < flexion["icc_31_high"]
    assert command(repeated, "--mdc", tmp_path / "r.json", "--json", tmp_path / "m.json") == 0
    capsys.readouterr()
    person = json.loads((tmp_path / "m.json").read_text())["persons"][0]
    change = next(each for each in person["measures"] if each["key"] == FLEXION)["changes"][0]
    assert change["mdc95"] == pytest.approx(flexion["sdc"])
    plot = tmp_path / "plots" / f"agreement_right_{FLEXION}.svg"
    drawn = plot.read_text(encoding="utf-8")
    assert "1.96 SD" in drawn and "mean of session 1 and session 2" in drawn and "<dc:date>" not in drawn
    assert (tmp_path / "plots" / "curve_p0_right_elbow_flexion.svg").exists()
    assert command(repeated, "--plots", tmp_path / "plots") == 1
    assert "exists; give another folder, or --force" in capsys.readouterr().err
    assert command(repeated, "--reliability", "--plots", tmp_path / "plots", "--force") == 0
    assert plot.read_text(encoding="utf-8") == drawn  # the same data, the same bytes


def test_reliability_of_one_person_is_refused(repeated: Path, capsys: Capture):
    assert command(repeated, "--reliability", "--person", "p0") == 1
    assert "--reliability needs 3 persons with two sessions each" in capsys.readouterr().err
