"""What commands print: tables, short sentences, what they say about bad input and odd names."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from calib.motion import known_to
from smoother.cli import output
from smoother.cli.output import say, show
from smoother.cli.run import run
from smoother.io import open_recording, write_recording
from smoother.runtime.printable import printable
from smoother.simulation import ArmSimulation, simulate_arm
from smoother.table import Table

DEMO = Path(__file__).parents[2] / "data" / "demo.mcap"


def test_tables_fit_and_numbers_stand_to_the_right(monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    path = "/data/" + 60 * "x" + ".mcap"
    for width in (120, 60, 40):
        monkeypatch.setattr(output, "console", lambda width=width: Console(width=width))
        show(Table("Errors", ("joint", "cm", "file"), [["elbow", 1.5, path], ["hand", None, "-"]]))
        lines = capsys.readouterr().out.splitlines()
        assert max(map(len, lines)) <= width and lines[0].strip() == "Errors"
        text = "\n".join(lines)
        assert "│ 1.5 │" in text and "│   - │" in text and "│ hand  │" in text
        assert "".join(re.findall(r"[/\w.]+", text)).count("x") == 60


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


@pytest.mark.parametrize(
    ("degrees", "words"),
    [(4.2, "known to 4 degrees only"), (1137.0, "not known"), (np.inf, "not known"), (np.nan, "not known")],
)
def test_an_angle_beyond_a_right_one_is_not_known(degrees: float, words: str) -> None:
    assert known_to(np.radians(degrees)) == words


@pytest.mark.slow
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
        "import os, sys\nimport smoother.cli.config as d\n"
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


ROOT = Path(__file__).parents[2]
#: Clears the screen, sets the title, links, turns the direction of writing, goes back, markup, a formula.
HOSTILE = (
    "\x1b[2J\x1b]0;owned\x07",
    "\x9b31m",
    "\x1b]8;;http://evil.example\x1b\\here\x1b]8;;\x1b\\",
    "a\u202egnp.exe",
    "good\rbad\x08\x7f",
    "[red]markup[/red][link=http://evil.example]x[/link]",
    "=cmd|' /C calc'!A0",
)
ACTING = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u200e\u200f\u202a-\u202e\u2066-\u2069]")
SUSPECT = re.compile(r"pickle|dill|joblib|shelve|marshal|yaml|eval|exec|__import__|np\.load|numpy\.load")


@pytest.fixture(scope="module")
def hostile(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording whose topics and frames are named so."""
    folder = tmp_path_factory.mktemp("hostile")
    settings = ArmSimulation.preset("white", protocol="random", duration_s=12.0)
    write_recording(simulate_arm(settings, 3).recording, folder / "plain.mcap")
    file = open_recording(folder / "plain.mcap")
    imu, arm = file.imus[0], file.arms[0]
    imu.topic = "/imu/" + HOSTILE[0] + HOSTILE[5]
    imu.name = HOSTILE[2] + HOSTILE[6]
    arm.frame_id = HOSTILE[1] + HOSTILE[3]
    path = folder / f"rec{HOSTILE[4]}{HOSTILE[1]}.mcap"
    write_recording(file, path)
    return path


@pytest.mark.slow
@pytest.mark.parametrize(
    "arguments",
    [
        ("info",),
        ("check",),
        ("smooth", "-o", "out.mcap", "--force"),
        ("smooth", "--imu", "/none", "-o", "o.mcap"),
    ],
    ids=" ".join,
)
def test_no_command_lets_them_through(
    hostile: Path,
    arguments: tuple[str, ...],
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
):
    monkeypatch.chdir(hostile.parent)
    command, *options = arguments
    run([command, hostile.name, *options])
    said = capsys.readouterr()
    assert said.out or said.err
    assert not ACTING.search(said.out + said.err)


@pytest.mark.parametrize("name", HOSTILE)
def test_tables_and_lines(name: str, capsys: pytest.CaptureFixture[str]):
    show(Table(name, (name, "b"), [(name, 1.0)]))
    say(name)
    said = capsys.readouterr().out
    assert not ACTING.search(said)
    if name.startswith("[red]"):
        assert said.count("[red]markup") >= 1, "markup is shown, not done"


def test_printable_keeps_what_is_harmless():
    for text in ("Übung 3 (links)", "σ = 0.5 m", "腕", "a\tb\nc"):
        assert printable(text, lines=True) == text
    assert printable("\x1b[31m\udcff\u202e") == "\\x1b[31m\\xff\\u202e"


def test_an_array_with_objects_is_refused(tmp_path: Path):
    import numpy as np

    class Bomb:
        def __reduce__(self):
            return (Path.touch, (tmp_path / "ran",))

    np.save(tmp_path / "joints.npy", np.array([Bomb()], dtype=object), allow_pickle=True)
    run(["import", "describe", str(tmp_path / "joints.npy")])
    arguments = [
        "import",
        "files",
        "--skeleton",
        str(tmp_path / "joints.npy"),
        "-o",
        str(tmp_path / "o.mcap"),
    ]
    assert run(arguments) == 1
    assert not (tmp_path / "ran").exists()
