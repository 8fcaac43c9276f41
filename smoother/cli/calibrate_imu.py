"""`unocclude calibrate imu` and `calibrate magnetometer`: a sensor by itself."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..errors import CalibrationError
from .calibrate import CalibrationOutput
from .options import Force, Imu, Json, RecordingPath, Report
from .output import check_outputs, print_notes, print_table, say, say_written, write_json

if TYPE_CHECKING:
    from calib.imu.sensor_calibration import ImuCalibration

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
    from calib.imu.imu_summary import imu_next, imu_verdict, noise_rows
    from calib.imu.sensor_calibration import calibrate_imu

    if not 9.7 <= gravity <= 9.9:
        raise typer.BadParameter("--gravity on Earth lies between 9.76 and 9.84 m/s^2")
    stream, notes = _load(recording_file, output, name, [report, json_file], force)
    try:
        found = calibrate_imu(stream, gravity)
    except CalibrationError as error:
        raise CalibrationError(f"{recording_file}, {stream.name}: {error}") from error
    if report is not None:
        from ..report.imu import write_imu_report

        write_imu_report(report, str(recording_file), stream, found, force=force)
    _write(output, stream.name, found.tables())
    write_json(json_file, _figures(found), force)
    for sentence in imu_verdict(found):
        say(sentence)
    if rows := noise_rows(found):
        print_table("Noise", ("figure", "x", "y", "z"), rows)
    print_notes([*notes, *imu_next(found)])
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
    from calib.imu.imu_summary import magnetometer_next, magnetometer_verdict
    from calib.imu.magnetometer import calibrate_magnetometer

    stream, notes = _load(recording_file, output, name, [report, json_file], force)
    if stream.mag is None:
        raise CalibrationError(
            f"{recording_file}: {stream.name} has no magnetometer; record its magnetic field as well."
        )
    try:
        found = calibrate_magnetometer(stream.mag)
    except CalibrationError as error:
        raise CalibrationError(f"{recording_file}, {stream.name}: {error}") from error
    if report is not None:
        from ..report.magnetometer import write_magnetometer_report

        write_magnetometer_report(report, str(recording_file), stream, found, force=force)
    table = {
        "offset": found.offset.tolist(),
        "matrix": found.matrix.tolist(),
        "residual_rms": found.residual,
        "samples": found.samples,
    }
    _write(output, stream.name, {"magnetometer": table})
    more = {
        "radii": found.radii,
        "largest_hole_rad": found.coverage.hole_rad,
        "covered_share": found.coverage.share,
        "remarks": found.remarks,
    }
    write_json(json_file, {"imu": stream.name, "magnetometer": {**table, **more}}, force)
    for sentence in magnetometer_verdict(found):
        say(sentence)
    print_notes([*notes, *magnetometer_next(found)])
    say_written(output, json_file, report)


def _load(
    path: Path, output: Path, name: str | None, others: list[Path | None], force: bool
) -> tuple[ImuStream, list[str]]:
    """The stream to calibrate, once it is certain that the outputs can be written."""
    from calib.file import read_calibration
    from calib.imu.sensor import sensors_in

    from ..io import read_imu

    check_outputs(True, [output, *others], [path])
    check_outputs(force, others)
    if output.exists():
        sensors_in(read_calibration(output))  # before the work: what cannot be read cannot be added to
    stream, notes = read_imu(path, name)
    say(f"{path}: IMU {stream.name}, {stream.rate_hz:.0f} Hz, {stream.t_s[-1] - stream.t_s[0]:.0f} s")
    return stream, notes


def _write(output: Path, topic: str, parts: dict[str, dict[str, Any]]) -> None:
    """Merge a sensor's tables into the calibration file; what another recording told of it is kept."""
    from calib.file import CalibrationFile, write_calibration
    from calib.imu.sensor import sensor_name

    write_calibration(output, CalibrationFile().with_table("imu", {sensor_name(topic): parts}))


def _figures(found: ImuCalibration) -> dict[str, Any]:
    tables = found.tables()
    figures: dict[str, Any] = {
        "imu": found.name,
        "rests": len(found.rests),
        "poses": found.rests.poses,
        "gravity": found.gravity,
        "accelerometer": tables.get("accelerometer", {}),
        "gyroscope": {
            **tables["gyroscope"],
            "rule": found.gyroscope.rule,
            "samples": found.gyroscope.samples,
        },
    }
    acc = found.accelerometer
    if acc is not None:
        figures["accelerometer"] |= {
            "covariance": acc.covariance,
            "worst_direction": acc.worst_direction,
            "residual": acc.residual,
            "remarks": acc.remarks,
        }
    for name, noise in (("accelerometer", found.accelerometer_noise), ("gyroscope", found.gyroscope_noise)):
        if noise is not None:
            figures[name]["allan"] = {
                "tau_s": noise.tau_s,
                "deviation": noise.deviation,
                "noise_density": noise.density,
                "bias_instability": noise.instability,
                "random_walk": noise.walk,
            }
    return figures
