"""`unocclude calibrate`: what is measured once and kept in a calibration file; and `calibrate motion`."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..errors import CalibrationError
from .estimates import print_arm, print_camera, print_clocks
from .load import load_arm
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

if TYPE_CHECKING:
    from calib.file import CalibrationFile
    from calib.protocol import Answer

#: Files that a command reads or writes; some may not be given.
Paths = Iterable[Path | None]


def held_calibration(
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
def naming(what: str) -> Iterator[None]:
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
    was found replaces what the file holds of this arm, the rest of it is kept.
    """
    from calib.motion.estimates import motion_answer
    from calib.motion.motion_summary import roll_known
    from calib.motion.several_recordings import calibrate_motion

    from .config_file import read_config, with_processes

    twice = [str(path) for path in recording_files if recording_files.count(path) > 1]
    if twice:
        raise typer.BadParameter(f"{twice[0]} is named twice; it would count twice")
    held_calibration(output, [json_file], [*recording_files, config_file], force=force, known=[known_file])
    config = with_processes(read_config(config_file), processes)
    loaded = [
        load_arm(path, known_file, imu=imu, skeleton=skeleton, side=one_side(side), body=body)
        for path in recording_files
    ]
    estimates = calibrate_motion([recording for recording, _ in loaded], loaded[0][1], config)
    if not estimates.calibration.lever_arms:
        raise CalibrationError(
            "only the strap was tracked, which is the IMU's own place: there is no lever arm to find"
        )
    answer = motion_answer(estimates)
    notes = [note for recording, _ in loaded for note in recording.notes]
    write_answer(answer, output, json_file, force, notes)
    print_arm(estimates)
    print_clocks(estimates.offsets)
    say("A clock offset belongs to its recording: every recording's is solved anew, never carried over.")
    print_camera(estimates)
    if sentence := roll_known(estimates.frame):
        say(sentence)
    print_words(answer)
    print_notes(notes)
    say_written(output, json_file)
