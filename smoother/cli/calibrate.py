"""`calibrate motion`, `forearm`, `imu`, `magnetometer`, `cameras`, and what all calibrations share."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..errors import CalibrationError
from .arm_output import arms_figures, say_arm
from .load import AS_USUAL, Solving, load_arm, load_arms
from .options import (
    ANY_ARM,
    NO_FILES,
    ArmSelection,
    CalibrationOutput,
    Force,
    Imu,
    Json,
    Outputs,
    RecordingPath,
)
from .output import check_outputs, print_notes, say, say_written, show, write_json

if TYPE_CHECKING:
    from calib.file import CalibrationFile
    from calib.protocol import Answer

    from ..calibration import ArmCalibration
    from ..recording import ImuStream, Recording


#: Files that a command reads or writes; some may not be given.
Paths = Iterable[Path | None]


def load_existing_calibration(
    output: Path | None, to: Outputs, inputs: Paths, *, known: Paths = ()
) -> CalibrationFile:
    """What the file contains already; before the work, as what cannot be read cannot be added to."""
    from calib.file import CalibrationFile, read_calibration

    others = [path for path in (to.json_file, to.report) if path is not None]
    check_outputs(True, [output, *others], inputs)
    check_outputs(to.force, others, known)
    return read_calibration(output) if output is not None and output.exists() else CalibrationFile()


def finish(
    answer: Answer,
    output: Path | None,
    to: Outputs,
    title: str,
    notes: Iterable[str],
) -> None:
    """Write what a calibration found to all its outputs, then print it."""
    from calib.file import write_calibration

    notes = list(dict.fromkeys(notes))
    if to.report is not None:
        from ..report.calibration_page import calibration_page

        calibration_page(title, answer, notes).write(to.report, to.force)
    write_json(to.json_file, {**answer.figures, "notes": notes}, to.force)
    if output is not None:
        write_calibration(output, answer.table)
    print_answer(answer)
    print_notes(notes)
    say_written(output, to.json_file, to.report)


def print_answer(answer: Answer) -> None:
    """Print the figures, the verdict, what was not determined, and what to record next."""
    from calib.protocol import findings

    for table in findings(answer.figures):
        show(table)
    say(f"verdict: {answer.verdict.sentence}")
    for sentence in answer.verdict.findings:
        say(f"  {sentence}")
    for sentence in answer.open_questions:
        say(f"not determined: {sentence}")
    for sentence in answer.verdict.next:
        say(f"next: {sentence}")


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
        typer.Option(
            "--known", metavar="CAL.toml", help="Calibration file with known values, used as given."
        ),
    ] = None,
    solving: Solving = AS_USUAL,
    json_file: Json = None,
    force: Force = False,
) -> None:
    """Lever arms, limb lengths, IMU mounting, from visible motion.

    Several recordings are solved together. An existing calibration file is updated, without --force: the
    arm's values are replaced, everything else is kept. With IMUs on both arms, each arm is calibrated
    separately.
    """
    from calib.file import write_calibration
    from calib.motion.motion_calibration import calibrate_motion, motion_answer

    twice = [str(path) for path in recording_files if recording_files.count(path) > 1]
    if twice:
        raise typer.BadParameter(f"{twice[0]} is named twice; it would count twice")
    inputs = [*recording_files, solving.config_file]
    load_existing_calibration(output, Outputs(None, json_file, force), inputs, known=[known_file])
    config = solving.config()
    arms = _by_side(recording_files, known_file, solving.arm)
    several = len(arms) > 1
    answers = []
    for recordings, known in arms:
        with error_prefix(recordings[0].arm_label) if several else nullcontext():
            estimates = calibrate_motion(recordings, known, config)
            if not estimates.calibration.lever_arms:
                raise CalibrationError(
                    "only the strap was tracked, which is the IMU's own place: there is no lever arm to find"
                )
        answers.append((recordings[0], motion_answer(estimates)))
    notes = [note for recordings, _ in arms for recording in recordings for note in recording.notes]
    figures = [answer.figures for _, answer in answers]
    together = arms_figures([recording for recording, _ in answers], figures)
    write_json(json_file, {**together, "notes": list(dict.fromkeys(notes))}, force)
    for recording, answer in answers:
        write_calibration(output, answer.table)
        say_arm(recording, len(arms))
        print_answer(answer)
        say("A clock offset belongs to its recording: every recording's is solved anew, never carried over.")
        if answer.figures["R_F_A"] is not None:
            say("R_F_A takes the IMU to sit on the back of the forearm.")
    print_notes(notes)
    say_written(output, json_file)


def _by_side(
    recording_files: list[Path],
    known_file: Path | None,
    selection: ArmSelection,
) -> list[tuple[list[Recording], ArmCalibration | None]]:
    """The recordings of each arm, with what is known of it; one arm unless recordings have both."""
    loaded = [(path, *arm) for path in recording_files for arm in load_arms(path, known_file, selection)]
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
                f"{path} does not state whether it is the left or the right arm's, and the others are of"
                " both; calibrate it apart"
            )
    arms = []
    for one in sides:
        mine = [(recording, known) for _, recording, known in loaded if recording.side == one]
        arms.append(([recording for recording, _ in mine], mine[0][1]))
    return arms


def imu(
    recording_file: RecordingPath,
    output: CalibrationOutput,
    name: Imu = None,
    gravity: Annotated[
        float,
        typer.Option(
            "--gravity", metavar="M/S^2", help="Gravity at the place of recording; `smooth` assumes 9.81."
        ),
    ] = 9.81,
    to: Outputs = NO_FILES,
) -> None:
    """An IMU's offsets, scales and noise, from rest poses.

    Lay the sensor still for three seconds on each of its six sides and on six edges between them, in any
    order; rests are found automatically. One long rest (an hour) instead gives the noise.
    """
    from calib.imu.imu_summary import imu_answer
    from calib.imu.sensor_calibration import calibrate_imu

    if not 9.7 <= gravity <= 9.9:
        raise typer.BadParameter("--gravity on Earth is between 9.76 and 9.84 m/s^2")
    stream, notes = _load(recording_file, output, name, to)
    with error_prefix(f"{recording_file}, {stream.name}"):
        calibration = calibrate_imu(stream, gravity)
    finish(imu_answer(calibration), output, to, f"Accelerometer and gyroscope of {stream.name}", notes)


def magnetometer(
    recording_file: RecordingPath,
    output: CalibrationOutput,
    name: Imu = None,
    to: Outputs = NO_FILES,
) -> None:
    """A magnetometer's hard and soft iron.

    Turn the sensor slowly about all its axes for a minute, on one spot and away from iron, until every side
    has pointed in every direction.
    """
    from calib.imu.imu_summary import magnetometer_answer
    from calib.imu.magnetometer import calibrate_magnetometer

    stream, notes = _load(recording_file, output, name, to)
    if stream.mag is None:
        raise CalibrationError(
            f"{recording_file}: {stream.name} has no magnetometer; record its magnetic field as well."
        )
    with error_prefix(f"{recording_file}, {stream.name}"):
        calibration = calibrate_magnetometer(stream.mag)
    answer = magnetometer_answer(calibration, stream.name)
    finish(answer, output, to, f"Magnetometer of {stream.name}", notes)


def _load(path: Path, output: Path, name: str | None, to: Outputs) -> tuple[ImuStream, list[str]]:
    """The stream to calibrate, once it is certain that the outputs can be written."""
    from calib.imu.sensor import sensors_in

    from ..io import read_imu

    sensors_in(load_existing_calibration(output, to, [path]))
    stream, notes = read_imu(path, name)
    say(f"{path}: IMU {stream.name}, {stream.rate_hz:.0f} Hz, {stream.t_s[-1] - stream.t_s[0]:.0f} s")
    return stream, notes


def forearm(
    recording_file: RecordingPath,
    output: CalibrationOutput,
    from_s: Annotated[
        float | None,
        typer.Option("--from", metavar="S", help="Start of the held pose, s on the camera's clock."),
    ] = None,
    to_s: Annotated[float | None, typer.Option("--to", metavar="S", help="End of the held pose, s.")] = None,
    radius_m: Annotated[
        float | None,
        typer.Option(
            "--radius-m",
            min=0.005,
            max=0.15,
            help="Axis of the forearm to the sensor, measured with a ruler.",
        ),
    ] = None,
    strap_to_wrist_m: Annotated[
        float | None,
        typer.Option(
            "--strap-to-wrist-m", min=-0.1, max=0.3, help="Strap to the wrist joint, measured with a ruler."
        ),
    ] = None,
    solving: Solving = AS_USUAL,
    to: Outputs = NO_FILES,
) -> None:
    """Lever arms, lengths, mounting, from a held pose.

    The forearm raised beside the head, palm to the camera, still for a second or more; motion in the same
    recording gives the sensor's orientation to the camera, and is compared with the pose. An existing
    calibration file is updated, without --force.
    """
    from calib.forearm.forearm_summary import forearm_answer
    from calib.forearm.held_pose import calibrate_forearm

    if (from_s is None) != (to_s is None) or (from_s is not None and to_s is not None and to_s <= from_s):
        raise typer.BadParameter("--from and --to belong together, --to later than --from")
    load_existing_calibration(output, to, [recording_file, solving.config_file])
    config = solving.config()
    recording, _ = load_arm(recording_file, None, solving.arm)
    calibration = calibrate_forearm(
        recording,
        from_s=from_s,
        to_s=to_s,
        radius_m=radius_m,
        strap_to_wrist_m=strap_to_wrist_m,
        config=config,
    )
    answer = forearm_answer(calibration)
    finish(answer, output, to, f"Forearm from a held pose: {recording.name}", recording.notes)


def cameras(
    recording_files: Annotated[
        list[Path],
        typer.Argument(metavar="REC.mcap..", help="Recordings of the set-up.", show_default=False),
    ],
    output: CalibrationOutput,
    arm: ArmSelection = ANY_ARM,
    json_file: Json = None,
) -> None:
    """Poses of further cameras, from joints seen by both.

    `smooth --calibration` uses the poses as priors and reports a camera that was moved since. Clock offsets
    belong to one recording: they are shown and not stored. An existing calibration file is updated.
    """
    from calib.camera_poses import calibrate_cameras, cameras_answer

    to = Outputs(None, json_file, True)
    load_existing_calibration(output, to, recording_files)
    recordings = [load_arm(path, None, arm)[0] for path in recording_files]
    answer = cameras_answer(calibrate_cameras(recordings))
    notes = [note for recording in recordings for note in recording.notes]
    finish(answer, output, to, "Poses of the cameras", notes)
