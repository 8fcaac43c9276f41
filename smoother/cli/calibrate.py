"""`unocclude calibrate`: what is measured once and kept in a calibration file."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..errors import CalibrationError
from .load import load_arm
from .options import Body, ConfigFile, Force, Imu, Json, Processes, Side, Skeleton, one_side
from .output import check_outputs, print_notes, print_table, say, say_written, write_json

if TYPE_CHECKING:
    from calib.motion import MotionCalibration

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
    from calib.motion import calibrate_motion

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
    found = calibrate_motion(recordings, known, config)
    if not found.calibration.lever_arms:
        raise CalibrationError(
            "only the strap was tracked, which is the IMU's own place: there is no lever arm to find"
        )
    write_calibration(output, CalibrationFile().with_arm(found.calibration))
    write_json(json_file, figures(found), force)
    print_motion(found)
    print_notes(note for recording in recordings for note in recording.notes)
    say_written(output, json_file)


def lengths(found: MotionCalibration) -> dict[str, tuple[float, float]]:
    """Upper arm, forearm and the IMU's distance from the forearm's axis with their sigmas, m."""
    table = {}
    if found.calibration.upper_arm is not None:
        table["upper_arm"] = (found.calibration.upper_arm.value_m, found.calibration.upper_arm.sigma_m)
    if found.frame is not None:
        table["forearm"] = (found.frame.length_m, found.frame.length_sigma_m)
        table["imu_to_forearm_axis"] = (found.frame.distance_m, found.frame.distance_sigma_m)
    return table


def figures(found: MotionCalibration) -> dict[str, Any]:
    """All figures, as plain values."""
    import numpy as np

    arm, frame = found.calibration, found.frame
    values: dict[str, Any] = {
        "side": arm.side,
        "lever_arms": {
            joint: {"position_m": lever.position_m, "sigma_m": lever.sigma_m}
            for joint, lever in arm.lever_arms.items()
        },
        "lengths": {
            name: {"value_m": value, "sigma_m": sigma} for name, (value, sigma) in lengths(found).items()
        },
        "R_F_A": arm.R_F_A,
        "clock_offsets": [
            {
                "recording": each.recording,
                "offset_s": each.offset_s,
                "sigma_s": each.sigma_s,
                "drift_s": each.drift_s,
            }
            for each in found.offsets
        ],
        "camera_sigma_m": {joint: noise.sample_m for joint, noise in found.knowledge.noise.items()},
        "visible_s": found.evidence.visible_s,
        "frames": found.evidence.frames,
        "turning_rms_deg_s": np.degrees(found.evidence.turning_rad_s),
        "turned_about_forearm_deg": np.degrees(found.evidence.axial_rad),
        "not_determined": list(found.not_determined),
    }
    if frame is not None:
        values |= {
            "forearm_direction": frame.direction,
            "forearm_direction_sigma_deg": np.degrees(frame.direction_sigma_rad),
            "roll_sigma_deg": np.degrees(frame.roll_sigma_rad),
        }
    return values


def print_motion(found: MotionCalibration) -> None:
    """Print what was found, each with its sigma, and what was not."""
    from calib.words import roll_known

    rows = []
    for joint, lever in found.calibration.lever_arms.items():
        cells = [
            f"{1e3 * value:.1f} +- {1e3 * sigma:.1f}"
            for value, sigma in zip(lever.position_m, lever.sigma_m, strict=True)
        ]
        rows.append((joint, *cells))
    print_table("Lever arms in the IMU's axes, mm (+- one sigma)", ("joint", "x", "y", "z"), rows)
    rows = [
        (name.replace("_", " ").replace("imu", "IMU"), f"{1e3 * value:.1f} +- {1e3 * sigma:.1f}")
        for name, (value, sigma) in lengths(found).items()
    ]
    print_table("Lengths, mm", ("length", "found"), rows)
    print_table(
        "Clocks, ms",
        ("recording", "IMU minus camera", "wandered by"),
        [
            (each.recording, f"{1e3 * each.offset_s:+.1f} +- {1e3 * each.sigma_s:.1f}", 1e3 * each.drift_s)
            if each.offset_s == each.offset_s
            else (each.recording, "not known", "-")
            for each in found.offsets
        ],
    )
    say("A clock offset belongs to its recording: every recording's is solved anew, never carried over.")
    if sentence := roll_known(found.frame):
        say(sentence)
    for sentence in found.not_determined:
        say(f"not determined: {sentence}")
