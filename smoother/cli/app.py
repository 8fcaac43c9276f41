"""All commands, each imported when it is asked for; what their options are, and how `--help` shows them."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass
from functools import wraps
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any, ClassVar, get_type_hints

import typer
from typer.core import TyperCommand, TyperGroup

from .options import ADDED_TO, PANELS, SHARED, UNCHECKED, WRITTEN


class Command(TyperCommand):
    """A command whose help has its options in panels, those that are rarely needed last."""

    alone: Mapping[str, str] = {}  # Options that may stand without a value, and the one that they have then

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Give an option that stands alone its value."""
        complete: list[str] = []
        for arg, follows in zip(args, [*args, "-"][1:], strict=True):
            complete.append(arg)
            if arg in self.alone and follows.startswith("-"):
                complete.append(self.alone[arg])
        return list(super().parse_args(ctx, complete))

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write the arguments, then the options of every panel."""
        rows: dict[str, list[tuple[str, str]]] = {panel: [] for panel in PANELS}
        for parameter in self.get_params(ctx):
            if (record := parameter.get_help_record(ctx)) is not None:
                panel = getattr(parameter, "rich_help_panel", None) or "Options"
                rows["Arguments" if parameter.param_type_name == "argument" else panel].append(record)
        for panel, records in rows.items():
            if records:
                with formatter.section(panel):
                    formatter.write_dl(records)


def flat(function: Callable[..., None]) -> Callable[..., None]:
    """A command with the fields of its groups of options, which are dataclasses, as options of its own.

    Where one of the groups is `Out`, the files that it reads and writes are checked first.
    """
    own: list[inspect.Parameter] = []
    grouped: list[inspect.Parameter] = []
    groups: dict[str, Any] = {}
    for name, parameter in inspect.signature(function, eval_str=True).parameters.items():
        if is_dataclass(group := parameter.annotation):
            groups[name], hints = group, get_type_hints(group, include_extras=True)
            grouped += [
                parameter.replace(name=each.name, default=each.default, annotation=hints[each.name])
                for each in fields(group)
            ]
        else:
            own.append(parameter)
    shown = [each.replace(kind=inspect.Parameter.KEYWORD_ONLY) for each in (*own, *grouped)]

    @wraps(function)
    def command(**given: Any) -> None:
        only_lists = "list" in (given.get("settings") or ())  # what can be set; nothing is written
        files: dict[str, list[Path]] = {WRITTEN: [], ADDED_TO: [], SHARED: [], UNCHECKED: [], "read": []}
        for each in shown:
            marks = [mark for mark in getattr(each.annotation, "__metadata__", ()) if mark in files]
            paths = value if isinstance(value := given[each.name], list) else [value]
            files[marks[0] if marks else "read"] += [path for path in paths if isinstance(path, Path)]
        for name, group in groups.items():
            given[name] = group(**{each.name: given.pop(each.name) for each in fields(group)})
            if hasattr(given[name], "check_files") and not only_lists:
                given[name].check_files(files[WRITTEN], files[ADDED_TO], files["read"], files[SHARED])
        function(**given)

    command.__signature__ = inspect.Signature(shown)  # type: ignore[attr-defined]
    return command


class Commands(TyperGroup):
    """A group whose commands are imported when they are looked up; its list has whole sentences."""

    modules: ClassVar[Mapping[str, str]] = {}  # Of this package, each with its commands

    def __init__(self, *, commands: Any = None, **attributes: Any) -> None:
        everything: Any = {name: place for place, names in self.modules.items() for name in names.split()}
        super().__init__(commands=everything | (commands or {}), **attributes)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """The command of a name, or None.

        The last paragraph of its docstring is its example, shown below the options.
        """
        known: Any = self.commands.get(cmd_name)
        if not isinstance(known, str):
            return known
        place = import_module(f".{known}", __package__)
        function = getattr(place, cmd_name.replace("-", "_"))
        text, _, example = (inspect.getdoc(function) or "").partition("\n\nExample: ")
        epilog = "Example: " + example.replace("\n\n", "\n\n\b\n")  # what follows the line keeps its lines
        own = typer.Typer(add_completion=False, rich_markup_mode=None)
        own.command(cmd_name, cls=Command, help=text, epilog=epilog)(flat(function))
        command: Any = typer.main.get_command(own)
        command.alone = getattr(place, "ALONE", {})
        self.commands[cmd_name] = command
        return command

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write the commands, each with its first sentence."""
        rows = [(name, self.get_command(ctx, name).get_short_help_str(limit=200)) for name in self.commands]
        with formatter.section("Commands"):
            formatter.write_dl(rows)


def _group(help_text: str, **modules: str) -> typer.Typer:
    """A group of the commands of some modules."""
    return typer.Typer(
        help=help_text,
        cls=type("Group", (Commands,), {"modules": modules}),
        no_args_is_help=True,
        add_completion=False,
        rich_markup_mode=None,
        pretty_exceptions_enable=False,
        context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110},
    )


PURPOSE = "Recover arm motion that a depth camera could not see, with a wrist IMU."
app = _group(
    PURPOSE,
    demo="app demo",
    recordings="info check match repair cut",
    smooth="smooth",
    evaluation="validate compare gaps benchmark measures progress",
    export="export methods view",
    batch="batch",
    live="live",
    config="config doctor",
)


def _version(wanted: bool) -> None:
    if wanted:
        from .. import __version__

        print(f"unocclude {__version__}")
        raise typer.Exit


_Version = Annotated[
    bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version.")
]


@app.callback(
    help=PURPOSE, epilog="Example: unocclude smooth session.mcap -o recovered.mcap --report report.html"
)
def _root(version: _Version = False) -> None:
    pass


_imports = _group(
    "Make a recording from other files.", imports="csv files video formats describe broad utd-mhad strap"
)
app.add_typer(_imports, name="import")
_calibrations = _group(
    "Measure once what does not change; write a calibration file.",
    calibrate="motion imu magnetometer cameras forearm clock panel world",
)
app.add_typer(_calibrations, name="calibrate")
_simulations = _group(
    "Simulate recordings with truth.", simulate="arm people strap imu magnetometer panel clock"
)
app.add_typer(_simulations, name="simulate")
