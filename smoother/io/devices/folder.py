"""A folder of device files: which of them are skeletons and which IMUs."""

from __future__ import annotations

from pathlib import Path

from ...errors import RecordingError
from .file_reader import FileReader
from .files import ImuFiles
from .head import first_rows, read_head
from .protocol import ImuTable, SkeletonTable
from .registry import keys, unknown_file


def sort_files(
    paths: list[Path], reader: FileReader, output: Path | None = None
) -> tuple[list[Path], list[ImuFiles], list[str]]:
    """Device files among paths, by what is in them.

    Parameters
    ----------
    paths : list of Path
        Files, and folders whose files are meant (not those in folders below).
    reader : FileReader
        Keeps what it reads.
    output : Path, optional
        The recording to write, which is no input where it lies in a folder.

    Returns
    -------
    skeletons : list of Path
    imus : list of ImuFiles
        An accelerometer and a gyroscope in two files of one folder are one IMU, where there is one of each.
    passed_over : list of str
        Files that no importer recognises, a sentence each.

    Raises
    ------
    RecordingError
        Nothing is recognised, or a file cannot be read.
    """
    skeletons: list[Path] = []
    imus: list[ImuFiles] = []
    halves: dict[str, list[Path]] = {"acc": [], "gyro": []}
    passed_over: list[str] = []
    refused: list[RecordingError] = []
    files = _files(paths, output)
    for path in files:
        importer = reader.recognised(path)
        if importer is None:
            head = read_head(path)
            passed_over.append(
                f"{path.name} is of no known format and was passed over; it begins: {first_rows(head, 100)}."
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
        raise RecordingError(f"{paths[0]} holds no file of a known format ({keys()}). {seen}")
    return skeletons, imus, passed_over


def _joined(halves: dict[str, list[Path]]) -> list[ImuFiles]:
    if not halves["acc"] and not halves["gyro"]:
        return []
    if len(halves["acc"]) == len(halves["gyro"]) == 1:
        return [ImuFiles((halves["acc"][0], halves["gyro"][0]))]
    listed = ", ".join(path.name for path in (*halves["acc"], *halves["gyro"]))
    raise RecordingError(
        f"{listed} hold accelerometers or gyroscopes alone; say which belong together:"
        " --imu NAME=ACC_FILE,GYRO_FILE."
    )


def _files(paths: list[Path], output: Path | None) -> list[Path]:
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
