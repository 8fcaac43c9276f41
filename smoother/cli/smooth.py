"""`unocclude smooth`: recover every gap of a recording."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..errors import UnoccludeError
from ..evaluation.methods import GRAPH, METHODS, make_methods
from . import options as o
from .load import PersonConfigInput, TrialInput, filter_of
from .output import Out, end_strictly, is_imported, progress_bar, say, say_more, show

if TYPE_CHECKING:
    from ..calibration import ArmCalibration
    from ..config import Config
    from ..measurements.clock import Clock
    from ..recording import Recording
    from ..result import Recoveries, Recovery
    from ..runtime.pool import Progress


def smooth(
    recording_file: o.RecordingPath,
    output: o.ResultOutput,
    source: TrialInput,
    settings: PersonConfigInput,
    out: Out,
    method: Annotated[str, o.value("M", f"Method: {', '.join(METHODS)}.")] = "graph",
    report: o.Report = None,
    max_sigma_m: Annotated[o.Number, o.value("M", "Mark samples above this sigma (`usable` = 0).")] = None,
    strict: o.Strict = False,
    verbose: o.Verbose = False,
    orientation: o.Orientation = None,
    solve_lever_arms: Annotated[
        bool, o.rare("Estimate the offset of strap and IMU, else zero.", "--solve-lever-arms")
    ] = False,
    draws: o.Draws = None,
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

    names = o.listed(method, METHODS, "method")
    several = "--method takes one method; `unocclude compare` runs several"
    not_a_length = "--max-sigma-m is a length above zero, in m"
    o.refuse({several: len(names) > 1, not_a_length: max_sigma_m is not None and not max_sigma_m > 0})
    chosen_filter = filter_of(names, orientation)
    motions = drawn_motions(draws, seed, names[0])
    config = settings.read()
    with source.in_session(recording_file, config) as known:
        arms = known.load(recording_file, truth=False)
        recordings = [recording for recording, _ in arms]
        clocks = [known.clock(one) for one in recordings]
        given = [with_strap(known, recording) if solve_lever_arms else known for recording, known in arms]
        with progress_bar("recovering") as progress:
            recoveries = recover_arms(
                recordings, names[0], given, clocks, config, chosen_filter, progress, motions, seed or 0
            )
        results = []
        for recovery in recoveries:
            recording, own = next(arm for arm in arms if is_of_arm(recovery, arm[0]))
            recovery = with_given(recovery, own)
            if solve_lever_arms:
                recovery = with_strap_note(recovery)
            results.append((recording, limit_sigma(recovery, max_sigma_m)))
        answers = [recovery for _, recovery in results]
        write_recovery(answers, output, source=recording_file, force=out.force)
        if report is not None:
            from ..report import write_report

            write_report([(*each, None, None) for each in results], report, force=out.force)
        figures = [{} if out.json_file is None else smooth_figures(*each) for each in results]
        out.arms(answers, figures, lambda number: print_recovery(*results[number], verbose))
        out.end(output, report)
    if strict:
        end_strictly(recovery.estimates.trusted for recovery in answers)


def smooth_figures(recording: Recording, recovery: Recovery) -> dict[str, Any]:
    """All figures of a recovery, what it found and what it rejected included."""
    from calib.motion import found_in

    from ..evaluation.summary import recovery_figures, rejected, verdict_figures
    from ..result.untrusted import usable

    found = found_in(recovery, recording)
    return recovery_figures(recovery) | {
        **verdict_figures(recovery.estimates),
        "usable": int(usable(recovery).sum()),
        "found": None if found is None else found.figures,
        "not_determined": [] if found is None else list(found.not_determined),
        "rejected": rejected(recovery),
    }


def print_recovery(recording: Recording, recovery: Recovery, verbose: bool = False) -> None:
    """Print what matters of a recovery: verdict, self-check, gaps, and what must be known of it.

    `verbose`: every gap, what was found and rejected, and every note.
    """
    from calib.motion import found_in

    from ..evaluation.summary import cameras, gap_summaries, gap_table, rejections
    from ..io.mcap.messages import damage
    from ..result.untrusted import untrusted_sentences

    gaps = gap_summaries(recovery)
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
    show(cameras(recovery))
    most = MOST_ROWS if verbose else FEW_GAPS
    # of many the doubtful and the least certain; in the order of time
    shown = sorted(gaps, key=lambda gap: (gap.trusted is not False, -(gap.error_95_m or math.inf)))
    few_gaps = sorted(shown[:most], key=lambda gap: gap.number)
    which = "Gaps" if len(gaps) <= most else f"The {most} least certain of {len(gaps)} gaps"
    show(gap_table(f"{which}: errors that 95 of 100 stay below", few_gaps))
    found = found_in(recovery, recording)
    if verbose:
        from calib.protocol import tables_of

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


def drawn_motions(draws: int | None, seed: int | None, method: str) -> int:
    """How many motions are drawn from the posterior: as usual unless something else was said."""
    from ..result.draws import USUAL_DRAWS

    if method == GRAPH:
        contradictory = "--seed is for the drawn motions, and --draws 0 draws none; leave one out"
        o.refuse({contradictory: seed is not None and draws == 0})
        return USUAL_DRAWS if draws is None else draws
    option = "--draws" if draws else "--seed"
    no_posterior = f"{option} belongs to the method {GRAPH}: '{method}' has no posterior"
    o.refuse({no_posterior: draws or seed is not None})
    return 0


def recover_arms(
    recordings: Sequence[Recording],
    name: str,
    calibrations: Sequence[ArmCalibration | None],
    clocks: Sequence[Clock | None],
    config: Config,
    orientation: str,
    progress: Progress,
    draws: int = 0,
    seed: int = 0,
) -> Recoveries:
    """The arms of a recording by one method; those that cannot be recovered are left out.

    Motions are drawn from the graph's posterior only.
    """
    from ..several_arms import smooth_arms, together

    if name == GRAPH:
        return smooth_arms(recordings, calibrations, config, progress, clocks=clocks, draws=draws, seed=seed)

    def recovered(recording: Recording, given: ArmCalibration | None, clock: Clock | None) -> Any:
        try:
            return make_methods([name], given, config, orientation, progress, clock)[name](recording)
        except UnoccludeError as error:
            return error

    return together(recordings, list(map(recovered, recordings, calibrations, clocks)))


#: How far the camera's strap may lie from the IMU where that is to be found, m per axis.
STRAP_SIGMA_M = 0.02


def with_strap(calibration: ArmCalibration | None, recording: Recording) -> ArmCalibration:
    """The calibration with the strap's lever arm as a variable, unless it contains one."""
    import numpy as np

    from ..calibration import ArmCalibration, LeverArm

    calibration = calibration or ArmCalibration(side=recording.side)
    if "strap" not in recording.arm.present:
        raise typer.BadParameter(
            "--solve-lever-arms is for recordings with a tracked strap;"
            " lever arms of the joints are found without it"
        )
    strap = LeverArm(np.zeros(3), np.full(3, STRAP_SIGMA_M))
    return replace(calibration, lever_arms={"strap": strap, **calibration.lever_arms})


def with_strap_note(recovery: Recovery) -> Recovery:
    """The recovery with a note that its positions are the IMU's, not the strap's."""
    import numpy as np

    arm = recovery.calibration
    if arm is None or "strap" not in arm.lever_arms:
        return recovery
    lever = arm.lever_arms["strap"]
    note = (
        f"The tracked strap was found {1e3 * np.linalg.norm(lever.position_m):.1f} mm from the IMU; positions"
        " are those of the IMU, and a reference of the strap is that far off."
    )
    return replace(recovery, notes=(*recovery.notes, note))


def limit_sigma(recovery: Recovery, max_sigma_m: float | None) -> Recovery:
    """Mark the samples whose position is less certain than asked for; they stay as they are."""
    if max_sigma_m is None:
        return recovery
    from ..result.untrusted import certain

    answered = int(certain(recovery).sum())
    marked = replace(recovery, estimates=replace(recovery.estimates, max_sigma_m=float(max_sigma_m)))
    below = int(certain(marked).sum())
    note = (
        f"{answered - below} of {answered} samples are less certain than {max_sigma_m:g} m (one standard"
        " deviation) and are marked as not to be used: `usable` is 0 in the CSV export."
    )
    return replace(marked, notes=(*recovery.notes, note))
