"""`unocclude gaps`: hide visible stretches and recover them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..baselines.registry import DEFAULT_ORIENTATION
from .load import load_arm
from .methods import METHODS, baseline_settings, choose, make_methods
from .options import (
    Body,
    BoundaryS,
    Calibration,
    ConfigFile,
    Force,
    Imu,
    Json,
    Orientation,
    Processes,
    RecordingPath,
    Report,
    Seed,
    Side,
    Skeleton,
    SolveLeverArms,
    one_side,
)
from .output import check_outputs, print_notes, print_table, say_written, write_json
from .progress import progress_bar
from .remedies import (
    CLOCK_SIGMA_S,
    CameraAxes,
    ClockOffset,
    ClockSigma,
    Mirror,
    Negate,
    Swap,
    clock_of,
    remedy_of,
)
from .strap import with_strap

if TYPE_CHECKING:
    from ..evaluation import GapTable


def gaps(
    recording_file: RecordingPath,
    lengths: Annotated[
        str, typer.Option("--lengths", metavar="S,S,..", help="Lengths of the gaps to hide, s.")
    ] = "0.5,1,2,3",
    methods: Annotated[
        str,
        typer.Option("--methods", metavar="M,M,..", help=f"Methods to try, or all: {', '.join(METHODS)}."),
    ] = "graph",
    orientation: Orientation = DEFAULT_ORIENTATION,
    boundary_s: BoundaryS = None,
    calibration_file: Calibration = None,
    config_file: ConfigFile = None,
    seed: Seed = 0,
    repetitions: Annotated[
        int, typer.Option("--repetitions", min=1, help="How often, with gaps elsewhere each time.")
    ] = 1,
    gaps_per_run: Annotated[
        int, typer.Option("--gaps-per-run", min=1, help="Most gaps hidden at the same time.")
    ] = 6,
    imu: Imu = None,
    skeleton: Skeleton = None,
    side: Side = None,
    body: Body = None,
    mirror: Mirror = None,
    swap: Swap = None,
    negate: Negate = None,
    camera_frame: CameraAxes = None,
    clock_offset: ClockOffset = None,
    clock_sigma: ClockSigma = CLOCK_SIGMA_S,
    solve_lever_arms: SolveLeverArms = False,
    processes: Processes = None,
    report: Report = None,
    json_file: Json = None,
    force: Force = False,
) -> None:
    """Hide visible stretches at random, recover them, and measure the error by gap length.

    The answer is compared with the recording's truth where it has one, else with the camera samples
    that were hidden; these carry the camera's own noise.
    """
    from ..evaluation import evaluate_gaps
    from .config_file import read_config, with_processes

    lengths_s = parse_lengths(lengths)
    names = choose(methods)
    settings = baseline_settings(names, orientation, boundary_s)
    remedy, swap_sides = remedy_of(mirror, swap, negate, camera_frame)
    check_outputs(force, [report, json_file], [recording_file, calibration_file, config_file])
    config = with_processes(read_config(config_file), processes)
    recording, calibration = load_arm(
        recording_file,
        calibration_file,
        imu=imu,
        skeleton=skeleton,
        side=one_side(side),
        body=body,
        remedy=remedy,
        swap_sides=swap_sides,
    )
    clock = clock_of(clock_offset, clock_sigma, calibration_file, recording)
    given = with_strap(calibration, recording) if solve_lever_arms else calibration
    with progress_bar("hiding and recovering") as progress:
        table = evaluate_gaps(
            recording,
            lengths_s,
            make_methods(names, given, config, settings, clock=clock),
            seed=seed,
            repetitions=repetitions,
            gaps_per_run=gaps_per_run,
            progress=progress,
        )
    if report is not None:
        from ..report.gap_curves import write_gap_curves

        write_gap_curves(table, recording.name, report, notes=recording.notes, force=force)
    write_json(json_file, gap_figures(table), force)
    print_gaps(table)
    print_notes([*recording.notes, *table.notes])
    say_written(report, json_file)


def gap_figures(table: GapTable) -> dict[str, Any]:
    """All figures as plain values; `spread` has the quartiles over the gaps of a length."""
    from ..evaluation.gap_spread import spread_by_length

    spread = [
        {"length_s": length, "methods": {name: each.to_dict() for name, each in methods.items()}}
        for length, methods in spread_by_length(table.rows).items()
    ]
    return table.to_dict() | {"spread": spread}


def parse_lengths(text: str) -> list[float]:
    """Gap lengths of a comma-separated list, s."""
    try:
        lengths = [float(part) for part in text.split(",") if part.strip()]
    except ValueError:
        lengths = []
    if not lengths or not all(0.05 <= length <= 600 for length in lengths):
        raise typer.BadParameter(f"--lengths takes seconds between 0.05 and 600, as 0.5,1,2; not '{text}'")
    return lengths


def print_gaps(table: GapTable) -> None:
    """Print error against gap length."""
    reference = next((row.reference for row in table.rows if row.reference), "truth")
    against = "truth" if reference == "truth" else f"camera's hidden samples of the {reference}"
    rows = []
    for length, methods in table.lengths.items():
        for name, result in methods.items():
            figures = result.figures
            distances = (
                figures.position_rms_m,
                figures.position_median_m,
                figures.position_p95_m,
                figures.position_max_m,
            )
            rows.append(
                (
                    f"{length:g}",
                    name,
                    *[None if value is None else f"{100 * value:.2f}" for value in distances],
                    figures.nees,
                    figures.coverage_95,
                    f"{result.gaps}" if not result.failed else f"{result.gaps} ({result.failed} failed)",
                )
            )
    columns = ("gap, s", "method", "rms, cm", "median", "95 %", "max", "NEES", "inside 95 %", "gaps")
    print_table(f"Error in hidden gaps against the {against}", columns, rows)
