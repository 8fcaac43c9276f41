"""Commands on results that are not to be trusted: what they print, write as JSON, and end with."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from arms import make_recording, make_truth
from results import made

from smoother.cli.run import NOT_TRUSTED, run
from smoother.io import write_recording, write_recovery
from smoother.result import Estimates, Pairing, Recovery, SelfCheck, UntrustedInterval

BODY = UntrustedInterval(9.0, 12.0, ("another person's joints",))
CHECK = SelfCheck(8, 0, 1.7, 0.011, 0.010, 0.96, 1.4)
SOUND = Estimates(trusted=True, self_check=CHECK, pairing=Pairing(True, 1e-4, 120.0))
PARTLY = replace(SOUND, cautions=("one gap",), untrusted=(BODY,))
WRONG = Estimates(
    trusted=False,
    reasons=("the skeleton seems mirrored (x): run again with --mirror x", "gravity is 80 degrees off"),
    cause="the skeleton seems mirrored (x): run again with --mirror x",
    remedies=("--mirror x",),
    pairing=Pairing(False, 0.2, 12.0),
)


@pytest.fixture
def smooth(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    """Runs `smooth` on a made recording whose recoveries have these estimates: code, figures, words."""
    write_recording(replace(make_recording(), name="rec"), tmp_path / "rec.mcap")

    def smoothed(estimates: Estimates, *options: str) -> tuple[int, dict, str]:
        def recovered(recordings, *rest: object) -> list[Recovery]:
            return [
                replace(made(one.side), arm=one.arm, side=one.side, body=one.body, estimates=estimates)
                for one in recordings
            ]

        monkeypatch.setattr("smoother.cli.smooth.recover_arms", recovered)
        capsys.readouterr()
        command = [
            "smooth",
            tmp_path / "rec.mcap",
            "-o",
            tmp_path / "out.mcap",
            "--json",
            tmp_path / "j.json",
        ]
        code = run([*map(str, command), "--force", *options])
        return code, json.loads((tmp_path / "j.json").read_text()), capsys.readouterr().out

    return smoothed


def test_the_verdict_comes_first_and_untrusted_gaps_are_named(smooth) -> None:
    code, figures, said = smooth(PARTLY, "--strict")
    assert code == 0
    lines = said.splitlines()
    at = lines.index("Usable with care: one gap.")
    assert lines[at + 1] == CHECK.sentence
    assert "not to be trusted: gap 2 (" in said and ": another person's joints" in said
    assert "trusted" in said
    assert [gap["trusted"] for gap in figures["gaps"]] == [True, False]
    assert [gap["reasons"] for gap in figures["gaps"]] == [[], ["another person's joints"]]
    assert {"start_s", "end_s"} <= set(figures["gaps"][0])
    assert figures["self_check"]["stretches"] == 8
    assert figures["self_check"].keys() >= {
        *("stretches", "length_s", "rms_m", "stated_sigma_m", "inside_95", "sigma_factor")
    }
    assert figures["pairing"].items() >= {"proved": True, "chance": 1e-4, "evidence": 120.0}.items()
    assert figures["usable"] == 1600 - 240  # 3 s of 80 samples per second


def test_strict_ends_with_3_and_writes_all_the_same(smooth, tmp_path: Path) -> None:
    code, figures, said = smooth(WRONG, "--strict", "--report", str(tmp_path / "out.html"))
    assert code == NOT_TRUSTED == 3
    assert (tmp_path / "out.mcap").exists() and (tmp_path / "out.html").exists()
    assert "written: " in said and said.count("sign: gravity is 80 degrees off") == 1
    assert figures["trusted"] is False and figures["usable"] == 0
    assert figures["pairing"]["proved"] is False and figures["self_check"] is None
    assert all(gap["trusted"] is False and gap["reasons"] for gap in figures["gaps"])
    assert smooth(WRONG)[0] == 0
    assert smooth(SOUND, "--strict")[0] == 0
    code, figures, _ = smooth(Estimates(), "--strict")  # nobody judged: nothing says that it is to be trusted
    assert code == NOT_TRUSTED
    assert [gap["trusted"] for gap in figures["gaps"]] == [None, None]


def results(folder: Path) -> Path:
    for name, estimates in (("sound", SOUND), ("partly", PARTLY), ("wrong", WRONG)):
        write_recovery(replace(made(), estimates=estimates), folder / f"{name}.mcap")
    both = [replace(made("left"), estimates=SOUND), replace(made("right"), estimates=WRONG)]
    write_recovery(both, folder / "both.mcap")
    return folder


@pytest.mark.parametrize("format_name", ["csv", "trc", "mot", "osim", "parquet"])
def test_export_warns_in_a_line(tmp_path: Path, capsys: pytest.CaptureFixture[str], format_name: str) -> None:
    results(tmp_path)
    words = {
        "sound": None,
        "partly": "unocclude: warning: Usable with care: one gap. Not to be trusted: gap 2 (",
        "wrong": "unocclude: warning: Not to be trusted: the skeleton seems mirrored",
        "both": "unocclude: warning: right arm: Not to be trusted: the skeleton seems mirrored",
    }
    for name, begins in words.items():
        output, figures = tmp_path / f"{name}.{format_name}", tmp_path / f"{name}.json"
        command = [
            "export",
            tmp_path / f"{name}.mcap",
            "--format",
            format_name,
            "-o",
            output,
            "--json",
            figures,
        ]
        assert run([*map(str, command)]) == 0
        err = capsys.readouterr().err
        assert err.startswith(begins) and err.count("\n") == 1 if begins else err == ""
        last = json.loads(figures.read_text())["files"][-1]
        assert last["trusted"] is (name in ("sound", "partly"))
        assert bool(last["untrusted"]) is (name == "partly")


def test_validate_says_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:

    results(tmp_path)
    truth = replace(make_recording(), truth=make_truth(np.arange(0, 20, 0.0125)))
    write_recording(truth, tmp_path / "truth.mcap")
    for name, trusted in (("sound", True), ("wrong", False)):
        command = ["validate", tmp_path / f"{name}.mcap", "--truth", tmp_path / "truth.mcap"]
        assert run([*map(str, command), "--json", str(tmp_path / f"{name}.json")]) == 0
        assert ("warning: Not to be trusted" in capsys.readouterr().err) is not trusted
        assert json.loads((tmp_path / f"{name}.json").read_text())["trusted"] is trusted


def test_info_says_the_verdict_of_a_result(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    results(tmp_path)
    words = {
        "sound": "Usable.",
        "partly": "not to be trusted at 1 time; export lists them",
        "wrong": WRONG.verdict,
        "both": f"right: {WRONG.verdict}",
    }
    for name, word in words.items():
        assert run(["info", str(tmp_path / f"{name}.mcap")]) == 0
        assert word in capsys.readouterr().out.splitlines()
