"""`unocclude import`: recordings from other formats and from files of devices, and the strap from images."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import asdict
from difflib import get_close_matches
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..errors import UnoccludeError
from .load import AS_USUAL, Solving, load_arm
from .options import (
    NO_FILES,
    Calibration,
    Force,
    Json,
    Lenses,
    Output,
    Outputs,
    RecordingPath,
    Seed,
)
from .output import check_mcap, check_outputs, print_notes, print_table, say, say_written, write_json

if TYPE_CHECKING:
    from ..io import RecordingFile
    from ..io.files import FileReport, ImuFiles
    from ..io.rig.strap import StrapFound
    from ..io.tables.describe import DescribedFile
    from ..recording import Recording


Templates = Annotated[
    list[Path] | None,
    typer.Option(
        "--template",
        metavar="FILE.toml",
        help="Template for your own table layout; tried before all formats.",
    ),
]


def csv(
    folder: Annotated[
        Path,
        typer.Argument(
            metavar="FOLDER", help="Folder with recording.toml and its tables.", show_default=False
        ),
    ],
    output: Output,
    outside: Annotated[
        bool,
        typer.Option(
            "--outside",
            help="Also read files outside FOLDER that recording.toml or a link in FOLDER refers to.",
        ),
    ] = False,
    template: Templates = None,
    json_file: Json = None,
    force: Force = False,
) -> None:
    """Import recording.toml with skeleton and IMU tables."""
    from ..io import open_csv
    from ..io.tables.recording_toml import read_templates

    check_mcap(output)
    inputs = [path for path in folder.glob("*") if path.is_file()]
    check_outputs(force, [output, json_file], [*inputs, *(template or [])])
    templates = read_templates(template or [])
    write_imported(open_csv(folder, outside=outside, templates=templates), output, json_file, force)


def broad(
    mat: Annotated[Path, typer.Argument(metavar="TRIAL.mat", help="A trial of BROAD.", show_default=False)],
    output: Output,
    rate_hz: Annotated[float, typer.Option("--rate-hz", help="Frame rate of the simulated camera.")] = 30.0,
    noise_m: Annotated[
        float, typer.Option("--noise-m", help="Noise of the simulated camera, m per axis.")
    ] = 0.008,
    seed: Seed = 0,
    json_file: Json = None,
    force: Force = False,
) -> None:
    """Import a BROAD trial: real IMU, optical truth plus noise."""
    from ..io import import_broad

    if not 1 <= rate_hz <= 1000:
        raise typer.BadParameter("--rate-hz is between 1 and 1000")
    if not 0 <= noise_m <= 1:
        raise typer.BadParameter("--noise-m is between 0 and 1")
    check_mcap(output)
    check_outputs(force, [output, json_file], [mat])
    made = import_broad(mat, rate_hz=rate_hz, noise_m=noise_m, seed=seed)
    write_imported(made, output, json_file, force)


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
    """Import a UTD-MHAD trial: Kinect v1 and one wrist IMU."""
    from ..io import import_utd_mhad

    skeleton = skeleton or _skeleton_beside(inertial)
    check_mcap(output)
    check_outputs(force, [output, json_file], [inertial, skeleton])
    write_imported(import_utd_mhad(inertial, skeleton), output, json_file, force)


def _skeleton_beside(inertial: Path) -> Path:
    """The skeleton file that belongs to an inertial file, in its folder or in `Skeleton/` beside it."""
    name = inertial.name.replace("inertial", "skeleton")
    places = [inertial.with_name(name), inertial.parent.parent / "Skeleton" / name]
    for place in places:
        if name != inertial.name and place.is_file():
            return place
    raise UnoccludeError(f"{inertial}: no skeleton file was found beside it; name it as the second argument")


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
        list[str] | None,
        typer.Option(
            "--skeleton",
            metavar="[NAME=]FILE",
            help="A file with the skeleton; of several cameras each with its NAME, the results in the first"
            " one's frame.",
        ),
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
            help="Poses of the forearm IMU in the camera frame (.csv with t_s,x,y,z,qw,qx,qy,qz); keep"
            " markers in a separate file for `validate --truth`.",
        ),
    ] = None,
    skeleton_format: Annotated[
        str | None,
        typer.Option("--skeleton-format", metavar="FORMAT", help="Format, if recognised wrongly."),
    ] = None,
    imu_format: Annotated[
        str | None, typer.Option("--imu-format", metavar="FORMAT", help="Format, if recognised wrongly.")
    ] = None,
    imu_starts_at: Annotated[
        float | None,
        typer.Option(
            "--imu-starts-at",
            metavar="S",
            help="When the first IMU sample was taken, seconds after the camera's first frame.",
        ),
    ] = None,
    intrinsics: Lenses = None,
    template: Templates = None,
    one_session: Annotated[
        bool,
        typer.Option(
            "--one-session",
            help="Refuse files whose dates are a day apart or more, as those of a FOLDER always are.",
        ),
    ] = False,
    json_file: Json = None,
    force: Force = False,
) -> None:
    """Import files as exported by devices and camera programs."""
    from calib.intrinsics import read_camera_file

    from ..io.files import add_truth, import_files, sort_files
    from ..io.registry import FileReader
    from ..io.tables.recording_toml import read_templates

    reader = FileReader(imu_format, skeleton_format, read_templates(template or []))
    named_skeletons = sorted((skeleton_file(text) for text in skeleton or []), key=lambda each: bool(each[0]))
    skeletons, imus = [path for _, path in named_skeletons], [imu_files(text) for text in imu or []]
    check_mcap(output)
    named = [*skeletons, *(p for files in imus for p in files.paths), truth, intrinsics, *(paths or [])]
    beside = [
        path for folder in paths or [] if folder.is_dir() for path in folder.glob("*") if path.is_file()
    ]
    check_outputs(force, [output, json_file], [*named, *beside])
    more_skeletons, more_imus, passed_over = sort_files(paths or [], reader, output)
    file, reports = import_files(
        skeletons + more_skeletons,
        imus + more_imus,
        imu_starts_at_s=imu_starts_at,
        reader=reader,
        one_session=one_session or bool(paths),
        cameras=[name for name, _ in named_skeletons],
        lenses=None if intrinsics is None else read_camera_file(intrinsics),
    )
    if truth is not None:
        reports.append(add_truth(file, truth))
    write_imported(file, output, json_file, force, reports, passed_over)


def write_imported(
    recording: Recording | RecordingFile,
    output: Path,
    json_file: Path | None,
    force: bool,
    reports: Sequence[FileReport] | None = None,
    passed_over: Sequence[str] = (),
) -> None:
    """Print what was recognised in files, write their recording, and print what it contains."""
    from ..io import describe, write_recording
    from .recordings import print_topics

    for report in reports or ():
        say(report.sentence)
    write_recording(recording, output, force=force)
    about = describe(output)
    files = {} if reports is None else {"files": [vars(report) for report in reports]}
    write_json(json_file, {**about.to_dict(), **files}, force)
    print_topics(about)
    print_notes([*recording.notes, *passed_over], imported=reports is None)


def skeleton_file(text: str) -> tuple[str, Path]:
    """The camera's name, "" without one, and the file that `--skeleton [NAME=]FILE` names."""
    name, mark, rest = text.strip().partition("=")
    if Path(text.strip()).exists() or not mark:
        return "", Path(text.strip())
    name, rest = name.strip(), rest.strip()
    if not name or not rest or any(mark in name for mark in "/\\, "):
        raise UnoccludeError(f"--skeleton {text}: give NAME=FILE, as in --skeleton left=left.csv")
    return name, Path(rest)


#: Where an IMU may be worn; it may also have another name.
_ROLES = (
    *(
        f"{segment}_{side}"
        for segment in ("forearm", "upper_arm", "hand", "wrist")
        for side in ("left", "right")
    ),
    *("forearm", "upper_arm", "hand", "wrist", "trunk", "base"),
)


def _check_role(name: str) -> None:
    """Refuse a misspelled place of an IMU, which would be taken for a name without meaning."""
    near = get_close_matches(name.lower(), _ROLES, n=1, cutoff=0.8)
    parts = set(re.split(r"[_\W\d]+", name.lower())) - {""}
    if near and not parts <= {part for role in _ROLES for part in role.split("_")} | {"l", "r", "lower"}:
        raise UnoccludeError(f"--imu {name}=: there is no such place; did you mean {near[0]}?")


def imu_files(text: str) -> ImuFiles:
    """What `--imu [NAME=]FILE[,FILE]` or `FILE#SENSOR[,#SENSOR]` names."""
    from ..io.files import ImuFiles

    name, sensor, rest = "", "", text.strip()
    if not Path(rest).exists() and "=" in rest:
        name, _, rest = (part.strip() for part in rest.partition("="))
        if not name or any(mark in name for mark in "/\\,"):
            raise UnoccludeError(f"--imu {text}: give NAME=FILE, as in --imu forearm_right=imu.csv")
        _check_role(name)
    marks = [at for at, mark in enumerate(rest) if mark == "#"]
    if not Path(rest).exists() and marks:
        at = next((at for at in marks if Path(rest[:at]).exists()), marks[-1])
        rest, sensor = rest[:at], rest[at + 1 :]
    parts = [rest] if Path(rest).exists() else [part.strip() for part in rest.split(",") if part.strip()]
    if not parts:
        raise UnoccludeError(f"--imu {text} names no file; give NAME=FILE, as in --imu forearm_right=imu.csv")
    return ImuFiles(tuple(Path(part) for part in parts), name, sensor)


def formats(json_file: Json = None, force: Force = False) -> None:
    """List the formats that `import files` recognises."""
    from ..io.registry import formats as importers

    check_outputs(force, [json_file])
    figures = [
        {"format": each.key, "title": each.title, "kind": each.kind, "recognised_by": each.recognised_by}
        for each in importers()
    ]
    write_json(json_file, {"formats": figures}, force)
    columns = ("format", "what it is", "holds", "recognised by")
    print_table("Formats of device files", columns, [tuple(each.values()) for each in figures])


def describe(
    paths: Annotated[
        list[Path],
        typer.Argument(
            metavar="FILE",
            help="Any table of text; or several files or a folder, to list what each of them contains.",
            show_default=False,
        ),
    ],
    name: Annotated[
        str, typer.Option("--name", metavar="NAME", help="Of the IMU in recording.toml.")
    ] = "forearm_right",
    template: Templates = None,
    json_file: Json = None,
    force: Force = False,
) -> None:
    """Guess a table's columns and units; print a recording.toml.

    Of several files, or those of a folder, list the streams that they contain: rates, units, axes. --json has
    a small plot of each, and the guess about tables of an unknown layout.
    """
    from ..io.registry import FileReader
    from ..io.tables.columns import toml_of
    from ..io.tables.describe import describe_files, guessed_table
    from ..io.tables.recording_toml import read_templates

    check_outputs(force, [json_file], [path for path in paths if not path.is_dir()])
    reader = FileReader(templates=read_templates(template or []))
    if len(paths) > 1 or paths[0].is_dir():
        found = describe_files(paths, reader, json_file)
        _print_streams(found)
        write_json(json_file, {"files": [each.to_dict() for each in found]}, force)
        return
    (path,) = paths
    importer, sheet, guess = guessed_table(path, reader)
    if importer is not None:
        option = "--skeleton" if importer.kind == "skeleton" else "--imu"
        say(f"# {path.name} is recognised as {importer.title}: unocclude import files {option} {path} ..")
    if sheet is None or guess is None:
        assert importer is not None
        write_json(json_file, {"format": importer.key, "recording_toml": None, "unsure": []}, force)
        return
    text = toml_of(path, guess, name)
    say(f"# {len(sheet):,} rows, {sheet.width} columns, parted by {sheet.separator!r}")
    for sentence in (*sheet.notes, *(f"unsure: {each}" for each in guess.unsure)):
        say(f"# {sentence}")
    say(text)
    key = None if importer is None else importer.key
    write_json(json_file, {"format": key, "recording_toml": text, **asdict(guess)}, force)


def _print_streams(found: list[DescribedFile]) -> None:
    """Print one row per stream, then what is wrong with files and what was decided of them."""
    rows: list[tuple[object, ...]] = [
        (
            Path(each.file).name,
            each.title or "-",
            ", ".join(stream.holds) + (f" ({stream.name})" if stream.name else ""),
            stream.rate_hz,
            stream.count,
            f"{stream.duration_s:.1f}",
            stream.units,
        )
        for each in found
        for stream in each.streams
    ]
    rows += [
        (Path(each.file).name, each.title or "-", "-", None, "-", "-", "-")
        for each in found
        if not each.streams
    ]
    columns = ("file", "what it is", "holds", "rate, Hz", "samples", "length, s", "units")
    print_table(f"{len(found)} files", columns, rows)
    print_notes(f"{Path(each.file).name}: {note}" for each in found for note in each.notes)
    print_notes(each.error for each in found if each.error)


#: A length by ruler, m.
RULER_SIGMA_M = 0.004


def strap(
    recording_file: RecordingPath,
    output: Output,
    calibration_file: Calibration = None,
    radius_m: Annotated[
        float | None,
        typer.Option("--radius-m", min=0.01, max=0.1, help="Axis of the forearm to the sensor."),
    ] = None,
    colour: Annotated[
        str | None,
        typer.Option("--colour-topic", metavar="TOPIC", help="Colour images to take."),
    ] = None,
    depth: Annotated[
        str | None,
        typer.Option("--depth-topic", metavar="TOPIC", help="Depth images to take."),
    ] = None,
    solving: Solving = AS_USUAL,
    to: Outputs = NO_FILES,
) -> None:
    """Find the strap in colour images and add it as a joint.

    The recording is first solved without images; the sensor's orientation then relates the strap in the
    image to the sensor. Detections that contradict the forearm are rejected. Memory does not grow.
    """
    from calib.file import read_calibration
    from calib.strap import held_radius, mounted_on

    from ..calibration import Length
    from ..io.rig.strap import check_images
    from ..report.strap import verdict
    from ..smoothing import smooth
    from ..strap_search.search import import_strap

    check_mcap(output)
    check_outputs(
        to.force, [output, to.json_file, to.report], [recording_file, calibration_file, solving.config_file]
    )
    config = solving.config()
    recording, known = load_arm(recording_file, calibration_file, solving.arm)
    check_images(recording_file, colour, depth)
    recovery = smooth(recording, known, config)
    radius = None if radius_m is None else Length(radius_m, RULER_SIGMA_M)
    if radius is None and calibration_file is not None:
        radius = held_radius(read_calibration(calibration_file), recording.side)
    mounted = mounted_on(recovery, radius)
    sigma = max((recovery.estimates.camera_sigma_m or {}).values(), default=0.008)
    found = import_strap(
        recording_file,
        output,
        mounted,
        skeleton=recording.arm.name,
        side=recording.side,
        joint_sigma_m=sigma,
        colour_topic=colour,
        depth_topic=depth,
        force=to.force,
    )
    sentences = verdict(found)
    write_json(
        to.json_file,
        {**_figures(found), "verdict": sentences, "notes": [*recording.notes, *found.notes]},
        to.force,
    )
    if to.report is not None:
        from ..report.strap import strap_page

        strap_page(recording.name, found).write(to.report, to.force)
    total = len(found.reasons)
    rows = [
        (what, count, f"{100 * count / max(total, 1):.0f}") for what, count in sorted(found.counts.items())
    ]
    print_table(f"The strap in {total} images", ("", "images", "%"), rows)
    for sentence in sentences:
        say(sentence)
    print_notes([*recording.notes, *found.notes])
    say_written(output, to.json_file, to.report)


def _figures(found: StrapFound) -> dict[str, Any]:
    """What was found, as plain values for `--json`."""
    import numpy as np

    good = [not reason for reason in found.reasons]
    sigma = found.sigma_m[good]
    return {
        "images": len(found.reasons),
        "found": int(sum(good)),
        "reasons": found.counts,
        "sigma_m": np.median(sigma, axis=0) if len(sigma) else None,
        "along": float(np.median(found.along[good])) if any(good) else None,
        "colour_topic": found.topics[0],
        "depth_topic": found.topics[1],
    }
