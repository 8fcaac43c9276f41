"""`unocclude check`: what a recording allows, and what seems wrong with it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import typer

from .load import load_arms
from .option_groups import with_groups
from .options import (
    Anatomy,
    Body,
    Calibration,
    ConfigFile,
    Force,
    Imu,
    Json,
    Processes,
    RecordingPath,
    Side,
    Skeleton,
    one_side,
)
from .output import check_outputs, print_notes, say, say_written, write_json
from .progress import progress_bar
from .remedies import AS_RECORDED, SetUp
from .run import NOT_TRUSTED
from .several_figures import arms_figures, say_arm

if TYPE_CHECKING:
    from ..calibration import ArmCalibration
    from ..config import Config
    from ..evaluation.gaps import TriedGaps
    from ..measurements.clock import Clock
    from ..recording import Recording
    from ..result import Recovery


@with_groups
def check(
    recording_file: RecordingPath,
    calibration_file: Calibration = None,
    config_file: ConfigFile = None,
    imu: Imu = None,
    skeleton: Skeleton = None,
    side: Side = None,
    body: Body = None,
    set_up: SetUp = AS_RECORDED,
    anatomy: Anatomy = None,
    processes: Processes = None,
    json_file: Json = None,
    force: Force = False,
) -> None:
    """Say what a recording allows, and what seems wrong with its set-up and what mends it.

    Of a long recording the excerpts that tell most are looked at. Every arm that has an IMU is checked. The
    exit code is 0 where a result can be used, 3 where it is not to be trusted, of one arm at least.
    """
    from .config_file import read_config, with_anatomy, with_processes

    remedy, swap_sides = set_up.remedy()
    check_outputs(force, [json_file], [recording_file, calibration_file, config_file])
    config = with_processes(read_config(config_file), processes)
    if anatomy is not None:
        config = with_anatomy(config, anatomy)
    arms = load_arms(
        recording_file,
        calibration_file,
        imu=imu,
        skeleton=skeleton,
        side=one_side(side),
        body=body,
        truth=False,
        remedy=remedy,
        swap_sides=swap_sides,
    )
    recordings = [recording for recording, _ in arms]
    clocks = [set_up.clock(calibration_file, recording) for recording in recordings]
    findings = []
    with progress_bar("checking") as progress:
        for number, (recording, calibration) in enumerate(arms):

            def advanced(share: float, text: str, done: int = number) -> None:
                progress((done + share) / len(arms), text)

            findings.append(_checked(recording, calibration, config, clocks[number], advanced))
        progress(1.0, "done")
    figures = arms_figures(recordings, [mine for mine, _ in findings])
    write_json(json_file, figures, force)
    for recording, (mine, allowed) in zip(recordings, findings, strict=True):
        say_arm(recording, len(arms))
        _print(mine, allowed)
        print_notes(recording.notes)
    say_written(json_file)
    if not figures["trusted"]:
        raise typer.Exit(NOT_TRUSTED)


def _checked(
    recording: Recording,
    calibration: ArmCalibration | None,
    config: Config,
    clock: Clock | None,
    progress: Callable[[float, str], None],
) -> tuple[dict[str, Any], TriedGaps | None]:
    """The figures of an arm, and what its recording allows where a result could be trusted."""
    from ..errors import CalibrationError, SolveError
    from ..measurements.segment import Timeline
    from ..selfcal.excerpts import informative_recording
    from ..smoothing import smooth

    excerpt = informative_recording(recording, Timeline.of(recording))

    def recover(some: Recording) -> Recovery:
        return smooth(some, calibration, config, clock=clock)

    allowed = None
    progress(0.0, "calibrating")
    try:
        recovery = recover(excerpt)
        figures = _figures(recovery)
        if recovery.estimates.trusted:
            allowed = _tried(excerpt, recovery, recover, lambda part, text: progress(0.3 + 0.7 * part, text))
    except (SolveError, CalibrationError) as error:  # what cannot be recovered is the finding
        figures = _refused(str(error))
    figures["allows"] = None if allowed is None else allowed.to_dict()
    return {"recording": recording.name, "side": recording.side, **figures}, allowed


def _tried(excerpt: Recording, recovery: Recovery, recover: Any, progress: Any) -> TriedGaps:
    from calib.motion.motion_calibration import found_in

    from ..evaluation.gaps import try_gaps

    found = found_in(recovery, excerpt)
    left_open = () if found is None else found.not_determined
    return try_gaps(replace(excerpt, truth=None), recover, left_open, progress)


def _figures(recovery: Recovery) -> dict[str, Any]:
    """The verdict as plain values, and the signs besides the cause."""
    from ..evaluation.summary import verdict_figures

    estimates = recovery.estimates
    signs = [reason for reason in estimates.reasons if reason != estimates.cause]
    return {**verdict_figures(estimates), "trusted": bool(estimates.trusted), "signs": signs}


def _refused(sentence: str) -> dict[str, Any]:
    """The same where nothing could be recovered."""
    return {
        "trusted": False,
        "verdict": f"Cannot be recovered: {sentence.rstrip('.')}.",
        "reasons": [sentence],
        "cautions": [],
        "cause": None,
        "remedies": [],
        "signs": [],
    }


def _print(figures: dict[str, Any], allowed: TriedGaps | None) -> None:
    say(figures["verdict"])
    if allowed is not None:
        allows, *open_questions = allowed.sentences
        say(f"allows: {allows}")
        for sentence in open_questions:
            say(f"not determined: {sentence}")
    for sign in figures["signs"] if figures["cause"] else ():
        say(f"sign: {sign}")
