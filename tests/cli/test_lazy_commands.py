"""Only the command that runs is imported; help, names and mistakes are those of all commands."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
import typer

from smoother.cli.app import CommandSpec, LazyCommands, app
from smoother.cli.run import run
from smoother.io import write_recording
from smoother.simulation import ArmSimulation, simulate_arm

LOADED = (
    "import sys; from smoother.cli.run import run; code = run(sys.argv[1:]);"
    "print(*(name for name in sys.modules), file=sys.stderr); sys.exit(code)"
)


def all_places() -> dict[str, CommandSpec]:
    """Every command's place, by all its words."""
    group = typer.main.get_command(app)
    commands = {}
    for name in group.commands:
        if name in group.commands._specs:
            commands[name] = group.commands._specs[name]
        else:
            below = group.commands[name].commands._specs
            commands |= {f"{name} {command}": place for command, place in below.items()}
    return commands


def loaded(*arguments: str) -> set[str]:
    """Modules that a command has imported when it is done."""
    done = subprocess.run(
        [sys.executable, "-c", LOADED, *arguments], capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 0, done.stderr
    return set(done.stderr.split())


def others(command: str) -> set[str]:
    """Modules that hold other commands only."""
    commands = all_places()
    return {f"smoother.cli.{place.module}" for place in commands.values()} - {
        f"smoother.cli.{commands[command].module}"
    }


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("lazy") / "a.mcap"
    write_recording(simulate_arm(ArmSimulation(repetitions=1), 1).recording, path)
    return path


def test_smooth_imports_no_other_command(recording: Path, tmp_path: Path) -> None:
    modules = loaded("smooth", str(recording), "-o", str(tmp_path / "out.mcap"), "--method", "hold")
    assert (tmp_path / "out.mcap").exists() and "smoother.cli.smooth" in modules
    assert len(others("smooth")) > 15
    assert not modules & others("smooth")
    # what only they need: the server of `view`, the graphs' live window, the importers of devices
    beside = (
        "http.server",
        "smoother.live",
        "smoother.streams",
        "smoother.simulation",
        "smoother.io.devices",
        "smoother.io.tables",
    )
    assert not {name for name in modules if name.startswith(beside)}


@pytest.mark.parametrize("command", ["info", "config", "batch", "import describe", "calibrate motion"])
def test_the_help_of_a_command_imports_no_other_one(command: str) -> None:
    assert not loaded(*command.split(), "--help") & others(command)


def test_the_version_imports_no_command() -> None:
    assert not {name for name in loaded("--version") if name.startswith("smoother.cli.smooth")}


def test_the_help_of_all_starts_no_server() -> None:
    assert not loaded("--help") & {"http.server", "ssl", "numpy", "pydantic", "smoother.cli.imports"}


def test_every_place_has_its_command() -> None:
    commands = all_places()
    assert len(commands) > 30
    for words, place in commands.items():
        command = place.command(words.split()[-1])
        assert command.help and command.name == words.split()[-1]
        assert place.epilog.startswith(f"Example: unocclude {words}")


def test_a_command_is_made_once_and_only_when_it_is_looked_up() -> None:
    commands = LazyCommands(
        {"config": CommandSpec("demo", ""), "none": CommandSpec("no_such_module", "")}, {"more": "group"}
    )
    assert list(commands) == ["config", "none", "more"] and len(commands) == 3
    assert commands["config"] is commands["config"] and commands["more"] == "group"
    assert commands.get("frobnicate") is None
    with pytest.raises(ModuleNotFoundError):
        commands["none"]


@pytest.mark.parametrize(
    "words, meant",
    [(["smoth"], "smooth"), (["calibrate", "wrld"], "world"), (["simulate", "peple"], "people")],
)
def test_a_mistake_in_a_name_is_seen_through(
    words: list[str], meant: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(words) == 2
    assert f"Did you mean {meant!r}" in capsys.readouterr().err
