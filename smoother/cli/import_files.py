"""`unocclude import files`: recordings as devices write them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..errors import UnoccludeError
from .info import print_topics
from .options import Force, Json, Output
from .output import check_mcap, check_outputs, print_notes, print_table, say, write_json

if TYPE_CHECKING:
    from ..io.devices.files import ImuFiles


def files(
    output: Output,
    paths: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="FOLDER",
            help="A folder of device files (or the files), each recognised by what is in it.",
        ),
    ] = None,
    skeleton: Annotated[
        list[Path] | None, typer.Option("--skeleton", metavar="FILE", help="A file with the skeleton.")
    ] = None,
    imu: Annotated[
        list[str] | None,
        typer.Option(
            "--imu",
            metavar="[NAME=]FILE[,FILE]",
            help="A file with an IMU, or two of its accelerometer and its gyroscope; NAME as in"
            " recording.toml (forearm_right, upper_arm_left, ..), FILE#SENSOR for one of several.",
        ),
    ] = None,
    truth: Annotated[
        Path | None,
        typer.Option(
            "--truth",
            metavar="FILE",
            help="Poses of the forearm IMU in the camera frame (.csv with t_s,x,y,z,qw,qx,qy,qz); markers of"
            " a motion capture stay a file of their own, for `validate --truth`.",
        ),
    ] = None,
    skeleton_format: Annotated[
        str | None,
        typer.Option("--skeleton-format", metavar="FORMAT", help="Overrules what is recognised."),
    ] = None,
    imu_format: Annotated[
        str | None, typer.Option("--imu-format", metavar="FORMAT", help="Overrules what is recognised.")
    ] = None,
    imu_starts_at: Annotated[
        float | None,
        typer.Option(
            "--imu-starts-at",
            metavar="S",
            help="When the first IMU sample was taken, seconds after the camera's first frame.",
        ),
    ] = None,
    json_file: Json = None,
    force: Force = False,
) -> None:
    """Import files as devices and camera programs write them; `import formats` lists them."""
    from ..io import describe, write_recording
    from ..io.devices.files import import_files
    from ..io.devices.folder import add_truth, sort_files
    from ..io.devices.registry import FileReader

    reader = FileReader(imu_format, skeleton_format)
    skeletons, imus = list(skeleton or []), [imu_files(text) for text in imu or []]
    check_mcap(output)
    named = [*skeletons, *(p for files in imus for p in files.paths), truth, *(paths or [])]
    beside = [
        path for folder in paths or [] if folder.is_dir() for path in folder.glob("*") if path.is_file()
    ]
    check_outputs(force, [output, json_file], [*named, *beside])
    more_skeletons, more_imus, passed_over = sort_files(paths or [], reader, output)
    file, reports = import_files(
        skeletons + more_skeletons, imus + more_imus, imu_starts_at_s=imu_starts_at, reader=reader
    )
    if truth is not None:
        reports.append(add_truth(file, truth))
    for report in reports:
        say(report.sentence)
    write_recording(file, output, force=force)
    about = describe(output)
    write_json(json_file, {**about.to_dict(), "files": [vars(report) for report in reports]}, force)
    print_topics(about)
    print_notes([*file.notes, *passed_over])


def imu_files(text: str) -> ImuFiles:
    """What `--imu [NAME=]FILE[,FILE]` names."""
    from ..io.devices.files import ImuFiles

    name, sensor, rest = "", "", text.strip()
    if not Path(rest).exists() and "=" in rest:
        name, _, rest = (part.strip() for part in rest.partition("="))
        if not name or any(mark in name for mark in "/\\,"):
            raise UnoccludeError(f"--imu {text}: give NAME=FILE, as in --imu forearm_right=imu.csv")
    if not Path(rest).exists() and "#" in rest:
        rest, _, sensor = rest.rpartition("#")
    parts = [rest] if Path(rest).exists() else [part.strip() for part in rest.split(",") if part.strip()]
    if not parts:
        raise UnoccludeError(f"--imu {text} names no file; give NAME=FILE, as in --imu forearm_right=imu.csv")
    return ImuFiles(tuple(Path(part) for part in parts), name, sensor)


def formats(json_file: Json = None, force: Force = False) -> None:
    """List the formats of `import files`, and what each is recognised by."""
    from ..io.devices.registry import formats as importers

    check_outputs(force, [json_file])
    figures = [
        {"format": each.key, "title": each.title, "kind": each.kind, "recognised_by": each.recognised_by}
        for each in importers()
    ]
    write_json(json_file, {"formats": figures}, force)
    columns = ("format", "what it is", "holds", "recognised by")
    print_table("Formats of device files", columns, [tuple(each.values()) for each in figures])
