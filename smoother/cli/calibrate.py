"""`unocclude calibrate`: what is measured once and kept in a calibration file."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..errors import CalibrationError
from .estimates import found_figures, print_arm, print_camera, print_clocks, print_open
from .load import load_arm
from .options import Body, ConfigFile, Force, Imu, Json, Processes, Side, Skeleton, one_side
from .output import check_outputs, print_notes, say, say_written, write_json

if TYPE_CHECKING:
    from calib.motion.estimates import ArmEstimates

CalibrationOutput = Annotated[
    Path,
    typer.Option(
        "-o", "--output", metavar="CAL.toml", help="File to write or to add to.", show_default=False
    ),
]


def motion(
    recording_files: Annotated[
        list[Path],
        typer.Argument(
            metavar="REC.mcap", help="Recordings of one person and one mounting.", show_default=False
        ),
    ],
    output: CalibrationOutput,
    known_file: Annotated[
        Path | None,
        typer.Option("--known", metavar="CAL.toml", help="What is measured already; it is believed."),
    ] = None,
    config_file: ConfigFile = None,
    imu: Imu = None,
    skeleton: Skeleton = None,
    side: Side = None,
    body: Body = None,
    processes: Processes = None,
    json_file: Json = None,
    force: Force = False,
) -> None:
    """Find lever arms, limb lengths and the IMU's mounting from visible motion.

    Several recordings are solved together. A calibration that exists is added to, without --force: what
    was found replaces what the file holds of this arm, the rest of it is kept.
    """
    from calib.file import CalibrationFile, read_calibration, write_calibration
    from calib.motion.several_recordings import calibrate_motion

    from .config_file import read_config, with_processes

    twice = [str(path) for path in recording_files if recording_files.count(path) > 1]
    if twice:
        raise typer.BadParameter(f"{twice[0]} is named twice; it would count twice")
    check_outputs(True, [output, json_file], [*recording_files, config_file])
    check_outputs(force, [json_file], [known_file])
    if output.exists():
        read_calibration(output)  # before the work: what cannot be read cannot be added to
    config = with_processes(read_config(config_file), processes)
    loaded = [
        load_arm(path, known_file, imu=imu, skeleton=skeleton, side=one_side(side), body=body)
        for path in recording_files
    ]
    recordings, known = [recording for recording, _ in loaded], loaded[0][1]
    found = calibrate_motion(recordings, known, config).found
    if not found.calibration.lever_arms:
        raise CalibrationError(
            "only the strap was tracked, which is the IMU's own place: there is no lever arm to find"
        )
    write_calibration(output, CalibrationFile().with_arm(found.calibration))
    write_json(json_file, found_figures(found), force)
    print_motion(found)
    print_notes(note for recording in recordings for note in recording.notes)
    say_written(output, json_file)


def print_motion(found: ArmEstimates) -> None:
    """Print what was found, each with its sigma, and what was not."""
    from calib.motion.motion_summary import roll_known

    print_arm(found)
    print_clocks(found.offsets)
    say("A clock offset belongs to its recording: every recording's is solved anew, never carried over.")
    print_camera(found)
    if sentence := roll_known(found.frame):
        say(sentence)
    print_open(found)
