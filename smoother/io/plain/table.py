"""CSV files of a recording: columns of numbers and words, with errors that name the line."""

from __future__ import annotations

import csv
import os
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from ...array_types import FloatArray
from ...errors import RecordingError
from ...recording import ImuStream
from ...runtime.inputs import check_input
from ..tables.table import ROWS_BEFORE, is_cut_number, plain_minus, shown

#: Bytes at the end of a file that contain its last rows.
_TAIL = 1 << 14
Columns = tuple[dict[str, FloatArray], dict[str, list[str]]]


def read_table(
    path: str | os.PathLike[str],
    required: Sequence[str],
    optional: Sequence[str] = (),
    *,
    words: Sequence[str] = (),
    empty: Sequence[str] = (),
) -> Columns:  # numbers dict of (n,), texts
    """Read the named columns of a comma-separated file whose first line is a header."""
    path = Path(path)
    check_input(path, RecordingError)
    try:
        with open(path, encoding="utf-8-sig", newline="") as file:
            header = [cell.strip() for cell in next(csv.reader(file, skipinitialspace=True), [])]
        _check_header(header, path, required)
        _check_end(path)
        names = [name for name in (*required, *optional) if name in header]
        place = {name: header.index(name) for name in names}
        columns = _read_plain(path, len(header), place, words, empty)
        return columns or _read_cells(path, len(header), place, words, empty)
    except FileNotFoundError:
        raise RecordingError(
            f"{path} does not exist, but recording.toml names it; add it or correct the name."
        ) from None
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        reason = error.strerror if isinstance(error, OSError) else str(error)
        raise RecordingError(
            f"{path} cannot be read as comma-separated text: {shown(str(reason))}."
        ) from error


def vectors(columns: dict[str, FloatArray], *names: str) -> FloatArray:
    """Columns side by side, (n, number of names)."""
    return np.stack([columns[name] for name in names], axis=1)


def _check_header(header: list[str], path: Path, required: Sequence[str]) -> None:
    if not any(header):
        raise RecordingError(f"{path} is empty; its first line must be the header {', '.join(required)}.")
    if len(header) == 1 and (";" in header[0] or "\t" in header[0]):
        mark = "semicolons" if ";" in header[0] else "tabs"
        raise RecordingError(
            f"{path} is separated by {mark}; export it with commas, and points as decimal marks."
        )
    missing = [name for name in required if name not in header]
    if len(missing) == len(required):  # another kind of file, whose first line may be private
        raise RecordingError(
            f"{path} has none of the columns {', '.join(required)} in its first line; name the right file."
            f" `unocclude import describe {path}` helps with other layouts."
        )
    if missing:
        raise RecordingError(
            f"{path} has no column {', '.join(missing)}; its columns are {shown(', '.join(header))}."
            f" `unocclude import describe {path}` helps with other layouts."
        )


def _check_end(path: Path) -> None:
    """Refuse a file that ends within a number: the number would be read as another one."""
    with open(path, "rb") as file:
        file.seek(max(path.stat().st_size - _TAIL, 0))
        lines = file.read().split(b"\n")[1:]  # behind the header, or a line that is not whole
    cells = [line.rsplit(b",", 1)[-1].decode(errors="replace") for line in lines[-ROWS_BEFORE:]]
    if cells and cells[-1].strip() and is_cut_number(cells, 20):
        raise RecordingError(
            f"{path} ends within a number of its last line; copy it again, or delete the line."
        )


def _read_plain(
    path: Path, width: int, place: dict[str, int], words: Sequence[str], empty: Sequence[str]
) -> Columns | None:
    """The columns of a file as programs write it; None where there is anything else in it."""
    import pyarrow as pa
    from pyarrow import csv as arrow_csv

    word = pa.dictionary(pa.int32(), pa.string())
    kinds = {str(at): word if name in words else pa.float64() for name, at in place.items()}
    try:
        table = arrow_csv.read_csv(
            path,
            arrow_csv.ReadOptions(skip_rows=1, column_names=[str(at) for at in range(width)]),
            convert_options=arrow_csv.ConvertOptions(
                column_types=kinds, include_columns=list(kinds), null_values=["", " "]
            ),
        ).unify_dictionaries()
    except pa.ArrowException:
        return None
    numbers, texts = {}, {}
    for name, at in place.items():
        column = table[str(at)].combine_chunks()
        if name in words:
            spelled = [cell.strip() for cell in column.dictionary.to_pylist()]
            if any('"' in cell for cell in spelled):  # a quote behind a space, say, is none to Arrow
                return None
            texts[name] = [spelled[code] for code in column.indices.to_numpy().tolist()]
        elif column.null_count and name not in empty:
            return None
        else:
            numbers[name] = column.to_numpy(zero_copy_only=False, writable=True)
    return (numbers, texts) if len(table) else None


def _read_cells(
    path: Path, width: int, place: dict[str, int], words: Sequence[str], empty: Sequence[str]
) -> Columns:
    numbers: dict[str, list[float]] = {name: [] for name in place if name not in words}
    texts: dict[str, list[str]] = {name: [] for name in place if name in words}
    for line, cells in _rows(path, width):
        for name, text in texts.items():
            text.append(cells[place[name]].strip())
        for name, values in numbers.items():
            cell = plain_minus(cells[place[name]].strip())
            try:
                values.append(float(cell or "nan") if name in empty else float(cell))
            except ValueError:
                what = (
                    f"'{shown(cell, 40)}' in column {name} is not a number"
                    if cell
                    else f"column {name} is empty"
                )
                raise RecordingError(f"{path}, line {line}: {what}; correct the cell.") from None
    if not any([*numbers.values(), *texts.values()]):
        raise RecordingError(f"{path} has a header and no rows; export it again.")
    return {name: np.array(values) for name, values in numbers.items()}, texts


def _rows(path: Path, width: int) -> Iterator[tuple[int, list[str]]]:
    """Yield the rows behind the header and the line that each ends in, without blank lines."""
    with open(path, encoding="utf-8-sig", newline="") as file:
        reader = csv.reader(file, skipinitialspace=True)
        next(reader)
        for cells in reader:
            if len(cells) == width:
                yield reader.line_num, cells
            elif any(cell.strip() for cell in cells):
                raise RecordingError(
                    f"{path}, line {reader.line_num}: {len(cells)} cells where the header has {width}; "
                    "correct the line."
                )


_MAGNETOMETER = ("mx", "my", "mz")


def read_imu_table(path: str | os.PathLike[str], name: str) -> ImuStream:
    """Read `t_s, ax, ay, az, gx, gy, gz [, mx, my, mz]`: s, m/s^2, rad/s, any unit for the field."""
    if not os.path.isfile(path):
        raise RecordingError(f"{path} does not exist; check the name.")
    t_s, acc, gyro, mag = imu_columns(path)
    if len(t_s) < 2 or not (np.diff(t_s) > 0).all():
        raise RecordingError(f"{path}: t_s must increase from row to row and have at least two rows.")
    if mag is not None and not np.isfinite(mag).all():
        mag = None
    if np.median(np.linalg.norm(acc, axis=1)) < 3:
        raise RecordingError(f"{path}: the specific force is near 1, not near 9.81; give it in m/s^2.")
    return ImuStream(name, t_s, acc, gyro, mag)


def imu_columns(
    path: str | os.PathLike[str],
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray | None]:
    """Times (n,), specific force, angular velocity and magnetic field (n, 3), in the file's units."""
    columns, _ = read_table(
        path, ("t_s", "ax", "ay", "az", "gx", "gy", "gz"), _MAGNETOMETER, empty=_MAGNETOMETER
    )
    acc, gyro = vectors(columns, "ax", "ay", "az"), vectors(columns, "gx", "gy", "gz")
    has_field = all(name in columns for name in _MAGNETOMETER)
    return columns["t_s"], acc, gyro, vectors(columns, *_MAGNETOMETER) if has_field else None
