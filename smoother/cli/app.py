"""All commands on one page, each imported when it is asked for; how `--help` shows them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from importlib import import_module
from typing import Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup

ADVANCED = "Advanced"


#: Options that several commands share, by group.
_SHARED = {
    "Which arm": ("imu", "skeleton", "side", "body"),
    "Correct a wrong set-up": ("mirror", "swap", "negate", "camera-frame", "clock-offset", "clock-sigma"),
    ADVANCED: (
        *("config", "orientation", "boundary-s", "solve-lever-arms", "processes", "draws", "seed", "anatomy"),
        "body-height",
        *("live", "latency", "gaps-per-run", "scheduler", "retry-failed", "time-limit"),
        *("hash-names", "outside", "skeleton-format", "imu-format", "wait"),
        *("one-session", "port", "lsl-out", "gravity", "mocap-sigma-mm", "panel-topic"),
        *("base-topic", "colour-topic", "depth-topic", "sound-clocks", "motion-clocks", "audio-topic"),
        *("audio-rate-hz", "sound-start", "tone-hz", "distance-m", "resolution-ms"),
    ),
}


#: Commands whose --imu and --skeleton name what they read, and not one of several.
_OWN_STREAMS = ("live", "import files", "match", "calibrate imu", "calibrate magnetometer")


def group_of(command: str, option: str) -> str:
    """The group under which an option is shown, "" for those that come first."""
    if command in _OWN_STREAMS and option in _SHARED["Which arm"]:
        return ""
    if command.startswith("simulate "):
        return ""
    return next((group for group, names in _SHARED.items() if option in names), "")


class GroupedCommand(TyperCommand):
    """A command whose help has its options in groups."""

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write arguments, then the options of every group, those that are rarely needed last."""
        command = ctx.command_path.partition(" ")[2]
        groups: dict[str, list[tuple[str, str]]] = {"Arguments": [], "": []}
        for group in _SHARED:
            groups.setdefault(group, [])
        for parameter in self.get_params(ctx):
            record = parameter.get_help_record(ctx)
            if record is None:
                continue
            if parameter.param_type_name == "argument":
                groups["Arguments"].append(record)
            else:
                flag = max(parameter.opts, key=len).lstrip("-")
                groups[group_of(command, flag)].append(record)
        groups[ADVANCED] = groups.pop(ADVANCED)  # last
        for group, records in groups.items():
            if records:
                with formatter.section(group or "Options"):
                    formatter.write_dl(records)


class WholeSentences(TyperGroup):
    """A group whose list of commands has the whole first sentence of each."""

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write the commands, each with its first sentence."""
        names = self.list_commands(ctx)
        commands = [(name, self.get_command(ctx, name)) for name in names]
        rows = [(name, each.get_short_help_str(limit=200)) for name, each in commands if each is not None]
        with formatter.section("Commands"):
            formatter.write_dl(rows)


@dataclass(frozen=True)
class CommandSpec:
    """Where a command is."""

    module: str  # Of this package; its function has the command's name, with `_` for `-`
    epilog: str  # Text below its help: an example
    cls: str = ""  # The command's class in the module, where it is not typer's
    has_settings: bool = False  # `--set` takes the settings that the module's `NAME_settings()` gives

    def command(self, name: str) -> Any:
        """The command, imported now."""
        from .options import with_groups

        module = import_module(f".{self.module}", __package__)
        settings = getattr(module, f"{name}_settings")() if self.has_settings else None
        function = with_groups(getattr(module, name.replace("-", "_")), settings)
        app = typer.Typer(add_completion=False, rich_markup_mode=None)
        cls = getattr(module, self.cls) if self.cls else GroupedCommand
        app.command(name, cls=cls, epilog=self.epilog)(function)
        return typer.main.get_command(app)


class LazyCommands(Mapping[str, Any]):
    """Commands by name; each is imported when it is looked up."""

    def __init__(self, specs: Mapping[str, CommandSpec], groups: Mapping[str, Any]) -> None:
        self._specs, self._commands = specs, dict(groups)
        self._names = [*specs, *groups]

    def __getitem__(self, name: str) -> Any:
        if name not in self._commands:
            self._commands[name] = self._specs[name].command(name)
        return self._commands[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __len__(self) -> int:
        return len(self._names)


def lazy_group(specs: Mapping[str, CommandSpec]) -> type[WholeSentences]:
    """A kind of group that contains commands."""

    class LazyGroup(WholeSentences):
        def __init__(self, *, commands: Any = None, **attributes: Any) -> None:
            super().__init__(commands=commands, **attributes)
            self.commands = LazyCommands(specs, self.commands)  # type: ignore[assignment]

        def list_commands(self, ctx: Any) -> list[str]:
            return list(self.commands)

    return LazyGroup


_CSV_EXAMPLE = """Example: unocclude import csv session -o session.mcap

\b
session/recording.toml:
  [camera]
  frame = "kinect"            # or "optical", "zup"
  skeleton = "skeleton.csv"   # t_s, joint, x, y, z, state [, body]
  [imu.forearm_right]
  file = "imu.csv"            # t_s, ax, ay, az, gx, gy, gz [, mx, my, mz]
  accelerometer_unit = "g"    # or "m/s^2"
  gyroscope_unit = "deg/s"    # or "rad/s"
  [truth]                     # optional
  file = "truth.csv"          # t_s, x, y, z, qw, qx, qy, qz
"""


def _spec(module: str, example: str, cls: str = "", has_settings: bool = False) -> CommandSpec:
    """A command with an example of its use below its help."""
    return CommandSpec(module, f"Example: unocclude {example}", cls, has_settings)


_COMMANDS = {
    "app": _spec("demo", "app --folder recordings"),
    "demo": _spec("demo", "demo"),
    "info": _spec("recordings", "info session.mcap"),
    "check": _spec("recordings", "check session.mcap --json check.json"),
    "match": _spec("recordings", "match session.mcap --json matches.json"),
    "repair": _spec("recordings", "repair broken.mcap -o whole.mcap --json lost.json"),
    "cut": _spec("cut", "cut session.mcap --trials trials.csv -o trials"),
    "smooth": _spec("smooth", "smooth session.mcap -o out.mcap --calibration arm.toml --report out.html"),
    "validate": _spec(
        "validate", "validate out.mcap --truth trial.c3d --markers map.toml --calibration rig.toml"
    ),
    "compare": _spec("compare", "compare session.mcap --truth trial.c3d --markers map.toml --report c.html"),
    "measures": _spec("measures", "measures out.mcap --csv measures.csv --json measures.json"),
    "gaps": _spec("gaps", "gaps session.mcap --lengths 0.5,1,2,3 --seed 1 --json gaps.json"),
    "benchmark": _spec("benchmark", "benchmark --data datasets -o benchmark"),
    "export": _spec("export", "export recovered.mcap --format trc -o recovered.trc"),
    "methods": _spec("export", "methods recovered.mcap -o methods.md"),
    "view": _spec("view", "view recovered.mcap"),
    "batch": _spec("batch", "batch sessions -o recovered --calibration arm.toml --report", "BatchCommand"),
    "progress": _spec("progress", "progress recovered --person p12 --report p12.html"),
    "live": _spec(
        "live",
        "live --imu wrist --skeleton kinect --side right --record session.mcap --foxglove",
        "LiveCommand",
    ),
    "config": _spec("demo", "config > settings.toml"),
    "doctor": _spec("demo", "doctor"),
}
_IMPORTS = {
    "csv": CommandSpec("imports", _CSV_EXAMPLE),
    "files": _spec(
        "imports", "import files --skeleton azure.csv --imu forearm_right=dot.csv -o session.mcap"
    ),
    "video": _spec(
        "import_video",
        "import video phone.mp4 --model pose_landmarker_full.task --imu dot.csv -o session.mcap",
    ),
    "formats": _spec("imports", "import formats"),
    "describe": _spec("imports", "import describe sensor.csv > session/recording.toml"),
    "broad": _spec("imports", "import broad 01_trial.mat -o trial.mcap"),
    "utd-mhad": _spec("imports", "import utd-mhad a1_s1_t1_inertial.mat a1_s1_t1_skeleton.mat -o t.mcap"),
    "strap": _spec("imports", "import strap session.mcap -o with_strap.mcap"),
}
_CALIBRATIONS = {
    "motion": _spec("calibrate", "calibrate motion a.mcap b.mcap -o arm.toml"),
    "imu": _spec("calibrate", "calibrate imu poses.mcap -o arm.toml --report imu.html"),
    "magnetometer": _spec("calibrate", "calibrate magnetometer turning.mcap -o arm.toml"),
    "clock": _spec(
        "calibrate_rig",
        "calibrate clock --sound beep.wav --event-time 12.3456 --broadcast times.csv",
    ),
    "panel": _spec(
        "calibrate_rig",
        "calibrate panel --depth d.png --infrared i.png --markers m.csv --intrinsics k.toml"
        " --panel panel.toml -o cal.toml",
    ),
    "world": _spec("calibrate_rig", "calibrate world session.mcap --panel panel.toml -o cal.toml"),
    "cameras": _spec("calibrate", "calibrate cameras session.mcap -o cal.toml"),
    "forearm": _spec("calibrate", "calibrate forearm session.mcap -o arm.toml --report forearm.html"),
}
_SIMULATIONS = {
    "arm": _spec(
        "simulate", "simulate arm -o sim.mcap --preset realistic --repetitions 3 --seed 7", has_settings=True
    ),
    "clock": _spec("simulate_rig", "simulate clock -o session --seed 7"),
    "imu": _spec("simulate_rig", "simulate imu -o poses.mcap --seed 7"),
    "magnetometer": _spec("simulate_rig", "simulate magnetometer -o turning.mcap --seed 7"),
    "panel": _spec(
        "simulate_rig",
        "simulate panel -o session --poses 8 --seed 7 --mcap session.mcap",
        has_settings=True,
    ),
    "people": _spec(
        "simulate",
        "simulate people -o people.mcap --people 2 --sensors 4 --seed 7",
        has_settings=True,
    ),
    "strap": _spec("simulate", "simulate strap -o session.mcap --seed 7"),
}


def _app(help_text: str, commands: Mapping[str, CommandSpec]) -> typer.Typer:
    return typer.Typer(
        help=help_text,
        cls=lazy_group(commands),
        no_args_is_help=True,
        add_completion=False,
        rich_markup_mode=None,
        pretty_exceptions_enable=False,
        context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110},
    )


app = _app("Recover arm motion that a depth camera could not see, with a wrist IMU.", _COMMANDS)


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


for _name, _help, _commands in (
    ("import", "Make a recording from other files.", _IMPORTS),
    ("calibrate", "Measure once what does not change; write a calibration file.", _CALIBRATIONS),
    ("simulate", "Simulate recordings with truth.", _SIMULATIONS),
):
    app.add_typer(_app(_help, _commands), name=_name)
