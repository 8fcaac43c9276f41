"""From figures to sentences: what was found, the methods section of a paper."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from arms import make_recording, make_recovery
from commands import done
from results import made

from calib.motion import found_in
from smoother import __version__
from smoother.baselines.registry import BASELINES, ORIENTATIONS
from smoother.error_radius import error_radius
from smoother.io import read_recovery, write_recovery
from smoother.report.methods import CITATION, ORIENTATION_WORDS, REFERENCES, methods_section
from smoother.result import Estimates, Pairing, Recovery, SelfCheck, UntrustedInterval


def test_what_a_recovery_shows_and_what_was_given():
    recovery = make_recovery(make_recording())
    whole = found_in(recovery)
    assert whole is not None and whole.offsets[0].offset_s == 0.0 and not whole.all_given
    assert found_in(replace(recovery, calibration=None)) is None
    given = {"given": ["elbow", "wrist", "hand", "upper_arm"]}
    told = found_in(replace(recovery, estimates=Estimates.from_plain(given)))
    assert told is not None and told.all_given


def test_how_far_the_clock_wandered():
    recording = make_recording()
    recovery = make_recovery(recording, offset_s=0.01)
    t = recovery.arm.t_s
    there = found_in(replace(recovery, arm=replace(recovery.arm, t_s=t + 0.002 * t)), recording)
    assert there is not None
    assert there.offsets[0].drift_s == pytest.approx(0.002 * np.ptp(t), rel=1e-6)


CHECK = SelfCheck(8, 1, 1.7, 0.011, 0.010, 0.96, 1.4, 1.1)
#: What a section says, and the result of which it may say it; without it, it may not.
DONE = {
    "independent reference": {"self_check": CHECK},
    "multiplied by 1.30": {"sigma_factors": (1.0, 1.3)},
    "The magnetometer was used in 7 of 9": {"magnetometer_blocks": 9, "magnetometer_blocks_used": 7},
    "Given beforehand: elbow": {"given": ("elbow",)},
    "measured beforehand: +10.0 ms with 2.0 ms": {"clock_given_s": (0.01, 0.002)},
    "tested and proved (by chance: 0.0001)": {"pairing": Pairing(True, 1e-4, 120.0)},
    "tested and not proved": {"pairing": Pairing(False, 0.4, 3.0)},
    "1 gaps not trusted": {"trusted": True, "untrusted": (UntrustedInterval(9.0, 12.0, ("a push",)),)},
    "gyroscope bias": {"gyroscope_bias": (0.01, 0.0, 0.0)},
}


def section(recovery: Recovery, version: str = "9.9", simulation: str = "") -> str:
    return methods_section([recovery], version, simulation)[0]


@pytest.mark.parametrize("words", DONE)
def test_what_was_done_is_named_and_nothing_else(words: str) -> None:
    assert words in section(replace(made(), estimates=Estimates(**DONE[words])))
    assert words not in section(replace(made(), estimates=Estimates()))


def test_figures_are_the_results() -> None:
    one = made()
    text, t = section(one), one.t_s
    inside = np.zeros(len(t), bool)
    for gap in one.gaps:
        inside |= (t >= gap.start_s) & (t <= gap.end_s)
    worst_cm = 100 * np.nanmax(error_radius(np.asarray(one.pose_covariance)[inside, :3, :3]))
    occluded_s = sum(gap.end_s - gap.start_s for gap in one.gaps)
    for part in (
        f"recorded for {t[-1] - t[0]:.1f} s by a camera ({len(one.arm)} frames",
        f"({len(t)} samples of the forearm's, median rate {1 / np.median(np.diff(t)):.1f} Hz)",
        f"in {len(one.gaps)} gaps of {occluded_s:.1f} s in total",
        f"within {worst_cm:.1f} cm in 95 of 100 cases",
        f"estimated as {1e3 * one.clock_offset_s:+.1f} ± {1e3 * one.clock_offset_sigma_s:.1f} ms",
        "unocclude 9.9 [1]",
    ):
        assert part in text, part


def test_a_bare_result_and_a_simulation_claim_nothing() -> None:
    bare = replace(
        made(), calibration=None, gaps=(), clock_offset_s=float("nan"), residuals=None, estimates=Estimates()
    )
    assert "The forearm was never occluded." in section(bare)
    assert not [words for words in ("Place of", "clock offset", "Clock") if words in section(bare)]
    assert "Participants" in section(made()) and "Participants" not in section(made(), simulation="an arm")


@pytest.mark.parametrize("method", BASELINES)
def test_a_baseline_is_not_called_the_graph(method: str) -> None:
    estimates = Estimates(self_check=CHECK, further={"orientation": "madgwick"}, trusted=True)
    text = section(replace(made(), method=method, estimates=estimates))
    assert CITATION.sub("", BASELINES[method].words).split(" after")[0].strip() in text
    assert "Madgwick's" in text and "preintegration" not in text and "independent reference" not in text


def test_every_source_is_known_and_listed_once() -> None:
    texts = [*(entry.words for entry in BASELINES.values()), *ORIENTATION_WORDS.values()]
    assert {key for text in texts for key in CITATION.findall(text)} <= REFERENCES.keys()
    assert ORIENTATION_WORDS.keys() == set(ORIENTATIONS)
    hostile = section(replace(made(), name="a|b_c<d>[@gtsam].mcap"))
    table = [line for line in hostile.splitlines() if line.startswith("|")]
    assert len(table) > 4 and {len(re.findall(r"(?<!\\)\|", line)) for line in table} <= {3, 4, 5, 6}
    listed = re.findall(r"^(\d+)\. ", hostile, re.MULTILINE)
    assert listed == [str(n + 1) for n in range(len(listed))]


def test_the_command_gives_each_arm_a_section(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_recovery([made("left"), made("right")], tmp_path / "out.mcap")
    done("methods", tmp_path / "out.mcap", "-o", tmp_path / "m.md", "--json", tmp_path / "m.json")
    text = (tmp_path / "m.md").read_text(encoding="utf-8")
    assert text.count("## Methods: ") == 2 and text.count("### References") == 1 and __version__ in text
    assert json.loads((tmp_path / "m.json").read_text(encoding="utf-8"))["text"] == text
    assert len(read_recovery(tmp_path / "out.mcap")) == 2
    capsys.readouterr()
    done("methods", tmp_path / "out.mcap", "--side", "left")
    assert "right arm" not in capsys.readouterr().out
