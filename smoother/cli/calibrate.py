"""`calibrate motion`, `forearm`, `imu`, `magnetometer`, `cameras`, and what all calibrations share."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..errors import CalibrationError
from . import options as o
from .load import ConfigInput, Which, load_arm, load_arms, refuse_twice
from .output import Out, arms_figures, print_notes, say, say_arm, say_written, show

if TYPE_CHECKING:
    from calib.file import CalibrationFile
    from calib.protocol import Answer

    from ..calibration import ArmCalibration
    from ..io.recording.choose import Selection
    from ..recording import ImuStream, Recording


@dataclass(frozen=True)
class CalibrationOut(Out):
    """Where a calibration is written besides its file, which is added to."""

    report: o.Report = None

    def finish(self, output: Path | None, answer: Answer, title: str, notes: Iterable[str]) -> None:
        """Write what a calibration found to all outputs, then print it."""
        from ..report.calibration_page import calibration_page

        notes = list(dict.fromkeys(notes))
        if self.report is not None:
            calibration_page(title, answer, notes).write(self.report, self.force)
        self.json({**answer.to_dict(), "notes": notes})
        keep(output, answer)
        print_notes(notes)
        say_written(output, self.json_file, self.report)


def held(output: Path | None) -> CalibrationFile:
    """What the file contains already: read before the work, as what cannot be read cannot be added to."""
    from calib.file import CalibrationFile, read_calibration

    return read_calibration(output) if output is not None and output.exists() else CalibrationFile()


def keep(output: Path | None, answer: Answer) -> None:
    """Add an answer to the file; print its figures, verdict, what is open and what to record next."""
    from calib.file import write_calibration

    if output is not None:
        write_calibration(output, answer.table)
    for table in answer.tables():
        show(table)
    say(f"verdict: {answer.sentence}")
    for before, sentences in (
        ("  ", answer.findings),
        ("not determined: ", answer.open_questions),
        ("next: ", answer.next),
    ):
        for sentence in sentences:
            say(f"{before}{sentence}")


@contextmanager
def error_prefix(what: str) -> Iterator[None]:
    """Put the name of what is worked on before the message of an error."""
    try:
        yield
    except CalibrationError as error:
        raise CalibrationError(f"{what}: {error}") from error


def motion(
    files: Annotated[list[Path], o.argument("REC.mcap", "Recordings of one person and one mounting.")],
    output: o.CalibrationOutput,
    which: Which,
    settings: ConfigInput,
    out: Out,
    known: o.Known = None,
) -> None:
    """Lever arms, limb lengths, IMU mounting, from visible motion.

    Several recordings are solved together. An existing calibration file is updated, without --force: the
    arm's values are replaced, everything else is kept. With IMUs on both arms, each arm is calibrated
    separately.

    Example: unocclude calibrate motion a.mcap b.mcap -o arm.toml
    """
    from calib.motion import calibrate_motion, motion_answer

    refuse_twice(files)
    held(output)
    config = settings.read()
    arms = _by_side(files, known, which.chosen)
    answers: list[tuple[Recording, Answer]] = []
    for recordings, given in arms:
        with error_prefix(recordings[0].arm_label) if len(arms) > 1 else nullcontext():
            estimates = calibrate_motion(recordings, given, config)
            if not estimates.calibration.lever_arms:
                raise CalibrationError(
                    "only the strap was tracked, which is the IMU's own place: there is no lever arm to find"
                )
        answers.append((recordings[0], motion_answer(estimates)))
    notes = [note for recordings, _ in arms for recording in recordings for note in recording.notes]
    figures = arms_figures([own for own, _ in answers], [answer.to_dict() for _, answer in answers])
    out.json({**figures, "notes": list(dict.fromkeys(notes))})
    for recording, answer in answers:
        say_arm(recording, len(arms))
        keep(output, answer)
        say("A clock offset belongs to its recording: every recording's is solved anew, never carried over.")
        if answer.figures["R_F_A"] is not None:
            say("R_F_A takes the IMU to sit on the back of the forearm.")
    print_notes(notes)
    out.end(output)


def _by_side(
    files: list[Path], known_file: Path | None, chosen: Selection
) -> list[tuple[list[Recording], ArmCalibration | None]]:
    """The recordings of each arm, with what is known of it; one arm unless recordings have both."""
    loaded = [(path, *arm) for path in files for arm in load_arms(path, known_file, **chosen)]
    sides = {recording.side for _, recording, _ in loaded} - {""}
    for path, recording, _ in loaded:
        if recording.body is not None:
            raise CalibrationError(
                f"{path}: several people wear IMUs, and a calibration is one person's; choose with --body"
            )
        if not recording.side and len(sides) > 1:
            raise CalibrationError(
                f"{path} does not state whether it is the left or the right arm's, and the others are of"
                " both; calibrate it apart"
            )
    arms = [
        [(recording, known) for _, recording, known in loaded if recording.side in (side, "")]
        for side in sorted(sides) or [""]
    ]
    return [([recording for recording, _ in mine], mine[0][1]) for mine in arms]


Sensor = Annotated[o.Text, o.value("TOPIC", "The IMU, where the recording has several.", "--imu")]


def imu(
    recording_file: o.RecordingPath,
    output: o.CalibrationOutput,
    out: CalibrationOut,
    name: Sensor = None,
    gravity: Annotated[
        float, o.rare_value("M/S^2", "Gravity where it was recorded; `smooth` assumes 9.81.")
    ] = 9.81,
) -> None:
    """An IMU's offsets, scales and noise, from rest poses.

    Lay the sensor still for three seconds on each of its six sides and on six edges between them, in any
    order; rests are found automatically. One long rest (an hour) instead gives the noise.

    Example: unocclude calibrate imu poses.mcap -o arm.toml --report imu.html
    """
    from calib.imu import calibrate_imu, imu_answer

    if not 9.7 <= gravity <= 9.9:
        raise typer.BadParameter("--gravity on Earth is between 9.76 and 9.84 m/s^2")
    stream, notes = _load(recording_file, name, output)
    with error_prefix(f"{recording_file}, {stream.name}"):
        calibration = calibrate_imu(stream, gravity)
    out.finish(output, imu_answer(calibration), f"Accelerometer and gyroscope of {stream.name}", notes)


def magnetometer(
    recording_file: o.RecordingPath, output: o.CalibrationOutput, out: CalibrationOut, name: Sensor = None
) -> None:
    """A magnetometer's hard and soft iron.

    Turn the sensor slowly about all its axes for a minute, on one spot and away from iron, until every side
    has pointed in every direction.

    Example: unocclude calibrate magnetometer turning.mcap -o arm.toml
    """
    from calib.imu import calibrate_magnetometer, magnetometer_answer

    stream, notes = _load(recording_file, name, output)
    if stream.mag is None:
        raise CalibrationError(
            f"{recording_file}: {stream.name} has no magnetometer; record its magnetic field as well."
        )
    with error_prefix(f"{recording_file}, {stream.name}"):
        calibration = calibrate_magnetometer(stream.mag)
    answer = magnetometer_answer(calibration, stream.name)
    out.finish(output, answer, f"Magnetometer of {stream.name}", notes)


def _load(path: Path, name: str | None, output: Path) -> tuple[ImuStream, list[str]]:
    """The stream to calibrate, and what there is to know of its file."""
    from calib.file import sensors_in

    from ..io.recording.read import read_imu

    sensors_in(held(output))
    stream, notes = read_imu(path, name)
    say(f"{path}: IMU {stream.name}, {stream.rate_hz:.0f} Hz, {stream.t_s[-1] - stream.t_s[0]:.0f} s")
    return stream, notes


def forearm(
    recording_file: o.RecordingPath,
    output: o.CalibrationOutput,
    which: Which,
    settings: ConfigInput,
    out: CalibrationOut,
    from_s: Annotated[
        o.Number, o.value("S", "Start of the held pose, s on the camera's clock.", "--from")
    ] = None,
    to_s: Annotated[o.Number, o.value("S", "End of the held pose, s.", "--to")] = None,
    radius_m: Annotated[
        o.Number, o.option("Axis of the forearm to the sensor, by ruler.", min=0.005, max=0.15)
    ] = None,
    strap_to_wrist_m: Annotated[
        o.Number, o.option("Strap to the wrist joint, by ruler.", min=-0.1, max=0.3)
    ] = None,
) -> None:
    """Lever arms, lengths, mounting, from a held pose.

    The forearm raised beside the head, palm to the camera, still for a second or more; motion in the same
    recording gives the sensor's orientation to the camera, and is compared with the pose. An existing
    calibration file is updated, without --force.

    Example: unocclude calibrate forearm session.mcap -o arm.toml --report forearm.html
    """
    from calib.forearm import calibrate_forearm, forearm_answer

    if (from_s is None) != (to_s is None) or (from_s is not None and to_s is not None and to_s <= from_s):
        raise typer.BadParameter("--from and --to belong together, --to later than --from")
    held(output)
    config = settings.read()
    recording, _ = load_arm(recording_file, **which.chosen)
    calibration = calibrate_forearm(recording, from_s, to_s, radius_m, strap_to_wrist_m, config)
    title = f"Forearm from a held pose: {recording.name}"
    out.finish(output, forearm_answer(calibration), title, recording.notes)


def cameras(
    files: Annotated[list[Path], o.argument("REC.mcap..", "Recordings of the set-up.")],
    output: o.CalibrationOutput,
    which: Which,
    out: CalibrationOut,
) -> None:
    """Poses of further cameras, from joints seen by both.

    `smooth --calibration` uses the poses as priors and reports a camera that was moved since. Clock offsets
    belong to one recording: they are shown and not stored. An existing calibration file is updated.

    Example: unocclude calibrate cameras session.mcap -o cal.toml
    """
    from calib.intrinsics import calibrate_cameras

    held(output)
    recordings = [load_arm(path, **which.chosen)[0] for path in files]
    notes = [note for recording in recordings for note in recording.notes]
    out.finish(output, calibrate_cameras(recordings), "Poses of the cameras", notes)
