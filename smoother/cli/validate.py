"""`unocclude validate`: a result against mocap."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .load import load_recovery
from .options import Force, Json, Report, Side, one_side
from .output import centimetres, check_outputs, print_notes, print_table, write_json

if TYPE_CHECKING:
    from ..evaluation import Validation


def validate(
    result: Annotated[
        Path, typer.Argument(metavar="OUT.mcap", help="What `smooth` wrote.", show_default=False)
    ],
    truth_file: Annotated[
        Path,
        typer.Option(
            "--truth",
            metavar="TRUTH",
            help="Pose of the forearm IMU in the camera frame: .csv (t_s,x,y,z,qw,qx,qy,qz) or .mcap.",
            show_default=False,
        ),
    ],
    side: Side = None,
    report: Report = None,
    json_file: Json = None,
    force: Force = False,
) -> None:
    """Compare a result with a reference: position, orientation, and whether sigma is honest."""
    from ..evaluation import read_truth, validate

    check_outputs(force, [report, json_file], [result, truth_file])
    recovery = load_recovery(result, one_side(side))
    truth = read_truth(truth_file, recovery)
    found = validate(recovery, truth)
    if report is not None:
        from ..report import write_report

        write_report(recovery, report, validation=found, truth=truth, force=force)
    write_json(json_file, found.to_dict(), force)
    print_validation(found)


def print_validation(found: Validation) -> None:
    """Print the figures of a validation."""
    columns = (
        "part",
        "position rms, cm",
        "95 %, cm",
        "max, cm",
        "orientation rms, deg",
        "max, deg",
        "NEES",
        "inside 95 %",
        "samples",
    )
    rows = [
        (
            name,
            centimetres(figures.position_rms_m),
            centimetres(figures.position_p95_m),
            centimetres(figures.position_max_m),
            figures.orientation_rms_deg,
            figures.orientation_max_deg,
            figures.nees,
            figures.coverage_95,
            figures.samples,
        )
        for name, figures in (("all", found.all), ("occluded", found.occluded), ("visible", found.visible))
    ]
    print_table("Error against the truth (NEES: 1 = the stated sigma is honest)", columns, rows)
    joints = [
        (
            name,
            *[centimetres(part.joint_rms_m.get(name)) for part in (found.all, found.occluded, found.visible)],
        )
        for name in found.all.joint_rms_m
    ]
    if joints:
        print_table("Joints, position rms, cm", ("joint", "all", "occluded", "visible"), joints)
    print_notes(found.notes)
