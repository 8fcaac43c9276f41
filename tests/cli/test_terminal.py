"""What commands print: tables with whole words at any width, short sentences, one table in the demo."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console
from scenes import ALONE

from calib.motion.motion_summary import known_to
from smoother.cli import output
from smoother.cli.demo import print_gaps
from smoother.cli.output import laid_out
from smoother.cli.run import run
from smoother.evaluation.validate import validate
from smoother.io import write_recording
from smoother.simulation import ArmSimulation, SimulatedArm, simulate_arm
from smoother.smoothing import smooth

DEMO = Path(__file__).parents[2] / "data" / "demo.mcap"
COLUMNS = ("part", "rms, cm", "95 %, cm", "max, cm", "orientation, deg", "NEES", "inside 95 %", "samples")
ROWS = [["occluded", "1.62", "2.12", "2.14", "1.147", "1.156", "100 %", "543"]]
MATCH = ("IMU", "body", "joint", "probability", "else")
LONG = [["/imu/sensor_2", "-", "upper_arm_left", "0.308", "none 0.31, wrist_right of body 0 0.20"]]


def printed(width: int, columns=COLUMNS, rows=ROWS, title: str = "Error against the truth") -> list[str]:
    console = Console(width=width, force_terminal=True, color_system=None)
    with console.capture() as capture:
        console.print(laid_out(title, columns, rows, width))
    return capture.get().splitlines()


@pytest.mark.parametrize("width", [200, 100, 80, 72, 60, 40])
@pytest.mark.parametrize(("columns", "rows"), [(COLUMNS, ROWS), (MATCH, LONG)])
def test_words_stay_whole_at_every_width(width: int, columns, rows) -> None:
    lines = printed(width, columns, rows)
    assert max(map(len, lines)) <= width
    words = set(re.findall(r"[\w./%+-]+", " ".join(lines)))
    for text in [*columns, *rows[0], "Error against the truth"]:
        assert set(re.findall(r"[\w./%+-]+", text)) <= words, text


def test_lines_where_there_is_room_and_a_paragraph_where_there_is_none() -> None:
    assert any("┃" in line for line in printed(120))
    assert not any("┃" in line for line in printed(70))
    assert "  samples: 543" in printed(24)


def test_numbers_stand_to_the_right_and_names_to_the_left() -> None:
    rows = [["elbow", "1.5", "100 %"], ["hand", "-12.5", "-"]]
    text = "\n".join(printed(80, ("joint", "cm", "inside"), rows))
    assert "│   1.5 │" in text and "│ -12.5 │" in text and "│      - │" in text and "│ hand  │" in text


def test_a_path_that_is_longer_than_the_terminal_is_broken() -> None:
    path = "/data/" + 60 * "x" + ".mcap"
    lines = printed(50, ("file", "rows"), [[path, "5"]])
    assert max(map(len, lines)) <= 50
    assert "".join(re.findall(r"[/\w.]+", "".join(lines[4:-1]))).replace("5", "") == path


def test_sentences_break_between_words_on_a_terminal_only(monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    sentence = "hidden gaps " * 20
    output.say(sentence)
    assert capsys.readouterr().out == sentence + "\n"
    monkeypatch.setattr("sys.stdout.isatty", lambda: True)
    monkeypatch.setenv("COLUMNS", "50")
    output.say(sentence)
    output.say_command("smooth", "a b.mcap", "-o", "x" * 60)
    *lines, command = capsys.readouterr().out.splitlines()
    assert len(lines) > 3 and all(len(line) <= 50 for line in lines)
    assert set(" ".join(lines).split()) == {"hidden", "gaps"}
    assert command == f"try: unocclude smooth 'a b.mcap' -o {'x' * 60}"


@pytest.fixture(scope="module")
def arm() -> SimulatedArm:
    return simulate_arm(ArmSimulation.preset("white", protocol="random", duration_s=12.0), 4)


def test_the_demo_prints_one_table(arm: SimulatedArm, capsys) -> None:
    recovery = smooth(arm.recording, arm.calibration, ALONE)
    assert arm.recording.truth is not None
    validation = validate(recovery, arm.recording.truth)
    print_gaps(recovery, validation)
    out = capsys.readouterr().out
    assert out.count("┏") == 1 and "In the gaps the answer is within " in out and " of the truth, " in out
    # one row per gap, with the figures of the validation
    assert out.count("\n│") == len(recovery.gaps) == len(validation.gaps)
    assert f"{100 * validation.gaps[0][1].position_p95_m:.2f}" in out
    print_gaps(recovery, None)
    out = capsys.readouterr().out
    assert "the truth" not in out and out.count("\n│") == len(recovery.gaps)


@pytest.mark.parametrize(
    ("name", "advice"),
    [
        ("out.csv", "write it to {folder}/out.mcap, then `unocclude export {folder}/out.mcap --format csv"),
        ("out.C3D", "--format c3d -o {folder}/out.C3D`"),
        ("out.html", "name it {folder}/out.mcap"),
    ],
)
def test_mcap_is_not_written_under_another_ending(
    arm: SimulatedArm, tmp_path: Path, capsys, name: str, advice: str
) -> None:
    write_recording(arm.recording, tmp_path / "rec.mcap")
    assert run(["smooth", str(tmp_path / "rec.mcap"), "-o", str(tmp_path / name)]) == 1
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and advice.format(folder=tmp_path) in error
    assert not (tmp_path / name).exists()


def test_a_recording_is_not_written_under_another_ending(tmp_path: Path, capsys) -> None:
    assert run(["simulate", "imu", "-o", str(tmp_path / "poses.csv")]) == 1
    assert f"name it {tmp_path / 'poses.mcap'}" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("degrees", "words"),
    [(4.2, "known to 4 degrees only"), (1137.0, "not known"), (np.inf, "not known"), (np.nan, "not known")],
)
def test_an_angle_beyond_a_right_one_is_not_known(degrees: float, words: str) -> None:
    assert known_to(np.radians(degrees)) == words


@pytest.mark.skipif(os.name != "posix", reason="a shell of POSIX closes them")
@pytest.mark.parametrize(
    ("closed", "words", "code"),
    [
        (">&-", f"info {DEMO}", 0),
        (">&-", "info nothing.mcap", 1),
        ("2>&-", "config", 0),
        ("<&- >&- 2>&-", f"info {DEMO}", 0),
        ("<&- >&- 2>&-", "info nothing.mcap", 1),
    ],
)
def test_closed_streams_are_the_null_device(tmp_path: Path, closed: str, words: str, code: int) -> None:
    """Python has no such stream then: `sys.stdout` is None, and a command ended in an AttributeError."""
    program = f"'{sys.executable}' -c 'from smoother.cli import main; main()'"
    done = subprocess.run(
        f"{program} {words} {closed}", shell=True, cwd=tmp_path, capture_output=True, text=True, timeout=60
    )
    assert done.returncode == code
    assert "unexpected" not in done.stderr and "Traceback" not in done.stderr
    if code and "2" not in closed:
        assert done.stderr == "unocclude: nothing.mcap does not exist; check the name.\n"


@pytest.mark.skipif(os.name != "posix", reason="a shell of POSIX closes them")
def test_no_output_gets_the_number_of_a_closed_stream(tmp_path: Path) -> None:
    """What is printed would be written into it."""
    code = (
        "import os, sys\nimport smoother.cli.demo as d\n"
        "def write(*_):\n"
        "  with open('out', 'w') as file:\n"
        "    print('a'); os.write(1, b'b'); os.write(2, b'c'); assert file.fileno() > 2\n"
        "    assert os.get_inheritable(1) and os.get_inheritable(2)\n"
        "    file.write('the output')\n"
        "d.memory = write\nfrom smoother.cli import main\nsys.argv = ['x', 'doctor']\nmain()"
    )
    command = f"'{sys.executable}' -c \"$CODE\" <&- >&- 2>&-"
    subprocess.run(
        command, shell=True, cwd=tmp_path, env=os.environ | {"CODE": code}, timeout=60, check=False
    )
    assert (tmp_path / "out").read_text() == "the output"
