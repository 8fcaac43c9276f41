"""`unocclude calibrate forearm`: the mounting from a held pose, held against the motion."""

from __future__ import annotations

from typing import Annotated

import typer

from .calibrate import load_existing_calibration, print_words, write_answer
from .load import load_arm
from .options import (
    Body,
    CalibrationOutput,
    ConfigFile,
    Force,
    Imu,
    Json,
    Processes,
    RecordingPath,
    Report,
    Side,
    Skeleton,
    one_side,
)
from .output import print_notes, print_table, say_written

#: What the measures are called in print.
MEASURES = {
    "r": "core to sensor (r)",
    "d_se": "strap to elbow",
    "d_sw": "strap to wrist",
    "d_ul": "upper arm",
    "forearm": "forearm",
}


def forearm(
    recording_file: RecordingPath,
    output: CalibrationOutput,
    from_s: Annotated[
        float | None,
        typer.Option("--from", metavar="S", help="Where the held pose begins, s on the camera's clock."),
    ] = None,
    to_s: Annotated[float | None, typer.Option("--to", metavar="S", help="Where it ends.")] = None,
    radius_m: Annotated[
        float | None,
        typer.Option("--radius-m", min=0.005, max=0.15, help="Core of the forearm to the sensor, by ruler."),
    ] = None,
    strap_to_wrist_m: Annotated[
        float | None,
        typer.Option("--strap-to-wrist-m", min=-0.1, max=0.3, help="Strap to the wrist joint, by ruler."),
    ] = None,
    config_file: ConfigFile = None,
    imu: Imu = None,
    skeleton: Skeleton = None,
    side: Side = None,
    body: Body = None,
    processes: Processes = None,
    report: Report = None,
    json_file: Json = None,
    force: Force = False,
) -> None:
    """Find lever arms, lengths and the sensor's mounting from a held pose.

    The forearm raised beside the head, palm to the camera, still for a second or more; motion in the same
    recording says how the sensor is turned against the camera, and is held against what the pose tells. A
    calibration that exists is added to, without --force.
    """
    from calib.forearm.forearm_summary import compare, forearm_answer
    from calib.forearm.held_pose import calibrate_forearm

    from .config_file import read_config, with_processes

    if (from_s is None) != (to_s is None) or (from_s is not None and to_s is not None and to_s <= from_s):
        raise typer.BadParameter("--from and --to belong together, --to later than --from")
    load_existing_calibration(output, [json_file, report], [recording_file, config_file], force=force)
    config = with_processes(read_config(config_file), processes)
    recording, _ = load_arm(recording_file, None, imu=imu, skeleton=skeleton, side=one_side(side), body=body)
    calibration = calibrate_forearm(
        recording,
        from_s=from_s,
        to_s=to_s,
        radius_m=radius_m,
        strap_to_wrist_m=strap_to_wrist_m,
        config=config,
    )
    answer = forearm_answer(calibration)
    if report is not None:
        from ..report.forearm import write_forearm_report

        write_forearm_report(report, recording, calibration, force=force)
    write_answer(answer, output, json_file, force, recording.notes)
    lengths = calibration.measured.lengths.items()
    cells = [
        (MEASURES[name], f"{1e3 * length.value_m:.1f} +- {1e3 * length.sigma_m:.1f}")
        for name, length in lengths
    ]
    print_table("Measures in the pose, mm", ("measure", "found"), cells)
    rows = [
        (
            row.name,
            f"{row.pose:.1f} +- {row.pose_sigma:.1f} {row.unit}",
            f"{row.motion:.1f} +- {row.motion_sigma:.1f} {row.unit}"
            if row.motion_sigma
            else "counted from it",
            f"{row.apart:.1f}",
        )
        for row in compare(calibration)
    ]
    if rows:
        print_table("Pose against motion", ("measure", "pose", "motion", "sigmas apart"), rows)
    print_words(answer)
    print_notes(recording.notes)
    say_written(output, json_file, report)
