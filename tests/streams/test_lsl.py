"""Real outlets of the Lab Streaming Layer on this computer, `unocclude live` behind them, and its outlet."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import threading
import time
import uuid
from configparser import ConfigParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from lsl_lab import JOINTS, config, program_of

from smoother.cli.run import run
from smoother.io import read_recording
from smoother.streams.lsl import local_settings

HELPERS = Path(__file__).parents[1] / "helpers"
DEMO = Path(__file__).parents[2] / "data" / "demo.mcap"


def is_there() -> bool:
    """Whether pylsl is installed with its library, which wheels for an older glibc than 2.35 lack."""
    try:
        import pylsl  # noqa: F401
    except (ImportError, OSError, RuntimeError):
        return False
    return True


pytestmark = pytest.mark.skipif(not is_there(), reason="pylsl with liblsl is not installed")


class Lab:
    """Programs that see each other and nobody else."""

    def __init__(self, folder: Path):
        self.folder = folder
        self.environment = dict(os.environ)
        self.environment["LSLAPICFG"] = str(config(folder, uuid.uuid4().hex))
        paths = [str(HELPERS), str(HELPERS.parents[1]), os.environ.get("PYTHONPATH", "")]
        self.environment["PYTHONPATH"] = os.pathsep.join(path for path in paths if path)
        self.programs: list[subprocess.Popen] = []

    def start(self, function: str, *given: object, **options: object) -> subprocess.Popen:
        pipe = subprocess.PIPE
        program = subprocess.Popen(
            program_of(function, *given, **options),
            env=self.environment,
            stdin=pipe,
            stdout=pipe,
            stderr=pipe,
            text=True,
            cwd=self.folder,
        )
        self.programs.append(program)
        return program

    def outlets(self, recording: Path, *names: str, **options: bool) -> subprocess.Popen:
        """Outlets of IMU and skeleton that wait for the word to begin."""
        program = self.start("play", str(recording), *names, **options)
        lines_until(program, "ready")
        return program

    def printed(self, function: str, *given: object, **options: object) -> Any:
        """What a program of the lab says in JSON."""
        program = self.start(function, *given, **options)
        said, errors = program.communicate(timeout=120)
        assert program.returncode == 0, errors
        return json.loads(said)

    def end(self) -> None:
        for program in self.programs:
            if program.poll() is None:
                program.kill()
            program.communicate()


def interrupted(live: subprocess.Popen) -> None:
    """Ctrl-C ends it well, and without a word of error."""
    live.send_signal(signal.SIGINT)
    said, errors = live.communicate(timeout=20)
    assert (live.returncode, errors) == (0, ""), said


@pytest.fixture
def lab(tmp_path):
    lab = Lab(tmp_path)
    yield lab
    lab.end()


def lines_until(program: subprocess.Popen, words: str) -> None:
    """Read what a program prints until these words; a machine with other work to do may need a while."""
    lines: list[str] = []
    assert program.stdout is not None
    ender = threading.Timer(60.0, program.kill)
    ender.start()
    try:
        while not lines or words not in lines[-1]:
            lines.append(program.stdout.readline())
            assert lines[-1], f"ended before {words!r}: {lines} {program.stderr and program.stderr.read()}"
    finally:
        ender.cancel()


def tell(program: subprocess.Popen, words: str) -> None:
    assert program.stdin is not None
    program.stdin.write(f"{words}\n")
    program.stdin.flush()


@pytest.mark.slow
def test_two_outlets_in_and_one_out(lab, tmp_path):
    outlets = lab.outlets(DEMO, "wrist", "kinect")
    arguments = ["--imu", "wrist", "--skeleton", "kinect", "--lsl-out", "arm", "--record", "session.mcap"]
    # with the arm's calibration half a minute of motion suffices
    arguments += ["--calibration", str(DEMO.with_name("demo_calibration.toml"))]
    live = lab.start("live", *arguments, "--json", "session.json")
    lines_until(live, "LSL: streams arm and arm_settled, for this computer")
    tell(outlets, "go")
    lines_until(live, "  visible")
    # a machine with other work to do takes fewer, longer steps
    sent = lab.printed("read", "arm", 6, least=200)
    tell(outlets, "imu 2")
    lines_until(live, "back, after")
    time.sleep(0.3)
    interrupted(live)

    assert sent["type"] == "MoCap"
    labels = [label for label, *_ in sent["labels"]]
    assert labels[:4] == ["imu_right_x", "imu_right_y", "imu_right_z", "imu_right_sigma"]
    assert {f"{joint}_right_{axis}" for joint in JOINTS for axis in "xyz"} < set(labels)
    assert dict((label, (kind, unit)) for label, kind, unit in sent["labels"])["wrist_right_y"] == (
        "PositionY",
        "meters",
    )
    samples = np.array(sent["samples"])
    state = samples[:, labels.index("state")]
    assert set(state) <= {0, 1, 2, 3}
    shown = samples[state == 1]
    assert len(shown) > 50
    camera = read_recording(DEMO).arm.joint("wrist")
    camera = camera[np.isfinite(camera).all(axis=1)]
    wrist = shown[:, [labels.index(f"wrist_right_{axis}") for axis in "xyz"]]
    nearest = np.linalg.norm(wrist[:, None] - camera[None], axis=2).min(axis=1)
    assert np.median(nearest) < 0.05  # metres, and of this arm: its path is half a metre wide
    sigma = shown[:, labels.index("wrist_right_sigma")]
    assert 0.002 < np.median(sigma) < 0.1
    assert np.all(np.diff(sent["t_s"]) > -1e-3)
    assert np.median(sent["ages"]) < 0.3  # of now; 0.02 on an idle machine

    figures = json.loads((tmp_path / "session.json").read_text())
    assert figures["imu"]["lost_times"] == 1
    assert figures["skeleton"]["lost_times"] == 0
    # away for 2 s, and found again by the library within another
    assert 1.8 < figures["imu"]["lost_s"] < 6.0
    assert figures["skeleton"]["delay_s"] == pytest.approx(0.1, abs=0.04)
    recorded = read_recording(tmp_path / "session.mcap")
    assert (recorded.side, recorded.arm.present) == ("right", ("shoulder", "elbow", "wrist"))
    assert recorded.imu.rate_hz == pytest.approx(80, rel=0.02)
    original = read_recording(DEMO)
    rows = {tuple(row) for row in original.imu.acc.tolist()}
    assert all(tuple(row) in rows for row in recorded.imu.acc.tolist())
    assert not list(tmp_path.glob("*.recording.mcap"))


@pytest.mark.slow
@pytest.mark.parametrize("named", [(), ("--gyro", "wrist")])
def test_accelerometer_and_gyroscope_in_two_streams(lab, tmp_path, named):
    outlets = lab.outlets(DEMO, "wrist", "kinect", halves=True)
    arguments = ["--imu", "wrist", "--record", "session.mcap", *named]
    live = lab.start("live", *arguments, echo=True)
    lines_until(live, "calibrating")
    tell(outlets, "go")
    for _ in range(3):  # a line every two seconds
        lines_until(live, " IMU ")
    interrupted(live)
    recorded, original = read_recording(tmp_path / "session.mcap"), read_recording(DEMO)
    assert len(recorded.imu.t_s) > 100
    # each sample is known by its gyroscope; the accelerometer's stamps are 5 ms earlier
    at = [int(np.flatnonzero((original.imu.gyro == row).all(axis=1))[0]) for row in recorded.imu.gyro]
    t = original.imu.t_s
    expected = np.stack([np.interp(t[at] + 0.005, t, axis) for axis in original.imu.acc.T], axis=1)
    # LSL corrects each stream by itself
    np.testing.assert_allclose(recorded.imu.acc, expected, atol=0.005)


@pytest.mark.slow
def test_both_arms_and_imus_on_the_upper_arms(lab, tmp_path):
    both = tmp_path / "both.mcap"
    made = ["--arms", "both", "--set", "imus=wrist,upper-arm", "--set", "protocol=random"]
    made += ["--set", "duration_s=8"]
    assert run(["simulate", "arm", "-o", str(both), *made]) == 0
    outlets = lab.outlets(both, "imu", "kinect", both=True)
    arguments = ["--arms", "both", "--imu", "right=imu_right", "--imu", "left=imu_left"]
    arguments += ["--imu", "right-upper-arm=imu_right_upper_arm"]
    arguments += ["--imu", "left-upper-arm=imu_left_upper_arm", "--skeleton", "kinect"]
    arguments += ["--lsl-out", "arm", "--record", "session.mcap", "--json", "session.json"]
    live = lab.start("live", *arguments, echo=True)
    lines_until(live, "LSL: streams arm_left and arm_left_settled, for this computer")
    tell(outlets, "go")
    lines_until(live, "left arm: visible")
    sent = lab.printed("read", "arm_left", 3, least=30)
    interrupted(live)
    assert sent["labels"][0][0] == "imu_left_x" and len(sent["samples"]) > 20
    arms = {each["side"]: each for each in json.loads((tmp_path / "session.json").read_text())["arms"]}
    assert set(arms) == {"right", "left"}
    for side, figures in arms.items():
        recorded, played = (
            read_recording(tmp_path / name, side=side) for name in ("session.mcap", "both.mcap")
        )
        for imu, original in (
            (recorded.imu, played.imu),
            (recorded.further_imus["upper_arm"], played.further_imus["upper_arm"]),
        ):
            rows = {tuple(row) for row in original.acc.tolist()}
            assert len(imu) > 100 and all(tuple(row) in rows for row in imu.acc.tolist())
        assert figures["further"]["upper_arm"]["count"] > 100
        wrist = recorded.arm.joint("wrist")
        of_side = played.arm.joint("wrist")
        nearest = np.linalg.norm(wrist[:, None] - of_side[None], axis=2)
        assert np.nanmax(np.nanmin(nearest, axis=1)) < 1e-6


@pytest.mark.slow
def test_streams_that_cannot_be_used(lab, tmp_path):
    lab.outlets(DEMO, "wrist", "kinect", bare=True)  # never begins: it shows before its first sample

    def refused(*arguments: str) -> str:
        live = lab.start("live", *arguments)
        _, said = live.communicate(timeout=40)
        assert live.returncode == 1
        assert said.count("\n") == 1, said
        return said

    assert (
        "its channels have no labels; acc_x, acc_y, acc_z and gyro_x, gyro_y, gyro_z are missing"
        in refused("--imu", "wrist", "--skeleton", "kinect", "--record", "session.mcap")
    )
    missing = refused("--imu", "ankle", "--skeleton", "kinect", "--wait", "4")
    assert "no stream for --imu ankle arrived within 4 s" in missing
    assert "kinect (type MoCap), wrist (type IMU)" in missing
    assert not list(tmp_path.glob("*.mcap"))


@pytest.mark.slow
def test_an_outlet_that_comes_back_is_known_by_its_name_and_refused_with_another_unit(lab):
    answers = lab.printed("again")
    assert answers["first"] and answers["second"]
    assert answers["events"] == ["wrist: found again by its name, its source_id is another"]
    assert answers["refused"] == (
        "the stream wrist came back with other labels, units or channels; begin a new session"
    )


def read(text: str) -> ConfigParser:
    parser = ConfigParser(interpolation=None)
    parser.optionxform = str  # type: ignore[assignment,method-assign]
    parser.read_string(text)
    return parser


def test_a_users_settings_stay_but_for_how_far_streams_are_announced(tmp_path):
    file = tmp_path / "lsl_api.cfg"
    file.write_text(
        "[lab]\nSessionID = mine ; of the room\n[multicast]\nResolveScope = site\n[ports]\nBasePort = 17000\n"
    )
    parser = read(local_settings(file))
    assert parser["lab"]["SessionID"] == "mine"
    assert parser["ports"]["BasePort"] == "17000"
    assert parser["multicast"]["ResolveScope"] == "machine"
    assert parser["multicast"]["ListenAddress"] == "127.0.0.1"
    assert parser["log"]["level"] == "-3"
    (tmp_path / "damaged.cfg").write_text("no section")
    for unread in (None, tmp_path / "missing.cfg", tmp_path / "damaged.cfg"):
        assert read(local_settings(unread))["multicast"]["ResolveScope"] == "machine"
