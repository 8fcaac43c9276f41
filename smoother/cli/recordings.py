"""`unocclude info`, `match`, `repair` and `check`: what a recording contains and allows."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from .arm_output import arms_figures, say_arm
from .load import EVERY_ARM, ArmInput
from .options import (
    ANY_ARM,
    Anatomy,
    ArmSelection,
    BodyHeight,
    ConfigFile,
    Force,
    Json,
    Processes,
    RecordingPath,
    Skeleton,
)
from .output import (
    check_mcap,
    check_outputs,
    print_notes,
    print_table,
    progress_bar,
    say,
    say_written,
    write_json,
)
from .run import NOT_TRUSTED

if TYPE_CHECKING:
    from ..calibration import ArmCalibration
    from ..config import Config
    from ..evaluation.gaps import TriedGaps
    from ..io.info import RecordingInfo
    from ..io.mcap.repair import RepairReport
    from ..matching import ImuMatch
    from ..measurements.clock import Clock
    from ..recording import Recording
    from ..result import Recovery


def info(
    recording_file: RecordingPath,
    arm: ArmSelection = ANY_ARM,
    json_file: Json = None,
    force: Force = False,
) -> None:
    """Show streams, rates, clocks, gaps, and what is missing."""
    from ..io import describe

    check_outputs(force, [json_file], [recording_file])
    about = describe(recording_file, **arm.reading())
    write_json(json_file, about.to_dict(), force)
    print_topics(about)
    print_arm(about)
    print_missing(about)
    print_notes(about.notes, imported=True)


def print_topics(about: RecordingInfo) -> None:
    """Print the topics of a recording."""
    rows = [
        (topic.name, topic.schema, topic.count, topic.rate_hz, f"{topic.duration_s:.1f}")
        for topic in about.topics
    ]
    title = f"{about.path}, {about.size_bytes / 1e6:.1f} MB"
    print_table(title, ("topic", "schema", "messages", "rate, Hz", "length, s"), rows)


def print_arm(about: RecordingInfo) -> None:
    """Print the streams found, and what would be taken of them."""
    from ..body import FURTHER

    rows: list[tuple[str, object]] = [("IMU found", text) for text in about.imus]
    rows += [("skeleton found", text) for text in about.skeletons]
    rows += [("truth found", text) for text in about.poses]
    for arm in about.arms:
        of = f"{arm.label}: " if len(about.arms) > 1 else ""
        body = "" if arm.body is None else f" (body {arm.body})"
        rows += [
            (f"{of}taken", f"{arm.imu}, {arm.side or 'no side'} arm of {arm.skeleton}{body}"),
            *(
                (f"{of}on the {segment.label}", name)
                for segment in FURTHER
                if (name := getattr(arm, f"{segment.prefix}_imu"))
            ),
            *([(f"{of}on the trunk", arm.trunk_imu)] if arm.trunk_imu else []),
            *((f"{of}further camera", text) for text in arm.cameras),
            (f"{of}joints", ", ".join(arm.joints) or "none tracked"),
            (f"{of}both recorded, s", arm.duration_s),
            (f"{of}gaps", arm.gaps),
            (f"{of}occluded, s", arm.gap_total_s),
            (f"{of}longest gap, s", arm.gap_longest_s),
        ]
    if about.arms:
        rows.append(("camera frame", about.camera_frame or "not stated"))
    for topic, clock in about.clocks.items():
        behind = clock.get("log_time_behind_s")
        lag = "" if behind is None else f", logged {1000 * behind:.1f} ms later"
        rows.append((f"clock of {topic}", f"{clock['first_s']:.3f} to {clock['last_s']:.3f} s{lag}"))
    print_table("Streams", ("what", "found"), rows)


def _say_verdicts(about: RecordingInfo) -> None:
    """Print the verdict on each arm of a result, and how many of its times are not to be trusted."""
    for each in about.verdicts:
        of = f"{each['arm']}: " if each["arm"] else ""
        if each["verdict"]:
            say(f"{of}{each['verdict']}")
        if each["trusted"] is not False and (times := each["untrusted"]):
            assert isinstance(times, list)
            count = f"{len(times)} {'time' if len(times) == 1 else 'times'}"
            say(f"{of}not to be trusted at {count}; export lists them")


def print_missing(about: RecordingInfo) -> None:
    """Print what is missing for recovering first, then in short what it can do without."""
    if about.result:
        say("contains a result: use validate or export")
    elif "smooth" in about.missing:
        say(f"cannot be recovered: {about.missing['smooth']}")
    else:
        for arm in about.arms:
            of = f"{arm.label}: " if len(about.arms) > 1 else ""
            say(of + (arm.allows if arm.ready else f"not ready for `unocclude smooth`: it {arm.allows}"))
        if about.ready:
            say("ready for `unocclude smooth`")
    _say_verdicts(about)
    for step, reason in about.missing.items():
        if step != "smooth":
            say(f"{step}: {reason}")
    if about.optional and not about.result:
        lacks = ", ".join(f"{what} ({use})" for what, use in about.optional.items())
        say(f"not in the file, not needed to recover: {lacks}")


Method = Annotated[
    str,
    typer.Option(
        "--method",
        metavar="motion|joint-likelihood|all",
        help="How pairs are compared; `all` prints both results.",
    ),
]
Reach = Annotated[
    float,
    typer.Option("--clocks-apart-s", metavar="S", min=0.0, max=60.0, help="Clocks may differ by this, s."),
]


def match(
    recording_file: RecordingPath,
    method: Method = "motion",
    clocks_apart_s: Reach = 5.0,
    skeleton: Skeleton = None,
    json_file: Json = None,
    force: Force = False,
) -> None:
    """Find which IMU is on which body and limb, by motion alone.

    Needs no calibration, common orientation or common clock. An IMU is assigned to a wrist (forearm) or
    upper arm, to none of the limbs in view, or left unknown if the motion does not decide.
    """
    from ..io import open_recording
    from ..io.recording.match import match_file
    from ..matching import METHODS

    names = list(METHODS) if method == "all" else [method]
    if names[0] not in METHODS:
        raise typer.BadParameter(f"--method is {', '.join(METHODS)} or all, not '{method}'")
    check_outputs(force, [json_file], [recording_file])
    file = open_recording(recording_file, truth=False)
    answers = {}
    for name in names:
        answers[name], notes = match_file(file, name, clocks_apart_s, skeleton=skeleton)
        if name == names[0]:
            print_matches(str(recording_file), answers[name])
            print_notes([*file.notes, *notes])
    if len(names) > 1:
        _print_beside(answers)
    figures: dict[str, object] = {"matches": [one.to_dict() for one in answers[names[0]]], "method": names[0]}
    if len(names) > 1:
        figures["methods"] = {name: [one.to_dict() for one in found] for name, found in answers.items()}
    write_json(json_file, figures, force)


def print_matches(title: str, matches: list[ImuMatch]) -> None:
    """Print what was decided, one row per IMU."""
    rows = []
    for one in matches:
        body = "-" if one.limb is None else str(one.limb.body)
        others = ", ".join(f"{where} {p:.2f}" for where, p in one.others[:3])
        clock = None if one.limb is None else f"{one.clock_offset_s:+.2f}"
        rows.append((one.imu, body, one.joint, f"{one.probability:.3f}", clock, others or "-"))
    print_table(title, ("IMU", "body", "joint", "probability", "IMU - camera, s", "else"), rows)
    sure = sum(one.is_sure for one in matches)
    are = "is" if sure == 1 else "are"
    say(f"{sure} of {len(matches)} IMUs {are} matched with a probability above 0.95")


def _print_beside(answers: dict[str, list[ImuMatch]]) -> None:
    """Print every method's answer, one row per IMU."""
    rows = [
        [
            found[0].imu,
            *(f"{'' if m.limb is None else m.limb.body} {m.joint} {m.probability:.2f}" for m in found),
        ]
        for found in zip(*answers.values(), strict=True)
    ]
    print_table("Both methods: body, joint, probability", ("IMU", *answers), rows)


Broken = Annotated[
    Path,
    typer.Argument(metavar="BROKEN.mcap", help="The damaged file; it is not changed.", show_default=False),
]
Whole = Annotated[
    Path, typer.Option("-o", "--output", metavar="WHOLE.mcap", help="Where to write.", show_default=False)
]


def repair(broken_file: Broken, output: Whole, json_file: Json = None, force: Force = False) -> None:
    """Salvage a damaged MCAP file and list what was lost.

    Messages are written in the order of their log times, with a new index. Messages of chunks that fail their
    checksum are kept; the new file states it, and every command that reads it repeats the note.
    """
    from ..io.mcap.repair import repair_container

    check_mcap(output)
    check_outputs(force, [output, json_file], [broken_file])
    report = repair_container(broken_file, output, force)
    print_losses(report)
    write_json(json_file, report.to_dict(), force)
    print_notes(report.notes)
    if report.attachments_left_out:
        say(f"note: {report.attachments_left_out} damaged attachments were left out.")
    say_written(output, json_file)


def print_losses(report: RepairReport) -> None:
    """Print what was written by topic, and what was lost where."""
    from ..io.mcap.messages import plain_name

    rows = [
        (plain_name(name), report.messages.get(name, 0), report.missing.get(name, 0))
        for name in sorted({*report.messages, *report.missing})
    ]
    print_table(f"{report.source}: messages", ("topic", "written", "missing by its own count"), rows)
    if not report.losses:
        say("no message before the end is lost" if report.notes else "nothing damaged was met")
        return
    start = min((loss.first_ns for loss in report.losses if loss.first_ns is not None), default=0)
    lines = [
        (
            f"{loss.start_byte} .. {loss.stop_byte}",
            "-" if loss.first_ns is None else f"{(loss.first_ns - start) / 1e9:.3f}",
            "-" if loss.last_ns is None else f"{(loss.last_ns - start) / 1e9:.3f}",
            loss.what,
        )
        for loss in report.losses
    ]
    columns = ("bytes", "from, s", "to, s", "what")
    print_table("What is damaged (s after the first damage)", columns, lines[:MOST_ROWS])
    if len(lines) > MOST_ROWS:
        say(f".. and {len(lines) - MOST_ROWS} places more; --json has them all")


#: A table longer than this is too long for a terminal.
MOST_ROWS = 25


def check(
    recording_file: RecordingPath,
    source: ArmInput = EVERY_ARM,
    config_file: ConfigFile = None,
    anatomy: Anatomy = None,
    body_height: BodyHeight = None,
    processes: Processes = None,
    json_file: Json = None,
    force: Force = False,
) -> None:
    """Test what a recording allows and what is wrong with its set-up.

    Checks every arm that has an IMU; of a long recording only the most informative excerpts. The exit code
    is 0 if the results can be used, 3 if one is not to be trusted.
    """
    from .config import read_config

    source.check()
    check_outputs(force, [json_file], [recording_file, source.calibration_file, config_file])
    config = read_config(config_file, processes, anatomy, body_height)
    arms = source.load(recording_file, truth=False)
    recordings = [recording for recording, _ in arms]
    clocks = [source.clock(recording) for recording in recordings]
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
    from ..cameras import join_cameras
    from ..errors import CalibrationError, SolveError
    from ..measurements.segment import Timeline
    from ..recovery.cameras import with_cameras
    from ..selfcal.excerpts import informative_recording
    from ..smoothing import smooth
    from ..window.priors import limb_lengths

    forearm_m = float(limb_lengths(config.arm).mean[0])
    # before it is cut: each camera's clock is its own
    recording, rig = join_cameras(recording, forearm_m=forearm_m)
    excerpt = informative_recording(recording, Timeline.of(recording))

    # lengths of gaps are tried side by side, each in one process
    recover = partial(smooth, calibration=calibration, config=config, processes=1, clock=clock)
    processes, allowed = config.windows.processes, None
    progress(0.0, "calibrating")
    try:
        recovery = with_cameras(smooth(excerpt, calibration, config, clock=clock), rig)
        figures = _figures(recovery)
        if recovery.estimates.trusted:
            allowed = _tried(
                excerpt, recovery, recover, lambda part, text: progress(0.3 + 0.7 * part, text), processes
            )
    except (SolveError, CalibrationError) as error:  # what cannot be recovered is the finding
        figures = _refused(str(error))
    figures["allows"] = None if allowed is None else allowed.to_dict()
    return {"recording": recording.name, "side": recording.side, **figures}, allowed


def _tried(excerpt: Recording, recovery: Recovery, recover: Any, progress: Any, processes: int) -> TriedGaps:
    from calib.motion.motion_calibration import found_in

    from ..evaluation.gaps import try_gaps

    found = found_in(recovery, excerpt)
    left_open = () if found is None else found.not_determined
    return try_gaps(replace(excerpt, truth=None), recover, left_open, progress, processes)


def _figures(recovery: Recovery) -> dict[str, Any]:
    """The verdict as plain values, and the signs besides the cause."""
    from ..evaluation.summary import verdict_figures

    estimates = recovery.estimates
    signs = [reason for reason in estimates.reasons if reason != estimates.cause]
    return verdict_figures(estimates) | {"trusted": bool(estimates.trusted), "signs": signs}


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
    for camera in figures.get("cameras", [])[1:]:
        if not camera["reason"]:
            away_m = math.dist((0.0, 0.0, 0.0), camera["p_K_C_m"])
            say(
                f"{camera['name']} is {away_m:.2f} m from the first camera (sigma"
                f" {camera['sigma_deg']:.1f} degrees, {100 * camera['sigma_m']:.1f} cm); both see"
                f" the forearm for {camera['together_s']:.0f} s"
            )
    if allowed is not None:
        allows, *open_questions = allowed.sentences
        say(f"allows: {allows}")
        for sentence in open_questions:
            say(f"not determined: {sentence}")
    for sign in figures["signs"] if figures["cause"] else ():
        say(f"sign: {sign}")
