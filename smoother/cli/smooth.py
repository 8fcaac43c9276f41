"""`unocclude smooth`: recover every gap of a recording."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated

import typer

from .load import load_arm
from .methods import MAKERS, choose
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
from .output import check_outputs, print_notes, say, say_written, write_json
from .progress import progress_bar

if TYPE_CHECKING:
    from ..recording import Recording
    from ..result import Recovery


def smooth(
    recording_file: RecordingPath,
    output: Output,
    calibration_file: Calibration = None,
    config_file: ConfigFile = None,
    method: Annotated[str, typer.Option("--method", metavar="M", help="How to recover.")] = "graph",
    imu: Imu = None,
    skeleton: Skeleton = None,
    side: Side = None,
    body: Body = None,
    report: Report = None,
    passthrough_images: Annotated[
        bool, typer.Option("--passthrough-images", help="Carry images and depth over (they show the person).")
    ] = False,
    max_sigma_m: Annotated[
        float | None,
        typer.Option("--max-sigma-m", metavar="M", help="Leave answers out that are less certain than this."),
    ] = None,
    processes: Processes = None,
    json_file: Json = None,
    force: Force = False,
) -> None:
    """Recover the arm's motion in every gap, with its uncertainty, and write it as MCAP."""
    from ..evaluation.summary import recovery_figures
    from ..io import write_recovery
    from .config_file import read_config, with_processes
    from .limit import limit_sigma

    names = choose(method)
    if len(names) != 1:
        raise typer.BadParameter("--method takes one method; `unocclude compare` runs several")
    if max_sigma_m is not None and not max_sigma_m > 0:
        raise typer.BadParameter("--max-sigma-m is a length above zero, in m")
    check_outputs(force, [output, report, json_file], [recording_file, calibration_file, config_file])
    config = with_processes(read_config(config_file), processes)
    recording, calibration = load_arm(
        recording_file, calibration_file, imu=imu, skeleton=skeleton, side=one_side(side), body=body
    )
    with progress_bar("recovering") as progress:
        recovery = MAKERS[names[0]](calibration, config, progress)(recording)
    recovery = limit_sigma(recovery, max_sigma_m)
    write_recovery(
        [recovery], output, source=recording_file, force=force, passthrough_images=passthrough_images
    )
    if report is not None:
        from ..report import write_report

        write_report(recovery, report, recording=recording, force=force)
    write_json(json_file, recovery_figures(recovery), force)
    print_recovery(recording, recovery)
    say_written(output, report, json_file)


def print_recovery(recording: Recording, recovery: Recovery) -> None:
    """Print a recovery's gaps and what must be known of it."""
    from ..evaluation.summary import gap_summaries, recovery_figures
    from .output import centimetres, print_table

    rows = [
        (
            f"{summary.gap.start_s:.2f}",
            f"{summary.gap.length_s:.2f}",
            centimetres(summary.sigma_max_m),
            "-" if summary.sigma_max_deg is None else f"{summary.sigma_max_deg:.1f}",
            "one side" if summary.gap.open_start or summary.gap.open_end else "both sides",
        )
        for summary in gap_summaries(recovery)
    ]
    figures = recovery_figures(recovery)
    say(
        f"{recovery.name}: {figures['duration_s']:.1f} s, {len(recovery)} samples,"
        f" {len(rows)} gaps, {figures['occluded_s']:.1f} s occluded"
    )
    if math.isfinite(recovery.clock_offset_s):
        sigma_ms = 1000 * recovery.clock_offset_sigma_s
        known = f" +- {sigma_ms:.1f} ms" if math.isfinite(sigma_ms) else ""
        say(f"the IMU's clock is {1000 * recovery.clock_offset_s:+.1f} ms{known} against the camera's")
    if rows:
        columns = ("gap starts, s", "length, s", "largest sigma, cm", "largest sigma, deg", "seen from")
        print_table("Gaps (sigma = one standard deviation)", columns, rows[:MOST_ROWS])
        if len(rows) > MOST_ROWS:
            say(f".. and {len(rows) - MOST_ROWS} gaps more; --json and the report have them all")
    print_notes([*recording.notes, *recovery.notes])


#: A table longer than this helps nobody on a terminal.
MOST_ROWS = 25
