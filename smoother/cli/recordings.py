"""`unocclude info`, `check`, `match`, `repair` and `cut`: what a recording contains and allows, and parts."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from ..table import Table, tabulated
from . import options as o
from .load import PersonConfigInput, TrialInput, Which
from .output import Out, arms_figures, part_of, print_notes, progress_bar, say, say_arm, show
from .run import NOT_TRUSTED

if TYPE_CHECKING:
    from ..calibration import ArmCalibration
    from ..config import Config
    from ..io.info import Figures
    from ..measurements.clock import Clock
    from ..recording import Recording

#: A table longer than this is too long for a terminal.
MOST_ROWS = 25


def info(recording_file: o.RecordingPath, which: Which, out: Out) -> None:
    """Show streams, rates, clocks, gaps, and what is missing.

    Example: unocclude info session.mcap
    """
    from ..io import describe

    about = describe(recording_file, **which.chosen)
    out.json(about)
    show(topic_table(about))
    show(Table("Streams", ("what", "found"), list(_streams(about))))
    print_missing(about)
    print_notes(about["notes"], imported=True)


def topic_table(about: Figures) -> Table:
    """The topics of a recording."""
    title = f"{about['path']}, {about['size_bytes'] / 1e6:.1f} MB"
    return tabulated(title, about["topics"], "name=topic schema count=messages rate_hz duration_s=length_s")


#: What is said of an arm that would be recovered: words for its figures.
_TAKEN = {
    "upper_imu": "on the upper arm",
    "hand_imu": "on the hand",
    "trunk_imu": "on the trunk",
    "cameras": "further cameras",
    "joints": "joints",
    "duration_s": "both recorded, s",
    "gaps": "gaps",
    "gap_total_s": "occluded, s",
    "gap_longest_s": "longest gap, s",
}


def _of_each(arms: list[Figures], label: str = "label") -> Iterator[tuple[str, Figures]]:
    """Arms, each after its name where there are several."""
    for arm in arms:
        yield f"{arm[label]}: " if len(arms) > 1 and arm[label] else "", arm


def _streams(about: Figures) -> Iterator[tuple[str, object]]:
    """The streams found, and what would be taken of them."""
    for what, texts in (("IMU", about["imus"]), ("skeleton", about["skeletons"]), ("truth", about["poses"])):
        yield from ((f"{what} found", text) for text in texts)
    for of, arm in _of_each(about["arms"]):
        body = "" if arm["body"] is None else f" (body {arm['body']})"
        yield f"{of}taken", f"{arm['imu']}, {arm['side'] or 'no side'} arm of {arm['skeleton']}{body}"
        for key, words in _TAKEN.items():
            value = arm.get(key, "")
            text = ", ".join(value) or "none tracked" if isinstance(value, list) else value
            yield from [(of + words, text)] if text != "" else []
    if about["arms"]:
        yield "camera frame", about["camera_frame"] or "not stated"
    for topic, clock in about["clocks"].items():
        behind = clock.get("log_time_behind_s")
        lag = "" if behind is None else f", logged {1000 * behind:.1f} ms later"
        yield f"clock of {topic}", f"{clock['first_s']:.3f} to {clock['last_s']:.3f} s{lag}"


def print_missing(about: Figures) -> None:
    """Print what is missing for recovering first, then in short what it can do without."""
    missing = dict(about["missing"])
    cannot = missing.pop("smooth", None)
    if about["result"]:
        say("contains a result: use validate or export")
    elif cannot:
        say(f"cannot be recovered: {cannot}")
    else:
        for of, arm in _of_each(about["arms"]):
            say(f"{of}{'' if arm['ready'] else 'not ready for `unocclude smooth`: it '}{arm['allows']}")
        if about["ready"]:
            say("ready for `unocclude smooth`")
    for of, each in _of_each(about["verdicts"], "arm"):  # of a result's arms
        if each["verdict"]:
            say(f"{of}{each['verdict']}")
        if each["trusted"] is not False and (times := each["untrusted"]):
            count = f"{len(times)} {'time' if len(times) == 1 else 'times'}"
            say(f"{of}not to be trusted at {count}; export lists them")
    for step, reason in missing.items():
        say(f"{step}: {reason}")
    if about["optional"] and not about["result"]:
        lacks = ", ".join(f"{what} ({use})" for what, use in about["optional"].items())
        say(f"not in the file, not needed to recover: {lacks}")


def match(
    recording_file: o.RecordingPath,
    out: Out,
    method: Annotated[Literal["motion", "joint-likelihood"], o.option("How pairs are compared.")] = "motion",
    clocks_apart_s: Annotated[float, o.value("S", "Clocks may differ by this, s.", min=0, max=60)] = 5.0,
    skeleton: Annotated[o.Text, o.value("TOPIC", "The skeleton, where there are several.")] = None,
) -> None:
    """Find which IMU is on which body and limb, by motion alone.

    Needs no calibration, common orientation or common clock. An IMU is assigned to a wrist (forearm) or
    upper arm, to none of the limbs in view, or left unknown if the motion does not decide.

    Example: unocclude match session.mcap --json matches.json
    """
    from ..io import open_recording
    from ..io.recording.choose import match_file

    file = open_recording(recording_file, truth=False)
    matches, notes = match_file(file, method, clocks_apart_s, skeleton=skeleton)
    figures = [one.to_dict() for one in matches]
    others = [{"else": [f"{where} {p:.2f}" for where, p in one.others[:3]]} for one in matches]
    rows = [mine | more for mine, more in zip(figures, others, strict=True)]
    out.json({"matches": figures, "method": method})
    show(tabulated(str(recording_file), rows, "imu body joint probability clock_offset_s else"))
    sure = sum(one.is_sure for one in matches)
    are = "is" if sure == 1 else "are"
    say(f"{sure} of {len(matches)} IMUs {are} matched with a probability above 0.95")
    print_notes([*file.notes, *notes])


def repair(
    broken_file: Annotated[Path, o.argument("BROKEN.mcap", "The damaged file; it is not changed.")],
    output: o.Output,
    out: Out,
) -> None:
    """Salvage a damaged MCAP file and list what was lost.

    Messages are written with a new index. Messages of chunks that fail their
    checksum are kept; the new file states it, and every command that reads it repeats the note.

    Example: unocclude repair broken.mcap -o whole.mcap --json lost.json
    """
    from ..io.mcap.merge import repair_container
    from ..io.mcap.messages import plain_name

    report = repair_container(broken_file, output, out.force)
    out.json(report)
    kept, lost = report["messages"], report["missing"]
    counts = [(plain_name(name), kept.get(name, 0), lost.get(name, 0)) for name in sorted({*kept, *lost})]
    show(Table(f"{report['source']}: messages", ("topic", "written", "missing"), counts))
    if not report["losses"]:
        say("no message before the end is lost" if report["notes"] else "nothing damaged was met")
    start = min((loss["first_ns"] for loss in report["losses"] if loss["first_ns"] is not None), default=0)
    columns: dict[str, Callable[[Any], object]] = {
        "bytes": lambda loss: f"{loss['start_byte']} .. {loss['stop_byte']}",
        "from, s": lambda loss: loss["first_ns"] and f"{(loss['first_ns'] - start) / 1e9:.2f}",
        "to, s": lambda loss: loss["last_ns"] and f"{(loss['last_ns'] - start) / 1e9:.2f}",
        "what": lambda loss: loss["what"],
    }
    title = "What is damaged (s after the first damage)"
    show(tabulated(title, report["losses"], columns), MOST_ROWS)
    print_notes(report["notes"])
    if report["attachments_left_out"]:
        say(f"note: {report['attachments_left_out']} damaged attachments were left out.")
    out.end(output)


def cut(
    recording_file: o.RecordingPath,
    output: Annotated[
        Path, o.value("FILE", "The part; a folder with --trials.", "-o", "--output"), o.UNCHECKED
    ],
    which: Which,
    out: Out,
    from_s: Annotated[o.Number, o.value("S", "Start, s.  [default: the recording's]", "--from")] = None,
    to_s: Annotated[o.Number, o.value("S", "End, s.  [default: the recording's]", "--to")] = None,
    trials: Annotated[o.File, o.value("TRIALS.csv", "Parts: name, start_s, end_s [, label].")] = None,
    label: Annotated[o.Texts, o.value("TEXT", "Only parts with this label; may be repeated.")] = None,
) -> None:
    """Cut a recording by time, or into the trials of a table.

    Times are seconds of the recording, as `smooth` prints them for gaps. All topics are copied unchanged,
    images too; camera calibrations and transforms that were recorded once are copied into every part.
    Leave some seconds of visible arm before and after each gap: a part is recovered without the rest.

    Example: unocclude cut session.mcap --trials trials.csv -o trials
    """
    from ..io.recording.cut_file import Part, cut_file, read_trials

    is_one, (start_s, end_s) = trials is None, (from_s or 0.0, math.inf if to_s is None else to_s)
    o.refuse(
        {
            "choose parts: --from S, --to S of one, or --trials TRIALS.csv": is_one
            == (from_s is to_s is None),
            "--label chooses among --trials; give the table too": label and is_one,
            f"--to {end_s:g} is not after --from {start_s:g}": not start_s < end_s,
            f"{output} is a file; with --trials name a folder": not is_one and output.is_file(),
        }
    )
    if trials is None:
        o.as_mcap(output)
        parts = [Part(output.stem, output, start_s, end_s)]
    else:
        parts = read_trials(trials, output, label or ())
        output.mkdir(parents=True, exist_ok=True)
    out.check((part.path for part in parts), [recording_file, trials])
    written, notes = cut_file(recording_file, parts, force=out.force, **which.chosen)
    out.json({"parts": written, "notes": notes})
    rows = [each | {"messages": sum(each["messages"].values())} for each in written]  # type: ignore[attr-defined]
    show(tabulated(f"Parts of {recording_file}", rows, "name from_s to_s messages file"), MOST_ROWS)
    print_notes(notes)


def check(recording_file: o.RecordingPath, source: TrialInput, settings: PersonConfigInput, out: Out) -> None:
    """Test what a recording allows and what is wrong with its set-up.

    Checks every arm that has an IMU; of a long recording only the most informative excerpts. The exit code
    is 0 if the results can be used, 3 if one is not to be trusted.

    Example: unocclude check session.mcap --json check.json
    """
    config = settings.read()
    with source.in_session(recording_file, config) as known, progress_bar("checking") as progress:
        arms = known.load(recording_file, truth=False)
        findings = [
            checked(*arm, config, known.clock(arm[0]), part_of(progress, place, len(arms)))
            for place, arm in enumerate(arms)
        ]
        progress(1.0, "done")
    recordings = [recording for recording, _ in arms]
    figures = arms_figures(recordings, findings)
    out.json(figures)
    for recording, mine in zip(recordings, findings, strict=True):
        say_arm(recording, len(arms))
        print_check(mine)
        print_notes(recording.notes)
    out.end()
    if not figures["trusted"]:
        raise typer.Exit(NOT_TRUSTED)


def checked(
    recording: Recording,
    calibration: ArmCalibration | None,
    config: Config,
    clock: Clock | None,
    progress: Callable[[float, str], None],
) -> dict[str, Any]:
    """The figures of an arm, with what its recording allows where a result could be trusted."""
    from calib.motion import found_in

    from ..cameras import join_cameras
    from ..errors import CalibrationError, SolveError
    from ..evaluation.gaps import allowed_gaps
    from ..evaluation.summary import verdict_figures
    from ..recovery.cameras import with_cameras
    from ..selfcal.excerpts import informative_recording
    from ..smoothing import smooth
    from ..window.priors import limb_lengths

    # before it is cut: each camera's clock is its own
    recording, rig = join_cameras(recording, forearm_m=float(limb_lengths(config.arm).mean[0]))
    excerpt = informative_recording(recording)
    # lengths of gaps are tried side by side, each in one process
    recover = partial(smooth, calibration=calibration, config=config, processes=1, clock=clock)
    allowed = None
    progress(0.0, "calibrating")
    try:
        recovery = with_cameras(smooth(excerpt, calibration, config, clock=clock), rig)
        estimates = recovery.estimates
        signs = [reason for reason in estimates.reasons if reason != estimates.cause]
        figures = {**verdict_figures(estimates), "trusted": bool(estimates.trusted), "signs": signs}
        if estimates.trusted:
            found = found_in(recovery, excerpt)
            left_open = () if found is None else found.not_determined
            blind = replace(excerpt, truth=None)
            trying = lambda part, text: progress(0.3 + 0.7 * part, text)  # noqa: E731
            allowed = allowed_gaps(blind, recover, left_open, trying, config.windows.processes)
    except (SolveError, CalibrationError) as error:  # what cannot be recovered is the finding
        sentence = str(error)
        figures = {"trusted": False, "verdict": f"Cannot be recovered: {sentence.rstrip('.')}."}
        figures |= {"reasons": [sentence], "cause": None}
        figures |= {name: [] for name in ("cautions", "remedies", "signs", "findings")}
    return {"recording": recording.name, "side": recording.side, **figures, "allows": allowed}


def print_check(figures: dict[str, Any]) -> None:
    """Print the verdict, further cameras, and what the recording allows."""
    say(figures["verdict"])
    for camera in figures.get("cameras", [])[1:]:
        if not camera["reason"]:
            away_m = math.dist((0.0, 0.0, 0.0), camera["p_K_C_m"])
            say(
                f"{camera['name']} is {away_m:.2f} m from the first camera (sigma"
                f" {camera['sigma_deg']:.1f} degrees, {100 * camera['sigma_m']:.1f} cm); both see"
                f" the forearm for {camera['together_s']:.0f} s"
            )
    if figures["allows"] is not None:
        allows, *open_questions = figures["allows"]["sentences"]
        say(f"allows: {allows}")
        for sentence in open_questions:
            say(f"not determined: {sentence}")
    for sign in figures["signs"] if figures["cause"] else ():
        say(f"sign: {sign}")
