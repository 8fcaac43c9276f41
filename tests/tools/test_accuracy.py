"""The runner of the documents' figures: its commands, its table of long gaps, what its checks count."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from tools.accuracy.__main__ import main, option_parser
from tools.accuracy.recordings import GapErrors

ROOT = Path(__file__).parents[2]


def test_a_gaps_errors_are_held_against_what_is_stated():
    gap = GapErrors(
        distance_m=np.array([0.03, 0.04, np.nan]),
        angle_deg=np.array([1.0, 1.0, 1.0]),
        variance_m2=np.array([1e-4, 1e-4, np.nan]),
        squared_sigmas=np.array([9.0, 16.0, np.nan]),
        turn_squared_sigmas=np.ones(3),
    )
    assert gap.rms_m == pytest.approx(np.sqrt(0.00125))
    assert gap.sigmas == pytest.approx(np.sqrt(12.5))
    assert "answered 67 %" in str(gap)


def test_the_table_of_long_gaps(capsys: pytest.CaptureFixture[str]):
    settings = "arm --preset azure --gap-s 3 4 --seeds 0:1 --each --set duration_s=30"
    main(settings.split())
    printed = capsys.readouterr().out
    tables = re.findall(r"^([34]) s, (\d) gaps: rms (\S+) cm  worst gap (\S+) cm", printed, re.MULTILINE)
    assert [length for length, *_ in tables] == ["3", "4"]
    for length, count, rms, worst in tables:
        gaps = re.findall(rf"\+ +{length}\.\d s: rms +(\S+) cm", printed)
        assert len(gaps) == int(count) > 0
        assert float(worst) == max(float(each) for each in gaps)
        assert min(float(each) for each in gaps) <= float(rms) <= float(worst)
    assert printed.count("largest rms / sigma of a gap") == 2
    assert len(re.findall(r"50 %: \d+ %   95 %: \d+ %", printed)) == 4  # position and orientation


def test_the_sum_over_simulated_arms(capsys: pytest.CaptureFixture[str]):
    main(["arm", "--preset", "white", "--seeds", "0:1", "--set", "repetitions=1"])
    printed = capsys.readouterr().out
    (seed,) = re.findall(r"occluded +(\S+) / +(\S+) cm", printed)
    assert re.findall(r"occluded: rms +(\S+) cm  max +(\S+) cm", printed) == [seed]
    assert "visible: rms" in printed and "inside the region that should hold" in printed


def test_short_gaps_with_one_imu_and_two(capsys: pytest.CaptureFixture[str]):
    settings = "short --presets white --seeds 0:1 --set duration_s=16"
    main(settings.split())
    printed = capsys.readouterr().out
    rows = re.findall(r"^  (\S+(?: s)?) +(\d+) +(\S+) +(\S+) +(\S+)   (\S+) (\S+)", printed, re.MULTILINE)
    (every,) = [row for row in rows if row[0] == "all"]
    assert int(every[1]) == sum(int(row[1]) for row in rows if row[0] != "all") > 0
    assert float(every[4]) == pytest.approx(float(every[3]) / float(every[2]), rel=0.01)
    for row in rows:
        assert ("two are worse" in printed) == any(float(row[4]) > 1.02 for row in rows)


def test_angles_relative_to_the_trunk(capsys: pytest.CaptureFixture[str]):
    settings = "trunk --preset white --seeds 1:2 --set duration_s=20"
    main(settings.split())
    printed = capsys.readouterr().out
    pattern = r"shoulder_(\w+)_trunk +rms +(\S+) deg, without the trunk's IMU +(\S+) deg"
    found = {kind: (float(a), float(b)) for kind, a, b in re.findall(pattern, printed)}
    assert set(found) == {"plane", "elevation", "rotation"}
    assert found["elevation"][0] < 0.8 * found["elevation"][1]


def test_every_command_of_the_documents_is_one_of_the_program():
    pages = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").glob("*.md")]
    found = [
        command
        for page in pages
        for command in re.findall(r"`python -m tools\.accuracy( [^`]*)`", page.read_text(encoding="utf-8"))
        if "NAME" not in command
    ]
    assert len(found) > 30
    for command in found:
        option_parser().parse_args(command.split())
