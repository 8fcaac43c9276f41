"""What each command says about bad input, and what sessions print and which figures they write.

`messages/COMMAND.txt` has commands and their sentences, each file of `outputs/` a session, in order; there
numbers are shown as #, so that wording and structure are compared alone. To add a case, add its line
`$ unocclude ..`; to change a wording, change the program. Then write the answers again and review the diff:
`UNOCCLUDE_WRITE_MESSAGES=1 python -m pytest tests/cli/test_messages.py`.
"""

from __future__ import annotations

import json
import os
import re
import shlex
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import typer
from rich.console import Console

from smoother.cli import output
from smoother.cli.app import app
from smoother.cli.run import run
from tests.helpers.bad_inputs import bad_inputs

FILES = sorted((Path(__file__).parent / "messages").glob("*.txt"))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("inputs")
    bad_inputs(path)
    return path


def held(folder: Path) -> dict[Path, bytes | None]:
    return {path: path.read_bytes() if path.is_file() else None for path in folder.rglob("*")}


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem)
def test_what_a_command_says(file: Path, folder: Path, monkeypatch: Any, capsys: Any):
    monkeypatch.chdir(folder)
    before = held(folder)
    written = file.read_text(encoding="utf-8")
    answers = []
    for line in written.splitlines():
        if not line.startswith("$ "):
            continue
        words = shlex.split(line)[2:]
        assert words[0] == file.stem, f"{line} belongs into another file"
        code = run(words)
        said = capsys.readouterr().err.replace(str(folder), "/here")
        assert code in (1, 2), line
        assert said.startswith("unocclude: ") and "unexpected error" not in said, said
        answers.append(f"{line}\n[{code}] {said}")
    assert held(folder) == before, "something was written"
    assert len(answers) >= 2
    if os.environ.get("UNOCCLUDE_WRITE_MESSAGES"):
        file.write_text("\n".join(answers), encoding="utf-8")
        return
    assert "\n".join(answers) == written


def test_every_command_has_a_file():
    commands = typer.main.get_command(app)
    names = set(commands.list_commands(typer.Context(commands)))  # type: ignore[attr-defined]
    assert {file.stem for file in FILES} == names - {"demo"}  # it takes no input


SESSIONS = sorted((Path(__file__).parent / "outputs").glob("*.txt"))
DATA = Path(__file__).parents[2] / "data"


def keys(value: Any, path: str = "", depth: int = 0) -> Iterator[str]:
    """The keys of some figures and of what is in them; of lists and large tables those of the first."""
    if isinstance(value, list) and value:
        yield from keys(value[0], f"{path}[]", depth)
    elif isinstance(value, dict) and value and depth < 2:
        for key in sorted(value)[: 1 if depth and len(value) > 40 else None]:
            yield from keys(value[key], f"{path}.{key}".lstrip("."), depth + 1)
    else:
        yield path


def without_numbers(text: str) -> str:
    """A text whose numbers are #, and whose tables have no widths."""
    text = re.sub(r"[+-]?\d+(\.\d+)?(e-?\d+)?", "#", text)
    text = re.sub(r"#(,#)+", "#", re.sub(r" +", " ", re.sub(r"[━─]+", "─", text)))
    return "\n".join(line.rstrip() for line in text.splitlines()).strip()


@pytest.mark.slow
@pytest.mark.parametrize("session", SESSIONS, ids=lambda file: file.stem)
def test_what_a_session_prints(session: Path, tmp_path: Path, monkeypatch: Any, capsys: Any):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(
        output, "console", lambda: Console(width=400)
    )  # a cell on a line, whatever its numbers
    shutil.copy(DATA / "demo.mcap", "rec.mcap")
    shutil.copy(DATA / "demo_calibration.toml", "cal.toml")
    content = Path("rec.mcap").read_bytes()
    Path("damaged.mcap").write_bytes(content[: int(0.85 * len(content))])
    written = session.read_text(encoding="utf-8")
    answers = []
    for line in (line for line in written.splitlines() if line.startswith("$ ")):
        words = shlex.split(line)[2:]
        code = run([*words, *(["--json", "figures.json"] if "--json" not in words else [])])
        said, errors = (text.replace(str(tmp_path), "HERE") for text in capsys.readouterr())
        parts = [f"{line}\n[{code}]", without_numbers(said), without_numbers(errors)]
        if Path("figures.json").exists():
            parts.append("json: " + " ".join(keys(json.loads(Path("figures.json").read_text()))))
            Path("figures.json").unlink()
        answers.append("\n".join(filter(None, parts)) + "\n")
    if os.environ.get("UNOCCLUDE_WRITE_MESSAGES"):
        session.write_text("\n".join(answers), encoding="utf-8")
        return
    assert "\n".join(answers) == written
