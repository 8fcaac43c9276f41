"""`unocclude calibrate imu` and `calibrate magnetometer`: a sensor by itself."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..errors import CalibrationError
from .calibrate import error_prefix, load_existing_calibration, print_words, write_answer
from .options import CalibrationOutput, Force, Imu, Json, RecordingPath, Report
from .output import print_notes, print_table, say, say_written

if TYPE_CHECKING:
    from ..recording import ImuStream


def imu(
    recording_file: RecordingPath,
    output: CalibrationOutput,
    name: Imu = None,
    gravity: Annotated[
        float,
        typer.Option(
            "--gravity", metavar="M/S^2", help="Where it was recorded; recovering reckons with 9.81."
        ),
    ] = 9.81,
    report: Report = None,
    json_file: Json = None,
    force: Force = False,
) -> None:
    """Find an IMU's offsets, scales and cross-axis from rest poses, and its noise from a long rest.

    Lay the sensor still for three seconds on each of its six sides and on six edges between them, in any
    order; the rests are found by themselves. One long rest (an hour) instead gives the noise.
    """
    from calib.imu.imu_summary import imu_answer, noise_rows
    from calib.imu.sensor_calibration import calibrate_imu

    if not 9.7 <= gravity <= 9.9:
        raise typer.BadParameter("--gravity on Earth lies between 9.76 and 9.84 m/s^2")
    stream, notes = _load(recording_file, output, name, [report, json_file], force)
    with error_prefix(f"{recording_file}, {stream.name}"):
        calibration = calibrate_imu(stream, gravity)
    answer = imu_answer(calibration)
    if report is not None:
        from ..report.imu import write_imu_report

        write_imu_report(report, str(recording_file), stream, calibration, force=force)
    write_answer(answer, output, json_file, force, notes)
    if rows := noise_rows(calibration):
        print_table("Noise", ("figure", "x", "y", "z"), rows)
    print_words(answer)
    print_notes(notes)
    say_written(output, json_file, report)


def magnetometer(
    recording_file: RecordingPath,
    output: CalibrationOutput,
    name: Imu = None,
    report: Report = None,
    json_file: Json = None,
    force: Force = False,
) -> None:
    """Find a magnetometer's hard and soft iron from samples in all directions.

    Turn the sensor slowly about all its axes for a minute, on one spot and away from iron, until every side
    has pointed in every direction.
    """
    from calib.imu.imu_summary import magnetometer_answer
    from calib.imu.magnetometer import calibrate_magnetometer

    stream, notes = _load(recording_file, output, name, [report, json_file], force)
    if stream.mag is None:
        raise CalibrationError(
            f"{recording_file}: {stream.name} has no magnetometer; record its magnetic field as well."
        )
    with error_prefix(f"{recording_file}, {stream.name}"):
        calibration = calibrate_magnetometer(stream.mag)
    answer = magnetometer_answer(calibration, stream.name)
    if report is not None:
        from ..report.magnetometer import write_magnetometer_report

        write_magnetometer_report(report, str(recording_file), stream, calibration, force=force)
    write_answer(answer, output, json_file, force, notes)
    print_words(answer)
    print_notes(notes)
    say_written(output, json_file, report)


def _load(
    path: Path, output: Path, name: str | None, others: list[Path | None], force: bool
) -> tuple[ImuStream, list[str]]:
    """The stream to calibrate, once it is certain that the outputs can be written."""
    from calib.imu.sensor import sensors_in

    from ..io import read_imu

    sensors_in(load_existing_calibration(output, others, [path], force=force))
    stream, notes = read_imu(path, name)
    say(f"{path}: IMU {stream.name}, {stream.rate_hz:.0f} Hz, {stream.t_s[-1] - stream.t_s[0]:.0f} s")
    return stream, notes
