"""Commands of unocclude in this process: those that must succeed, and those that must be refused."""

from __future__ import annotations

import pytest

from smoother.cli.run import run


def done(*arguments: object) -> None:
    """Run a command to its end."""
    assert run([str(argument) for argument in arguments]) == 0, arguments


def refused(capsys: pytest.CaptureFixture[str], *arguments: object, code: int = 1) -> str:
    """The one sentence with which a command is refused, its white space made even."""
    capsys.readouterr()
    assert run([str(argument) for argument in arguments]) == code, arguments
    said = capsys.readouterr().err
    assert said.startswith("unocclude: ") and said.count("\n") == 1, said
    assert "Traceback" not in said and "unexpected error" not in said, said
    return " ".join(said.split())
