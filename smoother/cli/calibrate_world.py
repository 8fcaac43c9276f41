"""`unocclude calibrate world`: camera to base IMU, from poses of a panel with an IMU on it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..errors import CalibrationError
from .calibrate import CalibrationOutput
from .options import Force, Json
from .output import check_outputs, print_notes, print_table, say, say_written, write_json

if TYPE_CHECKING:
    from calib.panel.definition import Intrinsics
    from calib.panel.images import View
    from calib.world.world_calibration import WorldCalibration

    from ..recording import ImuStream

Files = list[Path] | None


def world(
    output: CalibrationOutput,
    recording: Annotated[
        Path | None,
        typer.Argument(metavar="[REC.mcap]", help="The session with images, lens and both IMUs."),
    ] = None,
    depth: Annotated[
        Files, typer.Option("--depth", metavar="D.png", help="Depth image, 16 bit, mm; one a panel pose.")
    ] = None,
    infrared: Annotated[
        Files, typer.Option("--infrared", metavar="I.png", help="Infrared image of the same moment.")
    ] = None,
    panel_imu: Annotated[
        Files,
        typer.Option(
            "--panel-imu",
            metavar="P.csv",
            help="Samples of the IMU on the panel in that pose: t_s, ax, ay, az, gx, gy, gz [, mx, my, mz].",
        ),
    ] = None,
    base_imu: Annotated[
        Files, typer.Option("--base-imu", metavar="B.csv", help="Those of the IMU on the camera.")
    ] = None,
    intrinsics_file: Annotated[
        Path | None,
        typer.Option(
            "--intrinsics",
            metavar="K.toml",
            help="width, height, fx, fy, cx, cy, distortion = [k1, k2, p1, p2, k3].",
        ),
    ] = None,
    panel_file: Annotated[
        Path | None,
        typer.Option(
            "--panel",
            metavar="PANEL.toml",
            help="[panel] markers = [[x, y], ..] and extent = [[xmin, ymin], [xmax, ymax]], m.",
        ),
    ] = None,
    panel_topic: Annotated[
        str, typer.Option("--panel-topic", metavar="TOPIC", help="In a recording: the IMU on the panel.")
    ] = "panel",
    base_topic: Annotated[
        str, typer.Option("--base-topic", metavar="TOPIC", help="In a recording: the IMU on the camera.")
    ] = "base",
    json_file: Json = None,
    force: Force = False,
) -> None:
    """Find how the IMU on the camera sits on it, so that gravity is known in every recording after.

    Hold the panel, with an IMU on it, still for two seconds in each pose. From a recording of the whole
    session the gyroscopes link the poses; from files each pose stands alone. The answer is added to the
    calibration file; `smooth --calibration` takes gravity from the recording's base IMU then.
    """
    from calib.file import CalibrationFile, read_calibration, write_calibration
    from calib.panel.definition import read_intrinsics, read_panel
    from calib.world.chain import BIAS_M_S2, CORRECTED_M_S2
    from calib.world.panel_view import view_panel
    from calib.world.world_calibration import calibrate_world, world_poses
    from calib.world.world_table import calibration_tables

    from .calibrate_panel import pictured

    images = (depth or [], infrared or [], panel_imu or [], base_imu or [])
    if panel_file is None:
        raise typer.BadParameter("give --panel, the places of the panel's markers and its outline")
    inputs = [*(path for each in images for path in each), panel_file, intrinsics_file, recording]
    check_outputs(True, [output], inputs)
    check_outputs(force, [json_file], [*inputs, output])
    file = read_calibration(output) if output.exists() else CalibrationFile()
    known = read_panel(panel_file)
    lens = read_intrinsics(intrinsics_file) if intrinsics_file is not None else None
    if recording is not None:
        if any(images):
            raise typer.BadParameter("give either a recording or files, not both")
        views, times, panels, bases, lens = _from_recording(recording, panel_topic, base_topic, lens)
    else:
        views, times, panels, bases = _from_files(*images)
        if lens is None:
            raise typer.BadParameter("give --intrinsics with --depth")
    panels, bases, corrected, both = _corrected(panels, bases, file)
    with pictured(output.with_name(f"{output.stem}.seen.png")):
        seen = [view_panel(view, t_s, known, lens) for view, t_s in zip(views, times, strict=True)]
    poses, notes = world_poses(seen, panels, bases)
    found = calibrate_world(poses, notes, CORRECTED_M_S2 if both else BIAS_M_S2)
    tables = calibration_tables(found)
    tables["camera_from_base"]["accelerometer_corrected"] = corrected
    written = CalibrationFile()
    for name, table in tables.items():
        written = written.with_table(name, table)
    write_json(json_file, {**tables, "words": _words(found)}, force)
    write_calibration(output, written)
    print_world(found)
    say_written(output, json_file)


def _from_files(
    depths: list[Path], infrareds: list[Path], panels: list[Path], bases: list[Path]
) -> tuple[list[View], list[float], list[ImuStream], list[ImuStream]]:
    """Views, their times, and both IMUs by pose; a pose's time is the middle of its samples."""
    from calib.panel.images import read_view

    from ..io.plain.imu_table import read_imu_table

    counts = [len(each) for each in (depths, infrareds, panels, bases)]
    if not depths:
        raise typer.BadParameter(
            "give --depth, --infrared, --panel-imu and --base-imu once a pose, or a recording"
        )
    if len(set(counts)) > 1:
        raise typer.BadParameter(
            "--depth, --infrared, --panel-imu and --base-imu must be given alike often, once a pose; they "
            f"are given {', '.join(map(str, counts[:-1]))} and {counts[-1]} times"
        )
    views = [read_view(d, i) for d, i in zip(depths, infrareds, strict=True)]
    on_panel = [read_imu_table(path, "panel") for path in panels]
    on_base = [read_imu_table(path, "base") for path in bases]
    times = []
    for mine, base, path in zip(on_panel, on_base, panels, strict=True):
        first, last = max(mine.t_s[0], base.t_s[0]), min(mine.t_s[-1], base.t_s[-1])
        if last <= first:
            raise CalibrationError(f"{path} and the base IMU's file of that pose do not overlap in time.")
        times.append(0.5 * float(first + last))
    return views, times, on_panel, on_base


def _from_recording(
    path: Path, panel_topic: str, base_topic: str, lens: Intrinsics | None
) -> tuple[list[View], list[float], list[ImuStream], list[ImuStream], Intrinsics]:
    from ..io.media.panel_session import read_session

    session = read_session(path, panel_topic, base_topic)
    lens = lens or session.lens
    if lens is None:
        raise CalibrationError(
            f"{path} holds no lens (CameraCalibration, CameraInfo) of the depth camera; give --intrinsics."
        )
    print_notes(session.notes)
    count = len(session.views)
    return session.views, session.times_s, [session.panel] * count, [session.base] * count, lens


def _corrected(
    panels: list[ImuStream], bases: list[ImuStream], file: Any
) -> tuple[list[ImuStream], list[ImuStream], bool, bool]:
    """The IMUs with what the file knows of them taken off (once a stream).

    Also: the base IMU's accelerometer was known, and both were.
    """
    from calib.imu.sensor import sensor_of

    def corrected(streams: list[ImuStream]) -> tuple[list[ImuStream], bool]:
        sensor = sensor_of(file, streams[0].name)
        if sensor is None:
            return streams, False
        once = {id(stream): sensor.apply(stream) for stream in streams}
        return [once[id(stream)] for stream in streams], sensor.accelerometer is not None

    (panels, other), (bases, known) = corrected(panels), corrected(bases)
    return panels, bases, known, known and other


def _words(found: WorldCalibration) -> dict[str, Any]:
    from calib.world.world_accuracy import verdict

    said = verdict(found)
    return {"grade": said.grade, "verdict": said.sentence, "findings": said.findings, "next": said.next}


def print_world(found: WorldCalibration) -> None:
    """Print the answer, the residuals by pose, the verdict and what to record next."""
    import numpy as np

    from calib.world.world_accuracy import verdict
    from calib.world.world_table import calibration_tables

    tables, said = calibration_tables(found), verdict(found)
    for name, what in (
        ("camera_from_base", "camera from base IMU"),
        ("panel_from_imu", "panel from its IMU"),
    ):
        table = tables[name]
        say(
            f"{what}: rotation {np.round(table['rotation'], 5).tolist()} (qw, qx, qy, qz) +-"
            f" {np.round(table['rotation_sigma_deg'], 2).tolist()} degrees"
        )
    print_table(
        "Poses",
        ("pose", "down in the camera", "left of its rotation, deg", "worst misfit, sigmas", "rest, s"),
        [
            (
                row["pose"],
                ", ".join(f"{x:.4f}" for x in row["down"]),
                f"{row['rotation_deg']:.3f}",
                f"{row['worst_sigma']:.1f}",
                f"{row['rest_s']:.1f}",
            )
            for row in tables["world"]["residuals"]
        ],
    )
    say(f"verdict: {said.sentence}")
    for sentence in said.findings:
        say(f"  {sentence}")
    for sentence in said.next:
        say(f"next: {sentence}")
