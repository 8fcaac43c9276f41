"""`unocclude validate`: a result against mocap."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from . import options as o
from .arm_output import arms_figures, say_arm, warn
from .load import camera_frame_of, damage, load_recoveries, refuse_several
from .output import check_outputs, print_notes, progress_bar, say, show, write_json

if TYPE_CHECKING:
    from ..evaluation.validate import Validation


#: More gaps than this are not printed, `--json` has them all; without --verbose this many notes and measures.
_MOST_GAPS, FEW_NOTES, FEW_MEASURES = 40, 2, 4


def validate(
    result: o.Result,
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
        Path | None,
        o.value("CAL.toml", "[camera_from_mocap]; else aligned by motion."),
    ] = None,
    align: o.Align = False,
    pool: Annotated[o.Files, o.value("FILE.json", "Add the measures of an earlier --json file.")] = None,
    verbose: o.Verbose = False,
    report: o.Report = None,
    json_file: o.Json = None,
    force: o.Force = False,
    side: o.Side = None,
    body: o.Body = None,
    processes: o.Processes = None,
) -> None:
    """Compare a result with motion capture or another reference.

    With several arms, each is compared with its own truth (topics /truth/left, /truth/right); a truth
    without a side belongs to one arm, chosen with --side.

    Example: unocclude validate out.mcap --truth trial.c3d --markers map.toml --calibration rig.toml
    """
    from ..evaluation.measure_agreement import read_pairs, unique_pairs
    from ..evaluation.reference import read_reference
    from ..evaluation.validate import validate

    check_outputs(force, [report, json_file], [result, truth, markers, calibration, *(pool or ())])
    pooled = unique_pairs(pair for path in pool or () for pair in read_pairs(path))
    recoveries = load_recoveries(result, side, body)
    refuse_several(recoveries, truth)
    axes = camera_frame_of(result)
    frame = None if calibration is None else axes
    results = []
    for recovery in recoveries:
        own, alignment = read_reference(
            truth, recovery, markers=markers, calibration=calibration, camera_frame=frame, align=align
        )
        with progress_bar("measuring") as progress:
            validation = validate(recovery, own, alignment, pooled, processes or 0, progress)
        if validation.measures is not None:
            pooled = validation.measures.together
        results.append((recovery, validation, own))
    if report is not None:
        from ..report import write_arms_report

        write_arms_report([(None, *each) for each in results], report, camera_frame=axes, force=force)
    validations, figures = [], []
    for recovery, one, _ in results:
        damaged = [note for note in damage(recovery.notes) if note not in one.notes]
        validations.append(replace(one, notes=(*damaged, *one.notes)))
        verdict = {"trusted": recovery.estimates.trusted, "verdict": recovery.estimates.verdict}
        figures.append(validations[-1].to_dict() | verdict)
    write_json(json_file, arms_figures(recoveries, figures), force)
    warn(recoveries)
    for recovery, validation in zip(recoveries, validations, strict=True):
        say_arm(recovery, len(recoveries))
        print_validation(validation, verbose)


def print_validation(validation: Validation, verbose: bool = False) -> None:
    """Print the figures of a validation: what matters in 40 lines, or all of them."""
    from ..evaluation.measure_agreement import agreement_table, pair_table
    from ..evaluation.words import first_of

    show(validation.errors)
    show(validation.joint_errors)
    angles = validation.angle_errors
    show(angles if verbose else replace(angles, rows=[row for row in angles.rows if row[1] != "visible"]))
    if verbose:
        show(validation.gap_errors, _MOST_GAPS)
        if (bias := validation.all.position_bias_m) is not None:
            say(f"bias of the position, x y z of the camera, cm: {' '.join(f'{100 * x:+.2f}' for x in bias)}")
        if (lag_s := validation.lag_s) is not None:
            say(f"lag of the answer behind the truth: {1000 * lag_s:+.1f} ms (peak of cross-correlation)")
    if (comparison := validation.measures) is not None:
        found = [one for by_key in comparison.agreements.values() for one in by_key.values()]
        several = any(one["recordings"] > 1 for one in found)
        session = [pair.key for pair in comparison.pairs if pair.scope == "session"]
        chosen = None if verbose else first_of(session, FEW_MEASURES)
        if verbose or not several:
            show(pair_table(validation.alignment.titled("Measures of the session"), comparison, chosen))
        if verbose or several:  # agreement is that of several recordings
            title = "Agreement of the measures (answer minus truth) over recordings and movements"
            show(agreement_table(validation.alignment.titled(title), comparison, chosen))
    print_notes(validation.notes if verbose else validation.notes[:FEW_NOTES])
    if not verbose:
        say("--verbose prints every gap, part, measure and note; --json has them all")
