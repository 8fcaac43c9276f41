"""`unocclude simulate arm`: a recording with truth. Every setting of the simulation is an option."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

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

    from ..runtime.outputs import writing

    file = CalibrationFile()
    for calibration in calibrations:
        file = file.with_arm(calibration)
    if markers is not None:
        file = file.with_table("camera_from_mocap", markers.extrinsics)
    with writing(path, force) as temporary:
        temporary.write_text(calibration_text(file, path), encoding="utf-8", newline="\n")


def settings() -> dict[str, FieldInfo]:
    """Every setting of the simulation by name."""
    from ..simulation import ArmSimulation, MocapSimulation

    return {**ArmSimulation.model_fields, **MocapSimulation.model_fields}


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
