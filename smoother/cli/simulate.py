"""`unocclude simulate arm`, `people`, `strap`: recordings of arms with truth; every setting by --set."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from .options import Force, Json, Output, Seed
from .output import check_mcap, check_outputs, print_table, say_command, say_written, write_json
from .simulate_rig import SimulatedFile

if TYPE_CHECKING:
    from pydantic.fields import FieldInfo

    from ..simulation import MarkerCapture


_MAP_HEAD = """# Markers of {name}: the mean of a joint's markers is its centre. The plate on the IMU is
# rigid; its mean is the IMU, and [imu_plate] gives the positions of its markers in the IMU's axes, m.
# Use: unocclude validate OUT.mcap --truth {name} --markers {map} --calibration {calibration}
"""


@dataclass(frozen=True)
class MocapFiles:
    """Names of what a motion capture is written to."""

    c3d: Path  # The markers, alike
    trc: Path  # The markers, alike
    map: Path  # Which markers make a joint
    calibration: Path  # Where [camera_from_mocap] goes if no other file is named

    @classmethod
    def beside(cls, recording: Path, calibration: Path | None) -> MocapFiles:
        """The names that belong to a recording's; the calibration's may be given."""

        def name(ending: str) -> Path:
            return recording.with_name(f"{recording.stem}{ending}")

        return cls(
            name(".c3d"), name(".trc"), name("_markers.toml"), calibration or name("_calibration.toml")
        )

    @property
    def markers(self) -> tuple[Path, Path, Path]:
        """All but the calibration."""
        return self.c3d, self.trc, self.map

    def write(self, capture: MarkerCapture, force: bool) -> None:
        """Write the capture as a lab would: its own frame and clock, millimetres, blanks where not seen."""
        from calib.file import to_toml

        from ..io.export.markers import C3dContent, write_c3d, write_trc
        from ..runtime.outputs import writing

        write_c3d(self.c3d, C3dContent(capture.names, capture.position, capture.rate_hz), force)
        write_trc(self.trc, capture.names, capture.t_s, capture.position, capture.rate_hz, force)
        head = _MAP_HEAD.format(name=self.c3d.name, map=self.map.name, calibration=self.calibration.name)
        text = head + "\n" + to_toml({"markers": capture.marker_map, "imu_plate": capture.plate})
        with writing(self.map, force) as temporary:
            temporary.write_text(text, encoding="utf-8")


CalibrationOut = Annotated[
    Path | None,
    typer.Option("--calibration-out", metavar="CAL.toml", help="Also write the true calibration of the arm."),
]
Mocap = Annotated[
    bool,
    typer.Option(
        "--mocap",
        help="Also write what a motion capture of 15 markers would deliver, beside FILE: .c3d, .trc, "
        "_markers.toml (the map for --markers), and the calibration with [camera_from_mocap].",
    ),
]
PresetName = Annotated[
    str,
    typer.Option(
        "--preset",
        metavar="white|realistic|azure|clean|FILE.toml",
        help="Errors to start from: a name, or a file of settings.",
    ),
]


Arms = Annotated[
    str,
    typer.Option(
        "--arms",
        metavar="one|both",
        help="Both arms of one person, each with its IMU or IMUs; --side is the first.",
    ),
]


def arm(
    output: Output,
    calibration_out: CalibrationOut = None,
    preset: PresetName = "white",
    seed: Seed = 0,
    mocap: Mocap = False,
    arms: Arms = "one",
    json_file: Json = None,
    force: Force = False,
    **settings: Any,
) -> None:
    """An arm with a wrist IMU before a depth camera.

    Omitted settings come from the preset; a file has settings by key, and `preset` for the one it starts
    from. The defaults shown are those of `white`.
    """
    from pydantic import ValidationError

    from ..io import write_recording
    from ..simulation import ArmSimulation, MocapSimulation, capture, simulate_arm, simulate_both_arms
    from .config import describe

    start, own = read_preset(preset, arm_settings())
    given = {name: parsed_setting(name, value) for name, value in settings.items() if value is not None}
    changes = own | given
    try:
        mocap_config = MocapSimulation(**taken(changes, MocapSimulation))
        config = ArmSimulation.preset(start, **changes)
    except ValidationError as error:
        raise typer.BadParameter(f"setting {describe(error)}") from error
    if not mocap and mocap_config != MocapSimulation():
        raise typer.BadParameter("the settings of markers and mocap need --mocap")
    if arms not in ("one", "both"):
        raise typer.BadParameter(f"--arms is one or both, not '{arms}'")
    if config.cameras and arms == "both":
        raise typer.BadParameter("--cameras films one arm; leave out --arms both")
    if config.rgb != "none" and (arms == "both" or mocap or "trunk" in config.imus):
        raise typer.BadParameter("--rgb goes with one arm and no motion capture; see `simulate arm --help`")
    if config.rgb == "further" and not config.cameras:
        raise typer.BadParameter("--rgb further needs --cameras, as in --cameras 75")
    if mocap and arms == "both":
        raise typer.BadParameter("--mocap captures one arm; leave out --arms both")
    files = MocapFiles.beside(output, calibration_out) if mocap else None
    calibration_out = files.calibration if files else calibration_out
    check_mcap(output)
    outputs = [output, calibration_out, *(files.markers if files else ()), json_file]
    check_outputs(force, outputs)
    both = simulate_both_arms(config, seed) if arms == "both" else (simulate_arm(config, seed),)
    simulated = both[0]
    markers = capture(simulated, mocap_config, seed) if files else None
    write_recording([one.recording for one in both], output, force=force)
    if calibration_out is not None:
        _write_calibration([one.calibration for one in both], markers, calibration_out, force)
    figures = {"seed": seed, "preset": preset, "config": config.model_dump(mode="json")}
    if files is not None and markers is not None:
        files.write(markers, force)
        found = {"offset_s": markers.offset_s, "skew_ppm": markers.skew_ppm} | markers.extrinsics
        figures["mocap"] = mocap_config.model_dump(mode="json") | found
    figures["parameters"] = simulated.parameters
    if len(both) > 1:
        figures["arms"] = [{"side": one.recording.side, "parameters": one.parameters} for one in both]
    write_json(json_file, figures, force)
    recording = simulated.recording
    rows: list[tuple[str, object]] = [
        ("length, s", f"{recording.imu.t_s[-1] - recording.imu.t_s[0]:.1f}"),
        ("IMU samples", len(recording.imu)),
        ("camera frames", len(recording.arm)),
    ]
    for camera in recording.cameras:
        angle = simulated.parameters["cameras"][camera.name]["angle_deg"]
        rows.append((f"frames of {camera.name}, at {angle:g} degrees", len(camera.arm)))
    for one in both:
        which = f", {one.recording.side} arm" if len(both) > 1 else ""
        rows.append((f"occluded frames{which}", int(one.occluded.sum())))
    if markers is not None:
        rows.append(("mocap frames, 15 markers", len(markers.position)))
    print_table(recording.name, ("what", "value"), rows)
    say_written(*outputs)


def read_preset(name: str, settings: Mapping[str, FieldInfo]) -> tuple[str, dict[str, Any]]:
    """The named preset that `--preset` starts from, and the settings of a file."""
    from ..runtime.inputs import read_toml
    from ..simulation import Preset

    own: dict[str, Any] = {}
    if name.endswith(".toml"):
        path, own = Path(name), read_toml(Path(name))
        name = str(own.pop("preset", Preset.WHITE))
        if unknown := sorted(set(own) - set(settings)):
            raise typer.BadParameter(
                f"{path}: there is no setting {', '.join(unknown)}; `--set list` prints all"
            )
    names = [preset.value for preset in Preset]
    if name not in names:
        raise typer.BadParameter(f"there is no preset '{name}'; presets: {', '.join(names)}, or a FILE.toml")
    return name, own


def taken(changes: dict[str, Any], model: Any) -> dict[str, Any]:
    """The settings of a model, taken out of `changes`."""
    return {name: changes.pop(name) for name in list(changes) if name in model.model_fields}


def _write_calibration(calibrations: list[Any], markers: Any, path: Path, force: bool) -> None:
    from calib.file import CalibrationFile, calibration_text

    from ..runtime.outputs import writing

    file = CalibrationFile()
    for calibration in calibrations:
        file = file.with_arm(calibration)
    if markers is not None:
        file = file.with_table("camera_from_mocap", markers.extrinsics)
    with writing(path, force) as temporary:
        temporary.write_text(calibration_text(file, path), encoding="utf-8", newline="\n")


def arm_settings() -> dict[str, FieldInfo]:
    """Every setting of the simulation by name."""
    from ..simulation import ArmSimulation, MocapSimulation

    return {**ArmSimulation.model_fields, **MocapSimulation.model_fields}


def parsed_setting(name: str, value: Any) -> Any:
    """A list of numbers for the settings that are one, the value as it is for the others."""
    known = arm_settings().get(name)
    if known is None or not isinstance(known.get_default(), tuple):
        return value
    try:
        return tuple(float(part) for part in str(value).split(",") if part.strip())
    except ValueError:
        raise typer.BadParameter(f"setting {name} takes numbers, as 0.5,1; not '{value}'") from None


#: Settings of an arm that each person draws for themselves, or that a crowd has no use for.
_NOT_OURS = {
    *("side", "strap", "belly", "frozen_gaps", "swapped_gaps", "still_all"),
    *("cameras", "camera_clock_s", "camera_clock_ppm", "camera_blind", "camera_fault", "rgb", "rgb_noise_px"),
}


def people(
    output: Output,
    preset: PresetName = "realistic",
    seed: Seed = 0,
    json_file: Json = None,
    force: Force = False,
    **settings: Any,
) -> None:
    """People with shuffled, unnamed IMUs, for `match`.

    The truth, which IMU is where, is printed and goes to --json. Omitted settings of the arms come from the
    preset.
    """
    from pydantic import ValidationError

    from ..io import write_recording
    from ..io.recording.write import as_session
    from ..simulation import ArmSimulation, PeopleSimulation, simulate_people
    from .config import describe

    start, own = read_preset(preset, people_settings())
    changes = own | {
        name: parsed_setting(name, value) for name, value in settings.items() if value is not None
    }
    try:
        crowd = PeopleSimulation(**taken(changes, PeopleSimulation))
        usual = {"protocol": "random", "duration_s": 20.0}
        config = ArmSimulation.preset(start, **(usual | changes))
        check_mcap(output)
        check_outputs(force, [output, json_file])
        simulated = simulate_people(crowd, config, seed)
    except ValidationError as error:
        raise typer.BadParameter(f"setting {describe(error)}") from error
    except ValueError as error:
        raise typer.BadParameter(str(error)) from error
    imus = [one.stream for one in simulated.worn]
    write_recording(
        as_session(simulated.name, imus, simulated.arms, simulated.camera_frame), output, force=force
    )
    rows = [(one.stream.name, one.body, one.joint, one.clock_offset_s) for one in simulated.worn]
    figures: dict[str, Any] = {
        "seed": seed,
        "people": crowd.model_dump(mode="json"),
        "config": config.model_dump(mode="json"),
        "truth": [
            {"imu": name, "body": body, "joint": joint, "clock_offset_s": offset}
            for name, body, joint, offset in rows
        ],
    }
    write_json(json_file, figures, force)
    print_table(simulated.name, ("IMU", "body", "joint", "its clock is ahead, s"), rows)
    say_written(output, json_file)


def people_settings() -> dict[str, FieldInfo]:
    """Every setting by name: of the people, then of their arms."""
    from ..simulation import ArmSimulation, PeopleSimulation

    arms = {name: field for name, field in ArmSimulation.model_fields.items() if name not in _NOT_OURS}
    return {**PeopleSimulation.model_fields, **arms}


def strap(
    to: SimulatedFile,
    duration_s: Annotated[
        float, typer.Option("--duration-s", min=8.0, max=120.0, help="Length of the recording, s.")
    ] = 20.0,
    every: Annotated[
        int,
        typer.Option("--every", min=1, max=60, help="One image every this many camera frames."),
    ] = 5,
) -> None:
    """An arm with images of its strap, for `import strap`.

    FILE_truth.toml contains the strap's true position, FILE the IMU's true motion.
    """
    from ..io.rig.strap import write_strap_recording
    from ..simulation import ArmSimulation, simulate_arm
    from ..simulation.strap import COLOUR, DEPTH, DEPTH_LATER_S, strap_images, strap_radius_m
    from .output import progress_bar

    to.check()
    simulated = simulate_arm(ArmSimulation(protocol="random", duration_s=duration_s), to.seed)
    recording, measures = simulated.recording, simulated.parameters
    times = recording.arm.t_s[::every]
    with progress_bar("drawing the arm") as progress:
        images = []
        for pair in strap_images(simulated, times, to.seed):
            images.append(pair)
            progress(len(images) / len(times), "drawing the arm")
    write_strap_recording(to.output, recording, images, times, (COLOUR, DEPTH), DEPTH_LATER_S, force=to.force)
    radius_m = strap_radius_m(simulated)
    truth = {
        "strap": {
            "radius_m": radius_m,
            "from_elbow_m": float(measures["forearm_m"] - measures["strap_to_wrist_m"]),
            "along": float(1.0 - measures["strap_to_wrist_m"] / measures["forearm_m"]),
        }
    }
    to.write_truth(truth, images=len(images))
    rows = [
        ("images, colour and depth", len(images)),
        ("forearm's core to the IMU, mm", f"{1e3 * radius_m:.1f}"),
        ("elbow to the strap, mm", f"{1e3 * truth['strap']['from_elbow_m']:.1f}"),
        ("the same in parts of the forearm", f"{truth['strap']['along']:.2f}"),
    ]
    print_table(to.output.name, ("what", "value"), rows)
    to.say_written()
    say_command("import", "strap", to.output, "-o", "with_strap.mcap", "--radius-m", f"{radius_m:.3f}")
