"""What each command says about bad input: the commands and their sentences are in `messages/COMMAND.txt`.

To add a case, add its line `$ unocclude ..`; to change a wording, change the program. Then write the answers
again and review the diff: `UNOCCLUDE_WRITE_MESSAGES=1 python -m pytest tests/cli/test_messages.py`.
"""

from __future__ import annotations

import os
import shlex
from pathlib import Path
from typing import Any

import pytest
import typer

from smoother.cli.app import app
from smoother.cli.run import run
from tests.helpers.bad_inputs import bad_inputs

FILES = sorted((Path(__file__).parent / "messages").glob("*.txt"))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("inputs")
    bad_inputs(path)
    return path


@pytest.mark.slow
@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem)
def test_what_a_command_says(file: Path, folder: Path, monkeypatch: Any, capsys: Any):
    monkeypatch.chdir(folder)
    before = sorted(folder.rglob("*"))
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
    assert sorted(folder.rglob("*")) == before, "something was written"
    assert len(answers) >= 2
    if os.environ.get("UNOCCLUDE_WRITE_MESSAGES"):
        file.write_text("\n".join(answers), encoding="utf-8")
        return
    assert "\n".join(answers) == written


def test_every_command_has_a_file():
    commands = typer.main.get_command(app)
    names = set(commands.list_commands(typer.Context(commands)))  # type: ignore[attr-defined]
    assert {file.stem for file in FILES} == names - {"demo"}  # it takes no input
