"""`unocclude simulate`: recordings with truth. Every setting of the simulation is an option."""

from __future__ import annotations

import inspect
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_args

import typer
from typer.core import TyperGroup

from .option_groups import with_signature
from .options import Force, Json, Output, Seed
from .output import check_mcap, check_outputs, print_table, say_written, write_json

if TYPE_CHECKING:
    from pydantic.fields import FieldInfo

CalibrationOut = Annotated[
    Path | None,
    typer.Option("--calibration-out", metavar="CAL.toml", help="Also write the true calibration of the arm."),
]
Mocap = Annotated[
    bool,
    typer.Option(
        "--mocap",
        help="Also write what a motion capture of 15 markers would deliver, beside FILE: .c3d, .trc, "
        "_markers.toml (the map for --markers), and the calibration with [camera_from_mocap].",
    ),
]
PresetName = Annotated[
    str, typer.Option("--preset", metavar="white|realistic|azure|clean", help="Set of errors to start from.")
]


Arms = Annotated[
    str,
    typer.Option(
        "--arms",
        metavar="one|both",
        help="Both arms of one person, each with its IMU or IMUs; --side is the first.",
    ),
]

#: Commands by name: the module that holds them, and an example of their use.
_COMMANDS = {
    "arm": ("simulate", "arm -o sim.mcap --preset realistic --repetitions 3 --seed 7"),
    "clock": ("simulate_clock", "clock -o session --seed 7"),
    "imu": ("simulate_sensor", "imu -o poses.mcap --seed 7"),
    "magnetometer": ("simulate_sensor", "magnetometer -o turning.mcap --seed 7"),
    "panel": ("simulate_panel", "panel -o session --poses 8 --seed 7 --mcap session.mcap"),
    "people": ("simulate_people", "people -o people.mcap --people 2 --sensors 4 --seed 7"),
    "strap": ("simulate_strap", "strap -o session.mcap --seed 7"),
}


class SimulateGroup(TyperGroup):
    """Makes a command when it is asked for: its options are the simulation's settings, slow to read."""

    def list_commands(self, ctx: Any) -> list[str]:
        """Names of the commands."""
        return list(_COMMANDS)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """The command of a name, or None."""
        if cmd_name not in _COMMANDS:
            return None
        home, example = _COMMANDS[cmd_name]
        module = import_module(f".{home}", __package__)
        command = getattr(module, cmd_name)
        if "settings" in inspect.signature(command).parameters:
            command = with_settings(command, module.settings())
        app = typer.Typer(add_completion=False, rich_markup_mode=None)
        app.command(cmd_name, epilog=f"Example: unocclude simulate {example}")(command)
        return typer.main.get_command(app)


def arm(
    output: Output,
    calibration_out: CalibrationOut = None,
    preset: PresetName = "white",
    seed: Seed = 0,
    mocap: Mocap = False,
    arms: Arms = "one",
    json_file: Json = None,
    force: Force = False,
    **settings: Any,
) -> None:
    """Simulate an arm with a wrist IMU before a depth camera, with truth.

    The settings that are not given come from the preset. Their defaults here are those of `white`.
    """
    from pydantic import ValidationError

    from ..io import write_recording
    from ..simulation import ArmSimulation, MocapSimulation, capture, simulate_arm, simulate_both_arms
    from .config_file import describe
    from .mocap_files import MocapFiles

    names = preset_names()
    if preset not in names:
        raise typer.BadParameter(f"there is no preset '{preset}'; presets: {', '.join(names)}")
    changes = {name: parsed_setting(name, value) for name, value in settings.items() if value is not None}
    try:
        mocap_config = MocapSimulation(**taken(changes, MocapSimulation))
        config = ArmSimulation.preset(preset, **changes)
    except ValidationError as error:
        raise typer.BadParameter(f"setting {describe(error)}") from error
    if not mocap and mocap_config != MocapSimulation():
        raise typer.BadParameter("the settings of markers and mocap need --mocap")
    if arms not in ("one", "both"):
        raise typer.BadParameter(f"--arms is one or both, not '{arms}'")
    if mocap and arms == "both":
        raise typer.BadParameter("--mocap captures one arm; leave out --arms both")
    files = MocapFiles.beside(output, calibration_out) if mocap else None
    calibration_out = files.calibration if files else calibration_out
    check_mcap(output)
    outputs = [output, calibration_out, *(files.markers if files else ()), json_file]
    check_outputs(force, outputs)
    both = simulate_both_arms(config, seed) if arms == "both" else (simulate_arm(config, seed),)
    simulated = both[0]
    markers = capture(simulated, mocap_config, seed) if files else None
    write_recording([one.recording for one in both], output, force=force)
    if calibration_out is not None:
        _write_calibration([one.calibration for one in both], markers, calibration_out, force)
    figures = {"seed": seed, "preset": preset, "config": config.model_dump(mode="json")}
    if files is not None and markers is not None:
        files.write(markers, force)
        found = {"offset_s": markers.offset_s, "skew_ppm": markers.skew_ppm} | markers.extrinsics
        figures["mocap"] = mocap_config.model_dump(mode="json") | found
    figures["parameters"] = simulated.parameters
    if len(both) > 1:
        figures["arms"] = [{"side": one.recording.side, "parameters": one.parameters} for one in both]
    write_json(json_file, figures, force)
    recording = simulated.recording
    rows: list[tuple[str, object]] = [
        ("length, s", f"{recording.imu.t_s[-1] - recording.imu.t_s[0]:.1f}"),
        ("IMU samples", len(recording.imu)),
        ("camera frames", len(recording.arm)),
    ]
    for one in both:
        which = f", {one.recording.side} arm" if len(both) > 1 else ""
        rows.append((f"occluded frames{which}", int(one.occluded.sum())))
    if markers is not None:
        rows.append(("mocap frames, 15 markers", len(markers.position)))
    print_table(recording.name, ("what", "value"), rows)
    say_written(*outputs)


def preset_names() -> list[str]:
    """Names of the presets."""
    from ..simulation import Preset

    return [preset.value for preset in Preset]


def taken(changes: dict[str, Any], model: Any) -> dict[str, Any]:
    """The settings of a model, taken out of `changes`."""
    return {name: changes.pop(name) for name in list(changes) if name in model.model_fields}


def _write_calibration(calibrations: list[Any], markers: Any, path: Path, force: bool) -> None:
    from calib.file import CalibrationFile, calibration_text

    from ..runtime.atomic import writing

    file = CalibrationFile()
    for calibration in calibrations:
        file = file.with_arm(calibration)
    if markers is not None:
        file = file.with_table("camera_from_mocap", markers.extrinsics)
    with writing(path, force) as temporary:
        temporary.write_text(calibration_text(file, path), encoding="utf-8", newline="\n")


def with_settings(command: Any, settings: dict[str, FieldInfo]) -> Any:
    """The command with an option for every setting of a simulation."""
    own = [p for p in inspect.signature(command, eval_str=True).parameters.values() if p.name != "settings"]
    taken = {parameter.name for parameter in own}
    fields = {name: field for name, field in settings.items() if name not in taken}
    more = [
        inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=None, annotation=_option(name, field))
        for name, field in fields.items()
    ]

    def run(**values: Any) -> None:
        command(**values)

    return with_signature(run, command, own + more)


def settings() -> dict[str, FieldInfo]:
    """Every setting of the simulation by name."""
    from ..simulation import ArmSimulation, MocapSimulation

    return {**ArmSimulation.model_fields, **MocapSimulation.model_fields}


def _option(name: str, field: FieldInfo) -> Any:
    """The option of a setting; None where it is not given."""
    flag = "--" + name.replace("_", "-")
    default = field.get_default()
    text = _shown(default)
    about = ". ".join(part for part in (field.description, f"[{text}]") if part)
    if isinstance(default, bool):
        return Annotated[bool | None, typer.Option(f"{flag}/--no-{flag[2:]}", help=about, show_default=False)]
    kind: Any = str
    if isinstance(default, int):
        kind = int
    elif isinstance(default, float) or (default is None and float in get_args(field.annotation)):
        kind = float
    metavar = "|".join(_choices(field)) or {int: "N", float: "X", str: "X,X,.."}[kind]
    return Annotated[kind | None, typer.Option(flag, metavar=metavar, help=about, show_default=False)]


def _choices(field: FieldInfo) -> list[str]:
    """Values that a setting may take, where they are named."""
    if hasattr(field.annotation, "__members__"):
        return [str(member.value) for member in field.annotation]  # type: ignore[union-attr]
    return [value for value in get_args(field.annotation) if isinstance(value, str)]


def _shown(default: Any) -> str:
    if default is None:
        return "none"
    if isinstance(default, tuple):
        return ",".join(str(item) for item in default)
    return str(default.value if hasattr(default, "value") else default).lower()


def parsed_setting(name: str, value: Any) -> Any:
    """A list of numbers for the settings that are one, the value as it is for the others."""
    if not isinstance(settings()[name].get_default(), tuple):
        return value
    try:
        return tuple(float(part) for part in str(value).split(",") if part.strip())
    except ValueError:
        raise typer.BadParameter(
            f"--{name.replace('_', '-')} takes numbers, as 0.5,1; not '{value}'"
        ) from None
