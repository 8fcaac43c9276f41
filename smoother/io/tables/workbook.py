"""An Excel workbook's table as text, for all that reads tables of text."""

from __future__ import annotations

import zipfile
from datetime import date, datetime, time
from functools import lru_cache
from itertools import islice
from pathlib import Path
from typing import Any

from ...errors import RecordingError, UnoccludeError
from ...runtime.packages import extra_module

#: Between the cells: no cell holds it.
SEPARATOR = "\t"
#: Rows at a sheet's beginning by which it is chosen.
_LOOKED_AT = 60
#: Bytes that a workbook may have when it is unpacked; a file of a few kB can claim any number.
_LARGEST = 4_000_000_000
#: This many texts are kept for the next reader of the same workbook.
_KEPT = 4


def is_workbook(raw: bytes) -> bool:
    """Whether a file's beginning is that of an Excel workbook (.xlsx)."""
    return raw.startswith(b"PK\x03\x04") and (b"[Content_Types]" in raw or b"xl/" in raw[:4000])


def workbook_text(path: Path, rows: int | None = None) -> str:
    """The rows of a workbook's table as lines of text.

    Parameters
    ----------
    path : Path
        The workbook.
    rows : int, optional
        This many rows at most; None for all.

    Returns
    -------
    text : str
        Cells parted by `SEPARATOR`, dates as in ISO 8601. Of several sheets the one whose first rows contain
        the most numbers.

    Raises
    ------
    RecordingError
        It cannot be read, or openpyxl is not installed.
    """
    about = path.stat()
    return _text(path, rows, about.st_mtime_ns, about.st_size)


@lru_cache(maxsize=_KEPT)
def _text(path: Path, rows: int | None, mtime_ns: int, size: int) -> str:
    try:
        openpyxl = extra_module("openpyxl", "openpyxl", "xlsx")
    except UnoccludeError as error:
        raise RecordingError(f"{path} is an Excel workbook; {error}, or save it as CSV") from error
    try:
        with zipfile.ZipFile(path) as parts:
            if sum(part.file_size for part in parts.infolist()) > _LARGEST:
                raise RecordingError(f"{path} is a workbook of more than 4 GB unpacked; save it as CSV.")
        book = openpyxl.load_workbook(path, read_only=True, data_only=True)
        try:
            sheets = [sheet for sheet in book.worksheets if sheet.sheet_state == "visible"]
            if not sheets:
                raise RecordingError(f"{path} is a workbook without a sheet of cells; save it as CSV.")
            for sheet in sheets:
                sheet.reset_dimensions()  # some programs state the wrong ones
            sheet = max(sheets, key=_numbers)
            return "\n".join(_line(row) for row in islice(sheet.iter_rows(values_only=True), rows)) + "\n"
        finally:
            book.close()
    except RecordingError:
        raise
    except Exception as error:  # a damaged workbook fails anywhere
        raise RecordingError(
            f"{path} is an Excel workbook that cannot be read ({type(error).__name__}); save it again, or as"
            " CSV."
        ) from error


def _numbers(sheet: Any) -> int:
    """How many numbers the first rows of a sheet contain."""
    rows = islice(sheet.iter_rows(values_only=True), _LOOKED_AT)
    return sum(isinstance(value, int | float) for row in rows for value in row)


def _line(row: tuple[Any, ...]) -> str:
    cells = [_cell(value) for value in row]
    while cells and not cells[-1]:
        cells.pop()
    return SEPARATOR.join(cells)


def _cell(value: Any) -> str:
    """A cell as text."""
    if value is None:
        return ""
    if isinstance(value, bool):
        return str(int(value))
    if isinstance(value, float):
        return str(int(value)) if value.is_integer() and abs(value) < 1e15 else repr(value)
    if isinstance(value, datetime):
        return value.isoformat(" ")
    if isinstance(value, date | time):
        return value.isoformat()
    return " ".join(str(value).split())
