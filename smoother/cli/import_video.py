"""`unocclude import video`: a phone's or web camera's video as the camera, by MediaPipe's pose landmarker."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ..errors import RecordingError
from .imports import Templates, imu_files, write_imported
from .options import Force, Json, Output
from .output import check_mcap, check_outputs, progress_bar

#: More people make MediaPipe slower, and no room holds them.
_MOST_PEOPLE = 10


def video(
    file: Annotated[
        Path,
        typer.Argument(metavar="FILE", help="MP4, MOV, AVI or MKV of a fixed camera.", show_default=False),
    ],
    output: Output,
    model: Annotated[
        Path | None,
        typer.Option("--model", metavar="FILE.task", help="The model of MediaPipe's pose landmarker."),
    ] = None,
    imu: Annotated[
        list[str] | None,
        typer.Option("--imu", metavar="[NAME=]FILE[,FILE]", help="A file with an IMU, as in `import files`."),
    ] = None,
    imu_starts_at: Annotated[
        float | None,
        typer.Option(
            "--imu-starts-at",
            metavar="S",
            help="When the first IMU sample was taken, seconds after the first picture.",
        ),
    ] = None,
    mirrored: Annotated[
        bool,
        typer.Option("--mirrored", help="The camera stored a mirror image, as front cameras of phones may."),
    ] = False,
    turn: Annotated[
        int,
        typer.Option(
            "--turn",
            metavar="90|180|270",
            help="Rotate the pictures clockwise, degrees; the file's own rotation is already applied.",
        ),
    ] = 0,
    people: Annotated[
        int, typer.Option("--people", help="Find at most this many people.", min=1, max=_MOST_PEOPLE)
    ] = 2,
    template: Templates = None,
    one_session: Annotated[
        bool, typer.Option("--one-session", help="Refuse files whose dates are a day apart or more.")
    ] = False,
    json_file: Json = None,
    force: Force = False,
) -> None:
    """Import a video as the camera; MediaPipe finds the joints.

    Joints are stored in metres relative to the hips, and in pixels.
    """
    from ..io.files import import_files
    from ..io.registry import FileReader
    from ..io.tables.recording_toml import read_templates
    from ..io.tables.table import read_head
    from ..io.tables.video import TURNS, pose_video

    if turn not in TURNS:
        raise typer.BadParameter("--turn is 90, 180 or 270")
    check_mcap(output)
    imus = [imu_files(text) for text in imu or []]
    check_outputs(force, [output, json_file], [file, model, *(p for files in imus for p in files.paths)])
    with progress_bar("opening the video") as progress:
        camera = pose_video(model, people, mirrored, turn, progress)
        reader = FileReader(templates=[camera, *read_templates(template or [])])
        if not camera.recognises(read_head(file)):
            raise RecordingError(
                f"{file} is not a video (MP4, MOV, AVI, MKV); export or convert it, or name another file."
            )
        recording, reports = import_files(
            [file], imus, imu_starts_at_s=imu_starts_at, reader=reader, one_session=one_session
        )
    write_imported(recording, output, json_file, force, reports)
