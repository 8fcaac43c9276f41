"""A folder of device files: which of them are skeletons and which IMUs; a truth beside them."""

from __future__ import annotations

from pathlib import Path

from ...errors import RecordingError
from ..markers import MARKER_FORMATS, read_markers
from ..plain.folder import read_pose_table
from ..recording.read import open_recording
from ..recording.streams import RecordingFile
from ..tables.imu import ImuTable
from ..tables.skeletons import SkeletonTable
from ..tables.table import first_rows, read_head
from .files import FileReport, ImuFiles
from .registry import FileReader, keys, unknown_file


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
        sensors = [table for table in tables if isinstance(table, ImuTable)]
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
