"""What is written into pages as they are read: the commands, the settings, and pages that no list names.

A page has one of the marks below on a line of its own. So the reference cannot fall behind the program, and a
page that somebody adds appears without a change elsewhere.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

COMMANDS, SETTINGS, OTHERS = "% every command", "% every setting", "% every other page"


def leaves(command: Any, words: tuple[str, ...]) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Every command that does something, with its words, in the order of `--help`."""
    import typer

    context = typer.Context(command, info_name=" ".join(words))
    if not hasattr(command, "list_commands"):
        yield words, command
        return
    for name in command.list_commands(context):
        yield from leaves(command.get_command(context, name), (*words, name))


def commands() -> str:
    """What every command does, its options and its example, as Markdown."""
    import typer

    from smoother.cli.app import app

    return "\n".join(
        command_text(words, command) for words, command in leaves(typer.main.get_command(app), ())
    )


def command_text(words: tuple[str, ...], command: Any) -> str:
    """One command as a section."""
    import typer

    context = typer.Context(command, info_name="unocclude " + " ".join(words))
    usage = " ".join(command.get_usage(context).removeprefix("Usage: ").split())
    lines = [f"## unocclude {' '.join(words)}", "", plain(command.help), "", "```", usage, "```", ""]
    example = plain(command.epilog).removeprefix("Example: ")
    if example:
        lines += ["For example:", "", "```sh", example, "```", ""]
    records = [option_record(parameter, context) for parameter in command.get_params(context)]
    rows = [record for record in records if record is not None]
    if rows:
        lines += [
            "| option | what it does |",
            "|---|---|",
            *(f"| {name} | {text} |" for name, text in rows),
            "",
        ]
    return "\n".join(lines)


def option_record(parameter: Any, context: Any) -> tuple[str, str] | None:
    """An option's or argument's name and help, as `--help` has them, for a table."""
    record = parameter.get_help_record(context)
    if record is None or "--help" in parameter.opts:
        return None
    name, text = (plain(part).replace("|", "\\|") for part in record)
    return f"`{name}`", re.sub(r"(--[a-z][a-z-]*)", r"`\1`", text.replace("<", "\\<").replace("*", "\\*"))


def plain(text: str | None) -> str:
    """Text on one line, as typer keeps it in help texts with control characters."""
    return " ".join((text or "").replace("\b", " ").split())


def settings() -> str:
    """The configuration as `unocclude config` prints it."""
    from smoother.cli.config import to_toml
    from smoother.config import Config

    return f"```toml\n{to_toml(Config()).strip()}\n```\n"


def other_pages(folder: Path) -> str:
    """A hidden list of the pages that no page's own list names, in the order of README's links."""
    lists = re.compile(r"^```{toctree}\n(.*?)^```", re.DOTALL | re.MULTILINE)
    named = {"index"}
    for page in folder.glob("*.md"):
        for listed in lists.findall(page.read_text(encoding="utf-8")):
            named |= {re.sub(r".*<(.*)>", r"\1", line).strip() for line in listed.splitlines()}
    linked = (folder.parent / "README.md").read_text(encoding="utf-8")
    rest = {page.stem for page in folder.glob("*.md")} - named
    rest = sorted(rest, key=lambda stem: (linked.find(f"docs/{stem}.md") % (len(linked) + 1), stem))
    return "\n".join(["```{toctree}", ":hidden:", "", *rest, "```", ""]) if rest else ""


def write(app: Any, docname: str, source: list[str]) -> None:
    """Put the texts where the marks are."""
    texts = {COMMANDS: commands, SETTINGS: settings, OTHERS: lambda: other_pages(Path(app.srcdir))}
    for mark, text in texts.items():
        if f"\n{mark}\n" in source[0]:
            source[0] = source[0].replace(f"\n{mark}\n", f"\n{text()}\n")


def setup(app: Any) -> dict[str, Any]:
    """Connect with Sphinx."""
    app.connect("source-read", write)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
