"""`unocclude calibrate panel` and `world`: the camera in the mocap's frame and its base IMU, from a panel."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..errors import CalibrationError
from .calibrate import error_prefix, load_existing_calibration, say_answer, write_answer
from .options import (
    NO_FILES,
    CalibrationOutput,
    Depth,
    Files,
    Infrared,
    IntrinsicsFile,
    Outputs,
    PanelFile,
)
from .output import print_notes, print_table, say

if TYPE_CHECKING:
    from calib.intrinsics import Intrinsics
    from calib.panel.images import View
    from calib.panel.panel_calibration import PanelCalibration

    from ..array_types import FloatArray
    from ..recording import ImuStream


def panel(
    output: CalibrationOutput,
    recording: Annotated[
        Path | None,
        typer.Argument(metavar="REC.mcap", help="Images, lens and mocap markers, instead of files."),
    ] = None,
    depth: Depth = None,
    infrared: Infrared = None,
    markers: Annotated[
        Files,
        typer.Option(
            "--markers",
            metavar="M.csv|.trc|.c3d",
            help="Mocap markers of the same moment; CSV: marker,x,y,z in metres, any names and order.",
        ),
    ] = None,
    intrinsics_file: IntrinsicsFile = None,
    panel_file: PanelFile = None,
    mocap_sigma_mm: Annotated[
        float,
        typer.Option("--mocap-sigma-mm", min=0.001, max=20.0, help="Noise of a mocap marker, per axis."),
    ] = 0.2,
    to: Outputs = NO_FILES,
) -> None:
    """The camera's pose in motion capture, from a marker panel.

    Hold the panel still in each pose; --depth, --infrared and --markers are given once per pose, in the same
    order. The result is added to the calibration file, with sigma and a verdict.
    """
    from calib.panel.definition import read_panel
    from calib.panel.panel_calibration import calibrate_panel
    from calib.panel.panel_table import panel_answer

    depths, infrareds, marked = depth or [], infrared or [], markers or []
    if panel_file is None:
        raise typer.BadParameter("give --panel (marker positions and outline of the panel)")
    inputs = [*depths, *infrareds, *marked, panel_file, intrinsics_file, recording]
    load_existing_calibration(output, to, inputs)
    known = read_panel(panel_file)
    notes: list[str] = []
    with pictured(output.with_name(f"{output.stem}.seen.png")):
        views, positions, lens = _session(recording, depths, infrareds, marked, intrinsics_file, notes)
        calibration = calibrate_panel(views, positions, known, lens, 1e-3 * mocap_sigma_mm)
    answer = panel_answer(calibration)
    write_answer(answer, output, to, calibration, views, notes=notes)
    print_panel(calibration)
    say_answer(answer, notes, output, to.report, to.json_file)


def _session(
    recording: Path | None,
    depths: list[Path],
    infrareds: list[Path],
    marked: list[Path],
    intrinsics_file: Path | None,
    notes: list[str],
) -> tuple[list[View], list[dict[str, FloatArray]], Intrinsics]:
    """Views, mocap markers by view, and the lens: from files, or from a recording."""
    from calib.panel.definition import read_intrinsics
    from calib.panel.images import read_view

    from ..io.markers import read_positions

    lens = read_intrinsics(intrinsics_file) if intrinsics_file is not None else None
    positions = [read_positions(path) for path in marked]
    if recording is not None:
        if depths or infrareds:
            raise typer.BadParameter("give either a recording or --depth and --infrared, not both")
        from ..io.media.panel_files import read_panel_session

        return read_panel_session(recording, positions, lens, notes)
    if not depths:
        raise typer.BadParameter("give --depth, --infrared and --markers once per pose, or a recording")
    if not len(depths) == len(infrareds) == len(marked):
        raise typer.BadParameter(
            f"--depth, --infrared and --markers must be given alike often, once per pose; they are given"
            f" {len(depths)}, {len(infrareds)} and {len(marked)} times"
        )
    if lens is None:
        raise typer.BadParameter("give --intrinsics with --depth")
    for what, files in (("--depth", depths), ("--infrared", infrareds), ("--markers", marked)):
        twice = [str(path) for path in files if files.count(path) > 1]
        if twice:
            raise typer.BadParameter(f"{what} {twice[0]} is given twice; it would count twice")
    views = [read_view(d, i) for d, i in zip(depths, infrareds, strict=True)]
    return views, positions, lens


@contextmanager
def pictured(path: Path) -> Iterator[None]:
    """Where the markers could not be identified, write a picture of what was seen, and print its path."""
    from calib.panel.identify import NotIdentified

    try:
        yield
    except NotIdentified as error:
        if error.view is None or error.blobs is None:
            raise
        from calib.panel.images import drawn_spots

        from ..runtime.outputs import writing

        with writing(path, force=True) as temporary:
            temporary.write_bytes(drawn_spots(error.view.infrared, error.blobs))
        text = str(error).rstrip(".")
        raise NotIdentified(f"{text}; what was seen is drawn in {path}.") from error


def print_panel(calibration: PanelCalibration) -> None:
    """Print the transform with its sigma, and the residuals by pose."""
    import numpy as np

    from calib.panel.panel_table import accuracy, pose_cells, pose_rows, transform_values

    sigma = accuracy(calibration)
    values = transform_values(calibration.solution.camera_from_mocap)
    say(
        f"camera from mocap: rotation {np.round(values['rotation'], 6).tolist()} (qw, qx, qy, qz) +-"
        f" {np.round(sigma.rotation_deg, 3).tolist()} degrees about the camera's axes"
    )
    say(
        f"  translation {np.round(values['translation'], 5).tolist()} m +-"
        f" {np.round(1e3 * sigma.translation_m, 2).tolist()} mm at the mocap's origin,"
        f" {np.round(1e3 * sigma.at_panel_m, 2).tolist()} mm at the panel"
    )
    print_table(
        "Poses",
        ("pose", "distance, m", "tilt, deg", "pixels", "markers, mm", "plane, mm", "depth noise, mm"),
        [(row["pose"], *pose_cells(row)) for row in pose_rows(calibration)],
    )


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
    to: Outputs = NO_FILES,
) -> None:
    """The orientation of an IMU on the camera, for gravity.

    Hold the panel, with an IMU on it, still for two seconds in each pose. From a recording of the whole
    session the gyroscopes link the poses; from files each pose is independent. The result is added to
    the calibration file; `smooth --calibration` then takes gravity from the recording's base IMU.
    """
    from calib.panel.definition import read_intrinsics, read_panel
    from calib.world.panel_view import calibrate_world_from_views
    from calib.world.world_table import world_answer

    images = (depth or [], infrared or [], panel_imu or [], base_imu or [])
    if panel_file is None:
        raise typer.BadParameter("give --panel (marker positions and outline of the panel)")
    inputs = [*(path for paths in images for path in paths), panel_file, intrinsics_file, recording]
    held = load_existing_calibration(output, to, inputs)
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
    write_answer(answer, output, to, calibration, notes)
    print_tables(answer.table.tables)
    say_answer(answer, (), output, to.report, to.json_file)


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
            "give --depth, --infrared, --panel-imu and --base-imu once per pose, or a recording"
        )
    if len(set(counts)) > 1:
        raise typer.BadParameter(
            "--depth, --infrared, --panel-imu and --base-imu must be given alike often, once per pose; they "
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
    from ..io.media.panel_files import read_session

    session = read_session(path, panel_topic, base_topic)
    lens = lens or session.lens
    if lens is None:
        raise CalibrationError(
            f"{path} has no lens (CameraCalibration, CameraInfo) of the depth camera; give --intrinsics."
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
