"""`unocclude smooth`: recover every gap of a recording."""

from __future__ import annotations

import math
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..evaluation.methods import METHODS
from ..table import tabulated
from . import options as o
from .arm_output import arms_figures, end_strictly, say_arm
from .load import ArmInput, damage
from .methods import baseline_settings, choose, drawn_motions, recover_arms, with_strap, with_strap_note
from .output import (
    check_mcap,
    check_outputs,
    is_imported,
    progress_bar,
    say,
    say_more,
    say_written,
    show,
    write_json,
)

if TYPE_CHECKING:
    from ..config import Config
    from ..io.recording.choose import Selection
    from ..recording import Recording
    from ..result import Recovery


def smooth(
    recording_file: o.RecordingPath,
    output: o.Output,
    calibration: o.Calibration = None,
    session: Annotated[o.File, o.value("FOLDER", "Trials of the same strap, calibrated together.")] = None,
    method: Annotated[str, o.value("M", f"Method: {', '.join(METHODS)}.")] = "graph",
    report: o.Report = None,
    max_sigma_m: Annotated[o.Number, o.value("M", "Mark samples above this sigma (`usable` = 0).")] = None,
    strict: o.Strict = False,
    verbose: o.Verbose = False,
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
    solve_lever_arms: Annotated[
        bool, o.rare("Estimate the offset of strap and IMU, else zero.", "--solve-lever-arms")
    ] = False,
    anatomy: o.Anatomy = None,
    body_height: o.BodyHeight = None,
    processes: o.Processes = None,
    draws: Annotated[o.Count, o.rare("Drawn motions; 0 = none.  [default: 64]", min=0, max=1000)] = None,
    seed: Annotated[int | None, o.rare("Seed of the drawn motions.  [default: 0]", min=0)] = None,
) -> None:
    """Recover the motion in every gap, with its uncertainty.

    Recovers every arm that has an IMU, of all persons. IMUs whose names do not state where they were
    worn are assigned by motion; the notes state the result. The exit code is 0 if the result was written;
    with --strict it is 3 if the verdict on an arm is "not to be trusted".

    Example: unocclude smooth session.mcap -o out.mcap --calibration arm.toml --report out.html
    """
    from calib.motion import with_given

    from ..io import write_recovery
    from ..result import is_of_arm
    from .config import read_config
    from .methods import limit_sigma

    names = choose(method)
    if len(names) != 1:
        raise typer.BadParameter("--method takes one method; `unocclude compare` runs several")
    settings = baseline_settings(names, orientation)
    if max_sigma_m is not None and not max_sigma_m > 0:
        raise typer.BadParameter("--max-sigma-m is a length above zero, in m")
    motions = drawn_motions(draws, seed, names[0])
    chosen: Selection = {"imu": imu, "skeleton": skeleton, "side": side, "body": body}
    source = ArmInput(calibration, chosen, mirror, swap, negate, camera_frame, clock_offset, clock_sigma)
    check_mcap(output, exports=True)
    check_outputs(force, [output, report, json_file], [recording_file, calibration, config_file])
    config = read_config(config_file, processes, anatomy, body_height)
    with ExitStack() as ended:
        if session is not None:
            folder = Path(ended.enter_context(TemporaryDirectory(prefix="unocclude-")))
            source = of_session(recording_file, session, source, config, folder)
        arms = source.load(recording_file, truth=False)
        recordings = [recording for recording, _ in arms]
        clocks = [source.clock(one) for one in recordings]
        given = [with_strap(known, recording) if solve_lever_arms else known for recording, known in arms]
        with progress_bar("recovering") as progress:
            recoveries = recover_arms(
                recordings, names[0], given, clocks, config, settings, progress, motions, seed or 0
            )
        results = []
        for recovery in recoveries:
            recording, own = next(arm for arm in arms if is_of_arm(recovery, arm[0]))
            recovery = with_given(recovery, own)
            if solve_lever_arms:
                recovery = with_strap_note(recovery)
            results.append((recording, limit_sigma(recovery, max_sigma_m)))
        answers = [recovery for _, recovery in results]
        write_recovery(answers, output, source=recording_file, force=force)
        if report is not None:
            from ..report import write_arms_report

            write_arms_report(results, report, force=force)
        if json_file is not None:
            figures = [smooth_figures(recording, recovery) for recording, recovery in results]
            together = arms_figures(answers, figures)
            write_json(json_file, together, force)
        for recording, recovery in results:
            say_arm(recovery, len(results))
            print_recovery(recording, recovery, verbose)
    say_written(output, report, json_file)
    if strict:
        end_strictly(recovery.estimates.trusted for recovery in answers)


def of_session(
    recording_file: Path, session: Path, source: ArmInput, config: Config, folder: Path
) -> ArmInput:
    """The input with the calibration that the trials of a folder show together, and what they brought."""
    from ..study.sessions import calibrate_session, write_arms

    if source.calibration_file is not None:
        raise typer.BadParameter("--session finds the calibration; give it or --calibration, not both")
    if not session.is_dir():
        raise typer.BadParameter(f"--session is a folder of recordings; {session} is none")
    own = recording_file.resolve()
    trials = dict.fromkeys([*(path.resolve() for path in sorted(session.glob("*.mcap"))), own])
    found = calibrate_session(trials, source.chosen or {}, config, config.windows.processes)
    if found.sentence:
        say(f"{session}: {found.sentence}")
    if own not in found.arms:
        say(f"{recording_file}: it is no trial of this session's straps, or its motion does not show it")
        return source
    write_arms(folder / "session.toml", found.arms[own])
    return replace(source, calibration_file=folder / "session.toml")


def smooth_figures(recording: Recording, recovery: Recovery) -> dict[str, Any]:
    """All figures of a recovery, what it found and what it rejected included."""
    from calib.motion import found_in

    from ..evaluation.advice import advice, rejected
    from ..evaluation.summary import recovery_figures, verdict_figures
    from ..result.untrusted import usable

    found = found_in(recovery, recording)
    return recovery_figures(recovery) | {
        **verdict_figures(recovery.estimates),
        "usable": int(usable(recovery).sum()),
        "found": None if found is None else found.figures,
        "not_determined": [] if found is None else list(found.not_determined),
        "rejected": rejected(recovery),
        "advice": advice(recovery, found),
    }


def print_recovery(recording: Recording, recovery: Recovery, verbose: bool = False) -> None:
    """Print what matters of a recovery: verdict, self-check, gaps, and what must be known of it.

    `verbose`: every gap, what was found and rejected, and every note.
    """
    from calib.motion import found_in

    from ..evaluation.summary import camera_sentences, gap_summaries
    from ..result.untrusted import untrusted_sentences

    gaps = list(enumerate(gap_summaries(recovery), start=1))
    duration_s = float(recovery.t_s[-1] - recovery.t_s[0]) if len(recovery) else 0.0
    estimates = recovery.estimates
    if estimates.verdict:
        say(estimates.verdict)
    if estimates.self_check is not None:
        say(estimates.self_check.sentence)
    for sign in estimates.reasons[1:] if estimates.cause else ():
        say(f"sign: {sign}")
    say(
        f"{recovery.name}: {duration_s:.1f} s, {len(recovery)} samples, {len(gaps)}"
        f" {'gap' if len(gaps) == 1 else 'gaps'}, {sum(gap.length_s for gap in recovery.gaps):.1f} s occluded"
    )
    for sentence in camera_sentences(recovery):
        say(sentence)
    most = MOST_ROWS if verbose else FEW_GAPS
    # of many the doubtful and the least certain; in the order of time
    shown = sorted(gaps, key=lambda gap: (gap[1].trusted is not False, -(gap[1].error_95_m or math.inf)))
    rows = [
        {
            "gap": number,
            "start_s": gap.gap.start_s,
            "length_s": gap.gap.length_s,
            "trusted": gap.trusted,
            "position_m": gap.error_95_m,
            "elbow_deg": gap.sigma_max_flexion_deg and SIGMAS_95 * gap.sigma_max_flexion_deg,
            "seen_from": "one side" if gap.one_sided else "both sides",
        }
        for number, gap in sorted(shown[:most], key=lambda gap: gap[0])
    ]
    which = "Gaps" if len(rows) == len(gaps) else f"The {len(rows)} least certain of {len(gaps)} gaps"
    keys = "gap start_s length_s trusted position_m elbow_deg seen_from"
    show(tabulated(f"{which}: errors that 95 of 100 stay below", rows, keys))
    found = found_in(recovery, recording)
    if verbose:
        from calib.protocol import tables_of

        from ..report.tables import rejections

        say_more(len(gaps), most, "gaps more; --json and the report have them all")
        known = ("lever_arms", "lengths") if found is not None and found.all_given else ()
        figures = {} if found is None else found.figures
        for table in tables_of({key: value for key, value in figures.items() if key not in known}):
            show(table)
        show(rejections(recovery))
    notes = dict.fromkeys((*recording.notes, *recovery.notes))
    damaged = damage(notes)
    remarks = [
        *(f"not to be trusted: {sentence}" for sentence in untrusted_sentences(recovery)),
        *(f"note: {note}" for note in damaged),
        *(f"not determined: {sentence}" for sentence in (() if found is None else found.not_determined)),
        *(f"note: {each}" for each in notes if each not in damaged and (verbose or not is_imported(each))),
    ]
    few = MOST_REMARKS if verbose else FEW_REMARKS
    for remark in remarks[:few]:
        say(remark)
    how = "" if verbose else "--verbose prints them, "
    say_more(len(remarks), few, f"more remarks; {how}--json and the report have them")


#: A table longer than this is too long for a terminal: without --verbose this many gaps are shown.
MOST_ROWS, FEW_GAPS = 25, 4
#: And this many remarks, the gravest first.
MOST_REMARKS, FEW_REMARKS = 25, 5
#: A normal error is smaller than this many sigmas in 95 of 100 cases.
SIGMAS_95 = 1.96
