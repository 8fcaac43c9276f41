"""A group of options stands in a command's help and reaches it as one value."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import pytest
import typer
from click.testing import CliRunner

from smoother.cli.load import AS_RECORDED, SetUp
from smoother.cli.options import with_groups
from smoother.cli.run import run


@dataclass(frozen=True)
class Size:
    width: Annotated[int, typer.Option("--width", help="Of the box.")] = 3
    name: Annotated[str | None, typer.Option("--name")] = None


SMALL = Size()


def test_a_group_reaches_the_command_as_one_value() -> None:
    got: list[object] = []

    def box(path: Annotated[Path, typer.Argument()], size: Size = SMALL, deep: bool = False) -> None:
        """Make a box."""
        got.append((path, size, deep))

    app = typer.Typer(add_completion=False)
    app.command()(with_groups(box))
    command = typer.main.get_command(app)
    assert [each.name for each in command.params] == ["path", "width", "name", "deep"]
    assert command.help == "Make a box."
    for words, expected in (
        (["a"], (Path("a"), Size(3, None), False)),
        (["--width", "5", "a", "--name", "x", "--deep"], (Path("a"), Size(5, "x"), True)),
    ):
        result = CliRunner().invoke(command, words)
        assert result.exit_code == 0, result.output
        assert got.pop() == expected


@pytest.mark.parametrize("command", ["smooth", "check", "gaps", "compare"])
def test_four_commands_share_the_set_up(command: str, capsys) -> None:
    assert run([command, "--help"]) == 0
    shown = capsys.readouterr().out
    options = ("--mirror", "--swap", "--negate", "--camera-frame", "--clock-offset", "--clock-sigma")
    commands = [shown.index(option) for option in options]
    assert commands == sorted(commands)


def test_a_set_up_undoes_what_its_options_say() -> None:
    assert AS_RECORDED.remedy()[0].options == "" and AS_RECORDED.remedy()[1] is False
    remedy, swap_sides = SetUp(mirror="x", swap="left,right", negate="gyroscope").remedy()
    assert "--mirror x" in remedy.options and "--negate gyroscope" in remedy.options and swap_sides
    with pytest.raises(typer.BadParameter, match="--camera-frame is one of"):
        SetUp(camera_frame="upside").remedy()
