"""`unocclude compare`: every method on one recording, one table."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..errors import UnoccludeError
from ..evaluation.methods import GRAPH, LIVE_METHODS, METHODS, make_methods
from .arm_output import arms_figures, each_arm, say_arm, warn
from .load import EVERY_ARM, ArmInput
from .methods import baseline_settings, choose, with_strap
from .options import (
    NO_FILES,
    Align,
    BoundaryS,
    ConfigFile,
    LatencyS,
    Live,
    Orientation,
    Outputs,
    Processes,
    RecordingPath,
    SolveLeverArms,
)
from .output import (
    check_outputs,
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
    from ..recording import Recording, Truth
    from ..result import Recovery


def print_comparison(comparison: Comparison) -> None:
    """Print the tables of a comparison."""
    errors, joints, lags = comparison.tables
    show(errors)
    show(joints)
    say(comparison.camera_words)
    show(lags)


def compare(
    recording_file: RecordingPath,
    truth_file: Annotated[
        Path | None,
        typer.Option(
            "--truth",
            metavar="TRUTH",
            help="As `validate` takes it (.c3d, .trc, .csv, .mcap); without it the recording's own truth.",
            show_default=False,
        ),
    ] = None,
    methods: Annotated[
        str,
        typer.Option(
            "--methods", metavar="M,M,..", help=f"Methods to compare, or all: {', '.join(METHODS)}."
        ),
    ] = "all",
    orientation: Orientation = None,
    boundary_s: BoundaryS = None,
    source: ArmInput = EVERY_ARM,
    markers: Annotated[
        Path | None,
        typer.Option("--markers", metavar="MAP.toml", help="Which markers of the truth form a joint."),
    ] = None,
    align: Align = False,
    config_file: ConfigFile = None,
    live: Live = False,
    latency_s: LatencyS = 0.1,
    solve_lever_arms: SolveLeverArms = False,
    processes: Processes = None,
    to: Outputs = NO_FILES,
) -> None:
    """Compare all methods on a recording with truth.

    The graph runs once; the other methods get its calibration, its clock and the camera samples that it
    accepted. No method sees the truth. With `--live` also what would have been shown live: by the live
    smoother and by two simple methods.
    """
    from ..evaluation.compare import compare
    from .config import read_config

    names = choose(methods)
    if live:
        names = [*names, *LIVE_METHODS]
    settings = baseline_settings(names, orientation, boundary_s)
    source.check()
    inputs = [recording_file, truth_file, source.calibration_file, markers, config_file]
    check_outputs(to.force, [to.report, to.json_file], inputs)
    config = read_config(config_file, processes)
    arms = source.load(recording_file)
    recordings = [recording for recording, _ in arms]
    for recording in recordings:
        _check_truth(recording_file, recording, truth_file, markers, align, several=len(arms) > 1)

    recovered: dict[int, Recovery] = {}

    def compare_arm(place: int) -> Comparison:
        recording, calibration = arms[place]
        clock = source.clock(recording)
        given = with_strap(calibration, recording) if solve_lever_arms else calibration
        blind = replace(recording, truth=None)

        def report_part(part: float, name: str) -> None:
            progress((place + part) / len(arms), name)

        running = make_methods(
            [GRAPH, *names],
            given,
            config,
            settings,
            lambda part, _: report_part(part / 2, GRAPH),
            clock=clock,
            latency_s=latency_s,
        )
        graph = running[GRAPH](blind)
        recovered[place] = graph
        truth, alignment = truth_for(
            recording, graph, truth_file, markers=markers, calibration=source.calibration_file, align=align
        )
        return compare(
            blind,
            graph,
            truth,
            {name: running[name] for name in names},
            alignment,
            lambda part, name: report_part((1 + part) / 2, name),
            config.windows.processes,
        )

    with progress_bar("comparing") as progress:
        compared, left_out = each_arm(recordings, compare_arm)
    if to.report is not None:
        write_page(compared, to.report, to.force)
    each = []
    for recording, comparison in compared:
        figures = {"recording": recording.name, "side": recording.side, **comparison.to_dict()}
        estimates = recovered[next(k for k, each in enumerate(recordings) if each is recording)].estimates
        figures |= {"trusted": estimates.trusted, "verdict": estimates.verdict}
        figures["notes"] = list(dict.fromkeys([*recording.notes, *left_out, *comparison.notes]))
        each.append(figures)
    write_json(to.json_file, arms_figures([recording for recording, _ in compared], each), to.force)
    warn(list(recovered.values()))
    for recording, comparison in compared:
        say_arm(recording, len(compared))
        print_comparison(comparison)
        print_notes([*recording.notes, *left_out, *comparison.notes])
    say_written(to.report, to.json_file)


def write_page(compared: Sequence[tuple[Recording, Comparison]], path: Path, force: bool) -> None:
    """The comparison of an arm, or of several on one page."""
    from ..report.method_comparison import comparison_page
    from ..report.page import arms_comparison_page

    if len(compared) > 1:
        arms_comparison_page(compared).write(path, force)
    else:
        ((recording, comparison),) = compared
        comparison_page(comparison, recording).write(path, force)


def _check_truth(
    path: Path,
    recording: Recording,
    truth_file: Path | None,
    markers: Path | None,
    align: bool,
    several: bool,
) -> None:
    """Refuse before anything is solved what cannot be compared in the end."""
    if truth_file is not None:
        if not truth_file.is_file():
            raise UnoccludeError(f"{truth_file}: there is no such file")
        if several and truth_file.suffix.lower() != ".mcap":
            raise UnoccludeError(
                f"{truth_file} is the truth of one arm, and {path} has IMUs on several; choose its arm with"
                " --side or --body"
            )
        return
    if markers is not None or align:
        raise typer.BadParameter("--markers and --align are for a truth named with --truth")
    if recording.truth is None or not len(recording.truth):
        raise UnoccludeError(
            f"{path} has no truth: name one with --truth, or hide visible stretches with `unocclude gaps`"
        )


def truth_for(
    recording: Recording,
    graph: Recovery,
    truth_file: Path | None,
    *,
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
        holds = "camera_from_mocap" in read_calibration(calibration).tables
        frame = calibration if holds else None
    return read_reference(
        truth_file,
        graph,
        markers=markers,
        calibration=frame,
        camera_frame=recording.camera_frame,
        align=align,
    )
