"""`--help`: whole first sentences, every option in a group, rare ones last."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest
import typer
from click.testing import CliRunner

from smoother.cli import app as help_page
from smoother.cli.app import app


def leaves(command: Any, words: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Any]]:
    if not hasattr(command, "list_commands"):
        yield words, command
        return
    context = typer.Context(command)
    for name in command.list_commands(context):
        yield from leaves(command.get_command(context, name), (*words, name))


ROOT = typer.main.get_command(app)
COMMANDS = dict(leaves(ROOT))


def shown(*words: str) -> str:
    result = CliRunner().invoke(ROOT, [*words, "--help"], prog_name="unocclude", terminal_width=80)
    assert result.exit_code == 0
    return result.output


@pytest.mark.parametrize("group", [(), ("import",), ("calibrate",), ("simulate",)], ids=" ".join)
def test_the_list_has_whole_sentences_on_a_line_each(group: tuple[str, ...]):
    listed = shown(*group).partition("Commands:\n")[2].partition("\n\n")[0].splitlines()
    sentences = [line.split(maxsplit=1)[1] for line in listed]
    context = typer.Context(ROOT)
    here = ROOT if not group else ROOT.get_command(context, group[0])
    assert len(sentences) == len(here.list_commands(context))
    assert all(sentence.endswith(".") and "..." not in sentence for sentence in sentences), sentences


@pytest.mark.parametrize("words", COMMANDS, ids=" ".join)
def test_every_option_is_shown_once_and_rare_ones_last(words: tuple[str, ...]):
    text = shown(*words).partition("\n  Example: ")[0]
    text = text[text.index("Options:") :]
    flags = [max(each.opts, key=len) for each in COMMANDS[words].params if each.param_type_name == "option"]
    for flag in flags:
        starts = [line.split()[0:2] for line in text.splitlines() if line.startswith("  -")]
        assert sum(flag in [word.rstrip(",") for word in start] for start in starts) == 1, flag
    head, found, rare = text.partition(f"{help_page.ADVANCED}:\n")
    assert text.startswith("Options:\n") and "--help" in head
    assert not found or "Options:\n" not in rare


def test_the_settings_of_a_simulation_are_in_groups():
    text = shown("simulate", "arm")
    first = text.partition("Options:\n")[2].partition("\n\n")[0]
    assert sum(line.startswith("  -") for line in first.splitlines()) < 12
    for group in ("Movement", "Occlusions", "Camera", "IMUs", "Several cameras", "Motion capture"):
        assert f"\n{group}" in text
    assert "--tremor-rad" in text.partition("Advanced:\n")[2]


def test_the_groups_name_options_that_exist():
    options = {
        max(option.opts, key=len).lstrip("-") for command in COMMANDS.values() for option in command.params
    } | {"help"}
    tables = (*help_page._SHARED.values(), *help_page._SIMULATED.values(), help_page._SIMULATED_FIRST)
    missing = {name for table in tables for name in table} - options
    assert not missing, missing
