"""`unocclude calibrate cameras`: where the further cameras of a set-up stand, found once and kept."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from .calibrate import CalibrationOutput, load_existing_calibration, say_answer, write_answer
from .load import load_arm
from .options import ANY_ARM, ArmSelection, Json, Outputs
from .output import print_table


def cameras(
    recording_files: Annotated[
        list[Path],
        typer.Argument(metavar="REC.mcap..", help="Recordings of the set-up.", show_default=False),
    ],
    output: CalibrationOutput,
    arm: ArmSelection = ANY_ARM,
    json_file: Json = None,
) -> None:
    """Poses of further cameras, from joints seen by both.

    `smooth --calibration` uses the poses as priors and reports a camera that was moved since. Clock offsets
    belong to one recording: they are shown and not stored. An existing calibration file is updated.
    """
    from calib.cameras.camera_poses import calibrate_cameras, cameras_answer

    to = Outputs(None, json_file, True)
    load_existing_calibration(output, to, recording_files)
    recordings = [load_arm(path, None, arm)[0] for path in recording_files]
    set_up = calibrate_cameras(recordings)
    answer = cameras_answer(set_up)
    notes = [note for recording in recordings for note in recording.notes]
    write_answer(answer, output, to, set_up, notes=notes)
    rows = [
        (
            name,
            ", ".join(f"{1000 * offset_s:+.0f}" for offset_s in set_up.clocks_s[name]),
            f"{100 * row.misfit_m:.1f}",
            f"{row.together_s:.0f}",
        )
        for name, row in set_up.cameras.items()
    ]
    columns = ("camera", "first clock less its own, ms", "joints apart, cm", "together, s")
    print_table("Cameras", columns, rows)
    say_answer(answer, notes, output, json_file)
