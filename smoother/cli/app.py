"""All commands on one page, each imported when it is asked for; how `--help` shows them."""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from importlib import import_module
from typing import Annotated, Any, ClassVar

import typer
from typer.core import TyperCommand, TyperGroup

from .options import PANELS


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


def imported(module: str, name: str) -> Any:
    """A command of a module; the last paragraph of its docstring is its example, shown below the options."""
    place = import_module(f".{module}", __package__)
    function = getattr(place, name.replace("-", "_"))
    text, _, example = (inspect.getdoc(function) or "").partition("\n\nExample: ")
    epilog = "Example: " + example.replace("\n\n", "\n\n\b\n")  # what follows the line keeps its lines
    app = typer.Typer(add_completion=False, rich_markup_mode=None)
    app.command(name, cls=Command, help=text, epilog=epilog)(function)
    command = typer.main.get_command(app)
    command.alone = getattr(place, "ALONE", {})  # type: ignore[attr-defined]
    return command


class Commands(TyperGroup):
    """A group whose commands are imported when they are looked up; its list has whole sentences."""

    modules: ClassVar[Mapping[str, str]] = {}  # Of this package, by command

    def __init__(self, *, commands: Any = None, **attributes: Any) -> None:
        everything: Any = {**self.modules, **(commands or {})}
        super().__init__(commands=everything, **attributes)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """The command of a name, or None."""
        command: Any = self.commands.get(cmd_name)
        if isinstance(command, str):
            command = self.commands[cmd_name] = imported(command, cmd_name)
        return command

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write the commands, each with its first sentence."""
        rows = [(name, self.get_command(ctx, name).get_short_help_str(limit=200)) for name in self.commands]
        with formatter.section("Commands"):
            formatter.write_dl(rows)


class _Root(Commands):
    modules: ClassVar[Mapping[str, str]] = {
        **dict.fromkeys(("app", "demo"), "demo"),
        **dict.fromkeys(("info", "check", "match", "repair", "cut"), "recordings"),
        **{name: name for name in ("smooth", "validate", "compare", "measures", "gaps", "benchmark")},
        **dict.fromkeys(("export", "methods"), "export"),
        **{name: name for name in ("view", "batch", "progress", "live")},
        **dict.fromkeys(("config", "doctor"), "demo"),
    }


class _Imports(Commands):
    names = ("csv", "files", "video", "formats", "describe", "broad", "utd-mhad", "strap")
    modules: ClassVar[Mapping[str, str]] = dict.fromkeys(names, "imports")


class _Calibrations(Commands):
    modules: ClassVar[Mapping[str, str]] = {
        "motion": "calibrate",
        "imu": "calibrate",
        "magnetometer": "calibrate",
        "clock": "calibrate_rig",
        "panel": "calibrate_rig",
        "world": "calibrate_rig",
        "cameras": "calibrate",
        "forearm": "calibrate",
    }


class _Simulations(Commands):
    names = ("arm", "clock", "imu", "magnetometer", "panel", "people", "strap")
    modules: ClassVar[Mapping[str, str]] = dict.fromkeys(names, "simulate")


def _app(help_text: str, kind: type[Commands]) -> typer.Typer:
    return typer.Typer(
        help=help_text,
        cls=kind,
        no_args_is_help=True,
        add_completion=False,
        rich_markup_mode=None,
        pretty_exceptions_enable=False,
        context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110},
    )


app = _app("Recover arm motion that a depth camera could not see, with a wrist IMU.", _Root)


def _version(wanted: bool) -> None:
    if wanted:
        from .. import __version__

        print(f"unocclude {__version__}")
        raise typer.Exit


@app.callback(epilog="Example: unocclude smooth session.mcap -o recovered.mcap --report report.html")
def _root(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    """Recover arm motion that a depth camera could not see, with a wrist IMU."""


for _name, _help, _kind in (
    ("import", "Make a recording from other files.", _Imports),
    ("calibrate", "Measure once what does not change; write a calibration file.", _Calibrations),
    ("simulate", "Simulate recordings with truth.", _Simulations),
):
    app.add_typer(_app(_help, _kind), name=_name)
