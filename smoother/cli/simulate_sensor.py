"""`unocclude simulate imu` and `simulate magnetometer`: a sensor alone, with its truth."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import typer

from .option_groups import with_groups
from .output import say, say_command
from .simulated_file import SimulatedFile

if TYPE_CHECKING:
    from ..array_types import FloatArray
    from ..recording import ImuStream


@with_groups
def imu(
    to: SimulatedFile,
    poses: Annotated[
        int, typer.Option("--poses", min=1, max=26, help="Rest poses: sides, then edges, then corners.")
    ] = 12,
    rest_s: Annotated[
        float, typer.Option("--rest-s", min=0.5, max=60.0, help="How long the sensor lies in a pose, s.")
    ] = 3.0,
    long_rest_s: Annotated[
        float | None,
        typer.Option(
            "--long-rest-s",
            metavar="S",
            min=10.0,
            max=14400.0,
            help="One long rest instead of poses, for the noise; 3600 for an hour.",
        ),
    ] = None,
    offset: Annotated[
        float, typer.Option("--offset", min=0.0, help="Of the accelerometer, m/s^2 an axis.")
    ] = 0.5,
    scale: Annotated[
        float, typer.Option("--scale", min=0.0, max=0.2, help="Largest error of an axis' scale.")
    ] = 0.03,
    cross: Annotated[
        float, typer.Option("--cross", min=0.0, max=0.2, help="Largest cross-axis term.")
    ] = 0.01,
    noise: Annotated[
        float, typer.Option("--noise", min=0.0, help="Of an accelerometer sample in a pose, m/s^2.")
    ] = 0.02,
) -> None:
    """Simulate an IMU in rest poses, for `calibrate imu`.

    Beside FILE lies FILE_truth.toml, in the form of a calibration file: what should be found.
    """
    import numpy as np

    from ..simulation.poses import SensorModel, long_rest, rest_poses

    to.check()
    model = SensorModel.draw(np.random.default_rng([to.seed, 2]), offset=offset, scale=scale, cross=cross)
    if long_rest_s is None:
        stream, bias = rest_poses(
            model, poses, seed=to.seed, rest_s=rest_s, acc_noise=noise, gyro_noise=noise / 10.0
        )
    else:
        stream, bias = long_rest(model, long_rest_s, seed=to.seed)
    truth = {"accelerometer": _correction(*model.correction()), "gyroscope": {"offset": bias.tolist()}}
    _write(to, stream, truth)
    say_command("calibrate", "imu", to.output, "-o", "arm.toml", "--report", "imu.html")


@with_groups
def magnetometer(
    to: SimulatedFile,
    hard_iron: Annotated[
        float, typer.Option("--hard-iron", min=0.0, max=5.0, help="Offset, in parts of the field.")
    ] = 0.5,
    soft_iron: Annotated[
        float, typer.Option("--soft-iron", min=0.0, max=0.25, help="Largest error of scale, and cross term.")
    ] = 0.2,
    field: Annotated[
        float, typer.Option("--field", min=0.01, help="The field's strength, in the sensor's unit.")
    ] = 48.0,
    noise: Annotated[
        float, typer.Option("--noise", min=0.0, max=0.2, help="Of a sample, in parts of the field.")
    ] = 0.01,
) -> None:
    """Simulate a magnetometer turned all round for a minute.

    Beside FILE lies FILE_truth.toml, in the form of a calibration file: what should be found.
    """
    import numpy as np

    from ..simulation.poses import SensorModel, turning_sensor

    to.check()
    rng = np.random.default_rng([to.seed, 2])
    model = SensorModel.draw(rng, offset=hard_iron, scale=soft_iron, cross=soft_iron)
    stream = turning_sensor(model, seed=to.seed, field=field, noise=noise)
    truth = {"magnetometer": _correction(*model.correction(field))}
    _write(to, stream, truth)
    say_command("calibrate", "magnetometer", to.output, "-o", "arm.toml", "--report", "magnetometer.html")


def _write(to: SimulatedFile, stream: ImuStream, truth: dict[str, Any]) -> None:
    """Write the recording of a sensor alone, and its truth; say what was written."""
    from calib.imu.sensor import sensor_name

    from ..io import write_recording
    from ..io.recording.write import as_session

    write_recording(as_session(to.output.name, [stream], []), to.output, force=to.force)
    to.write_truth({"imu": {sensor_name(stream.name): truth}})
    length_s = stream.t_s[-1] - stream.t_s[0]
    say(f"{to.output}: IMU {stream.name}, {stream.rate_hz:.0f} Hz, {length_s:.0f} s")
    to.say_written()


def _correction(offset: FloatArray, matrix: FloatArray) -> dict[str, Any]:
    return {"offset": offset.tolist(), "matrix": matrix.tolist()}
