"""`unocclude calibrate forearm`: the mounting from a held pose, held against the motion."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import typer

from .calibrate import CalibrationOutput
from .load import load_arm
from .options import (
    Body,
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
from .output import check_outputs, print_notes, print_table, say, say_written, write_json

if TYPE_CHECKING:
    from calib.forearm.forearm_summary import Compared
    from calib.forearm.held_pose_fit import ForearmCalibration


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
    from calib.file import CalibrationFile, read_calibration, write_calibration
    from calib.forearm.forearm_summary import compare, open_questions, verdict
    from calib.forearm.held_pose_fit import calibrate_forearm

    from .config_file import read_config, with_processes

    if (from_s is None) != (to_s is None) or (from_s is not None and to_s is not None and to_s <= from_s):
        raise typer.BadParameter("--from and --to belong together, --to later than --from")
    check_outputs(True, [output], [recording_file, config_file])
    check_outputs(force, [json_file, report], [recording_file])
    if output.exists():
        read_calibration(output)  # before the work: what cannot be read cannot be added to
    config = with_processes(read_config(config_file), processes)
    recording, _ = load_arm(recording_file, None, imu=imu, skeleton=skeleton, side=one_side(side), body=body)
    found = calibrate_forearm(
        recording,
        from_s=from_s,
        to_s=to_s,
        radius_m=radius_m,
        strap_to_wrist_m=strap_to_wrist_m,
        config=config,
    )
    rows = compare(found)
    said, left_open = verdict(found, rows), open_questions(found)
    table = {recording.side or "any": _table(found)}
    write_calibration(output, CalibrationFile().with_arm(found.calibration).with_table("forearm", table))
    write_json(json_file, _figures(found, rows, said, left_open), force)
    if report is not None:
        from ..report.forearm import write_forearm_report

        write_forearm_report(report, recording, found, force=force)
    _print(found, rows)
    for sentence in said:
        say(sentence)
    for sentence in left_open:
        say(f"not determined: {sentence}")
    print_notes(recording.notes)
    say_written(output, json_file, report)


def _measures(found: ForearmCalibration) -> dict[str, tuple[float, float]]:
    m = found.measured
    return {
        "r": (m.radius.value_m, m.radius.sigma_m),
        "d_se": (m.strap_to_elbow.value_m, m.strap_to_elbow.sigma_m),
        "d_sw": (m.strap_to_wrist.value_m, m.strap_to_wrist.sigma_m),
        "d_ul": (m.upper_arm.value_m, m.upper_arm.sigma_m),
        "forearm": (m.forearm.value_m, m.forearm.sigma_m),
    }


def _table(found: ForearmCalibration) -> dict[str, Any]:
    """The file's table [forearm.SIDE]: what [arm.SIDE] has no key for."""
    table: dict[str, Any] = {"strap_from": found.measured.strap_from}
    for name, (value, sigma) in _measures(found).items():
        table |= {f"{name}_m": float(value), f"{name}_sigma_m": float(sigma)}
    if found.calibration.R_F_A is not None:
        import numpy as np

        table["R_F_A_direction_sigma_deg"] = float(np.degrees(found.direction_sigma_rad))
        table["R_F_A_roll_sigma_deg"] = float(np.degrees(found.roll_sigma_rad))
    return table


def _figures(
    found: ForearmCalibration, rows: list[Compared], said: list[str], left_open: list[str]
) -> dict[str, Any]:
    """What was found, as plain values for `--json`."""
    return {
        "side": found.calibration.side,
        "pose": {"from_s": found.pose.start_s, "to_s": found.pose.end_s, "chosen": found.pose.chosen},
        "measures": {name: {"value_m": v, "sigma_m": s} for name, (v, s) in _measures(found).items()},
        "strap_from": found.measured.strap_from,
        "lever_arms": {
            joint: {"position_m": lever.position_m, "sigma_m": lever.sigma_m}
            for joint, lever in found.calibration.lever_arms.items()
        },
        "R_F_A": found.calibration.R_F_A,
        "R_F_A_sigma_deg": {
            "direction": found.direction_sigma_rad * 57.29577951308232,
            "roll": found.roll_sigma_rad * 57.29577951308232,
        },
        "against_motion": [
            {
                "measure": row.name,
                "unit": row.unit,
                "pose": row.pose,
                "pose_sigma": row.pose_sigma,
                "motion": row.motion,
                "motion_sigma": row.motion_sigma,
                "sigmas_apart": row.apart,
                "agrees": row.agrees,
            }
            for row in rows
        ],
        "verdict": said,
        "not_determined": left_open,
    }


def _print(found: ForearmCalibration, rows: list[Compared]) -> None:
    """Print the measures, and how they compare with the motion's."""
    names = {
        "r": "core to sensor (r)",
        "d_se": "strap to elbow",
        "d_sw": "strap to wrist",
        "d_ul": "upper arm",
        "forearm": "forearm",
    }
    cells = [(names[k], f"{1e3 * v:.1f} +- {1e3 * s:.1f}") for k, (v, s) in _measures(found).items()]
    print_table("Measures in the pose, mm", ("measure", "found"), cells)
    if rows:
        compared = [
            (
                row.name,
                f"{row.pose:.1f} +- {row.pose_sigma:.1f} {row.unit}",
                f"{row.motion:.1f} +- {row.motion_sigma:.1f} {row.unit}",
                f"{row.apart:.1f}",
            )
            for row in rows
        ]
        print_table("Pose against motion", ("measure", "pose", "motion", "sigmas apart"), compared)
