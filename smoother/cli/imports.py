"""`unocclude import`: recordings from other formats."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..errors import UnoccludeError
from .info import print_topics
from .options import Force, Json, Output, Seed
from .output import check_mcap, check_outputs, print_notes, write_json

if TYPE_CHECKING:
    from ..io import RecordingFile
    from ..recording import Recording


def csv(
    folder: Annotated[
        Path,
        typer.Argument(metavar="FOLDER", help="Holds recording.toml and its tables.", show_default=False),
    ],
    output: Output,
    outside: Annotated[
        bool,
        typer.Option(
            "--outside",
            help="Also read files outside FOLDER that recording.toml, or a link in FOLDER, names.",
        ),
    ] = False,
    json_file: Json = None,
    force: Force = False,
) -> None:
    """Import a folder of plain files: recording.toml, skeleton and IMU tables."""
    from ..io import open_csv

    check_mcap(output)
    inputs = [path for path in folder.glob("*") if path.is_file()]
    check_outputs(force, [output, json_file], inputs)
    _finish(open_csv(folder, outside=outside), output, json_file, force)


def broad(
    mat: Annotated[Path, typer.Argument(metavar="TRIAL.mat", help="A trial of BROAD.", show_default=False)],
    output: Output,
    rate_hz: Annotated[
        float, typer.Option("--rate-hz", help="Frames a second of the stand-in camera.")
    ] = 30.0,
    noise_m: Annotated[float, typer.Option("--noise-m", help="Its noise, m an axis.")] = 0.008,
    seed: Seed = 0,
    json_file: Json = None,
    force: Force = False,
) -> None:
    """Import a BROAD trial: a real IMU with optical truth; the truth with noise stands for the camera."""
    from ..io import import_broad

    if not 1 <= rate_hz <= 1000:
        raise typer.BadParameter("--rate-hz is between 1 and 1000")
    if not 0 <= noise_m <= 1:
        raise typer.BadParameter("--noise-m is between 0 and 1")
    check_mcap(output)
    check_outputs(force, [output, json_file], [mat])
    _finish(import_broad(mat, rate_hz=rate_hz, noise_m=noise_m, seed=seed), output, json_file, force)


def utd_mhad(
    inertial: Annotated[
        Path, typer.Argument(metavar="INERTIAL.mat", help="aA_sS_tT_inertial.mat", show_default=False)
    ],
    output: Output,
    skeleton: Annotated[
        Path | None,
        typer.Argument(
            metavar="[SKELETON.mat]", help="aA_sS_tT_skeleton.mat; found beside the first if not given."
        ),
    ] = None,
    json_file: Json = None,
    force: Force = False,
) -> None:
    """Import a UTD-MHAD trial: a Kinect v1 skeleton and one wrist IMU."""
    from ..io import import_utd_mhad

    skeleton = skeleton or _skeleton_beside(inertial)
    check_mcap(output)
    check_outputs(force, [output, json_file], [inertial, skeleton])
    _finish(import_utd_mhad(inertial, skeleton), output, json_file, force)


def _skeleton_beside(inertial: Path) -> Path:
    """The skeleton file that belongs to an inertial file, in its folder or in `Skeleton/` beside it."""
    name = inertial.name.replace("inertial", "skeleton")
    places = [inertial.with_name(name), inertial.parent.parent / "Skeleton" / name]
    for place in places:
        if name != inertial.name and place.is_file():
            return place
    raise UnoccludeError(f"{inertial}: no skeleton file was found beside it; name it as the second argument")


def _finish(recording: Recording | RecordingFile, output: Path, json_file: Path | None, force: bool) -> None:
    """Write what was imported, and say what it holds."""
    from ..io import describe, write_recording

    write_recording(recording, output, force=force)
    about = describe(output)
    write_json(json_file, about.to_dict(), force)
    print_topics(about)
    print_notes(recording.notes)
