"""`unocclude simulate people`: several people, both arms of each, and IMUs that nobody labelled."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import typer

from .options import Force, Json, Output, Seed
from .output import check_mcap, check_outputs, print_table, say_written, write_json
from .simulate import PresetName, preset_names

if TYPE_CHECKING:
    from pydantic.fields import FieldInfo

#: Settings of an arm that each person draws for themselves, or that a crowd has no use for.
_NOT_OURS = {"side", "strap", "belly", "frozen_gaps", "swapped_gaps", "still_all"}


def people(
    output: Output,
    preset: PresetName = "realistic",
    seed: Seed = 0,
    json_file: Json = None,
    force: Force = False,
    **settings: Any,
) -> None:
    """Simulate people before one camera with shuffled IMUs whose names say nothing.

    The truth, which IMU is where, is printed and goes to --json. The settings of the arms that are not given
    come from the preset.
    """
    from pydantic import ValidationError

    from ..io import write_recording
    from ..io.recording.write import as_session
    from ..simulation import ArmSimulation, PeopleSimulation, simulate_people
    from .config_file import describe
    from .simulate import parsed_setting, taken

    if preset not in preset_names():
        raise typer.BadParameter(f"there is no preset '{preset}'; presets: {', '.join(preset_names())}")
    changes = {name: value for name, value in settings.items() if value is not None}
    try:
        crowd = PeopleSimulation(**taken(changes, PeopleSimulation))
        usual = {"protocol": "random", "duration_s": 20.0}
        parsed = {name: parsed_setting(name, value) for name, value in changes.items()}
        config = ArmSimulation.preset(preset, **(usual | parsed))
        check_mcap(output)
        check_outputs(force, [output, json_file])
        simulated = simulate_people(crowd, config, seed)
    except ValidationError as error:
        raise typer.BadParameter(f"setting {describe(error)}") from error
    except ValueError as error:
        raise typer.BadParameter(str(error)) from error
    imus = [one.stream for one in simulated.worn]
    write_recording(
        as_session(simulated.name, imus, simulated.arms, simulated.camera_frame), output, force=force
    )
    rows = [(one.stream.name, one.body, one.joint, one.clock_offset_s) for one in simulated.worn]
    figures: dict[str, Any] = {
        "seed": seed,
        "people": crowd.model_dump(mode="json"),
        "config": config.model_dump(mode="json"),
        "truth": [
            {"imu": name, "body": body, "joint": joint, "clock_offset_s": offset}
            for name, body, joint, offset in rows
        ],
    }
    write_json(json_file, figures, force)
    print_table(simulated.name, ("IMU", "body", "joint", "its clock is ahead, s"), rows)
    say_written(output, json_file)


def settings() -> dict[str, FieldInfo]:
    """Every setting by name: of the people, then of their arms."""
    from ..simulation import ArmSimulation, PeopleSimulation

    arms = {name: field for name, field in ArmSimulation.model_fields.items() if name not in _NOT_OURS}
    return {**PeopleSimulation.model_fields, **arms}
