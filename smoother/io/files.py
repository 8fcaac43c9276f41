"""A recording of files as devices write them: sorted, read, times corrected, clocks brought together."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from calib.intrinsics import CameraFile

from ..array_types import FloatArray
from ..errors import RecordingError
from ..linalg import median_rate_hz
from ..recording import JOINTS, JointState
from .mcap.messages import nanoseconds
from .recording.clean import clean_arm, clean_imu
from .recording.decode import JointRows, joint_code
from .recording.keypoints import CAMERA_TOPIC, NAMED_TOPIC, TOPIC
from .recording.read import open_recording
from .recording.streams import (
    CameraStream,
    ImuSamples,
    KnownLens,
    RecordingFile,
    SkeletonTable,
    free_name,
    named_segment,
    named_side,
)
from .registry import FileReader, keys, unknown_file
from .tables.imu import paired
from .tables.markers import MARKER_FORMATS, read_markers
from .tables.skeletons import PIXELS
from .tables.table import Format, first_rows, read_head
from .tables.times import (
    Timed,
    check_one_session,
    count_from_zero,
    of_one_length,
    repaired_imu,
    repaired_skeleton,
    shifts,
)


@dataclass(frozen=True)
class ImuFiles:
    """Files of one IMU (or of several, where one file contains them)."""

    paths: tuple[Path, ...]  # One file, or one of the accelerometer and one of the gyroscope
    name: str = ""  # As in recording.toml (`forearm_right`); "" leaves it to the motion
    sensor: str = ""  # Of a file that contains several sensors, the one to take; "" = all
    formats: tuple[Format, ...] = ()  # How each file is read, where that is stated


@dataclass
class FileReport:
    """What was recognised in a file."""

    path: str  # The file
    format: str  # The importer's key
    sentence: str  # The line that is said of it
    topics: list[str] = field(default_factory=list)  # What it was written to
    rate_hz: float = float("nan")  # Median rate
    count: int = 0  # Samples or frames
    units: str = ""  # As the file has them
    notes: list[str] = field(default_factory=list)  # What was decided or corrected, a sentence each


def import_files(
    skeletons: list[Path],
    imus: list[ImuFiles],
    *,
    imu_format: str | None = None,
    skeleton_format: str | None = None,
    imu_starts_at_s: float | None = None,
    reader: FileReader | None = None,
    one_session: bool = False,
    cameras: Sequence[str] = (),
    lenses: Mapping[str, CameraFile] | None = None,
    formats: Sequence[Format] = (),  # How each skeleton's file is read, where that is stated
    one_clock: bool = False,  # All streams are on one
    one_recorder: bool = False,  # Has written what is equally long
) -> tuple[RecordingFile, list[FileReport]]:
    """Make a recording of device files."""
    if not skeletons and not imus:
        raise RecordingError("There is nothing to import: name files with --skeleton and --imu.")
    reader = reader or FileReader(imu_format, skeleton_format)
    reports: list[FileReport] = []
    stated = [*formats, *[None] * len(skeletons)]
    bodies = [_skeleton(reader, *each, reports) for each in zip(skeletons, stated, strict=False)]
    sensors = _named([row for files in imus for row in _sensors(reader, files, reports)])
    names = [*cameras, *[""] * len(bodies)]
    streams = [
        Timed(report.path, _all_times(tables), False, report.path, bool(number and names[number]))
        for number, (tables, report) in enumerate(bodies)
    ]
    streams += [Timed(topic, times_of(table), True, report.path) for topic, table, report in sensors]
    if one_session:
        check_one_session(streams)
    shift, sentences = ([0.0] * len(streams), []) if one_clock else shifts(streams, imu_starts_at_s)
    streams = [stream for stream in streams if not stream.is_further]
    is_known = one_clock or imu_starts_at_s is not None or (one_recorder and of_one_length(streams))
    if not is_known and not sentences and count_from_zero(streams):
        hint = "" if one_recorder else " (or --imu-starts-at S, if known)"
        sentences = [
            "Camera and IMU both count from about zero, so only the motion shows their offset and whether"
            f" they belong together{hint}."
        ]

    first = skeletons[0] if skeletons else imus[0].paths[0]
    file = RecordingFile(first, notes=sentences)
    file.clocks_unrelated = imu_starts_at_s is None and bool(sentences)
    for number, (tables, report) in enumerate(bodies):
        name, is_flat = names[number], tables[0].units == PIXELS
        known = _known_lens(report.path, number, cameras, lenses or {}) if is_flat else None
        report.topics.append(add_skeleton(file, tables, report.path, shift[number], number, name, known))
    for (topic, table, report), moved_s in zip(sensors, shift[len(bodies) :], strict=True):
        add_imu(file, topic, table, report.path, moved_s)
        report.topics.append(topic)
    file.notes = [note for report in reports for note in report.notes] + file.notes
    return file, reports


def _known_lens(
    source: str, number: int, cameras: Sequence[str], lenses: Mapping[str, CameraFile]
) -> KnownLens:
    """The lens of the camera whose file has that number, and its place in the first camera's frame."""
    name = cameras[number] if number < len(cameras) else ""
    camera = lenses.get(name) or (next(iter(lenses.values())) if len(lenses) == 1 else None)
    if camera is None:
        named = f", {name}" if name else ""
        held = f" (it contains {', '.join(map(repr, lenses))})" if lenses else ""
        raise RecordingError(
            f"{source} contains keypoints in the image, which need the camera's lens{named}: give"
            f" --intrinsics FILE{held}, or triangulate them (Pose2Sim) and give the file that makes."
        )
    first = lenses.get(cameras[0] if cameras else "")
    pose = camera.seen_from(first) if number and first is not None else None
    return KnownLens(camera.lens, pose)


def _skeleton(
    reader: FileReader, path: Path, stated: Format | None, reports: list[FileReport]
) -> tuple[list[SkeletonTable], FileReport]:
    """The bodies of a file with corrected times, and the report of it."""
    importer = stated or reader.format_of(path, "skeleton")
    tables = [t for t in reader.read(path, importer) if isinstance(t, SkeletonTable)]
    if not tables:
        raise RecordingError(f"{path} ({importer.title}) has no skeleton; name it with --imu alone.")
    tables = [repaired_skeleton(table, str(path)) for table in tables]
    frames, numbers = _all_times(tables), f"{len(tables)} bodies" if len(tables) > 1 else "1 body"
    report = _report(path, importer, tables, frames, f"{len(frames):,} frames, {numbers}")
    if any(table.relative for table in tables):
        report.notes.append(
            f"{path.name}: positions are relative to the body, so its place in the room is not known: the"
            " result is relative too, and where the trunk moves camera and IMU contradict each other."
        )
    elif tables[0].frame is None and tables[0].gravity_hint is None:
        report.notes.append(f"{path.name} does not state its axes; down is estimated from the motion.")
    reports.append(report)
    return tables, report


def _sensors(
    reader: FileReader, files: ImuFiles, reports: list[FileReport]
) -> list[tuple[str, ImuSamples, FileReport]]:
    """The sensors of files that belong together, with corrected times, and the name that each is to have."""
    parts: list[ImuSamples] = []
    stated = [*files.formats, *[None] * len(files.paths)]
    for path, of in zip(files.paths, stated, strict=False):
        importer = of or reader.format_of(path, "imu")
        tables = [t for t in reader.read(path, importer) if isinstance(t, ImuSamples)]
        if files.sensor:
            named = [_of_name(path, name.strip("# /"), tables) for name in files.sensor.split(",")]
            tables = [table for at, table in enumerate(named) if table not in named[:at]]
        if not tables:
            raise RecordingError(f"{path} ({importer.title}) has no IMU; name it with --skeleton alone.")
        tables = [repaired_imu(table, str(path)) for table in tables]
        names = f"{len(tables)} sensors ({', '.join(t.topic for t in tables)}), " if len(tables) > 1 else ""
        times = times_of(tables[0])
        reports.append(_report(path, importer, tables, times, f"{len(times):,} samples", names))
        parts += tables
    report, source = reports[-1], ", ".join(str(path) for path in files.paths)
    whole = [table for table in parts if table.acc is not None and table.gyro is not None]
    if len(files.paths) > 1 or not whole:
        joined = paired(parts, source)
        told = {note for part in parts for note in part.notes}
        report.notes += [f"{path.name}: {note}" for note in joined.notes if note not in told]
        return [(files.name, joined, report)]
    if files.name and len(whole) > 1:
        listed = ", ".join(table.topic for table in whole)
        raise RecordingError(
            f"{source} contains {len(whole)} sensors ({listed}); choose one for {files.name}:"
            f" --imu {files.name}={files.paths[0]}#{whole[0].topic}."
        )
    return [(files.name or (t.topic if len(whole) > 1 else ""), t, report) for t in whole]


def _report(
    path: Path,
    importer: Format,
    tables: Sequence[ImuSamples | SkeletonTable],
    times: FloatArray,
    count: str,
    names: str = "",
) -> FileReport:
    """What was recognised in a file, and the line that is said of it."""
    rate_hz, units = median_rate_hz(times), tables[0].units
    ending = f", {units}" if units else ""
    sentence = f"{path.name}: {importer.title}, {names}{rate_hz:.1f} Hz, {count}{ending}"
    notes = [f"{path.name}: {note}" for note in dict.fromkeys(n for t in tables for n in t.notes)]
    return FileReport(str(path), importer.key, sentence, [], rate_hz, len(times), units, notes)


def _of_name(path: Path, name: str, tables: list[ImuSamples]) -> ImuSamples:
    """The sensor of a name, or the IMU that was put together of it."""
    for table in tables:
        if name.lower() in (each.lower().strip("/ ") for each in (table.topic, *table.made_of)):
            return table
    listed = ", ".join(table.topic or "one without a name" for table in tables)
    raise RecordingError(f"{path} has no sensor {name}; it has {listed}.")


def _named(
    sensors: list[tuple[str, ImuSamples, FileReport]],
) -> list[tuple[str, ImuSamples, FileReport]]:
    """The sensors by topic; no topic twice."""
    named, topics = [], set[str]()
    for given, table, report in sensors:
        clean = re.sub(r"[^0-9A-Za-z_]+", "_", given).strip("_")
        if not clean:
            stem = re.sub(r"[^0-9A-Za-z_]+", "_", Path(report.path).stem).strip("_")
            # A file's name is not a statement about a limb: it must not decide which arm is meant.
            clean = "sensor" if not stem or named_segment(stem) or named_side(stem) else stem
        named.append((free_name(f"/imu/{clean}", topics), table, report))
    return named


def _all_times(tables: list[SkeletonTable]) -> FloatArray:
    return np.unique(np.concatenate([times_of(table) for table in tables]))


#: Slower or faster than any IMU that is worn, samples per second.
_RATES_HZ = (2.0, 10_000.0)


def add_skeleton(
    file: RecordingFile,
    tables: list[SkeletonTable],
    source: str,
    shift_s: float,
    number: int = 0,  # Of the camera; a further one with a name is in axes of its own
    name: str = "",
    known: KnownLens | None = None,
) -> str:
    """Put the arms of a file's bodies into a recording; all of them share its frames. Their topic."""
    first, is_further = tables[0], bool(number and name)
    is_flat, camera = first.units == PIXELS, name if is_further else "camera"
    if is_flat and known is None:
        raise RecordingError(f"{source} contains keypoints in the image; use `unocclude import files`.")
    if is_further:
        topic = NAMED_TOPIC.format(name) if is_flat else f"{CAMERA_TOPIC}{name}"
        file.cameras[topic] = CameraStream(name, first.frame, first.gravity_hint)
    else:
        topic = TOPIC if is_flat else "/skeleton" if number == 0 else f"/skeleton_{number + 1}"
    if known is not None:
        file.lenses[topic] = known
    stamps = [nanoseconds(times_of(table) + shift_s, 0) for table in tables]
    frames = np.unique(np.concatenate(stamps))
    rows = JointRows()
    for table, stamp in zip(tables, stamps, strict=True):
        frame = np.searchsorted(frames, stamp)
        for name, values in table.position.items():
            if (code := joint_code(name)) is not None:
                lost = ~np.isfinite(values).all(axis=1)
                state = np.where(lost, JointState.NOT_TRACKED, table.state[name]).astype(np.int64)
                rows.add(frame, table.body, code, state, np.array(values, dtype=float))
    arms = rows.arms(frames, topic, camera, first.frame)
    for arm in arms:
        arm.lens = None if known is None else known.lens
        if arm.tracked:
            clean_arm(arm, source)
    if not any(arm.tracked for arm in arms):
        raise RecordingError(
            f"{source}: no elbow, wrist, hand or strap is tracked in any frame ({', '.join(JOINTS)} are"
            " read); record again with the arm in view."
        )
    file.arms += arms
    if file.camera_frame is None and file.gravity_hint is None and not is_further:
        file.camera_frame, file.gravity_hint = first.frame, first.gravity_hint
    return topic


def add_imu(file: RecordingFile, topic: str, table: ImuSamples, source: str, shift_s: float) -> None:
    """Put an IMU with corrected times into a recording, if its units can be; as `add_skeleton`."""
    stamp = nanoseconds(times_of(table) + shift_s, 0)
    samples = ImuSamples(topic, topic.rpartition("/")[2], stamp, *table.vectors, table.mag)
    clean_imu(samples, source)
    file.imus.append(samples)
    step_s = float(np.median(np.diff(samples.stamp_ns))) / 1e9 if len(samples.stamp_ns) > 1 else 0.0
    if step_s > 0 and not _RATES_HZ[0] <= 1 / step_s <= _RATES_HZ[1]:
        file.notes.append(
            f"{topic}: its times give {1 / step_s:.3g} samples per second, which no IMU has; if they are in"
            " another unit, give time_unit in a recording.toml."
        )


def times_of(table: ImuSamples | SkeletonTable) -> FloatArray:
    """Times of a table that was corrected."""
    assert table.t_s is not None
    return table.t_s


# ---------------------------------------------------------------------- folders, and a truth beside the files


def sort_files(
    paths: list[Path], reader: FileReader, output: Path | None = None
) -> tuple[list[Path], list[ImuFiles], list[str]]:
    """Device files among paths, by what is in them."""
    skeletons: list[Path] = []
    imus: list[ImuFiles] = []
    halves: dict[str, list[Path]] = {"acc": [], "gyro": []}
    passed_over: list[str] = []
    refused: list[RecordingError] = []
    files = files_meant(paths, output)
    for path in files:
        importer = reader.recognised(path)
        if importer is None:
            head = read_head(path)
            passed_over.append(
                f"{path.name} has an unknown format and was skipped; it begins: {first_rows(head, 100)}."
            )
            continue
        try:
            tables = reader.read(path, importer)
        except RecordingError as error:
            if path in paths:
                raise
            refused.append(error)
            continue
        if any(isinstance(table, SkeletonTable) for table in tables):
            skeletons.append(path)
        sensors = [table for table in tables if isinstance(table, ImuSamples)]
        if any(table.acc is not None and table.gyro is not None for table in sensors):
            imus.append(ImuFiles((path,)))
        elif sensors:
            halves["acc" if sensors[0].acc is not None else "gyro"].append(path)
    imus += _joined(halves)
    if refused and not (skeletons and imus):
        raise refused[0]
    passed_over += [f"passed over: {error}" for error in refused]
    if paths and not skeletons and not imus:
        if len(files) == 1:
            raise unknown_file(read_head(files[0]))
        seen = " ".join(passed_over[:2]) or "It is empty."
        raise RecordingError(f"{paths[0]} has no file of a known format ({keys()}). {seen}")
    return skeletons, imus, passed_over


def _joined(halves: dict[str, list[Path]]) -> list[ImuFiles]:
    if not halves["acc"] and not halves["gyro"]:
        return []
    if len(halves["acc"]) == len(halves["gyro"]) == 1:
        return [ImuFiles((halves["acc"][0], halves["gyro"][0]))]
    listed = ", ".join(path.name for path in (*halves["acc"], *halves["gyro"]))
    raise RecordingError(
        f"{listed} contain accelerometers or gyroscopes only; name those that belong together:"
        " --imu NAME=ACC_FILE,GYRO_FILE."
    )


def files_meant(paths: list[Path], output: Path | None) -> list[Path]:
    """The files that are meant; hidden ones, results and empty ones in folders are not."""
    listed: list[Path] = []
    for path in paths:
        if not path.is_dir():
            listed.append(path)
            continue
        for inner in sorted(path.iterdir()):
            is_output = output is not None and inner.resolve() == output.resolve()
            if inner.is_file() and not inner.name.startswith(".") and not is_output and inner.stat().st_size:
                listed.append(inner)
    return list(dict.fromkeys(listed))


def add_truth(file: RecordingFile, path: Path) -> FileReport:
    """Put poses of the forearm IMU into a recording; markers stay a file of their own."""
    from .tables.columns import read_pose_table

    kind = path.suffix.lower()
    if kind in MARKER_FORMATS:
        markers = read_markers(path)
        sentence = (
            f"{path.name}: {len(markers.names)} markers, {markers.rate_hz:.1f} Hz, {len(markers):,} frames;"
            f" they stay there: unocclude validate RESULT.mcap --truth {path} --markers MAP.toml"
        )
        return FileReport(str(path), kind[1:], sentence, count=len(markers), rate_hz=markers.rate_hz)
    if kind == ".mcap":
        poses = open_recording(path).poses
        if len(poses) != 1:
            raise RecordingError(f"{path} contains {len(poses)} topics of poses; one is needed for --truth.")
        truth = poses[0]
    else:
        truth = read_pose_table(path)
    first, last = int(truth.stamp_ns.min()), int(truth.stamp_ns.max())
    if file.imus and not any(i.stamp_ns[0] < last and first < i.stamp_ns[-1] for i in file.imus):
        raise RecordingError(
            f"{path}: the poses (from {first / 1e9:.3f} s on) do not overlap with the IMU (from"
            f" {file.imus[0].stamp_ns[0] / 1e9:.3f} s on); write their times on the clock that the IMU has in"
            " the recording, or compare afterwards with `unocclude validate --truth --align`."
        )
    file.poses.append(truth)
    sentence = f"{path.name}: poses of the truth, {len(truth.stamp_ns):,} rows"
    return FileReport(str(path), "poses", sentence, [truth.topic], count=len(truth.stamp_ns))
