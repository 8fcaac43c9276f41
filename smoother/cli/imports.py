"""`unocclude import`: recordings from other formats and from files of devices, and the strap from images."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import asdict
from difflib import get_close_matches
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from ..errors import RecordingError, UnoccludeError
from ..table import tabulated
from . import options as o
from .load import ConfigInput, Which, load_arm
from .output import Out, print_notes, progress_bar, say, show

if TYPE_CHECKING:
    from ..io.files import FileReport, ImuFiles
    from ..io.recording.streams import RecordingFile
    from ..io.tables.describe import DescribedFile
    from ..recording import Recording


#: One session's files; which IMU; where its samples begin: shared by `files` and `video`.
OneSession = Annotated[bool, o.rare("Refuse files whose dates are a day apart.", "--one-session")]
_imu = (
    "An IMU's file, or its accelerometer's and gyroscope's; NAME as in recording.toml (forearm_right,"
    " upper_arm_left, ..), FILE#SENSOR for one of several."
)
ImuFile = Annotated[o.Texts, o.value("[NAME=]FILE[,FILE]", _imu, "--imu")]
ImuStarts = Annotated[o.Number, o.value("S", "First IMU sample, seconds after the camera's first frame.")]
_FormatName = Annotated[o.Text, o.rare_value("FORMAT", "Format, if recognised wrongly.")]


def csv(
    folder: Annotated[Path, o.argument("FOLDER", "Folder with recording.toml and its tables.")],
    output: o.Output,
    out: Out,
    outside: Annotated[bool, o.rare("Also read files outside FOLDER.", "--outside")] = False,
) -> None:
    """Import recording.toml with skeleton and IMU tables.

    Example: unocclude import csv session -o session.mcap

    session/recording.toml:
      [camera]
      frame = "kinect"            # or "optical", "zup"
      skeleton = "skeleton.csv"   # t_s, joint, x, y, z, state [, body]
      [imu.forearm_right]
      file = "imu.csv"            # t_s, ax, ay, az, gx, gy, gz [, mx, my, mz]
      accelerometer_unit = "g"    # or "m/s^2"
      gyroscope_unit = "deg/s"    # or "rad/s"
      [truth]                     # optional
      file = "truth.csv"          # t_s, x, y, z, qw, qx, qy, qz
    """
    from ..io import open_csv

    out.check([output], _inside([folder]))
    write_imported(open_csv(folder, outside=outside), output, out)


def _inside(paths: Iterable[Path]) -> list[Path]:
    """The files of those that are folders."""
    return [file for path in paths if path.is_dir() for file in path.glob("*") if file.is_file()]


def broad(
    mat: Annotated[Path, o.argument("TRIAL.mat", "A trial of BROAD.")],
    output: o.Output,
    out: Out,
    rate_hz: Annotated[float, o.option("Frame rate of the simulated camera.", min=1, max=1000)] = 30.0,
    noise_m: Annotated[float, o.option("Noise of that camera, m per axis.", min=0, max=1)] = 0.008,
    seed: o.Seed = 0,
) -> None:
    """Import a BROAD trial: real IMU, optical truth plus noise.

    Example: unocclude import broad 01_trial.mat -o trial.mcap
    """
    from ..io import import_broad

    write_imported(import_broad(mat, rate_hz=rate_hz, noise_m=noise_m, seed=seed), output, out)


def utd_mhad(
    inertial: Annotated[Path, o.argument("INERTIAL.mat", "aA_sS_tT_inertial.mat")],
    output: o.Output,
    out: Out,
    skeleton: Annotated[o.File, o.argument("[SKELETON.mat]", "Else found beside the first.")] = None,
) -> None:
    """Import a UTD-MHAD trial: Kinect v1 and one wrist IMU.

    Example: unocclude import utd-mhad a1_s1_t1_inertial.mat a1_s1_t1_skeleton.mat -o t.mcap
    """
    from ..io import import_utd_mhad

    if skeleton is None:
        name = inertial.name.replace("inertial", "skeleton")
        places = inertial.with_name(name), inertial.parent.parent / "Skeleton" / name
        skeleton = next((path for path in places if name != inertial.name and path.is_file()), None)
    if skeleton is None:
        raise UnoccludeError(
            f"{inertial}: no skeleton file was found beside it; name it as the second argument"
        )
    out.check([], [skeleton])
    write_imported(import_utd_mhad(inertial, skeleton), output, out)


_skeletons = "A skeleton's file; of several cameras each with its NAME, results in the first one's frame."
_lenses = (
    "Lenses, and places, of cameras with keypoints in images: OpenCV or ROS (YAML, JSON), Kalibr's camchain,"
    " Pose2Sim's Calib.toml; its names are the NAMEs of --skeleton."
)


def files(
    output: o.Output,
    out: Out,
    paths: Annotated[o.Files, o.argument("FOLDER", "Files of devices, or their folder.")] = None,
    skeleton: Annotated[o.Texts, o.value("[NAME=]FILE", _skeletons)] = None,
    imu: ImuFile = None,
    truth: Annotated[o.File, o.value("FILE", "Poses of the forearm IMU in the camera frame (.csv).")] = None,
    imu_starts_at: ImuStarts = None,
    intrinsics: Annotated[o.File, o.value("FILE", _lenses)] = None,
    template: o.Templates = None,
    skeleton_format: _FormatName = None,
    imu_format: _FormatName = None,
    one_session: OneSession = False,
) -> None:
    """Import files as exported by devices and camera programs.

    Example: unocclude import files --skeleton azure.csv --imu forearm_right=dot.csv -o session.mcap
    """
    from calib.intrinsics import read_camera_file

    from ..io.files import add_truth, import_files, sort_files
    from ..io.registry import FileReader
    from ..io.tables.recording_toml import read_templates

    reader = FileReader(imu_format, skeleton_format, read_templates(template or []))
    cameras = sorted((skeleton_file(text) for text in skeleton or []), key=lambda each: bool(each[0]))
    skeletons, imus = [path for _, path in cameras], list(map(imu_files, imu or []))
    out.check([output], [*skeletons, *_paths(imus), *_inside(paths or [])])
    more_skeletons, more_imus, passed_over = sort_files(paths or [], reader, output)
    file, reports = import_files(
        skeletons + more_skeletons,
        imus + more_imus,
        imu_starts_at_s=imu_starts_at,
        reader=reader,
        one_session=one_session or bool(paths),
        cameras=[name for name, _ in cameras],
        lenses=None if intrinsics is None else read_camera_file(intrinsics),
    )
    if truth is not None:
        reports.append(add_truth(file, truth))
    write_imported(file, output, out, reports, passed_over)


def video(
    file: Annotated[Path, o.argument("FILE", "MP4, MOV, AVI or MKV of a fixed camera.")],
    output: o.Output,
    out: Out,
    model: Annotated[o.File, o.value("FILE.task", "The model of MediaPipe's pose landmarker.")] = None,
    imu: ImuFile = None,
    imu_starts_at: ImuStarts = None,
    mirrored: Annotated[bool, o.option("The pictures are mirror images.", "--mirrored")] = False,
    turn: Annotated[int, o.value("90|180|270", "Rotate the pictures clockwise, degrees.")] = 0,
    # more people make MediaPipe slower, and no room holds them
    people: Annotated[int, o.option("Find at most this many people.", min=1, max=10)] = 2,
    template: o.Templates = None,
    one_session: OneSession = False,
) -> None:
    """Import a video as the camera; MediaPipe finds the joints.

    Joints are stored in metres relative to the hips.

    Example: unocclude import video phone.mp4 --model pose_landmarker_full.task --imu dot.csv -o session.mcap
    """
    from ..io.files import import_files
    from ..io.registry import FileReader
    from ..io.tables.recording_toml import read_templates
    from ..io.tables.table import read_head
    from ..io.tables.video import TURNS, pose_video

    o.refuse({"--turn is 90, 180 or 270": turn not in TURNS})
    imus = list(map(imu_files, imu or []))
    out.check([output], _paths(imus))
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
    write_imported(recording, output, out, reports)


def _paths(imus: Iterable[ImuFiles]) -> list[Path]:
    return [path for each in imus for path in each.paths]


def write_imported(
    recording: Recording | RecordingFile,
    output: Path,
    out: Out,
    reports: Sequence[FileReport] | None = None,
    passed_over: Sequence[str] = (),
) -> None:
    """Print what was recognised in files, write their recording, and print what it contains."""
    from ..io import describe, write_recording
    from .recordings import topic_table

    for report in reports or ():
        say(report.sentence)
    write_recording(recording, output, force=out.force)
    about = describe(output)
    out.json(about | ({} if reports is None else {"files": [vars(report) for report in reports]}))
    show(topic_table(about))
    print_notes([*recording.notes, *passed_over], imported=reports is None)


def named_file(option: str, text: str, example: str, marks: str = "/\\,") -> tuple[str, str]:
    """The name, "" without one, and the rest of `[NAME=]FILE`."""
    text = text.strip()
    if Path(text).exists() or "=" not in text:
        return "", text
    name, _, rest = (part.strip() for part in text.partition("="))
    if not name or not rest or any(mark in name for mark in marks):
        raise UnoccludeError(f"{option} {text}: give NAME=FILE, as in {option} {example}")
    return name, rest


def skeleton_file(text: str) -> tuple[str, Path]:
    """The camera's name, "" without one, and the file that `--skeleton [NAME=]FILE` names."""
    name, rest = named_file("--skeleton", text, "left=left.csv", marks="/\\, ")
    return name, Path(rest)


#: Where an IMU may be worn, and words that such a name may be made of; it may also have another name.
_LIMBS = ("forearm", "upper_arm", "hand", "wrist")
_ROLES = (*_LIMBS, *(f"{limb}_{side}" for limb in _LIMBS for side in ("left", "right")), "trunk", "base")
_WORDS = {part for role in _ROLES for part in role.split("_")} | {"l", "r", "lower", ""}


def imu_files(text: str) -> ImuFiles:
    """What `--imu [NAME=]FILE[,FILE]` or `FILE#SENSOR[,#SENSOR]` names."""
    from ..io.files import ImuFiles

    name, rest = named_file("--imu", text, "forearm_right=imu.csv")
    # a misspelled place would be taken for a name without meaning
    near = get_close_matches(name.lower(), _ROLES, n=1, cutoff=0.8)
    if near and not set(re.split(r"[_\W\d]+", name.lower())) <= _WORDS:
        raise UnoccludeError(f"--imu {name}=: there is no such place; did you mean {near[0]}?")
    # the sensor begins at the first # behind which a file's name is whole, else at the last
    marks = [] if Path(rest).exists() else [at for at, mark in enumerate(rest) if mark == "#"]
    at = next((at for at in marks if Path(rest[:at]).exists()), marks[-1] if marks else len(rest))
    rest, sensor = rest[:at], rest[at + 1 :]
    parts = [rest] if Path(rest).exists() else [part.strip() for part in rest.split(",") if part.strip()]
    if not parts:
        raise UnoccludeError(f"--imu {text} names no file; give NAME=FILE, as in --imu forearm_right=imu.csv")
    return ImuFiles(tuple(Path(part) for part in parts), name, sensor)


def formats(out: Out) -> None:
    """List the formats that `import files` recognises.

    Example: unocclude import formats
    """
    from ..io.registry import formats as importers

    keys = {"format": "key", "title": "title", "kind": "kind", "recognised_by": "recognised_by"}
    figures = [{name: getattr(each, key) for name, key in keys.items()} for each in importers()]
    out.json({"formats": figures})
    show(tabulated("Formats of device files", figures, "format title=what_it_is kind=holds recognised_by"))


def describe(
    paths: Annotated[list[Path], o.argument("FILE", "A table of text; several, or a folder, are listed.")],
    out: Out,
    name: Annotated[str, o.value("NAME", "Of the IMU in recording.toml.")] = "forearm_right",
    template: o.Templates = None,
) -> None:
    """Guess a table's columns and units; print a recording.toml.

    Of several files, or those of a folder, list the streams that they contain: rates, units, axes. --json has
    a small plot of each, and the guess about tables of an unknown layout.

    Example: unocclude import describe sensor.csv > session/recording.toml
    """
    from ..io.registry import FileReader
    from ..io.tables.describe import describe_files, guessed_table
    from ..io.tables.guess import toml_of
    from ..io.tables.recording_toml import read_templates

    reader = FileReader(templates=read_templates(template or []))
    if len(paths) > 1 or paths[0].is_dir():
        found = describe_files(paths, reader, out.json_file)
        out.json({"files": [asdict(each) for each in found]})
        _print_streams(found)
        return
    (path,) = paths
    importer, sheet, guess = guessed_table(path, reader)
    text = None if guess is None else toml_of(path, guess, name)
    guessed = {"unsure": []} if guess is None else asdict(guess)
    out.json({"format": importer and importer.key, "recording_toml": text, **guessed})
    if importer is not None:
        option = "--skeleton" if importer.kind == "skeleton" else "--imu"
        say(f"# {path.name} is recognised as {importer.title}: unocclude import files {option} {path} ..")
    if sheet is not None and guess is not None and text is not None:
        say(f"# {len(sheet):,} rows, {sheet.width} columns, parted by {sheet.separator!r}")
        for sentence in (*sheet.notes, *(f"unsure: {each}" for each in guess.unsure)):
            say(f"# {sentence}")
        say(text)


def _print_streams(found: list[DescribedFile]) -> None:
    """Print one row per stream, then what is wrong with files and what was decided of them."""
    rows: list[dict[str, object]] = []
    for each in found:
        about: dict[str, object] = {"file": Path(each.file).name, "format": each.title or None}
        for stream in each.streams or ({},):
            name = f" ({stream['name']})" if stream.get("name") else ""
            rows.append(about | stream | {"holds": ", ".join(stream.get("holds", ())) + name})
    keys = "file format holds rate_hz count=samples duration_s=length_s units"
    show(tabulated(f"{len(found)} files", rows, keys))
    print_notes(f"{Path(each.file).name}: {note}" for each in found for note in each.notes)
    print_notes(each.error for each in found if each.error)


#: A length by ruler, m.
RULER_SIGMA_M = 0.004


def strap(
    recording_file: o.RecordingPath,
    output: o.Output,
    which: Which,
    settings: ConfigInput,
    out: Out,
    calibration: o.Calibration = None,
    radius_m: Annotated[o.Number, o.option("Axis of the forearm to the sensor.", min=0.01, max=0.1)] = None,
    colour_topic: Annotated[o.Text, o.rare_value("TOPIC", "Colour images to take.")] = None,
    depth_topic: Annotated[o.Text, o.rare_value("TOPIC", "Depth images to take.")] = None,
) -> None:
    """Find the strap in colour images and add it as a joint.

    The recording is first solved without images; the sensor's orientation then relates the strap in the
    image to the sensor. Detections that contradict the forearm are rejected. Memory does not grow.

    Example: unocclude import strap session.mcap -o with_strap.mcap
    """
    import numpy as np

    from calib.file import read_calibration
    from calib.strap import held_radius, mounted_on

    from ..calibration import Length
    from ..io.rig.strap import check_images
    from ..smoothing import smooth
    from ..strap_search.search import import_strap, strap_verdict

    config = settings.read()
    recording, known = load_arm(recording_file, calibration, **which.chosen)
    check_images(recording_file, colour_topic, depth_topic)
    recovery = smooth(recording, known, config)
    radius = None if radius_m is None else Length(radius_m, RULER_SIGMA_M)
    if radius is None and calibration is not None:
        radius = held_radius(read_calibration(calibration), recording.side)
    found = import_strap(
        recording_file,
        output,
        mounted_on(recovery, radius),
        skeleton=recording.arm.name,
        side=recording.side,
        joint_sigma_m=max((recovery.estimates.camera_sigma_m or {}).values(), default=0.008),
        colour_topic=colour_topic,
        depth_topic=depth_topic,
        force=out.force,
    )
    sentences, notes = strap_verdict(found), [*recording.notes, *found.notes]
    good, total = [not reason for reason in found.reasons], len(found.reasons)
    rows = [{"what": what, "images": n, "share": n / total} for what, n in sorted(found.counts.items())]
    figures = {
        "images": total,
        "found": sum(good),
        "reasons": found.counts,
        "sigma_m": np.median(found.sigma_m[good], axis=0) if any(good) else None,
        "along": float(np.median(found.along[good])) if any(good) else None,
        "colour_topic": found.topics[0],
        "depth_topic": found.topics[1],
    }
    out.json({**figures, "verdict": sentences, "notes": notes})
    show(tabulated(f"The strap in {total} images", rows, "what images share"))
    for sentence in sentences:
        say(sentence)
    print_notes(notes)
    out.end(output)
