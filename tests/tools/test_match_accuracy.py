"""The program of the figures of `match`."""

from __future__ import annotations

import re

import pytest

from smoother.matching import ImuMatch, Limb
from smoother.simulation import ArmSimulation, simulate_arm
from tools.accuracy.__main__ import main
from tools.accuracy.pairing import Answer, answer_rows


def test_rows_count_what_they_say() -> None:
    limb = Limb(simulate_arm(ArmSimulation(protocol="hang", duration_s=2.0), 0).recording.arm, "wrist")
    sure, doubtful = (ImuMatch("/imu/a", limb, True, p, 0.0) for p in (0.99, 0.7))
    unknown = ImuMatch("/imu/a", None, False, 0.4, 0.0)
    rows = [
        Answer(sure, True, True),
        Answer(sure, False, True),
        Answer(doubtful, False, True),
        Answer(unknown, False, False),
    ]
    printed = "\n".join(answer_rows("Made", {"motion": rows}))
    assert re.search(r"motion +25\.0% +25\.0% +2 +50\.0% +1 +75\.0%$", printed, re.MULTILINE)
    assert "0.990: 0.500 of 2" in printed and "0.700: 0.000 of 1" in printed


def test_scenes_are_run(capsys: pytest.CaptureFixture[str]) -> None:
    main(["match", "scenes", "--seeds", "2", "--methods", "motion"])
    printed = capsys.readouterr().out
    assert "Scenes, seeds 0 to 1, 8 IMUs" in printed
    assert re.search(r"motion .* 0 +[\d.]+%$", printed, re.MULTILINE)  # none that is sure is wrong
