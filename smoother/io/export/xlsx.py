"""A recovery as an Excel workbook: the CSV's table, and a sheet that describes its columns."""

from __future__ import annotations

import os
import re
import shutil
import tempfile
import zipfile
from collections.abc import Iterable
from pathlib import Path
from typing import IO

import numpy as np

from ...errors import UnoccludeError
from ...result import Recovery
from ...result.untrusted import usable
from ...runtime.outputs import writing
from ...runtime.packages import extra_module
from ...runtime.pool import Progress
from .csv import column_groups

#: Rows of a sheet, the header's with them.
MOST_ROWS = 1_048_576
_ROWS = 2_000
_DATE = re.compile(rb"(<dcterms:(?:created|modified)[^>]*>)[^<]*(</dcterms:)")


def check_xlsx(recovery: Recovery) -> None:
    """Refuse what no workbook can hold, before anything is written.

    Raises
    ------
    UnoccludeError
        openpyxl is not installed, or there are more samples than a sheet has rows.
    """
    extra_module("openpyxl", "openpyxl", "xlsx")
    if len(recovery) >= MOST_ROWS:
        raise UnoccludeError(
            f"{recovery.name} has {len(recovery):,} samples, and a sheet has at most {MOST_ROWS - 1:,}:"
            " export csv or parquet, or cut the recording"
        )


def export_xlsx(
    recovery: Recovery,
    path: str | os.PathLike[str],
    force: bool = False,
    progress: Progress | None = None,
) -> None:
    """Write the columns of the CSV export as the sheet `motion`; cells without an answer are empty.

    The sheet `columns` has unit and meaning of each, the sheet `about` recording, arm and verdict. `t_s` is
    rounded as a double is: of clocks that count from 1970 to some 0.2 microseconds.

    Parameters
    ----------
    recovery : Recovery
        One arm.
    path : path-like
        The file to write.
    force : bool
        Overwrite a file that exists.
    progress : Progress, optional
        Told how far it is.

    Raises
    ------
    UnoccludeError
        The file exists and `force` is not given, or it cannot be written.
    """
    check_xlsx(recovery)
    from openpyxl import Workbook

    groups = column_groups(recovery)
    values = np.concatenate([group.values for group in groups], axis=1)
    names = ["t_s", "occluded", *(name for group in groups for name in group.names), "trusted", "usable"]
    t_s = recovery.t_s + recovery.origin_ns / 1e9
    has_verdict = recovery.has_verdict
    book = Workbook(write_only=True)  # rows go to the disk as they come
    sheet = book.create_sheet("motion")
    sheet.freeze_panes = "B2"
    sheet.append(names)
    for start in range(0, len(recovery), _ROWS):
        if progress is not None:
            progress(start / len(recovery), "writing rows")
        part = slice(start, start + _ROWS)
        heads = zip(t_s[part].tolist(), recovery.occluded[part].tolist(), strict=True)
        marks = zip(recovery.trusted[part].tolist(), usable(recovery)[part].tolist(), strict=True)
        for (stamp, hidden), row, (trusted, good) in zip(heads, values[part].tolist(), marks, strict=True):
            sheet.append(
                [
                    stamp,
                    int(hidden),
                    *(None if value != value else value for value in row),
                    int(trusted) if has_verdict else None,
                    int(good),
                ]
            )
    _add_sheet(book, "columns", ("column", "unit", "meaning"), _meanings(recovery))
    _add_sheet(book, "about", ("what", "value"), _about(recovery))
    with writing(path, force) as temporary, tempfile.TemporaryFile() as made:
        book.save(made)
        _without_dates(made, temporary)


def _without_dates(made: IO[bytes], path: Path) -> None:
    """The workbook without the time at which it was written: the same result gives the same bytes."""
    with zipfile.ZipFile(made) as source, zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as target:
        for name in source.namelist():
            entry = zipfile.ZipInfo(name)  # of 1980
            entry.compress_type = zipfile.ZIP_DEFLATED
            with source.open(name) as content, target.open(entry, "w") as file:
                if name == "docProps/core.xml":
                    file.write(_DATE.sub(rb"\g<1>1980-01-01T00:00:00Z\g<2>", content.read()))
                else:
                    shutil.copyfileobj(content, file)


def _meanings(recovery: Recovery) -> Iterable[tuple[str, str, str]]:
    yield "t_s", "s", "the IMU's own stamp"
    yield "occluded", "0/1", "1 where the camera had no forearm"
    for group in column_groups(recovery):
        for name in group.names:
            yield name, group.unit, group.description
    yield "trusted", "0/1", "0 where the answer is not to be trusted; empty without a verdict"
    yield "usable", "0/1", "1 where there is an answer that is not distrusted"


def _about(recovery: Recovery) -> Iterable[tuple[str, str]]:
    yield "recording", recovery.name
    yield "arm", recovery.arm_label
    yield "method", recovery.method
    yield "verdict", recovery.estimates.verdict
    for note in recovery.notes:
        yield "note", note


def _add_sheet(book: object, title: str, heads: tuple[str, ...], rows: Iterable[tuple[str, ...]]) -> None:
    """A sheet of texts; none of them is taken for a formula."""
    from openpyxl.cell import WriteOnlyCell
    from openpyxl.utils.exceptions import IllegalCharacterError

    sheet = book.create_sheet(title)  # type: ignore[attr-defined]
    sheet.append(heads)
    for row in rows:
        cells = []
        for text in row:
            try:
                cell = WriteOnlyCell(sheet, value=text)
            except IllegalCharacterError:
                cell = WriteOnlyCell(sheet, value="".join(c for c in text if c.isprintable()))
            cell.data_type = "s"
            cells.append(cell)
        sheet.append(cells)
