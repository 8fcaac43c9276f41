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
    (line,) = [
        line
        for line in (DATA / "README.md").read_text(encoding="utf-8").splitlines()
        if line.startswith("unocclude simulate")
    ]
    return shlex.split(line)[1:]


@pytest.fixture(scope="module")
def again(tmp_path_factory) -> Path:
    """What the command makes today."""
    folder = tmp_path_factory.mktemp("demo")
    assert run([part.replace("data/", f"{folder}/") for part in command()]) == 0
    return folder


def test_the_command_still_makes_the_recording(again):
    kept, made = read_recording(DATA / "demo.mcap"), read_recording(again / "demo.mcap")
    assert kept.truth is not None and made.truth is not None
    pairs = [
        (kept.imu.t_s, made.imu.t_s),
        (kept.imu.acc, made.imu.acc),
        (kept.imu.gyro, made.imu.gyro),
        (kept.arm.t_s, made.arm.t_s),
        (kept.arm.position, made.arm.position),
        (kept.arm.state, made.arm.state),
        (kept.truth.position, made.truth.position),
        (kept.truth.quaternion, made.truth.quaternion),
    ]
    for old, new in pairs:
        # another processor may round the last digits differently
        np.testing.assert_allclose(new, old, rtol=0, atol=2e-9)
    assert kept.side == made.side == "right"


def test_the_command_still_makes_the_calibration(again):
    kept = read_calibration(DATA / "demo_calibration.toml").arm("right")
    made = read_calibration(again / "demo_calibration.toml").arm("right")
    assert kept.upper_arm is not None and made.upper_arm is not None
    assert kept.upper_arm.value_m == pytest.approx(made.upper_arm.value_m, abs=1e-12)
    for joint in ("elbow", "wrist", "hand"):
        np.testing.assert_allclose(
            kept.lever_arms[joint].position_m, made.lever_arms[joint].position_m, rtol=0, atol=1e-12
        )


def test_small_enough_to_keep():
    assert sum(path.stat().st_size for path in DATA.iterdir()) < 1_000_000
