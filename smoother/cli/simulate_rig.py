"""`unocclude simulate imu`, `magnetometer`, `panel`, `clock`: what calibrations are made of, with truth."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..errors import UnoccludeError
from .options import Force, Json, Output, Seed
from .output import (
    check_mcap,
    check_outputs,
    print_table,
    say,
    say_command,
    say_written,
    truth_text,
    write_json,
    write_truth,
)

if TYPE_CHECKING:
    from pydantic.fields import FieldInfo

    from ..array_types import FloatArray
    from ..recording import ImuStream
    from ..simulation.panel import PanelSimulation, SimulatedPanel
    from ..simulation.rig import ClockSession


@dataclass(frozen=True)
class SimulatedFile:
    """A simulated recording and its truth, as a group of a command's options."""

    output: Output  # The recording
    seed: Seed = 0  # Of the simulation
    json_file: Json = None  # For the figures
    force: Force = False  # Overwrite what exists

    @property
    def truth(self) -> Path:
        """What the calibration should find, beside the recording."""
        return self.output.with_name(f"{self.output.stem}_truth.toml")

    def check(self) -> None:
        """Refuse what could not be written in the end."""
        check_mcap(self.output)
        check_outputs(self.force, [self.output, self.truth, self.json_file])

    def write_truth(self, tables: dict[str, Any], **figures: Any) -> None:
        """Write what should be found, in the form of a calibration file; as JSON with further figures."""
        write_truth(self.truth, tables, self.force)
        write_json(self.json_file, {"seed": self.seed, **figures, "truth": tables}, self.force)

    def say_written(self) -> None:
        """Print what was written."""
        say_written(self.output, self.truth, self.json_file)


def imu(
    to: SimulatedFile,
    poses: Annotated[
        int, typer.Option("--poses", min=1, max=26, help="Rest poses: sides, then edges, then corners.")
    ] = 12,
    rest_s: Annotated[
        float, typer.Option("--rest-s", min=0.5, max=60.0, help="How long the sensor stays in a pose, s.")
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
        float, typer.Option("--offset", min=0.0, help="Of the accelerometer, m/s^2 per axis.")
    ] = 0.5,
    scale: Annotated[
        float, typer.Option("--scale", min=0.0, max=0.2, help="Largest scale error of any axis.")
    ] = 0.03,
    cross: Annotated[
        float, typer.Option("--cross", min=0.0, max=0.2, help="Largest cross-axis term.")
    ] = 0.01,
    noise: Annotated[
        float, typer.Option("--noise", min=0.0, help="Of an accelerometer sample in a pose, m/s^2.")
    ] = 0.02,
) -> None:
    """An IMU in rest poses, for `calibrate imu`.

    The true values are written to FILE_truth.toml, in the form of a calibration file.
    """
    import numpy as np

    from ..simulation.rig import SensorModel, long_rest, rest_poses

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
    """A magnetometer turned in all directions.

    The true values are written to FILE_truth.toml, in the form of a calibration file.
    """
    import numpy as np

    from ..simulation.rig import SensorModel, turning_sensor

    to.check()
    rng = np.random.default_rng([to.seed, 2])
    model = SensorModel.draw(rng, offset=hard_iron, scale=soft_iron, cross=soft_iron)
    stream = turning_sensor(model, seed=to.seed, field=field, noise=noise)
    truth = {"magnetometer": _correction(*model.correction(field))}
    _write(to, stream, truth)
    say_command("calibrate", "magnetometer", to.output, "-o", "arm.toml", "--report", "magnetometer.html")


def _write(to: SimulatedFile, stream: ImuStream, truth: dict[str, Any]) -> None:
    """Write the recording of a sensor alone, and its truth; print what was written."""
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


Folder = Annotated[
    Path, typer.Option("-o", "--output", metavar="FOLDER", help="Folder to make.", show_default=False)
]
Recording = Annotated[
    Path | None,
    typer.Option("--mcap", metavar="REC.mcap", help="Also write the session as a recording."),
]
PanelFile = Annotated[
    Path | None,
    typer.Option("--panel", metavar="PANEL.toml", help="Markers and extent of the panel to simulate."),
]


def panel(
    output: Folder,
    mcap: Recording = None,
    panel_file: PanelFile = None,
    seed: Seed = 0,
    json_file: Json = None,
    force: Force = False,
    **settings: Any,
) -> None:
    """A marker panel with images, motion capture and IMUs.

    Writes depth and infrared images, mocap markers and IMU samples of each pose, intrinsics.toml, panel.toml
    and truth.toml: what `calibrate panel` and `calibrate world` take, and what they should find.
    """
    from ..io.rig.panel import check_folder, write_panel_folder, write_panel_recording
    from ..simulation.panel import simulate_panel

    config = _configured(panel_file, {name: value for name, value in settings.items() if value is not None})
    check_folder(output, force)
    check_outputs(force, [mcap, json_file], [panel_file])
    try:
        simulated = simulate_panel(config, seed)
    except ValueError as error:
        raise UnoccludeError(f"{error}.") from error
    shots, lens = _shots(simulated), simulated.lens.to_toml()
    imus = [simulated.imu_panel, simulated.imu_base]
    truth = answer(simulated)
    tables = {"intrinsics.toml": lens, "panel.toml": _definition(config), "truth.toml": truth}
    if mcap is not None:
        write_panel_recording(mcap, shots, imus, lens, force=force)
    write_panel_folder(output, shots, imus, config.hold_s / 2, tables, force=force)
    write_json(json_file, {"seed": seed, "config": config.model_dump(mode="json"), "truth": truth}, force)
    rows = [
        (name, f"{values['distance_m']:.2f}", f"{values['tilt_deg']:.0f}")
        for name, values in truth["pose"].items()
    ]
    print_table(str(output), ("pose", "distance, m", "tilt, deg"), rows)
    say_written(output, mcap, json_file)


def panel_settings() -> dict[str, FieldInfo]:
    """The simulation's settings."""
    from ..simulation.panel import PanelSimulation

    hidden = ("markers", "extent")  # in the panel's own file
    return {name: field for name, field in PanelSimulation.model_fields.items() if name not in hidden}


def answer(simulated: SimulatedPanel) -> dict[str, Any]:
    """What the calibrations should find, as plain values; quaternions are qw, qx, qy, qz."""
    import numpy as np

    poses = {}
    for number, pose in enumerate(simulated.poses, 1):
        middle = np.append(np.mean(simulated.config.extent, axis=0), 0.0)
        centre = pose.R_K_P @ middle + pose.p_K_P
        distance = float(np.linalg.norm(centre))
        poses[f"{number:02d}"] = {
            "t_s": pose.t_s,
            "rotation": _quaternion(pose.R_K_P),
            "translation": pose.p_K_P.tolist(),
            "distance_m": distance,
            "tilt_deg": float(np.degrees(np.arccos(np.clip(-pose.R_K_P[:, 2] @ centre / distance, -1, 1)))),
            "down": (-pose.R_W_K[2]).tolist(),
            "marker_pixels": pose.marker_pixels.tolist(),
            "marker_order": pose.marker_order.tolist(),
        }
    return {
        "camera_from_mocap": {
            "rotation": _quaternion(simulated.R_K_E),
            "translation": simulated.t_K_E.tolist(),
        },
        "camera_from_base": {"rotation": _quaternion(simulated.R_K_B)},
        "panel_from_imu": {"rotation": _quaternion(simulated.R_P_I)},
        "depth_offset_m": simulated.config.depth_offset_m,
        "pose": poses,
    }


def _quaternion(R: Any) -> list[float]:
    from scipy.spatial.transform import Rotation

    quaternion: list[float] = Rotation.from_matrix(R).as_quat(canonical=True, scalar_first=True).tolist()
    return quaternion


def _configured(panel_file: Path | None, changes: dict[str, Any]) -> PanelSimulation:
    from pydantic import ValidationError

    from ..simulation.panel import PanelSimulation
    from .config import describe

    if panel_file is not None:
        from calib.panel.definition import read_panel

        known = read_panel(panel_file)
        changes["markers"], changes["extent"] = known.markers_P.tolist(), known.extent_P.tolist()
        if known.height_m:
            changes |= {"marker_height_m": known.height_m, "marker_shape": "sphere"}
    for name, value in changes.items():
        if isinstance(value, str) and isinstance(PanelSimulation.model_fields[name].get_default(), tuple):
            changes[name] = _numbers(name, value)
    try:
        return PanelSimulation(**changes)
    except ValidationError as error:
        raise typer.BadParameter(f"setting {describe(error)}") from error


def _numbers(name: str, text: str) -> tuple[Any, ...]:
    """Numbers with commas between them; points (`extra_markers`) with semicolons between them."""
    kind = int if name == "hidden_markers" else float
    try:
        if name == "extra_markers":
            return tuple(tuple(float(x) for x in point.split(",")) for point in text.split(";"))
        return tuple(kind(part) for part in text.split(",") if part.strip())
    except ValueError:
        raise typer.BadParameter(f"setting {name} takes numbers, as 1.2,1.9; not '{text}'") from None


def _definition(config: PanelSimulation) -> dict[str, Any]:
    panel: dict[str, Any] = {"markers": [list(m) for m in config.markers]}
    panel["extent"] = [list(corner) for corner in config.extent]
    if config.marker_shape == "sphere" and config.marker_height_m > 0:
        panel["marker_height"] = config.marker_height_m
    return {"panel": panel}


def _shots(simulated: SimulatedPanel) -> list[Any]:
    import numpy as np

    from ..io.rig.panel import PanelShot

    return [
        PanelShot(
            pose.t_s,
            np.rint(pose.depth).astype(np.uint16),
            pose.infrared,
            pose.marker_names,
            pose.markers,
        )
        for pose in simulated.poses
    ]


def clock(
    output: Folder,
    rounds: Annotated[int, typer.Option("--rounds", min=4, max=1000, help="Broadcasts.")] = 20,
    minutes: Annotated[
        float, typer.Option("--minutes", min=0.5, max=120.0, help="Time over which they are spread.")
    ] = 5.0,
    motion_s: Annotated[
        float, typer.Option("--motion-s", min=10.0, max=600.0, help="Length of the arm's recording.")
    ] = 30.0,
    noise_db: Annotated[
        float, typer.Option("--noise-db", min=0.0, max=80.0, help="Noise of the room below the beep, dB.")
    ] = 25.0,
    seed: Seed = 0,
    json_file: Json = None,
    force: Force = False,
) -> None:
    """A beep, broadcasts and motion with known clocks.

    Writes beep.wav, times.csv, session.mcap and truth.toml. The IMU's clock runs 390 ppm fast.
    """
    from ..io.rig.clock import MOTION, SOUND, TIMES, write_clock_folder
    from ..io.rig.panel import check_folder
    from ..simulation.rig import simulate_clock_session

    check_folder(output, force)
    check_outputs(force, [json_file])
    session = simulate_clock_session(
        seed, rounds=rounds, minutes=minutes, motion_s=motion_s, noise_db=noise_db
    )
    truth = {"clock": {"links": true_links(session)}}
    write_clock_folder(
        output,
        session.sound,
        session.sound_rate_hz,
        session.receptions,
        session.recording,
        truth_text(truth),
        force=force,
    )
    write_json(json_file, {"seed": seed, "event_time_s": session.event_time_s, "truth": truth}, force)
    rows = [
        (link["from"], link["to"], f"{link['offset_s']:+.6f}", f"{link['skew_ppm']:.2f}")
        for link in truth["clock"]["links"]
    ]
    print_table(
        "True clocks at time 0: t_to = t_from + offset", ("from", "to", "offset, s", "skew, ppm"), rows
    )
    say(f"the beep ended at {session.event_time_s:.7f} s on the base's clock")
    say_written(output, json_file)
    say_command(
        *("calibrate", "clock", "--sound", output / SOUND, "--event-time", f"{session.event_time_s:.7f}"),
        *("--broadcast", output / TIMES, "--motion", output / MOTION, "-o", "clock.toml"),
    )


def true_links(session: ClockSession) -> list[dict[str, Any]]:
    """Every clock against every other at time 0 of the first, as the calibration file states links."""
    from ..simulation.rig import BASE, CAMERA, IMU

    links = []
    for first, second in ((CAMERA, BASE), (CAMERA, IMU), (BASE, IMU)):
        at_zero, later = (session.offset_s(first, second, at_s) for at_s in (0.0, 1000.0))
        links.append(
            {
                "from": first,
                "to": second,
                "at_s": 0.0,
                "offset_s": at_zero,
                "skew_ppm": 1e6 * (later - at_zero) / 1000.0 + 0.0,
            }
        )
    return links
