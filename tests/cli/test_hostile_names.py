"""Names that a stranger chose: nothing of them acts on a terminal, in a table, or as a formula."""

from __future__ import annotations

import ast
import csv
import re
from pathlib import Path

import pytest

from smoother.cli.output import print_table, say
from smoother.cli.run import run
from smoother.io import open_recording, write_recording
from smoother.runtime.printable import printable
from smoother.simulation import ArmSimulation, simulate_arm

Capture = pytest.CaptureFixture[str]
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
    print_table(name, (name, "b"), [(name, 1.0)])
    say(name)
    said = capsys.readouterr().out
    assert not ACTING.search(said)
    if name.startswith("[red]"):
        assert said.count("[red]markup") >= 1, "markup is shown, not done"


def test_printable_keeps_what_is_harmless():
    for text in ("Übung 3 (links)", "σ = 0.5 m", "腕", "a\tb\nc"):
        assert printable(text, lines=True) == text
    assert printable("\x1b[31m\udcff\u202e") == "\\x1b[31m\\xff\\u202e"


def test_exports_hold_numbers_only(hostile: Path, monkeypatch: pytest.MonkeyPatch):
    """No text of a recording gets into a cell: there is nothing for a spreadsheet to run."""
    monkeypatch.chdir(hostile.parent)
    assert run(["smooth", hostile.name, "-o", "r.mcap", "--processes", "1", "--draws", "0", "--force"]) == 0
    assert run(["export", "r.mcap", "--format", "csv", "-o", "r.csv", "--force"]) == 0
    with open("r.csv", newline="") as file:
        header, *rows = csv.reader(file)
    assert all(re.fullmatch(r"[a-z][a-z0-9_]*", name) for name in header)
    assert all(cell == "" or float(cell) is not None for row in rows for cell in row)


def test_no_pickle_is_read_from_a_file():
    """Only what the program has just written is unpickled: a file without a name, a pipe to its child."""
    allowed = {"smoother/runtime/disk_store.py", "smoother/streams/lsl_local.py"}
    for path in sorted([*(ROOT / "smoother").rglob("*.py"), *(ROOT / "calib").rglob("*.py")]):
        name = path.relative_to(ROOT).as_posix()
        text = path.read_text(encoding="utf-8")
        if not SUSPECT.search(text):
            continue
        tree = ast.parse(text)
        for node in ast.walk(tree):
            modules = []
            if isinstance(node, ast.Import):
                modules = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom):
                modules = [node.module or ""]
            unsafe = {"pickle", "cPickle", "dill", "cloudpickle", "joblib", "shelve", "marshal", "yaml"}
            assert name in allowed or not unsafe & {module.split(".")[0] for module in modules}, name
            if isinstance(node, ast.Call):
                called = ast.unparse(node.func)
                assert called not in ("eval", "exec", "__import__"), f"{name}: {called}"
                words = {word.arg: word.value for word in node.keywords}
                if called in ("np.load", "numpy.load"):
                    assert ast.unparse(words["allow_pickle"]) == "False", name
                assert "allow_pickle" not in words or ast.unparse(words["allow_pickle"]) == "False", name


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
