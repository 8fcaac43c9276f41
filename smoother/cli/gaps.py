"""`unocclude gaps`: hide visible stretches and recover them."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..errors import CalibrationError
from ..evaluation.methods import GRAPH, LIVE_METHODS, METHODS, make_methods
from ..table import centimetres, percent
from .arm_output import each_arm
from .load import EVERY_ARM, ArmInput
from .methods import baseline_settings, choose, with_strap
from .options import (
    BoundaryS,
    ConfigFile,
    Force,
    Json,
    LatencyS,
    Live,
    Orientation,
    Processes,
    Report,
    Seed,
    SolveLeverArms,
)
from .output import (
    check_outputs,
    print_notes,
    print_table,
    progress_bar,
    say,
    say_written,
    write_json,
)

if TYPE_CHECKING:
    from calib.sigma_factor import LengthFactor

    from ..calibration import ArmCalibration
    from ..evaluation.gap_table import GapTable, RealGaps, SinceFigures
    from ..recording import Recording


def gap_figures(table: GapTable, real: RealGaps | None = None) -> dict[str, Any]:
    """All figures as plain values; `spread` has the quartiles over the gaps of a length."""
    from ..evaluation.gap_table import spread_by_length

    spread = [
        {"length_s": length, "methods": {name: each.to_dict() for name, each in methods.items()}}
        for length, methods in spread_by_length(table.rows).items()
    ]
    figures = table.to_dict() | {"spread": spread}
    return figures if real is None else figures | {"real_gaps": real.to_dict() | {"sentence": real.sentence}}


def tables_by_arm(
    recordings: Sequence[Recording], tables: Sequence[GapTable]
) -> dict[tuple[str, int | None], GapTable]:
    """The gaps of each side (and body), of all recordings together."""
    from ..evaluation.gap_table import pooled

    arms = sorted({(recording.side, recording.body) for recording in recordings}, key=str)
    return {
        arm: pooled(
            [table for one, table in zip(recordings, tables, strict=True) if (one.side, one.body) == arm]
        )
        for arm in arms
    }


def print_gaps(table: GapTable, whose: str = "") -> None:
    """Print error against gap length; `whose` goes into the title."""
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
                    percent(figures.coverage_95),
                    f"{result.gaps}" if not result.failed else f"{result.gaps} ({result.failed} failed)",
                )
            )
    columns = ("gap, s", "method", "rms, cm", "median", "95 %", "max", "NEES", "inside 95 %", "gaps")
    print_table(f"Error in hidden gaps against the {against}{whose}", columns, rows)


def print_since(rows: Sequence[SinceFigures]) -> None:
    """Print what each method has at a time since the last frame."""
    if not rows:
        return
    columns = ("since the last frame, s", "method", "rms, cm", "median", "95 %", "NEES")
    cells = [
        (
            f"{row.from_s:g} to {row.to_s:g}",
            row.method,
            centimetres(row.figures.position_rms_m),
            centimetres(row.figures.position_median_m),
            centimetres(row.figures.position_p95_m),
            row.figures.nees,
        )
        for row in rows
    ]
    print_table("Error by the time since the last frame that showed the forearm", columns, cells)


def print_factors(factors: Sequence[LengthFactor]) -> None:
    """Print the sigma correction factors by length of gap."""
    if not factors:
        return
    columns = ("gap, s", "for 50 %", "for 95 %", "to be applied", "hidden gaps")
    rows = [
        (
            f"{row.length_s:g}",
            f"{row.factor_50:.2f}",
            f"{row.factor_95:.2f}",
            f"{row.factor:.2f}",
            f"{row.count} of all lengths" if row.pooled else f"{row.count}",
        )
        for row in factors
    ]
    print_table("Sigma correction factor", columns, rows)


def gaps(
    recording_files: Annotated[
        list[Path],
        typer.Argument(metavar="REC.mcap", help="The recording, or several of a study.", show_default=False),
    ],
    lengths: Annotated[
        str, typer.Option("--lengths", metavar="S,S,..", help="Lengths of the gaps to hide, s.")
    ] = "0.5,1,2,3",
    methods: Annotated[
        str,
        typer.Option("--methods", metavar="M,M,..", help=f"Methods to try, or all: {', '.join(METHODS)}."),
    ] = "graph",
    orientation: Orientation = None,
    boundary_s: BoundaryS = None,
    source: ArmInput = EVERY_ARM,
    config_file: ConfigFile = None,
    live: Live = False,
    latency_s: LatencyS = 0.1,
    seed: Seed = 0,
    repetitions: Annotated[
        int, typer.Option("--repetitions", min=1, help="Repetitions, each with other gaps.")
    ] = 1,
    gaps_per_run: Annotated[
        int, typer.Option("--gaps-per-run", min=1, help="Most gaps hidden at the same time.")
    ] = 6,
    solve_lever_arms: SolveLeverArms = False,
    processes: Processes = None,
    report: Report = None,
    keep_in: Annotated[
        Path | None,
        typer.Option(
            "--keep-in",
            metavar="CAL.toml",
            help="Save the sigma correction factors; `smooth --calibration CAL.toml` applies them.",
        ),
    ] = None,
    json_file: Json = None,
    force: Force = False,
) -> None:
    """Hide visible stretches and measure the error by gap length.

    The answer is compared with the recording's truth where it has one, else with the camera samples
    that were hidden; these carry the camera's own noise. Also prints sigma correction factors,
    which `--keep-in` saves in a calibration file. With `--live` also what would have been shown live, by
    the time since the last frame. Every arm with an IMU is tested, and all together.
    """
    from calib.sigma_factor import factor_sentences

    from ..evaluation.gap_table import compare_real_gaps, pooled, since_last_frame
    from ..evaluation.gaps import evaluate_gaps
    from ..recording import arm_words
    from .config import read_config, with_processes

    lengths_s = parse_lengths(lengths)
    names = choose(methods)
    if live:
        names = [*names, *LIVE_METHODS]
    settings = baseline_settings(names, orientation, boundary_s)
    source.check()
    if keep_in is not None and GRAPH not in names:
        raise typer.BadParameter(f"--keep-in keeps what {GRAPH} needs; add it to --methods")
    twice = [str(path) for path in recording_files if recording_files.count(path) > 1]
    if twice:
        raise typer.BadParameter(f"{twice[0]} is named twice; it would count twice")
    check_outputs(
        force, [report, json_file], [*recording_files, source.calibration_file, config_file, keep_in]
    )
    check_outputs(True, [keep_in], [*recording_files, config_file])
    if keep_in is not None and keep_in.exists():
        from calib.file import read_calibration

        read_calibration(keep_in)  # before the work: what cannot be read cannot be added to
    config = read_config(config_file, processes)
    side_by_side = config.windows.processes or os.cpu_count() or 1
    recordings: list[Recording] = []
    tables: list[GapTable] = []
    notes: list[str] = []
    several = False
    with progress_bar("hiding and recovering") as progress:
        for number, path in enumerate(recording_files):
            arms = source.load(path)
            here: list[Recording] = []
            for recording, _ in arms:
                label = f"{recording.name}, {recording.arm_label}" if len(arms) > 1 else recording.name
                others = [each.name for each in (*recordings, *here)]
                here.append(replace(recording, name=_unlike(label, others)))
            file_progress = _share(progress, number, len(recording_files))

            def hide_and_recover(
                place: int,
                arms: Sequence[tuple[Recording, ArmCalibration | None]] = arms,
                here: Sequence[Recording] = here,
                file_progress: Callable[[float, str], None] = file_progress,
            ) -> GapTable:
                recording, calibration = here[place], arms[place][1]
                clock = source.clock(recording)
                given = with_strap(calibration, recording) if solve_lever_arms else calibration
                if keep_in is not None and given is not None:  # what is measured anew is not applied before
                    given = replace(given, sigma_factors=None)
                inner = with_processes(config, max(side_by_side // (len(lengths_s) * repetitions), 1))
                return evaluate_gaps(
                    recording,
                    lengths_s,
                    make_methods(names, given, inner, settings, clock=clock, latency_s=latency_s),
                    seed=seed,
                    repetitions=repetitions,
                    gaps_per_run=gaps_per_run,
                    progress=_share(file_progress, place, len(here)),
                    processes=side_by_side,
                )

            evaluated, left_out = each_arm(here, hide_and_recover)
            several = several or len(arms) > 1
            notes += left_out
            recordings += [recording for recording, _ in evaluated]
            tables += [table for _, table in evaluated]
    table = pooled(tables)
    real = compare_real_gaps(recordings, table)
    factors = table.sigma_factors(GRAPH)
    notes = [*notes, *(note for recording in recordings for note in recording.notes), *table.notes]
    sentences = [*factor_sentences(factors), real.sentence]
    if report is not None:
        from ..report.method_comparison import gap_curves_page

        name = ", ".join(recording.name for recording in recordings)
        gap_curves_page(table, name, (*sentences, *notes)).write(report, force)
    figures = gap_figures(table, real) | {"notes": list(dict.fromkeys(notes))}
    since = since_last_frame(table, names) if live else []
    if live:
        figures["since_last_frame"] = [row.to_dict() for row in since]
    by_arm = tables_by_arm(recordings, tables) if several else {}
    if by_arm:
        figures["arms"] = [
            {"side": side, "body": body, **gap_figures(mine)} for (side, body), mine in by_arm.items()
        ]
    write_json(json_file, figures, force)
    for (arm_side, arm_body), mine in by_arm.items():
        print_gaps(mine, f" ({arm_words(arm_side, arm_body)})")
    print_gaps(table, " (all arms together)" if by_arm else "")
    print_since(since)
    print_factors(factors)
    for sentence in sentences:
        say(f"{sentence[0].upper()}{sentence[1:]}.")
    print_notes(notes)
    if keep_in is not None:
        keep(factors, table, recordings, keep_in)
    say_written(report, json_file, keep_in)


def _share(progress: Callable[[float, str], None], number: int, count: int) -> Callable[[float, str], None]:
    """Progress of one recording as that of all."""
    return lambda share, text: progress((number + share) / count, text)


def _unlike(name: str, others: Sequence[str]) -> str:
    """A name that no other recording has."""
    return name if name not in others else _unlike(f"{name} (again)", others)


def keep(
    factors: Sequence[LengthFactor], table: GapTable, recordings: Sequence[Recording], path: Path
) -> None:
    """Add the factors of sigma to a calibration file."""
    from calib.file import CalibrationFile, with_sigma_table, write_calibration
    from calib.sigma_factor import LARGEST_FACTOR

    if not factors:
        raise CalibrationError(f"{path} was not written: no hidden gap has an answer with a sigma")
    if (worst := max(row.factor for row in factors)) > LARGEST_FACTOR:
        raise CalibrationError(
            f"{path} was not written: sigma has to be multiplied by {worst:.0f}, so it is not sigma"
            " that is wrong; check clock, axes and mounting"
        )
    digits = ("factor", "factor_50", "factor_95", "level")
    rows = [
        {name: round(value, 4) if name in digits else value for name, value in row.to_dict().items()}
        for row in factors
    ]
    reference = next((row.reference for row in table.rows if row.reference), "truth")
    names = [recording.name for recording in recordings]
    write_calibration(path, with_sigma_table(CalibrationFile(), rows, reference, names))


def parse_lengths(text: str) -> list[float]:
    """Gap lengths of a comma-separated list, s."""
    try:
        lengths = [float(part) for part in text.split(",") if part.strip()]
    except ValueError:
        lengths = []
    if not lengths or not all(0.05 <= length <= 600 for length in lengths):
        raise typer.BadParameter(f"--lengths takes seconds between 0.05 and 600, as 0.5,1,2; not '{text}'")
    return lengths
