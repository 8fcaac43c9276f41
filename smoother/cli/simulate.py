"""`unocclude simulate`: recordings with truth, of arms and of what calibrations are made of."""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from ..errors import UnoccludeError
from ..table import Table, tabulated
from . import options as o
from .output import Out, progress_bar, say, say_command, show, write_text

if TYPE_CHECKING:
    from pydantic.fields import FieldInfo

    from ..array_types import FloatArray
    from ..recording import ImuStream
    from ..simulation import MarkerCapture, SimulatedArm
    from ..simulation.config import RestPoses, StrapImages, TurningMagnetometer
    from ..simulation.panel import SimulatedPanel
    from ..simulation.rig import SimulatedClocks


Preset = Annotated[
    str,
    o.option("Errors to start from, or a file of settings.", metavar="clean|white|realistic|azure|FILE.toml"),
]
Folder = Annotated[Path, o.value("FOLDER", "Folder to make.", "-o", "--output"), o.UNCHECKED]
#: What a calibration should find, further figures, and the command to try.
Made = tuple[dict[str, Any], dict[str, Any], tuple[object, ...]]
_TRUTH = "# Simulated: what the calibration of these files should find.\n"


def configured(
    given: list[str] | None, *kinds: Any, preset: str = "", hidden: tuple[str, ...] = (), **usual: Any
) -> list[Any]:
    """Settings of each kind, from the preset, a file and `--set`; a kind that has presets starts from one."""
    from pydantic import ValidationError

    from .config import describe

    fields = {
        name: field for kind in kinds for name, field in kind.model_fields.items() if name not in hidden
    }
    if "list" in (given or ()):
        rows = [(name, _shown(field.get_default()), field.description) for name, field in fields.items()]
        show(Table("Settings", ("key", "default", "what it is"), rows))
        raise typer.Exit
    start, own = read_preset(preset, fields) if preset else ("", {})
    changes = usual | own | dict(parsed_setting(text, fields) for text in given or ())
    try:
        made = []
        for kind in kinds:
            mine = {name: changes.pop(name) for name in list(changes) if name in kind.model_fields}
            made.append(kind.preset(start, **mine) if hasattr(kind, "preset") else kind(**mine))
    except ValidationError as error:
        raise typer.BadParameter(f"setting {describe(error)}") from error
    return made


def read_preset(name: str, fields: Mapping[str, FieldInfo]) -> tuple[str, dict[str, Any]]:
    """The named preset that `--preset` starts from, and the settings of a file."""
    from ..runtime.inputs import read_toml
    from ..simulation import Preset

    own: dict[str, Any] = {}
    if name.endswith(".toml"):
        path, own = name, read_toml(Path(name))
        name = str(own.pop("preset", Preset.WHITE))
        if unknown := ", ".join(sorted(set(own) - set(fields))):
            raise typer.BadParameter(f"{path}: there is no setting {unknown}; `--set list` prints all")
    if name not in tuple(Preset):
        names = ", ".join(Preset)
        raise typer.BadParameter(f"there is no preset '{name}'; presets: {names}, or a FILE.toml")
    return name, own


def parsed_setting(text: str, fields: Mapping[str, FieldInfo]) -> tuple[str, Any]:
    """Name and value of `--set KEY=VALUE`."""
    key, mark, value = (part.strip() for part in text.partition("="))
    name = key.replace("-", "_")
    if not mark or name not in fields:
        why = f"there is no setting '{key}'" if mark else f"'{text}' is not KEY=VALUE"
        raise typer.BadParameter(f"--set: {why}; `--set list` prints all")
    if not isinstance(fields[name].get_default(), tuple):
        return name, value
    try:  # as 0.5,1; or as TOML has it: [[0.1, 0.2]]
        return name, tomllib.loads(f"x = {value}" if value.startswith("[") else f"x = [{value}]")["x"]
    except tomllib.TOMLDecodeError:
        raise typer.BadParameter(f"setting {name} takes numbers, as 0.5,1; not '{value}'") from None


def _shown(default: Any) -> str:
    if isinstance(default, tuple):
        return ",".join(map(str, default))
    return str(getattr(default, "value", default)).lower()


def truth_text(tables: dict[str, Any]) -> str:
    """What a calibration should find, in the form of a calibration file."""
    from calib.file import FORMAT, VERSION, to_toml

    return _TRUTH + to_toml({"format": FORMAT, "version": VERSION} | tables)


def arm(
    output: o.Output,
    out: Out,
    calibration_out: Annotated[
        o.File, o.value("CAL.toml", "Also write the true calibration of the arm."), o.WRITTEN
    ] = None,
    preset: Preset = "white",
    seed: o.Seed = 0,
    settings: o.Settings = None,
    mocap: Annotated[
        bool,
        o.option(
            "Also write a motion capture of 15 markers beside FILE: .c3d, .trc, _markers.toml (for"
            " --markers), and the calibration with [camera_from_mocap].",
            "--mocap",
        ),
    ] = False,
    arms: Annotated[
        Literal["one", "both"], o.option("Both arms of one person; the setting `side` is the first.")
    ] = "one",
) -> None:
    """An arm with a wrist IMU before a depth camera.

    Settings that are not given come from the preset; a file has settings by key, and `preset` for the one it
    starts from.

    Example: unocclude simulate arm -o sim.mcap --preset realistic --set repetitions=3 --seed 7
    """
    from calib.file import CalibrationFile, calibration_text

    from ..io import describe, write_recording
    from ..simulation import ArmSimulation, MocapSimulation, capture, simulate_arm, simulate_both_arms
    from .recordings import topic_table

    config, mocap_config = configured(settings, ArmSimulation, MocapSimulation, preset=preset)
    two, rgb = arms == "both", config.rgb != "none"
    o.refuse(
        {
            "the settings of markers and mocap need --mocap": not mocap and mocap_config != MocapSimulation(),
            "cameras film one arm; leave out --arms both": two and config.cameras,
            "rgb goes with one arm and no motion capture; leave out the others": (
                rgb and (two or mocap or "trunk" in config.imus)
            ),
            "rgb=further needs cameras, as in --set cameras=75": config.rgb == "further"
            and not config.cameras,
            "--mocap captures one arm; leave out --arms both": two and mocap,
        }
    )
    markers: list[Path] = []
    if mocap:
        calibration_out = calibration_out or output.with_name(f"{output.stem}_calibration.toml")
        markers = [output.with_name(output.stem + end) for end in (".c3d", ".trc", "_markers.toml")]
        out.check([output, calibration_out, *markers])
    both: Sequence[SimulatedArm] = simulate_both_arms(config, seed) if two else [simulate_arm(config, seed)]
    simulated, captured = both[0], None
    if mocap:
        try:
            captured = capture(simulated, mocap_config, seed)
        except ValueError as error:
            raise typer.BadParameter(str(error)) from error
    write_recording([one.recording for one in both], output, force=out.force)
    figures = {"seed": seed, "preset": preset, "config": config.model_dump(mode="json")}
    calibration = CalibrationFile()
    for one in both:
        calibration = calibration.with_arm(one.calibration)
    if captured is not None and calibration_out is not None:
        write_mocap(captured, markers, calibration_out, out.force)
        found = {"offset_s": captured.offset_s, "skew_ppm": captured.skew_ppm} | captured.extrinsics
        figures["mocap"] = mocap_config.model_dump(mode="json") | found
        calibration = calibration.with_table("camera_from_mocap", captured.extrinsics)
    if calibration_out is not None:
        write_text(calibration_out, calibration_text(calibration, calibration_out), out.force)
    figures["parameters"] = simulated.parameters
    if two:
        figures["arms"] = [{"side": one.recording.side, "parameters": one.parameters} for one in both]
    out.json(figures)
    show(topic_table(describe(output)))
    out.end(output, calibration_out, *markers)


_MAP_HEAD = """# Markers of {name}: the mean of a joint's markers is its centre. The plate on the IMU is
# rigid; its mean is the IMU, and [imu_plate] gives the positions of its markers in the IMU's axes, m.
# Use: unocclude validate OUT.mcap --truth {name} --markers {map} --calibration {calibration}
"""


def write_mocap(capture: MarkerCapture, files: list[Path], calibration: Path, force: bool) -> None:
    """Write the capture as a lab would: its own frame and clock, millimetres, blanks where not seen."""
    from calib.file import to_toml

    from ..io.export.markers import write_c3d, write_trc

    c3d, trc, markers = files
    write_c3d(c3d, capture.names, capture.position, capture.rate_hz, force)
    write_trc(trc, capture.names, capture.t_s, capture.position, capture.rate_hz, force)
    head = _MAP_HEAD.format(name=c3d.name, map=markers.name, calibration=calibration.name)
    tables = {"markers": capture.marker_map, "imu_plate": capture.plate}
    write_text(markers, f"{head}\n{to_toml(tables)}", force)


#: Settings of an arm that each person draws for themselves, or that a crowd has no use for.
_NOT_OURS = (
    *("side", "strap", "frozen_gaps", "swapped_gaps", "still_all"),
    *("cameras", "camera_clock_s", "camera_clock_ppm", "camera_blind", "camera_fault", "rgb", "rgb_noise_px"),
)


def people(
    output: o.Output,
    out: Out,
    preset: Preset = "realistic",
    seed: o.Seed = 0,
    settings: o.Settings = None,
) -> None:
    """People with shuffled, unnamed IMUs, for `match`.

    The truth, which IMU is where, is printed and goes to --json. Omitted settings of the arms come from the
    preset.

    Example: unocclude simulate people -o people.mcap --set people=2 --set sensors=4 --seed 7
    """
    from ..io import write_recording
    from ..io.recording.write import as_session
    from ..simulation import ArmSimulation, PeopleSimulation, simulate_people

    usual: dict[str, Any] = {"protocol": "random", "duration_s": 20.0}
    kinds = (PeopleSimulation, ArmSimulation)
    crowd, config = configured(settings, *kinds, preset=preset, hidden=_NOT_OURS, **usual)
    try:
        simulated = simulate_people(crowd, config, seed)
    except ValueError as error:
        raise typer.BadParameter(str(error)) from error
    streams = [one.stream for one in simulated.worn]
    session = as_session(simulated.name, streams, simulated.arms, simulated.camera_frame)
    write_recording(session, output, force=out.force)
    keys = ("imu", "body", "joint", "clock_offset_s")
    rows = [(one.stream.name, one.body, one.joint, one.clock_offset_s) for one in simulated.worn]
    settings_used = {"people": crowd.model_dump(mode="json"), "config": config.model_dump(mode="json")}
    truth = [dict(zip(keys, row, strict=True)) for row in rows]
    out.json({"seed": seed, **settings_used, "truth": truth})
    show(Table(simulated.name, ("IMU", "body", "joint", "its clock is ahead, s"), rows))
    out.end(output)


def _for_calibration(kind: str, make: Callable[[Any, int, Path, bool], Made]) -> Callable[..., None]:
    """The command of a recording that a calibration takes: its settings, its files, what to try next."""

    def command(output: o.Output, out: Out, seed: o.Seed = 0, settings: o.Settings = None) -> None:
        import smoother.simulation.config as kinds

        (config,) = configured(settings, getattr(kinds, kind))
        truth_file = output.with_name(f"{output.stem}_truth.toml")
        out.check([output, truth_file])
        truth, figures, words = make(config, seed, output, out.force)
        write_text(truth_file, truth_text(truth), out.force)
        out.json({"seed": seed, **figures, "truth": truth})
        out.end(output, truth_file)
        say_command(*words)

    command.__doc__ = make.__doc__
    return command


def _strap(config: StrapImages, seed: int, output: Path, force: bool) -> Made:
    """An arm with images of its strap, for `import strap`.

    FILE_truth.toml contains the strap's true position, FILE the IMU's true motion.

    Example: unocclude simulate strap -o session.mcap --seed 7
    """
    from ..io.rig.strap import write_strap_recording
    from ..simulation import ArmSimulation, simulate_arm
    from ..simulation.strap import COLOUR, DEPTH, DEPTH_LATER_S, strap_images, strap_radius_m

    simulated = simulate_arm(ArmSimulation(protocol="random", duration_s=config.duration_s), seed)
    recording, measures = simulated.recording, simulated.parameters
    times = recording.arm.t_s[:: config.every]
    images = []
    with progress_bar("drawing the arm") as progress:
        for pair in strap_images(simulated, times, seed):
            images.append(pair)
            progress(len(images) / len(times), "drawing the arm")
    write_strap_recording(output, recording, images, times, (COLOUR, DEPTH), DEPTH_LATER_S, force=force)
    radius_m, behind_m = strap_radius_m(simulated), measures["strap_to_wrist_m"]
    from_elbow_m, along = float(measures["forearm_m"] - behind_m), float(1 - behind_m / measures["forearm_m"])
    say(f"{output}: {len(images)} images, colour and depth")
    truth = {"strap": {"radius_m": radius_m, "from_elbow_m": from_elbow_m, "along": along}}
    words = ("import", "strap", output, "-o", "with_strap.mcap", "--radius-m", f"{radius_m:.3f}")
    return truth, {"images": len(images)}, words


def _imu(config: RestPoses, seed: int, output: Path, force: bool) -> Made:
    """An IMU in rest poses, for `calibrate imu`.

    The true values are written to FILE_truth.toml, in the form of a calibration file.

    Example: unocclude simulate imu -o poses.mcap --seed 7
    """
    from ..simulation.rig import SensorModel, long_rest, rest_poses

    model = SensorModel.draw([seed, 2], offset=config.offset, scale=config.scale, cross=config.cross)
    if config.long_rest_s is None:
        noise = {"acc_noise": config.noise, "gyro_noise": config.noise / 10.0}
        stream, bias = rest_poses(model, config.poses, seed=seed, rest_s=config.rest_s, **noise)
    else:
        stream, bias = long_rest(model, config.long_rest_s, seed=seed)
    truth = {"accelerometer": model.correction(), "gyroscope": {"offset": bias.tolist()}}
    words = ("calibrate", "imu", output, "-o", "arm.toml")
    return write_sensor(output, stream, truth, force), {}, words


def _magnetometer(config: TurningMagnetometer, seed: int, output: Path, force: bool) -> Made:
    """A magnetometer turned in all directions.

    The true values are written to FILE_truth.toml, in the form of a calibration file.

    Example: unocclude simulate magnetometer -o turning.mcap --seed 7
    """
    from ..simulation.rig import SensorModel, turning_sensor

    iron = {"offset": config.hard_iron, "scale": config.soft_iron, "cross": config.soft_iron}
    model = SensorModel.draw([seed, 2], **iron)
    stream = turning_sensor(model, seed=seed, field=config.field, noise=config.noise)
    words = ("calibrate", "magnetometer", output, "-o", "arm.toml")
    return write_sensor(output, stream, {"magnetometer": model.correction(config.field)}, force), {}, words


strap = _for_calibration("StrapImages", _strap)
imu = _for_calibration("RestPoses", _imu)
magnetometer = _for_calibration("TurningMagnetometer", _magnetometer)


def write_sensor(output: Path, stream: ImuStream, truth: dict[str, Any], force: bool) -> dict[str, Any]:
    """Write the recording of a sensor alone; its truth under its name."""
    from calib.file import sensor_name

    from ..io import write_recording
    from ..io.recording.write import as_session

    write_recording(as_session(output.name, [stream], []), output, force=force)
    length_s = stream.t_s[-1] - stream.t_s[0]
    say(f"{output}: IMU {stream.name}, {stream.rate_hz:.0f} Hz, {length_s:.0f} s")
    return {"imu": {sensor_name(stream.name): truth}}


def panel(
    output: Folder,
    out: Out,
    mcap: Annotated[o.File, o.value("REC.mcap", "Also write the session as a recording."), o.WRITTEN] = None,
    panel: Annotated[o.File, o.value("PANEL.toml", "Markers and extent of the panel to simulate.")] = None,
    seed: o.Seed = 0,
    settings: o.Settings = None,
) -> None:
    """A marker panel with images, motion capture and IMUs.

    Writes depth and infrared images, mocap markers and IMU samples of each pose, intrinsics.toml, panel.toml
    and truth.toml: what `calibrate panel` and `calibrate world` take, and what they should find.

    Example: unocclude simulate panel -o session --set poses=8 --seed 7 --mcap session.mcap
    """
    from calib.panel import read_panel

    from ..io.rig.panel import check_folder, write_panel_folder, write_panel_recording
    from ..simulation.panel import PanelSimulation, simulate_panel

    usual: dict[str, Any] = {}
    if panel is not None:
        known = read_panel(panel)
        usual = {"markers": known.markers_P.tolist(), "extent": known.extent_P.tolist()}
        if known.height_m:
            usual |= {"marker_height_m": known.height_m, "marker_shape": "sphere"}
    hidden = ("markers", "extent")  # they are in the panel's own file
    (config,) = configured(settings, PanelSimulation, hidden=hidden, **usual)
    check_folder(output, out.force)
    try:
        simulated = simulate_panel(config, seed)
    except ValueError as error:
        raise UnoccludeError(f"{error}.") from error
    lens = vars(simulated.lens) | {"distortion": list(simulated.lens.distortion)}
    truth = panel_truth(simulated)
    imus = [simulated.imu_panel, simulated.imu_base]
    definition: dict[str, Any] = {name: [list(point) for point in getattr(config, name)] for name in hidden}
    if config.marker_shape == "sphere" and config.marker_height_m > 0:
        definition["marker_height"] = config.marker_height_m
    if mcap is not None:
        write_panel_recording(mcap, simulated.poses, imus, simulated.lens, force=out.force)
    tables = {"intrinsics.toml": lens, "panel.toml": {"panel": definition}, "truth.toml": truth}
    write_panel_folder(output, simulated.poses, imus, config.hold_s / 2, tables, force=out.force)
    poses = [{"pose": name, **one} for name, one in truth["pose"].items()]
    out.json({"seed": seed, "config": config.model_dump(mode="json"), "truth": truth})
    show(tabulated(str(output), poses, "pose distance_m tilt_deg"))
    out.end(output, mcap)


def panel_truth(simulated: SimulatedPanel) -> dict[str, Any]:
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
    mocap = {"rotation": _quaternion(simulated.R_K_E), "translation": simulated.t_K_E.tolist()}
    return {
        "camera_from_mocap": mocap,
        "camera_from_base": {"rotation": _quaternion(simulated.R_K_B)},
        "panel_from_imu": {"rotation": _quaternion(simulated.R_P_I)},
        "depth_offset_m": simulated.config.depth_offset_m,
        "pose": poses,
    }


def _quaternion(R: FloatArray) -> list[float]:
    from scipy.spatial.transform import Rotation

    quaternion: list[float] = Rotation.from_matrix(R).as_quat(canonical=True, scalar_first=True).tolist()
    return quaternion


def clock(output: Folder, out: Out, seed: o.Seed = 0, settings: o.Settings = None) -> None:
    """A beep, broadcasts and motion with known clocks.

    Writes beep.wav, times.csv, session.mcap and truth.toml. The IMU's clock runs 390 ppm fast.

    Example: unocclude simulate clock -o session --seed 7
    """
    from ..io.rig.clock import MOTION, SOUND, TIMES, write_clock_folder
    from ..io.rig.panel import check_folder
    from ..simulation.config import ClockSources
    from ..simulation.rig import SOUND_RATE_HZ, simulate_clock_session

    (config,) = configured(settings, ClockSources)
    check_folder(output, out.force)
    session = simulate_clock_session(config, seed)
    truth = {"clock": {"links": (links := true_links(session))}}
    text, sound = truth_text(truth), (session.sound, SOUND_RATE_HZ)
    write_clock_folder(output, *sound, session.receptions, session.recording, text, force=out.force)
    out.json({"seed": seed, "event_time_s": session.event_time_s, "truth": truth})
    rows = [(one["from"], one["to"], f"{one['offset_s']:+.6f}", f"{one['skew_ppm']:.2f}") for one in links]
    columns = ("from", "to", "offset, s", "skew, ppm")
    show(Table("True clocks at time 0: t_to = t_from + offset", columns, rows))
    say(f"the beep ended at {session.event_time_s:.7f} s on the base's clock")
    out.end(output)
    say_command(
        *("calibrate", "clock", "--sound", output / SOUND, "--event-time", f"{session.event_time_s:.7f}"),
        *("--broadcast", output / TIMES, "--motion", output / MOTION, "-o", "clock.toml"),
    )


def true_links(session: SimulatedClocks) -> list[dict[str, Any]]:
    """Every clock against every other at time 0 of the first, as the calibration file states links."""
    from ..simulation.rig import BASE, CAMERA, IMU

    links = []
    for first, second in ((CAMERA, BASE), (CAMERA, IMU), (BASE, IMU)):
        at_zero, later = (session.clocks.offset_between_s(first, second, at_s) for at_s in (0.0, 1000.0))
        skew_ppm = 1e6 * (later - at_zero) / 1000.0 + 0.0
        link = {"from": first, "to": second, "at_s": 0.0, "offset_s": at_zero, "skew_ppm": skew_ppm}
        links.append(link)
    return links
