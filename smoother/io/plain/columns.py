"""IMUs in tables of any layout: which of their columns is what, as recording.toml says."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...array_types import FloatArray
from ...errors import RecordingError
from ...runtime.inputs import check_input
from ..devices.head import decode, shown
from ..devices.protocol import ImuTable
from ..devices.sheet import Sheet, read_sheet, sheet_of_text
from ..devices.table_layout import SEPARATORS, TableLayout, is_data, layout_of, split_line
from .layout_keys import ACCELERATION, ANGULAR_VELOCITY, SECONDS, Column, ImuKeys, TableKeys

IMU_COLUMNS = ("t", "ax", "ay", "az", "gx", "gy", "gz", "mx", "my", "mz")
#: A header may be followed by so many lines of units and the like.
_BELOW_HEADER = 3


def read_imu_columns(folder: Path, keys: ImuKeys) -> list[ImuTable]:
    """The tables of an IMU, one a file, in SI units.

    Parameters
    ----------
    folder : Path
        Where the files are.
    keys : ImuKeys
        What recording.toml says of them.

    Returns
    -------
    list of ImuTable
        Times not yet repaired.

    Raises
    ------
    RecordingError
        A file or a column is missing, or is no numbers.
    """
    files = [keys.file] if isinstance(keys.file, str) else keys.file
    given = keys.columns if isinstance(keys.columns, list) else [keys.columns] * len(files)
    if len(given) != len(files):
        raise RecordingError(
            f"{folder / 'recording.toml'}: {len(files)} files have {len(given)} tables of columns; give one"
            " for each, or one for all."
        )
    return [
        _imu_table(folder / file, keys, columns or {}, len(files) > 1)
        for file, columns in zip(files, given, strict=True)
    ]


def _imu_table(path: Path, keys: ImuKeys, columns: dict[str, Column], is_part: bool) -> ImuTable:
    refuse_others(path, columns, IMU_COLUMNS)
    sheet = described_sheet(path, keys, columns)
    given = columns or {name: name if name != "t" else "t_s" for name in IMU_COLUMNS}
    at = {}
    for what, column in given.items():
        place = place_of(sheet, column)
        if place is not None:
            at[what] = place
        elif not is_part and (columns or what not in ("t", "mx", "my", "mz")):
            raise _no_column(sheet, what, column)
    acc = _vectors(sheet, at, "axyz") * ACCELERATION[keys.accelerometer_unit] if "ax" in at else None
    gyro = _vectors(sheet, at, "gxyz") * ANGULAR_VELOCITY[keys.gyroscope_unit] if "gx" in at else None
    if acc is None and gyro is None:
        raise RecordingError(
            f"{path}: columns name neither an accelerometer (ax, ay, az) nor a gyroscope (gx, gy, gz) that is"
            f" there; its columns are {_listed(sheet)}."
        )
    mag = _vectors(sheet, at, "mxyz") if "mx" in at else None
    t_s, counter = times_in(sheet, at.get("t"), keys)
    units = ", ".join(
        unit
        for unit, values in ((keys.accelerometer_unit, acc), (keys.gyroscope_unit, gyro))
        if values is not None
    )
    return ImuTable("", t_s, acc, gyro, mag, keys.rate_hz, counter, 0, units, sheet.notes)


def times_in(
    sheet: Sheet, column: int | None, keys: TableKeys
) -> tuple[FloatArray | None, NDArray[np.int64] | None]:
    """Times in s, or a counter, of a column."""
    if column is None or keys.time_unit == "counter":
        if keys.rate_hz is None:
            raise RecordingError(f"{sheet.path} has no times by recording.toml; give its rate as rate_hz.")
        if column is None:
            return None, None
        counter = sheet.numbers(column)
        if not np.isfinite(counter).all():
            raise RecordingError(f"{sheet.path}: {sheet.name(column)} is no counter; cells of it are empty.")
        return None, counter.astype(np.int64)
    values, are_dates = sheet.times(column)
    if are_dates != (keys.time_unit == "iso"):
        seen = shown(sheet.texts(column)[0], 40)
        raise RecordingError(
            f"{sheet.path}: {sheet.name(column)} begins with '{seen}', which is no time in"
            f" {keys.time_unit}; mend time_unit."
        )
    return (values if are_dates else values * SECONDS[keys.time_unit]), None


def described_sheet(path: Path, keys: TableKeys, columns: Mapping[str, Column | list[Column]]) -> Sheet:
    """The table of a file, laid out as said."""
    expected = "the table that recording.toml describes"
    check_input(path, RecordingError)
    if not path.is_file():
        raise RecordingError(f"{path} does not exist, but recording.toml names it; add it or mend the name.")
    if keys.separator is None and keys.skip_rows is None:
        return read_sheet(path, expected, quote=False)
    text = decode(path.read_bytes()).replace("\r\n", "\n").replace("\r", "\n")
    return sheet_of_text(path, text, expected, _layout(path, text.split("\n"), keys, columns))


def _layout(
    path: Path, lines: list[str], keys: TableKeys, columns: Mapping[str, Column | list[Column]]
) -> TableLayout:
    first = keys.skip_rows or 0
    rest = [line for line in lines[first:] if line.strip()]
    if not rest:
        raise RecordingError(f"{path} has no rows below the first {first}; mend skip_rows.")
    found = layout_of(rest)
    separator = keys.separator or ("," if found is None else found.separator)
    if separator not in SEPARATORS:
        raise RecordingError(f'{path}: separator is {separator!r}; it is one of ",", ";", "\\t" and " ".')
    while first < len(lines) - 1 and not lines[first].strip():
        first += 1
    cells = split_line(lines[first], separator)
    flat = [c for each in columns.values() for c in (each if isinstance(each, list) else [each])]
    has_header = any(isinstance(column, str) for column in flat) or not any(map(is_data, cells))
    row = first
    if has_header:
        row += 1
        for _ in range(_BELOW_HEADER):
            below = split_line(lines[row], separator) if row < len(lines) else []
            if row < len(lines) - 1 and not any(is_data(cell) for cell in below):
                row += 1
    names = tuple(cells) if has_header else ()
    width = max(len(cells), len(split_line(lines[min(row, len(lines) - 1)], separator)))
    names += ("",) * (width - len(names)) if names else ()
    labels = tuple(" ".join(name.lower().split()) for name in names)
    return TableLayout(
        separator, tuple(lines[:first]), names, ("",) * width, labels, first if has_header else -1, row, width
    )


def place_of(sheet: Sheet, column: Column | list[Column]) -> int | None:
    """Number (from 0) of a column by its name, or by its number from 1; None where it is not there."""
    if isinstance(column, int):
        return column - 1 if 1 <= column <= sheet.layout.width else None
    if not isinstance(column, str):
        return None
    for names in (sheet.layout.names, [" ".join(name.lower().split()) for name in sheet.layout.names]):
        wanted = column if names is sheet.layout.names else " ".join(column.lower().split())
        if wanted in names:
            return list(names).index(wanted)
    plain = " ".join(column.lower().split())  # as written, or without the unit in brackets
    return sheet.layout.labels.index(plain) if plain in sheet.layout.labels else None


def needed_place(sheet: Sheet, what: str, column: Column | list[Column]) -> int:
    """`place_of` a column that must be there."""
    place = place_of(sheet, column)
    if place is None:
        raise _no_column(sheet, what, column)
    return place


def _no_column(sheet: Sheet, what: str, column: Column | list[Column]) -> RecordingError:
    return RecordingError(
        f"{sheet.path} has no column {column!r} ({what}); its columns are {_listed(sheet)}."
    )


def _listed(sheet: Sheet) -> str:
    if not sheet.layout.names:
        return f"without names, 1 to {sheet.layout.width}"
    return shown(", ".join(sheet.layout.names))


def refuse_others(path: Path, columns: Mapping[str, object], known: tuple[str, ...]) -> None:
    """Refuse keys of `columns` that mean nothing."""
    for name in columns:
        if name not in known:
            raise RecordingError(f"{path}: columns.{name} is not known; it is one of {', '.join(known)}.")


def _vectors(sheet: Sheet, at: dict[str, int], letters: str) -> FloatArray:
    kind, axes = letters[0], letters[1:]
    missing = [kind + axis for axis in axes if kind + axis not in at]
    if missing:
        raise RecordingError(f"{sheet.path}: columns lack {', '.join(missing)}; name all three axes.")
    return sheet.vectors([at[kind + axis] for axis in axes])
