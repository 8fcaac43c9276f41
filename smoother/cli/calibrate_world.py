"""`unocclude calibrate world`: camera to base IMU, from poses of a panel with an IMU on it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..errors import CalibrationError
from .calibrate import error_prefix, load_existing_calibration, print_words, write_answer
from .options import CalibrationOutput, Depth, Files, Force, Infrared, IntrinsicsFile, Json, PanelFile, Report
from .output import print_notes, print_table, say, say_written

if TYPE_CHECKING:
    from calib.intrinsics import Intrinsics
    from calib.panel.images import View

    from ..recording import ImuStream


def world(
    output: CalibrationOutput,
    recording: Annotated[
        Path | None,
        typer.Argument(metavar="[REC.mcap]", help="The session with images, lens and both IMUs."),
    ] = None,
    depth: Depth = None,
    infrared: Infrared = None,
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
    intrinsics_file: IntrinsicsFile = None,
    panel_file: PanelFile = None,
    panel_topic: Annotated[
        str, typer.Option("--panel-topic", metavar="TOPIC", help="In a recording: the IMU on the panel.")
    ] = "panel",
    base_topic: Annotated[
        str, typer.Option("--base-topic", metavar="TOPIC", help="In a recording: the IMU on the camera.")
    ] = "base",
    report: Report = None,
    json_file: Json = None,
    force: Force = False,
) -> None:
    """Find how the IMU on the camera sits on it, so that gravity is known in every recording after.

    Hold the panel, with an IMU on it, still for two seconds in each pose. From a recording of the whole
    session the gyroscopes link the poses; from files each pose stands alone. The answer is added to the
    calibration file; `smooth --calibration` takes gravity from the recording's base IMU then.
    """
    from calib.panel.definition import read_intrinsics, read_panel
    from calib.world.panel_view import calibrate_world_from_views
    from calib.world.world_table import world_answer

    from .calibrate_panel import pictured

    images = (depth or [], infrared or [], panel_imu or [], base_imu or [])
    if panel_file is None:
        raise typer.BadParameter("give --panel, the places of the panel's markers and its outline")
    inputs = [*(path for paths in images for path in paths), panel_file, intrinsics_file, recording]
    held = load_existing_calibration(output, [json_file, report], inputs, force=force)
    known = read_panel(panel_file)
    lens = read_intrinsics(intrinsics_file) if intrinsics_file is not None else None
    if recording is not None:
        if any(images):
            raise typer.BadParameter("give either a recording or files, not both")
        views, times, panels, bases, lens, notes = _from_recording(recording, panel_topic, base_topic, lens)
    else:
        views, times, panels, bases = _from_files(*images)
        notes = ()
        if lens is None:
            raise typer.BadParameter("give --intrinsics with --depth")
    with pictured(output.with_name(f"{output.stem}.seen.png")):
        calibration = calibrate_world_from_views(views, times, panels, bases, known, lens, held)
    answer = world_answer(calibration)
    if report is not None:
        from ..report.world import write_world_report

        write_world_report(report, calibration, notes=notes, force=force)
    write_answer(answer, output, json_file, force)
    print_tables(answer.table.tables)
    print_words(answer)
    say_written(output, report, json_file)


def _from_files(
    depths: list[Path], infrareds: list[Path], panels: list[Path], bases: list[Path]
) -> tuple[list[View], list[float], list[ImuStream], list[ImuStream]]:
    """Views, their times, and both IMUs by pose; a pose's time is the middle of its samples."""
    from calib.panel.images import read_view
    from calib.world.panel_view import common_time

    from ..io.plain.table import read_imu_table

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
    for own, base, path in zip(on_panel, on_base, panels, strict=True):
        with error_prefix(f"{path} and the base IMU's file of that pose"):
            times.append(common_time(own, base))
    return views, times, on_panel, on_base


def _from_recording(
    path: Path, panel_topic: str, base_topic: str, lens: Intrinsics | None
) -> tuple[list[View], list[float], list[ImuStream], list[ImuStream], Intrinsics, tuple[str, ...]]:
    from ..io.media.panel_reading import read_session

    session = read_session(path, panel_topic, base_topic)
    lens = lens or session.lens
    if lens is None:
        raise CalibrationError(
            f"{path} holds no lens (CameraCalibration, CameraInfo) of the depth camera; give --intrinsics."
        )
    print_notes(session.notes)
    count, notes = len(session.views), tuple(session.notes)
    return session.views, session.times_s, [session.panel] * count, [session.base] * count, lens, notes


def print_tables(tables: dict[str, Any]) -> None:
    """Print the rotations with their sigmas, and the residuals by pose."""
    import numpy as np

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
