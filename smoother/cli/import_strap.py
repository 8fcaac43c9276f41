"""`unocclude import strap`: the strap found in a recording's images, as the joint `strap`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import typer

from .load import load_arm
from .options import (
    Body,
    Calibration,
    ConfigFile,
    Force,
    Imu,
    Json,
    Output,
    Processes,
    RecordingPath,
    Report,
    Side,
    Skeleton,
    one_side,
)
from .output import check_mcap, check_outputs, print_notes, print_table, say, say_written, write_json

if TYPE_CHECKING:
    from ..io.media.strap import StrapFound

#: A length by ruler, m.
RULER_SIGMA_M = 0.004


def strap(
    recording_file: RecordingPath,
    output: Output,
    calibration_file: Calibration = None,
    radius_m: Annotated[
        float | None,
        typer.Option("--radius-m", min=0.01, max=0.1, help="Core of the forearm to the sensor."),
    ] = None,
    colour: Annotated[
        str | None,
        typer.Option("--colour-topic", metavar="TOPIC", help="Colour images to take."),
    ] = None,
    depth: Annotated[
        str | None,
        typer.Option("--depth-topic", metavar="TOPIC", help="Depth images to take."),
    ] = None,
    passthrough_images: Annotated[
        bool, typer.Option("--passthrough-images", help="Carry the images over too; they show the patient.")
    ] = False,
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
    """Find the dark strap in the colour images and add it to the recording as the joint `strap`.

    The recording is solved without images first: the sensor's orientation takes the strap from the arm's core
    to the sensor. Images stream by, memory stays flat. What contradicts the forearm is rejected.
    """
    from calib.file import read_calibration
    from calib.strap.strap_mount import held_radius, mounted_on

    from ..calibration import Length
    from ..io.media.strap import check_images
    from ..report.strap_summary import verdict
    from ..smoothing import smooth
    from ..strap_search.search import import_strap
    from .config_file import read_config, with_processes

    check_mcap(output)
    check_outputs(force, [output, json_file, report], [recording_file, calibration_file, config_file])
    config = with_processes(read_config(config_file), processes)
    recording, known = load_arm(
        recording_file, calibration_file, imu=imu, skeleton=skeleton, side=one_side(side), body=body
    )
    check_images(recording_file, colour, depth)
    recovery = smooth(recording, known, config)
    radius = None if radius_m is None else Length(radius_m, RULER_SIGMA_M)
    if radius is None and calibration_file is not None:
        radius = held_radius(read_calibration(calibration_file), recording.side)
    mounted = mounted_on(recovery, radius)
    sigma = max((recovery.estimates.camera_sigma_m or {}).values(), default=0.008)
    found = import_strap(
        recording_file,
        output,
        mounted,
        skeleton=recording.arm.name,
        side=recording.side,
        joint_sigma_m=sigma,
        colour_topic=colour,
        depth_topic=depth,
        passthrough_images=passthrough_images,
        force=force,
    )
    sentences = verdict(found)
    write_json(
        json_file, {**_figures(found), "verdict": sentences, "notes": [*recording.notes, *found.notes]}, force
    )
    if report is not None:
        from ..report.strap import write_strap_report

        write_strap_report(report, recording.name, found, force=force)
    total = len(found.reasons)
    rows = [
        (what, count, f"{100 * count / max(total, 1):.0f}") for what, count in sorted(found.counts.items())
    ]
    print_table(f"The strap in {total} images", ("", "images", "%"), rows)
    for sentence in sentences:
        say(sentence)
    print_notes([*recording.notes, *found.notes])
    say_written(output, json_file, report)


def _figures(found: StrapFound) -> dict[str, Any]:
    """What was found, as plain values for `--json`."""
    import numpy as np

    good = [not reason for reason in found.reasons]
    sigma = found.sigma_m[good]
    return {
        "images": len(found.reasons),
        "found": int(sum(good)),
        "reasons": found.counts,
        "sigma_m": np.median(sigma, axis=0) if len(sigma) else None,
        "along": float(np.median(found.along[good])) if any(good) else None,
        "colour_topic": found.topics[0],
        "depth_topic": found.topics[1],
    }
