"""How commands print and end: tables, hostile names, streams closed or full, signals; the viewer.

And what is said of an angle not known, a wrong unit, a result that is its own truth, and the demo.
"""

from __future__ import annotations

import errno
import io
import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from commands import done
from results import made
from rich.console import Console

from calib.motion import known_to
from smoother import smooth
from smoother.cli import export as viewer
from smoother.cli import output
from smoother.cli.output import say, show
from smoother.cli.run import run
from smoother.errors import SolveError, UnoccludeError
from smoother.io import open_recording, read_recording, write_recording, write_recovery
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
    monkeypatch.setattr(output, "console", lambda: Console(width=80))
    show(Table("Wide", [*"abcdefghijklm"], [["gaussian-process", *[15.84] * 12]]))
    assert capsys.readouterr().out.count("15.84") == 12


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
        "d.use_open3d = write\nfrom smoother.cli import main\nsys.argv = ['x', 'doctor']\nmain()"
    )
    command = f"'{sys.executable}' -c \"$CODE\" <&- >&- 2>&-"
    subprocess.run(
        command, shell=True, cwd=tmp_path, env=os.environ | {"CODE": code}, timeout=60, check=False
    )
    assert (tmp_path / "out").read_text() == "the output"


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
    files = ["--skeleton", str(tmp_path / "joints.npy"), "-o", str(tmp_path / "o.mcap")]
    assert run(["import", "files", *files]) == 1
    assert not (tmp_path / "ran").exists()


UNOCCLUDE = [sys.executable, "-c", "from smoother.cli import main; main()"]


def test_what_nobody_reads_does_not_cost_the_result(tmp_path: Path):
    """`cut .. | head`: the reader is gone before the first word is printed."""
    output = tmp_path / "part.mcap"
    words = [*UNOCCLUDE, "cut", str(DEMO), "--from", "10", "--to", "15", "-o", str(output)]
    reader, writer = os.pipe()
    os.close(reader)
    done = subprocess.run(words, stdout=writer, stderr=subprocess.PIPE, text=True, timeout=120)
    os.close(writer)
    assert (done.returncode, done.stderr) == (0, "") and output.is_file()


@pytest.mark.parametrize(
    "words",
    [
        ("import", "formats"),
        ("import", "describe", "{folder}"),
        ("import", "describe", "{folder}/one.csv"),
        ("config",),
        ("simulate", "arm", "-o", "{folder}/arm.mcap", "--set", "protocol=random", "--set", "duration_s=2"),
        ("simulate", "people", "-o", "{folder}/people.mcap", "--set", "duration_s=2"),
        ("repair", str(DEMO), "-o", "{folder}/whole.mcap"),
    ],
    ids=" ".join,
)
def test_figures_are_written_before_anything_is_printed(words: tuple[str, ...], tmp_path: Path, monkeypatch):
    class Full(io.StringIO):
        def write(self, text: str) -> int:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    rows = (f"{k / 100},0.1,0.2,9.8,0.01,0.02,0.03\n" for k in range(50))
    (tmp_path / "one.csv").write_text("t,ax,ay,az,gx,gy,gz\n" + "".join(rows))
    monkeypatch.setattr(sys, "stdout", Full())
    figures = tmp_path / "figures.json"
    assert run([*(word.format(folder=tmp_path) for word in words), "--json", str(figures)]) == 1
    assert json.loads(figures.read_text())


@pytest.mark.skipif(os.name != "posix", reason="signals are POSIX'")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_waits_for_an_import(tmp_path: Path, number: int):
    """A library that is interrupted while it loads says "initialization failed", or is taken for missing."""
    (tmp_path / "slow_library.py").write_text(
        "import os, time\n"
        f"os.kill(os.getpid(), {int(number)})\n"
        "try:\n    time.sleep(0.3)\n"
        "except KeyboardInterrupt as error:\n    raise ImportError('initialization failed') from error\n"
        "print('loaded')\n"
    )
    code = (
        "import sys, time, smoother.cli.app as app\nfrom smoother.cli import main\n"
        "def command(*_, **__):\n    import slow_library\n    time.sleep(5)\n"
        "app.app = command\nmain()"
    )
    path = os.pathsep.join([str(tmp_path), str(DEMO.parents[1])])
    begin = time.monotonic()
    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONPATH": path},
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
        timeout=60,
    )
    assert done.stdout == "loaded\n" and done.returncode == 1
    assert done.stderr == "unocclude: interrupted; no output is left half written\n"
    assert time.monotonic() - begin < 30


@pytest.mark.parametrize(("factor", "unit"), [(1000, "millimetres"), (100, "centimetres")])
def test_a_wrong_unit_is_named(factor: int, unit: str):
    from dataclasses import replace

    recording = read_recording(DEMO)
    arm = replace(recording.arm, position=recording.arm.position * factor)
    with pytest.raises(SolveError, match=f"they seem to be {unit}: divide them by {factor}"):
        smooth(replace(recording, arm=arm))


def test_a_result_against_its_own_export_says_so():
    from arms import make_recording, make_recovery

    from smoother.evaluation.validate import validate
    from smoother.recording import Truth

    recovery = make_recovery(make_recording())
    own = Truth(recovery.t_s, recovery.position, recovery.quaternion, recovery.answered)
    said = "The reference is this result itself"
    assert any(note.startswith(said) for note in validate(recovery, own).notes)
    other = Truth(recovery.t_s, recovery.position + 0.003, recovery.quaternion, recovery.answered)
    assert not any(note.startswith(said) for note in validate(recovery, other).notes)


def test_the_demo_knows_no_true_lever_arms(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """It recovers as a user's own first recording is recovered."""
    given: list[object] = []

    def stop(recordings: object, name: object, calibrations: object, *_: object) -> None:
        given.append(calibrations)
        raise UnoccludeError("enough")

    monkeypatch.setattr("smoother.cli.smooth.recover_arms", stop)
    assert run(["demo", "-o", str(tmp_path / "demo")]) == 1 and given == [[None]]


@pytest.fixture
def result(tmp_path) -> Path:
    write_recovery(made("right"), tmp_path / "out.mcap")
    return tmp_path / "out.mcap"


@pytest.fixture
def needs_rerun():
    pytest.importorskip("rerun", reason="rerun-sdk, the extra `view`, is not installed")


def test_the_viewer_binds_to_the_loopback_address(needs_rerun):
    arguments = viewer.window("--port", "auto", "a.rrd")
    assert arguments[arguments.index("--bind") + 1] == "127.0.0.1"
    assert Path(arguments[0]).is_file()
    assert arguments[-1] == "a.rrd"


def test_a_session_is_shown_at_an_address_of_this_computer_until_it_ends(monkeypatch):
    waits = [sys.executable, "-c", "import time; time.sleep(60)"]
    monkeypatch.setattr(viewer, "window", lambda *options: [*waits, *options])
    began = time.monotonic()
    with viewer.live_window() as address:
        assert re.fullmatch(r"rerun\+http://127\.0\.0\.1:\d+/proxy", address)
    assert time.monotonic() - began < 30.0


def test_a_session_whose_window_does_not_open_is_refused(monkeypatch):
    monkeypatch.setattr(viewer, "window", lambda *_: ["false"])
    with pytest.raises(UnoccludeError, match="does not open"), viewer.live_window():
        pass


def test_the_viewer_speaks_to_nobody_else(monkeypatch):
    monkeypatch.setenv("FORCE_RERUN_ANALYTICS", "1")
    monkeypatch.setenv("https_proxy", "http://proxy.example:3128")
    monkeypatch.delenv("CI", raising=False)
    variables = viewer.environment()
    assert variables["CI"] == "true"
    assert "FORCE_RERUN_ANALYTICS" not in variables
    ways_out = {value for name, value in variables.items() if name.lower() in ("https_proxy", "all_proxy")}
    assert ways_out == {"http://127.0.0.1:9"}
    assert variables["NO_PROXY"] == "127.0.0.1,localhost"
    assert variables["PATH"] == os.environ["PATH"]


def test_a_file_is_shown_and_goes(needs_rerun, result, monkeypatch):
    shown = []

    def show(arguments):
        file = Path(arguments[-1])
        shown.append((file, file.stat().st_size))

    monkeypatch.setattr(viewer, "show_window", show)
    done("view", result)
    ((file, size),) = shown
    assert file.name == "out.rrd"
    assert size > 10_000
    assert not file.exists()


def test_a_viewer_that_fails_says_why():
    with pytest.raises(UnoccludeError, match="no display here"):
        viewer.show_window([sys.executable, "-c", "print('no display here'); raise SystemExit(3)"])
    viewer.show_window([sys.executable, "-c", "print('all is well')"])
