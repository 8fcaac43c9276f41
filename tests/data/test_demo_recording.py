"""The recordings in `data/` are what their command makes, and the demo uses them."""

from __future__ import annotations

import shlex
from pathlib import Path

import numpy as np
import pytest

from calib import read_calibration
from smoother.cli.run import run
from smoother.io import read_recording

DATA = Path(__file__).parents[2] / "data"


def command() -> list[str]:
    """The command that data/README.md gives."""
    lines = (DATA / "README.md").read_text(encoding="utf-8").splitlines()
    (line,) = (line for line in lines if line.startswith("unocclude simulate"))
    return shlex.split(line)[1:]


@pytest.fixture(scope="module")
def again(tmp_path_factory) -> Path:
    """What the command makes today."""
    folder = tmp_path_factory.mktemp("demo")
    assert run([part.replace("data/", f"{folder}/") for part in command()]) == 0
    return folder


def test_the_command_still_makes_the_recording(again):
    kept, made = read_recording(DATA / "demo.mcap"), read_recording(again / "demo.mcap")
    for stream, names in (
        ("imu", ("t_s", "acc", "gyro")),
        ("arm", ("t_s", "position", "state")),
        ("truth", ("position", "quaternion")),
    ):
        for name in names:
            old, new = (getattr(getattr(one, stream), name) for one in (kept, made))
            # another processor may round the last digits differently
            np.testing.assert_allclose(new, old, rtol=0, atol=2e-9)
    assert kept.side == made.side == "right"


def test_the_command_still_makes_the_calibration(again):
    kept, made = (read_calibration(each / "demo_calibration.toml").arm("right") for each in (DATA, again))
    assert kept.upper_arm.value_m == pytest.approx(made.upper_arm.value_m, abs=1e-12)
    for joint in ("elbow", "wrist", "hand"):
        old, new = (one.lever_arms[joint].position_m for one in (kept, made))
        np.testing.assert_allclose(new, old, rtol=0, atol=1e-12)


def test_small_enough_to_keep():
    assert sum(path.stat().st_size for path in DATA.iterdir()) < 1_000_000
