"""An inertial sensor's table of no known device, read by the names of its columns, or as date, x, y, z."""

from __future__ import annotations

from pathlib import Path

from ...errors import RecordingError
from ..plain.columns import ImuKeys, read_imu_columns
from ..tables.imu import UNUSED, ImuTable
from ..tables.table import FileHead, Format, Table, read_table, shown
from .describe_table import Guess, guess_sensor

#: How `guess_sensor` marks what it made up.
_UNKNOWN = "NOT KNOWN"


def _names_sensors(head: FileHead) -> bool:
    """Whether accelerometer or gyroscope are found, and nothing about them is made up."""
    if head.table is None:
        return False
    try:
        return _settled(_guessed(head.table))
    except RecordingError:
        return False


def read_named_imu(path: Path) -> list[ImuTable]:
    """Tables whose columns identify themselves; `import describe` prints the same guess to be edited."""
    sheet = read_table(path, f"a {NAMED_IMU.title}")
    names, guess = sheet.names, _guessed(sheet)
    if not _settled(guess):
        why = " ".join(guess.unsure) or "it names no sensor."
        raise RecordingError(
            f"{path} is a {NAMED_IMU.title}, of which something is not known: {why} `unocclude import"
            f" describe {path}` prints a recording.toml to complete."
        )
    keys = ImuKeys.model_validate({**guess.keys, "file": path.name, "columns": guess.columns})
    halves = "ax" in guess.columns, "gx" in guess.columns
    (table,) = read_imu_columns(path.parent, keys)
    said = [f"{name} = {column}" for name, column in guess.columns.items()]
    units = [f"{value} ({guess.reasons.get(key, '')})" for key, value in guess.keys.items() if value != "iso"]
    table.notes.insert(
        0, f"Its columns were taken as {', '.join(said)}; units: {', '.join(units) or 'none'}."
    )
    used = {str(column) for column in guess.columns.values()}
    if unused := [name for name in names if name and name not in used]:
        table.notes.append(f"{UNUSED} columns {shown(', '.join(unused), 120)}.")
    table.notes += [each for each in guess.unsure if "There is no" not in each]
    table.gyro_unit_assumed = halves[1] and any(
        "gyroscope's unit is guessed" in each for each in guess.unsure
    )
    return [table]


NAMED_IMU = Format(
    key="imu-table",
    title="table of an IMU by its columns",
    kind="imu",
    recognised_by="columns named after an accelerometer or a gyroscope and x, y, z; or date, x, y, z",
    recognises=_names_sensors,
    read=read_named_imu,
)


def _guessed(sheet: Table) -> Guess:
    """The guess at a table with a header, or at four columns of times and a vector; else an empty one."""
    if not sheet.names and sheet.width != 4:
        return Guess()
    return guess_sensor(sheet)


def _settled(guess: Guess) -> bool:
    """Whether times and units of what was found are known."""
    made_up = any(reason.startswith(_UNKNOWN) for reason in guess.reasons.values())
    return (
        bool(guess.kind)
        and {"ax", "gx"} & guess.columns.keys() != set()
        and "t" in guess.columns
        and not made_up
    )
