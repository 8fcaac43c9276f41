"""`unocclude compare`: every method on one recording, one table."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..errors import UnoccludeError
from ..evaluation.methods import GRAPH, LIVE_METHODS, METHODS, make_methods
from . import options as o
from .arm_output import arms_figures, each_arm, say_arm, warn
from .load import ArmInput, refuse_several
from .methods import baseline_settings, choose
from .output import (
    check_outputs,
    part_of,
    print_notes,
    progress_bar,
    say,
    say_written,
    show,
    write_json,
)

if TYPE_CHECKING:
    from ..evaluation.compare import Comparison
    from ..evaluation.reference import ReferenceAlignment
    from ..io.recording.choose import Selection
    from ..recording import Recording, Truth
    from ..result import Recovery


def compare(
    recording_file: o.RecordingPath,
    truth: Annotated[o.File, o.value("TRUTH", "As of `validate`; else the recording's own truth.")] = None,
    methods: Annotated[str, o.value("M,M,..", f"Methods to compare, or all: {', '.join(METHODS)}.")] = "all",
    markers: Annotated[o.File, o.value("MAP.toml", "Which markers of the truth form a joint.")] = None,
    align: o.Align = False,
    calibration: o.Calibration = None,
    report: o.Report = None,
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
    processes: o.Processes = None,
) -> None:
    """Compare all methods on a recording with truth.

    The graph runs once; the other methods get its calibration, its clock and the camera samples that it
    accepted. No method sees the truth. With `--live` also what would have been shown live: by the live
    smoother and by two simple methods.

    Example: unocclude compare session.mcap --truth trial.c3d --markers map.toml --report c.html
    """
    from ..evaluation.compare import compare
    from .config import read_config

    names = [*choose(methods), *(LIVE_METHODS if live else ())]
    settings = baseline_settings(names, orientation)
    chosen: Selection = {"imu": imu, "skeleton": skeleton, "side": side, "body": body}
    source = ArmInput(calibration, chosen, mirror, swap, negate, camera_frame, clock_offset, clock_sigma)
    check_outputs(force, [report, json_file], [recording_file, truth, calibration, markers, config_file])
    if truth is None and (markers is not None or align):
        raise typer.BadParameter("--markers and --align are for a truth named with --truth")
    config = read_config(config_file, processes)
    arms = source.load(recording_file)
    if truth is not None:
        refuse_several([recording for recording, _ in arms], truth)
    elif any(recording.truth is None or not len(recording.truth) for recording, _ in arms):
        raise UnoccludeError(
            f"{recording_file} has no truth: name one with --truth, or hide visible stretches with"
            " `unocclude gaps`"
        )

    def compare_arm(place: int) -> tuple[Recovery, Comparison]:
        recording, given = arms[place]
        blind = replace(recording, truth=None)
        of_arm = part_of(progress, place, len(arms))
        running = make_methods(
            [GRAPH, *names],
            given,
            config,
            settings,
            lambda part, _: of_arm(part / 2, GRAPH),
            clock=source.clock(recording),
            latency_s=latency,
        )
        graph = running[GRAPH](blind)
        own, alignment = truth_for(recording, graph, truth, markers, calibration, align)
        chosen_methods = {name: running[name] for name in names}
        comparison = compare(
            blind,
            graph,
            own,
            chosen_methods,
            alignment,
            lambda part, name: of_arm((1 + part) / 2, name),
            config.windows.processes,
        )
        return graph, comparison

    with progress_bar("comparing") as progress:
        answers, left_out = each_arm([recording for recording, _ in arms], compare_arm)
    compared = [(recording, comparison) for recording, (_, comparison) in answers]
    if report is not None:
        from ..report.method_comparison import comparison_page

        comparison_page(compared).write(report, force)
    each, notes = [], []
    for recording, (graph, comparison) in answers:
        notes.append(list(dict.fromkeys([*recording.notes, *left_out, *comparison.notes])))
        each.append(
            {"recording": recording.name, "side": recording.side, **comparison.to_dict()}
            | {"trusted": graph.estimates.trusted, "verdict": graph.estimates.verdict, "notes": notes[-1]}
        )
    write_json(json_file, arms_figures([recording for recording, _ in compared], each), force)
    warn([graph for _, (graph, _) in answers])
    for (recording, comparison), of_arm in zip(compared, notes, strict=True):
        say_arm(recording, len(compared))
        errors, joints, lags = comparison.tables
        show(errors)
        show(joints)
        say(comparison.camera_words)
        show(lags)
        print_notes(of_arm)
    say_written(report, json_file)


def truth_for(
    recording: Recording,
    graph: Recovery,
    truth_file: Path | None,
    markers: Path | None,
    calibration: Path | None,
    align: bool,
) -> tuple[Truth, ReferenceAlignment]:
    """The truth for a comparison: the recording's own, or a file's, brought to it as `validate` does.

    A calibration is used for the truth's frame where it contains [camera_from_mocap] and the truth needs one.
    """
    from calib.file import read_calibration

    from ..evaluation.reference import ReferenceAlignment, read_reference
    from ..io.tables.markers import MARKER_FORMATS

    if truth_file is None:
        assert recording.truth is not None
        return recording.truth, ReferenceAlignment()
    of_markers = truth_file.suffix.lower() in MARKER_FORMATS
    frame = None
    if calibration is not None and (of_markers or align):
        frame = calibration if "camera_from_mocap" in read_calibration(calibration).tables else None
    return read_reference(
        truth_file,
        graph,
        markers=markers,
        calibration=frame,
        camera_frame=recording.camera_frame,
        align=align,
    )
