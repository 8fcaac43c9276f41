"""Against a truth: `validate`, `compare`, `gaps`, `benchmark`; of motions: `measures`, `progress`."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from ..errors import CalibrationError, UnoccludeError
from ..evaluation.methods import GRAPH, METHODS, make_methods
from ..table import tabulated
from . import options as o
from .load import (
    ArmInput,
    ConfigInput,
    ResultInput,
    camera_frame_of,
    filter_of,
    refuse_several,
    refuse_twice,
)
from .output import (
    Out,
    each_arm,
    part_of,
    print_notes,
    progress_bar,
    say,
    say_more,
    say_written,
    show,
    warn,
    write_csv,
    write_json,
    write_text,
)

if TYPE_CHECKING:
    from calib.sigma_factor import LengthFactor

    from ..evaluation.compare import Comparison
    from ..evaluation.gaps import GapTable
    from ..evaluation.progress import PersonProgress
    from ..evaluation.validate import Validation
    from ..measures import BothArms, Measures
    from ..runtime.pool import Progress
    from .load import Arm


#: Without --verbose this many notes and measures are printed.
FEW_NOTES, FEW_MEASURES = 2, 4


def validate(
    result: o.Result,
    arms: ResultInput,
    out: Out,
    truth: Annotated[
        Path,
        o.value(
            "TRUTH",
            "Markers of a motion capture (.c3d, .trc), or poses of the forearm IMU in the camera frame (.csv"
            " with t_s,x,y,z,qw,qx,qy,qz, or .mcap).",
        ),
    ],
    markers: Annotated[o.File, o.value("MAP.toml", "Which markers form a joint or are on the IMU.")] = None,
    calibration: Annotated[
        o.File, o.value("CAL.toml", "[camera_from_mocap]; else aligned by motion.")
    ] = None,
    align: o.Align = False,
    verbose: o.Verbose = False,
    report: o.Report = None,
    processes: o.Processes = None,
) -> None:
    """Compare a result with motion capture or another reference.

    With several arms, each is compared with its own truth (topics /truth/left, /truth/right); a truth
    without a side belongs to one arm, chosen with --side.

    Example: unocclude validate out.mcap --truth trial.c3d --markers map.toml --calibration rig.toml
    """
    from ..evaluation.reference import read_reference
    from ..evaluation.validate import validate
    from ..io.mcap.messages import damage

    recoveries = arms.load(result)
    refuse_several(recoveries, truth)
    axes = camera_frame_of(result)
    frame = None if calibration is None else axes
    results = []
    for recovery in recoveries:
        own, alignment = read_reference(
            truth, recovery, markers=markers, calibration=calibration, camera_frame=frame, align=align
        )
        with progress_bar("measuring") as progress:
            validation = validate(recovery, own, alignment, True, processes or 0, progress)
        results.append((recovery, validation, own))
    if report is not None:
        from ..report import write_report

        write_report([(None, *each) for each in results], report, camera_frame=axes, force=out.force)
    validations = [
        replace(one, notes=tuple(dict.fromkeys((*damage(recovery.notes), *one.notes))))
        for recovery, one, _ in results
    ]
    figures = [
        one.to_dict() | {"trusted": of.estimates.trusted, "verdict": of.estimates.verdict}
        for of, one in zip(recoveries, validations, strict=True)
    ]
    warn(recoveries)
    out.arms(recoveries, figures, lambda number: print_validation(validations[number], verbose))


def print_validation(validation: Validation, verbose: bool = False) -> None:
    """Print the figures of a validation: what matters in 40 lines, or all of them."""
    from ..evaluation.measure_agreement import pair_table
    from ..evaluation.validate import SENSOR

    for table in (validation.errors, validation.angle_errors):
        few = [row for row in table.rows if row[1] != "visible" or row[0] == SENSOR]
        show(table if verbose else replace(table, rows=few))
    if verbose:
        if (bias := validation.all.position_bias_m) is not None:
            say(f"bias of the position, x y z of the camera, cm: {' '.join(f'{100 * x:+.2f}' for x in bias)}")
        if (lag_s := validation.lag_s) is not None:
            say(f"lag of the answer behind the truth: {1000 * lag_s:+.1f} ms (peak of cross-correlation)")
    if validation.measures is not None:
        title = validation.alignment.titled("Measures of the session")
        show(pair_table(title, validation.measures, None if verbose else FEW_MEASURES))
    print_notes(validation.notes if verbose else validation.notes[:FEW_NOTES])
    if not verbose:
        say("--verbose prints every part, measure and note; --json has every gap too")


def compare(
    recording_file: o.RecordingPath,
    source: ArmInput,
    settings: ConfigInput,
    out: Out,
    truth: Annotated[o.File, o.value("TRUTH", "As of `validate`; else the recording's own truth.")] = None,
    methods: Annotated[str, o.value("M,M,..", f"Methods to compare, or all: {', '.join(METHODS)}.")] = "all",
    markers: Annotated[o.File, o.value("MAP.toml", "Which markers of the truth form a joint.")] = None,
    align: o.Align = False,
    report: o.Report = None,
    orientation: o.Orientation = None,
) -> None:
    """Compare all methods on a recording with truth.

    The graph runs once; the other methods get its calibration, its clock and the camera samples that it
    accepted. No method sees the truth.

    Example: unocclude compare session.mcap --truth trial.c3d --markers map.toml --report c.html
    """
    from calib.file import read_calibration

    from ..evaluation.compare import compare
    from ..evaluation.reference import ReferenceAlignment, read_reference
    from ..io.tables.markers import MARKER_FORMATS

    names = o.listed(methods, METHODS, "method")
    chosen_filter = filter_of(names, orientation)
    if truth is None and (markers is not None or align):
        raise typer.BadParameter("--markers and --align are for a truth named with --truth")
    config = settings.read()
    arms = source.load(recording_file)
    recordings = [recording for recording, _ in arms]
    frame = None
    if truth is not None:
        refuse_several(recordings, truth)
        # of use where the truth is in a frame of its own
        if (align or truth.suffix.lower() in MARKER_FORMATS) and source.calibration_file is not None:
            held = read_calibration(source.calibration_file).tables
            frame = source.calibration_file if "camera_from_mocap" in held else None
    elif any(recording.truth is None or not len(recording.truth) for recording in recordings):
        raise UnoccludeError(
            f"{recording_file} has no truth: name one with --truth, or hide visible stretches with"
            " `unocclude gaps`"
        )

    def compare_arm(place: int, progress: Progress) -> Comparison:
        recording, given = arms[place]
        blind, clock = replace(recording, truth=None), source.clock(recording)
        first, second = (part_of(progress, half, 2) for half in (0, 1))
        running = make_methods([GRAPH, *names], given, config, chosen_filter, first, clock)
        graph = running[GRAPH](blind)
        own, alignment = recording.truth, ReferenceAlignment()
        if truth is not None:
            axes = recording.camera_frame
            own, alignment = read_reference(
                truth, graph, markers=markers, calibration=frame, camera_frame=axes, align=align
            )
        assert own is not None
        chosen = {name: running[name] for name in names}
        return compare(blind, graph, own, chosen, alignment, second, config.windows.processes)

    answers, left_out = each_arm("comparing", recordings, compare_arm)
    graphs = [one.graph for _, one in answers]
    if report is not None:
        from ..report import write_report

        tables = [replace(one.table, title=f"{one.table.title}, {each.arm_label}") for each, one in answers]
        pages = [(recording, one.graph, one.of_graph, one.truth) for recording, one in answers]
        write_report(pages, report, methods=tables, force=out.force)
    noted = [list(dict.fromkeys([*one.notes, *left_out, *each.notes])) for one, each in answers]
    figures = [
        {"recording": recording.name, "side": recording.side, **comparison.to_dict()}
        | {"trusted": graph.estimates.trusted, "verdict": graph.estimates.verdict, "notes": notes}
        for (recording, comparison), graph, notes in zip(answers, graphs, noted, strict=True)
    ]
    warn(graphs)

    def tell(place: int) -> None:
        show(answers[place][1].table)
        say(answers[place][1].camera_words)
        print_notes(noted[place])

    out.arms([recording for recording, _ in answers], figures, tell)
    out.end(report)


def gaps(
    recording_files: Annotated[list[Path], o.argument("REC.mcap", "The recording, or several of a study.")],
    source: ArmInput,
    settings: ConfigInput,
    out: Out,
    lengths: Annotated[str, o.value("S,S,..", "Lengths of the gaps to hide, s.")] = "0.5,1,2,3",
    methods: Annotated[str, o.value("M,M,..", f"Methods to try, or all: {', '.join(METHODS)}.")] = "graph",
    seed: o.Seed = 0,
    repetitions: Annotated[int, o.option("Repetitions, each with other gaps.", min=1)] = 1,
    report: o.Report = None,
    keep_in: Annotated[
        o.File, o.value("CAL.toml", "Save sigma correction factors, for `smooth`."), o.ADDED_TO
    ] = None,
    orientation: o.Orientation = None,
    gaps_per_run: Annotated[int, o.rare("Most gaps hidden at the same time.", min=1)] = 6,
) -> None:
    """Hide visible stretches and measure the error by gap length.

    The answer is compared with the recording's truth where it has one, else with the camera samples
    that were hidden; these carry the camera's own noise. Also prints sigma correction factors,
    which `--keep-in` saves in a calibration file. Every arm with an IMU is tested, and all together.

    Example: unocclude gaps session.mcap --lengths 0.5,1,2,3 --seed 1 --json gaps.json
    """
    from calib.file import read_calibration
    from calib.sigma_factor import factor_sentences

    from ..evaluation.gaps import evaluate_gaps, pooled
    from ..evaluation.words import said
    from ..recording import arm_words
    from .config import with_processes

    lengths_s = parse_lengths(lengths)
    names = o.listed(methods, METHODS, "method")
    chosen_filter = filter_of(names, orientation)
    if keep_in is not None and GRAPH not in names:
        raise typer.BadParameter(f"--keep-in keeps what {GRAPH} needs; add it to --methods")
    refuse_twice(recording_files)
    if keep_in is not None and keep_in.exists():
        read_calibration(keep_in)  # before the work: what cannot be read cannot be added to
    config = settings.read()
    side_by_side = config.windows.processes or os.cpu_count() or 1
    inner = with_processes(config, max(side_by_side // (len(lengths_s) * repetitions), 1))
    arms: list[Arm] = []
    loaded = [source.load(path) for path in recording_files]
    for file in loaded:
        for recording, known in file:
            name = f"{recording.name}, {recording.arm_label}" if len(file) > 1 else recording.name
            while name in [each.name for each, _ in arms]:
                name += " (again)"
            # what is measured anew is not applied before
            of_arm = replace(known, sigma_factors=None) if keep_in and known is not None else known
            arms.append((replace(recording, name=name), of_arm))

    def hide_and_recover(place: int, progress: Progress) -> GapTable:
        recording, known = arms[place]
        clock = source.clock(recording)
        running = make_methods(names, known, inner, chosen_filter, clock=clock)
        how = {"seed": seed, "repetitions": repetitions, "gaps_per_run": gaps_per_run}
        return evaluate_gaps(recording, lengths_s, running, progress=progress, processes=side_by_side, **how)

    evaluated, left_out = each_arm("hiding and recovering", [one for one, _ in arms], hide_and_recover)
    recordings, tables = [recording for recording, _ in evaluated], [own for _, own in evaluated]
    table = pooled(tables)
    factors = table.sigma_factors(GRAPH)
    notes = [*left_out, *(note for recording in recordings for note in recording.notes), *table.notes]
    sentences = [*factor_sentences(factors), said("gaps", "easier")]
    if report is not None:
        from ..report.pages import gap_curves_page

        name = ", ".join(recording.name for recording in recordings)
        gap_curves_page(table, name, sentences, notes).write(report, out.force)
    figures = table.to_dict() | {"notes": list(dict.fromkeys(notes))}
    by_arm: dict[tuple[str, int | None], list[GapTable]] = {}  # of all recordings together
    for recording, own in evaluated if len(arms) > len(loaded) else ():
        by_arm.setdefault((recording.side, recording.body), []).append(own)
    each = {arm: pooled(by_arm[arm]) for arm in sorted(by_arm, key=str)}
    if each:
        figures["arms"] = [{"side": arm[0], "body": arm[1], **own.to_dict()} for arm, own in each.items()]
    out.json(figures)
    for arm, own in each.items():
        show(own.table(f" ({arm_words(*arm)})"))
    show(table.table(" (all arms together)" if each else ""))
    keys = "length_s=gap_s factor_50 factor_95 factor=applied count=hidden_gaps pooled=of_all_lengths"
    show(tabulated("Sigma correction factor", factors, keys))
    for sentence in sentences:
        say(f"{sentence[0].upper()}{sentence[1:]}.")
    print_notes(notes)
    if keep_in is not None:
        keep(factors, table.reference, [recording.name for recording in recordings], keep_in)
    say_written(report, out.json_file, keep_in)


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
        {
            name: round(value, 4) if isinstance(value, float) else value
            for name, value in row.to_dict().items()
        }
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


#: Where the data sets lie, unless `--data` says.
VARIABLE = "UNOCCLUDE_DATASETS"
_FILES = ("benchmark.json", "benchmark.md", "gaps.csv")
#: Notes on the terminal; all are in the JSON.
_MOST_NOTES = 6


def benchmark(
    output: o.FolderOutput,
    out: Out,
    data: Annotated[o.File, o.value("FOLDER", f"One folder per data set.  [default: ${VARIABLE}]")] = None,
    method: Annotated[str, o.value("M,M,..", f"Methods, or all: {', '.join(METHODS)}.")] = "all",
    split: Annotated[Literal["development", "test", "all"], o.option("Which trials.")] = "all",
    processes: o.Processes = None,
) -> None:
    """Score all methods on public data sets with hidden gaps.

    The folder of --data contains broad/, utd_mhad/ and smartfallmm/ as published; missing ones are
    named and left out. Splits and gaps are frozen: they depend only on a trial's name. Writes
    benchmark.json, benchmark.md (the table) and gaps.csv (one row per gap).

    Example: unocclude benchmark --data datasets -o benchmark
    """
    from .. import __version__
    from ..evaluation.benchmark import SPLITS, digest, find_trials, gap_rows, plain, run_benchmark, summary

    folder = data or (Path(os.environ[VARIABLE]) if os.environ.get(VARIABLE) else None)
    if folder is None:
        raise typer.BadParameter(f"name the folder of the data sets with --data, or in {VARIABLE}")
    if not folder.is_dir():
        raise UnoccludeError(f"{folder} is not a folder; name the folder that contains the data sets")
    splits = list(SPLITS) if split == "all" else [split]
    names = tuple(o.listed(method, METHODS, "method"))
    files = [output / name for name in _FILES]
    out.check(files if output.is_dir() else [])
    found, missing = find_trials(folder, splits)
    output.mkdir(parents=True, exist_ok=True)
    began = time.perf_counter()
    with progress_bar("benchmark") as progress:
        run = run_benchmark(folder, found, names, progress, processes or 0)
    figures = plain(run, __version__, digest(found))
    tables = [summary(each) for each in figures["datasets"]]
    write_json(files[0], figures, out.force)
    write_text(files[1], "\n".join(f"### {each.title}\n\n{each.markdown()}" for each in tables), out.force)
    write_csv(files[2], gap_rows(run), out.force)
    out.json(figures)
    for table in tables:
        show(replace(table, title=f"{table.title}; median / rms in gaps, cm"))
    notes = [*missing, *figures["notes"]]
    print_notes(notes[:_MOST_NOTES])
    say_more(len(notes), _MOST_NOTES, f"notes more in {files[0]}")
    say(f"{len(found)} trials in {(time.perf_counter() - began) / 60:.1f} minutes")
    out.end(*files)


def csv_rows(rows: Sequence[Measures], pairs: Sequence[BothArms]) -> Iterator[Sequence[object]]:
    """One row per measure: recording, side, body, then the fields of a measure."""
    from ..measures import Measure

    names = [each.name for each in fields(Measure)]
    yield ["recording", "side", "body", *names]
    sources = [(one.name, one.side, one.body, one.rows) for one in rows]
    sources += [(both.left.name, "both", both.left.body, both.rows) for both in pairs]
    for name, side, body, own in sources:
        yield from ([name, side, body, *(getattr(row, each) for each in names)] for row in own)


def measures(
    result: o.Result,
    arms: ResultInput,
    out: Out,
    config_file: Annotated[o.File, o.value("M.toml", "Thresholds (docs/measures.md).", "--config")] = None,
    csv: o.Csv = None,
    report: o.Report = None,
    processes: o.Processes = None,
) -> None:
    """Measure range of motion, reach, speed, smoothness.

    For the session, each hand movement and each repetition of an exercise, with intervals from the motions
    that `unocclude smooth` drew; with both arms also their symmetry. No diagnosis: the numbers describe a
    motion.

    Example: unocclude measures out.mcap --csv measures.csv --json measures.json
    """
    from ..evaluation.words import measure_table
    from ..io.mcap.messages import damage
    from ..measures import MeasureSettings
    from ..measures.symmetry import measure_arms
    from .config import read_settings

    settings = read_settings(config_file, MeasureSettings)
    recoveries = arms.load(result)
    with progress_bar("measuring") as progress:
        rows, pairs = measure_arms(recoveries, settings, processes or 0, progress)
    if report is not None:
        from ..report.pages import measures_page

        measures_page(rows, pairs).write(report, out.force)
    write_csv(csv, csv_rows(rows, pairs), out.force)
    symmetry = [{"body": both.left.body, "measures": both.as_dict()} for both in pairs]
    out.arms(
        recoveries,
        [one.as_dict() for one in rows],
        lambda number: print_arm(rows[number], damage(recoveries[number].notes)),
        **({"symmetry": symmetry} if pairs else {}),
    )
    for both in pairs:
        of = "" if both.left.body is None else f" of body {both.left.body}"
        title = f"Right arm{of} against left: 0 = alike, above it the right has more"
        show(measure_table(title, "symmetry", both.rows))
    out.end(csv, report)


def print_arm(one: Measures, damaged: list[str]) -> None:
    """An arm's verdict, table and notes; what is not to be trusted is said first.

    Zones of angles are left to `--csv` and `--json`.
    """
    from ..evaluation.words import measure_table, not_measured

    if one.trusted is False:
        say(f"{one.verdict} The measures below are those of an answer that is not to be trusted.")
    shown = [row for row in one.session if "_zone_" not in row.key]
    show(measure_table(f"{one.name}, {one.arm_label}: the session", "measure", shown))
    for sentence in not_measured(one):
        say(sentence)
    say(f"{len(one.movements)} movements, {len(one.repetitions)} repetitions: --csv, --json and the report")
    print_notes([*damaged, *one.notes])


_sessions = (
    "Person and date of each recording: file, person, session or date [, task]; without it they are taken"
    " from folders: PERSON/SESSION.mcap or PERSON/SESSION/TASK.mcap."
)
_changes = "Minimal detectable changes: what `progress --reliability --json` wrote, or a .toml with [mdc95]."


def progress(
    study: Annotated[Path, o.argument("STUDY", "The folder that `unocclude batch` wrote.")],
    out: Out,
    person: Annotated[o.Text, o.value("NAME", "Only this person.")] = None,
    sessions: Annotated[o.File, o.value("FILE.csv", _sessions)] = None,
    mdc: Annotated[o.File, o.value("FILE", _changes)] = None,
    reliability: Annotated[bool, o.option("No true change: print ICC, SEM, MDC.", "--reliability")] = False,
    measure: Annotated[o.Texts, o.value("KEY", "Only this measure; may be repeated.")] = None,
    report: o.Report = None,
    csv: o.Csv = None,
) -> None:
    """Show how a person's measures changed over sessions.

    A change is clear where it is larger than the 95 % interval of the difference and, with --mdc, than the
    minimal detectable change. The study comes from `batch --measures`.

    Example: unocclude progress recovered --person p12 --report p12.html
    """
    from ..evaluation.progress import (
        CSV_COLUMNS,
        FEWEST_PERSONS,
        SESSIONS_VARY,
        read_detectable,
        reliability_of,
        reliability_table,
    )
    from ..report.pages import progress_page
    from ..study.progress import progress_of, read_rows, sessions_of

    if not study.is_dir():
        raise UnoccludeError(f"{study} is not a folder; name the one that `unocclude batch` wrote")
    detectable = None if mdc is None else read_detectable(mdc)
    rows = read_rows(study)
    attendances, left_out = sessions_of(study, rows, sessions)
    persons = progress_of(rows, attendances, detectable)
    names = ", ".join(each.person for each in persons[:20])
    persons = [each for each in persons if person in (None, each.person)]
    if person is not None and not persons:
        raise UnoccludeError(f"the study has no person {person}; it has: {names}")
    known = {series.key for each in persons for series in each.series}
    wanted = set(measure or known)
    if known and (unknown := ", ".join(sorted(wanted - known))):
        examples = ", ".join(series.key for series in persons[0].main[:5])
        raise UnoccludeError(f"the study has no measure {unknown}; measures are as {examples}")
    persons = [replace(p, series=tuple(one for one in p.series if one.key in wanted)) for p in persons]
    if report is not None and len(persons) > 1:
        raise UnoccludeError(f"a page is of one person; choose one with --person: {names}")
    if report is not None:
        progress_page(persons[0]).write(report, out.force)
    repeated = reliability_of(persons) if reliability else []
    if reliability and not repeated:
        raise UnoccludeError(
            f"--reliability needs {FEWEST_PERSONS} persons with two sessions each; no measure has them"
        )
    figures: dict[str, object] = {"persons": [each.to_dict() for each in persons], "left_out": left_out}
    if reliability:
        figures["reliability"] = repeated
    write_csv(csv, (CSV_COLUMNS, *(row for each in persons for row in each.csv_rows())), out.force)
    out.json(figures)
    for each in persons:
        print_person(each)
    if reliability:
        show(reliability_table(repeated))
    print_notes(left_out)
    say(f"This is not a diagnosis. {SESSIONS_VARY}.")
    out.end(report, csv)


def print_person(progress: PersonProgress) -> None:
    """Print a person's table, and what takes no part."""
    say(f"--- {progress.person}: {len(progress.sessions)} sessions ({', '.join(progress.sessions)}) ---")
    if len(progress.sessions) > 1:
        first, *_, last = progress.sessions
        show(progress.table(f"Last session ({last}) against the first ({first})"))
    for sentence in progress.sentences():
        say(f"{sentence}.")
    print_notes([*progress.notes, *progress.limits, *progress.left_out])
