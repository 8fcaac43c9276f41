"""`unocclude calibrate`: what is measured once and kept in a calibration file; and `calibrate motion`."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..errors import CalibrationError
from .estimates import print_arm, print_camera, print_clocks
from .load import load_arms
from .options import (
    Body,
    CalibrationOutput,
    ConfigFile,
    Force,
    Imu,
    Json,
    Processes,
    Side,
    Skeleton,
    one_side,
)
from .output import check_outputs, print_notes, say, say_written, write_json
from .several_figures import arms_figures, say_arm

if TYPE_CHECKING:
    from calib.file import CalibrationFile
    from calib.protocol import Answer

    from ..calibration import ArmCalibration
    from ..recording import Recording

#: Files that a command reads or writes; some may not be given.
Paths = Iterable[Path | None]


def load_existing_calibration(
    output: Path | None, others: Paths, inputs: Paths, *, force: bool, known: Paths = ()
) -> CalibrationFile:
    """What the file holds already; before the work, as what cannot be read cannot be added to.

    Parameters
    ----------
    output : Path, optional
        The calibration file, which may exist.
    others : iterable of Path
        Further outputs, which `force` overwrites.
    inputs, known : iterable of Path
        What is read; a calibration in `known` may be the output too.
    force : bool
        As given by the user.
    """
    from calib.file import CalibrationFile, read_calibration

    others = [path for path in others if path is not None]
    check_outputs(True, [output, *others], inputs)
    check_outputs(force, others, known)
    return read_calibration(output) if output is not None and output.exists() else CalibrationFile()


def print_words(answer: Answer) -> None:
    """Print the verdict, what was not determined, and what to record next."""
    say(f"verdict: {answer.verdict.sentence}")
    for sentence in answer.verdict.findings:
        say(f"  {sentence}")
    for sentence in answer.open_questions:
        say(f"not determined: {sentence}")
    for sentence in answer.verdict.next:
        say(f"next: {sentence}")


def write_answer(
    answer: Answer, output: Path | None, json_file: Path | None, force: bool, notes: Iterable[str] = ()
) -> None:
    """Write the figures with what must be known of the input, and add the answer to the calibration file."""
    from calib.file import write_calibration

    write_json(json_file, {**answer.figures, "notes": list(dict.fromkeys(notes))}, force)
    if output is not None:
        write_calibration(output, answer.table)


@contextmanager
def error_prefix(what: str) -> Iterator[None]:
    """Put the name of what is worked on before the message of an error."""
    try:
        yield
    except CalibrationError as error:
        raise CalibrationError(f"{what}: {error}") from error


def motion(
    recording_files: Annotated[
        list[Path],
        typer.Argument(
            metavar="REC.mcap", help="Recordings of one person and one mounting.", show_default=False
        ),
    ],
    output: CalibrationOutput,
    known_file: Annotated[
        Path | None,
        typer.Option("--known", metavar="CAL.toml", help="What is measured already; it counts as given."),
    ] = None,
    config_file: ConfigFile = None,
    imu: Imu = None,
    skeleton: Skeleton = None,
    side: Side = None,
    body: Body = None,
    processes: Processes = None,
    json_file: Json = None,
    force: Force = False,
) -> None:
    """Find lever arms, limb lengths and the IMU's mounting from visible motion.

    Several recordings are solved together. A calibration that exists is added to, without --force: what
    was found replaces what the file holds of this arm, the rest of it is kept. Of recordings with IMUs on
    both arms both are calibrated, each by itself.
    """
    from calib.file import write_calibration
    from calib.motion.motion_calibration import calibrate_motion, motion_answer
    from calib.motion.motion_summary import roll_known

    from .config_file import read_config, with_processes

    twice = [str(path) for path in recording_files if recording_files.count(path) > 1]
    if twice:
        raise typer.BadParameter(f"{twice[0]} is named twice; it would count twice")
    load_existing_calibration(
        output, [json_file], [*recording_files, config_file], force=force, known=[known_file]
    )
    config = with_processes(read_config(config_file), processes)
    arms = _by_side(recording_files, known_file, imu, skeleton, one_side(side), body)
    several = len(arms) > 1
    answers = []
    for recordings, known in arms:
        with error_prefix(recordings[0].arm_label) if several else nullcontext():
            estimates = calibrate_motion(recordings, known, config)
            if not estimates.calibration.lever_arms:
                raise CalibrationError(
                    "only the strap was tracked, which is the IMU's own place: there is no lever arm to find"
                )
        answers.append((recordings[0], estimates, motion_answer(estimates)))
    notes = [note for recordings, _ in arms for recording in recordings for note in recording.notes]
    figures = [answer.figures for _, _, answer in answers]
    together = arms_figures([recording for recording, _, _ in answers], figures)
    write_json(json_file, {**together, "notes": list(dict.fromkeys(notes))}, force)
    for recording, estimates, answer in answers:
        write_calibration(output, answer.table)
        say_arm(recording, len(arms))
        print_arm(estimates)
        print_clocks(estimates.offsets)
        say("A clock offset belongs to its recording: every recording's is solved anew, never carried over.")
        print_camera(estimates)
        if sentence := roll_known(estimates.frame):
            say(sentence)
        print_words(answer)
    print_notes(notes)
    say_written(output, json_file)


def _by_side(
    recording_files: list[Path],
    known_file: Path | None,
    imu: str | None,
    skeleton: str | None,
    side: str | None,
    body: int | None,
) -> list[tuple[list[Recording], ArmCalibration | None]]:
    """The recordings of each arm, with what is known of it; one arm unless recordings have both.

    Raises
    ------
    CalibrationError
        Recordings are of several people, or do not say which of two arms they are of.
    """
    loaded = [
        (path, *arm)
        for path in recording_files
        for arm in load_arms(path, known_file, imu=imu, skeleton=skeleton, side=side, body=body)
    ]
    for path, recording, _ in loaded:
        if recording.body is not None:
            raise CalibrationError(
                f"{path}: several people wear IMUs, and a calibration is one person's; choose with --body"
            )
    sides = sorted({recording.side for _, recording, _ in loaded} - {""})
    if len(sides) < 2:
        return [([recording for _, recording, _ in loaded], loaded[0][2])]
    for path, recording, _ in loaded:
        if not recording.side:
            raise CalibrationError(
                f"{path} does not say whether it is the left or the right arm's, and the others are of both;"
                " calibrate it apart"
            )
    arms = []
    for one in sides:
        mine = [(recording, known) for _, recording, known in loaded if recording.side == one]
        arms.append(([recording for recording, _ in mine], mine[0][1]))
    return arms
