"""`unocclude gaps`: hide visible stretches and recover them."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..errors import CalibrationError
from ..evaluation.methods import GRAPH, LIVE_METHODS, METHODS, make_methods
from ..table import tabulated
from . import options as o
from .arm_output import each_arm
from .load import ArmInput, refuse_twice
from .methods import baseline_settings, choose
from .output import check_outputs, part_of, print_notes, progress_bar, say, say_written, show, write_json

if TYPE_CHECKING:
    from calib.sigma_factor import LengthFactor

    from ..calibration import ArmCalibration
    from ..evaluation.gaps import GapTable
    from ..io.recording.choose import Selection
    from ..recording import Recording


def gaps(
    recording_files: Annotated[list[Path], o.argument("REC.mcap", "The recording, or several of a study.")],
    lengths: Annotated[str, o.value("S,S,..", "Lengths of the gaps to hide, s.")] = "0.5,1,2,3",
    methods: Annotated[str, o.value("M,M,..", f"Methods to try, or all: {', '.join(METHODS)}.")] = "graph",
    seed: o.Seed = 0,
    repetitions: Annotated[int, o.option("Repetitions, each with other gaps.", min=1)] = 1,
    calibration: o.Calibration = None,
    report: o.Report = None,
    keep_in: Annotated[o.File, o.value("CAL.toml", "Save sigma correction factors, for `smooth`.")] = None,
    json_file: o.Json = None,
    force: o.Force = False,
    imu: o.Imu = None,
    skeleton: o.Skeleton = None,
    side: o.Side = None,
    body: o.Body = None,
    mirror: o.Mirror = None,
    swap: o.Swap = None,
    negate: o.Negate = None,
    camera_frame: o.CameraAxes = None,
    clock_offset: o.ClockOffset = None,
    clock_sigma: o.ClockSigma = None,
    config_file: o.ConfigFile = None,
    orientation: o.Orientation = None,
    live: o.Live = False,
    latency: o.Latency = 0.1,
    gaps_per_run: Annotated[int, o.rare("Most gaps hidden at the same time.", min=1)] = 6,
    processes: o.Processes = None,
) -> None:
    """Hide visible stretches and measure the error by gap length.

    The answer is compared with the recording's truth where it has one, else with the camera samples
    that were hidden; these carry the camera's own noise. Also prints sigma correction factors,
    which `--keep-in` saves in a calibration file. With `--live` also what would have been shown live, by
    the time since the last frame. Every arm with an IMU is tested, and all together.

    Example: unocclude gaps session.mcap --lengths 0.5,1,2,3 --seed 1 --json gaps.json
    """
    from calib.file import read_calibration
    from calib.sigma_factor import factor_sentences

    from ..evaluation.gaps import compare_real_gaps, evaluate_gaps, pooled, since_last_frame, since_table
    from ..recording import arm_words
    from .config import read_config, with_processes

    lengths_s = parse_lengths(lengths)
    names = [*choose(methods), *(LIVE_METHODS if live else ())]
    settings = baseline_settings(names, orientation)
    chosen: Selection = {"imu": imu, "skeleton": skeleton, "side": side, "body": body}
    source = ArmInput(calibration, chosen, mirror, swap, negate, camera_frame, clock_offset, clock_sigma)
    if keep_in is not None and GRAPH not in names:
        raise typer.BadParameter(f"--keep-in keeps what {GRAPH} needs; add it to --methods")
    refuse_twice(recording_files)
    check_outputs(force, [report, json_file], [*recording_files, calibration, config_file, keep_in])
    check_outputs(True, [keep_in], [*recording_files, config_file])
    if keep_in is not None and keep_in.exists():
        read_calibration(keep_in)  # before the work: what cannot be read cannot be added to
    config = read_config(config_file, processes)
    side_by_side = config.windows.processes or os.cpu_count() or 1
    inner = with_processes(config, max(side_by_side // (len(lengths_s) * repetitions), 1))
    given: list[ArmCalibration | None] = []
    recordings: list[Recording] = []
    several = False
    for arms in map(source.load, recording_files):
        several = several or len(arms) > 1
        for recording, known in arms:
            name = f"{recording.name}, {recording.arm_label}" if len(arms) > 1 else recording.name
            while name in [each.name for each in recordings]:
                name += " (again)"
            recordings.append(replace(recording, name=name))
            # what is measured anew is not applied before
            given.append(replace(known, sigma_factors=None) if keep_in and known is not None else known)

    def hide_and_recover(place: int) -> GapTable:
        clock = source.clock(recordings[place])
        return evaluate_gaps(
            recordings[place],
            lengths_s,
            make_methods(names, given[place], inner, settings, clock=clock, latency_s=latency),
            seed=seed,
            repetitions=repetitions,
            gaps_per_run=gaps_per_run,
            progress=part_of(progress, place, len(recordings)),
            processes=side_by_side,
        )

    with progress_bar("hiding and recovering") as progress:
        evaluated, left_out = each_arm(recordings, hide_and_recover)
    recordings, tables = [recording for recording, _ in evaluated], [own for _, own in evaluated]
    table = pooled(tables)
    real = compare_real_gaps(recordings, table)
    factors = table.sigma_factors(GRAPH)
    notes = [*left_out, *(note for recording in recordings for note in recording.notes), *table.notes]
    sentences = [*factor_sentences(factors), real["sentence"]]
    if report is not None:
        from ..report.method_comparison import gap_curves_page

        name = ", ".join(recording.name for recording in recordings)
        gap_curves_page(table, name, (*sentences, *notes)).write(report, force)
    figures = table.to_dict() | {"real_gaps": real, "notes": list(dict.fromkeys(notes))}
    since = since_last_frame(table, names) if live else []
    if live:
        figures["since_last_frame"] = since
    by_arm: dict[tuple[str, int | None], list[GapTable]] = {}  # of all recordings together
    for recording, own in evaluated if several else ():
        by_arm.setdefault((recording.side, recording.body), []).append(own)
    each = {arm: pooled(by_arm[arm]) for arm in sorted(by_arm, key=str)}
    if each:
        figures["arms"] = [{"side": arm[0], "body": arm[1], **own.to_dict()} for arm, own in each.items()]
    write_json(json_file, figures, force)
    for arm, own in each.items():
        show(own.table(f" ({arm_words(*arm)})"))
    show(table.table(" (all arms together)" if each else ""))
    show(since_table(since))
    keys = "length_s=gap_s factor_50 factor_95 factor=applied count=hidden_gaps pooled=of_all_lengths"
    show(tabulated("Sigma correction factor", factors, keys))
    for sentence in sentences:
        say(f"{sentence[0].upper()}{sentence[1:]}.")
    print_notes(notes)
    if keep_in is not None:
        keep(factors, table.reference, [recording.name for recording in recordings], keep_in)
    say_written(report, json_file, keep_in)


def keep(factors: Sequence[LengthFactor], reference: str, names: list[str], path: Path) -> None:
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
    rows = [
        {name: value if isinstance(value, int) else round(value, 4) for name, value in row.to_dict().items()}
        for row in factors
    ]
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
