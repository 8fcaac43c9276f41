"""Delimited text as devices and spreadsheets write it, read fast and forgivingly."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta, timezone
from pathlib import Path
from typing import Any

import numpy as np

from ...array_types import FloatArray
from ...errors import RecordingError
from ...runtime.inputs import check_input
from .protocol import HEAD_BYTES, amount, decode, no_table, shown
from .table_layout import TableLayout, check_lines, is_workbook, layout_of, split_line, workbook_text

_DATE = re.compile(
    r"(?:(\d{4})[-/.](\d\d?)[-/.](\d\d?)|(\d\d?)([-/.])(\d\d?)[-/.](\d{4}))[ T_]+"
    r"(\d\d?)[:.](\d\d)[:.](\d\d)(?:[.,:_](\d+))?\s*([AaPp][Mm])?\s*"
    r"(?:Z|UTC|GMT)?\s*(?:([+-])(\d\d?):?(\d\d)?)?"
)
#: To the way of writing that Arrow reads: from 2026/01/31, 10:11:12,5, and a blank before +0100.
_PLAINER = (
    (r"^(\d{4})[/.](\d\d)[/.](\d\d)", r"\1-\2-\3"),
    (r"(:\d\d),(\d{1,9})", r"\1.\2"),
    (r"\s+([+-]\d\d:?\d\d|Z)$", r"\1"),
)
_TIME_OF_DAY = re.compile(r"(\d\d?):(\d\d):(\d\d)(?:[.,:_](\d+))?")
_DAY_S = 86_400.0


def seconds_of_dates(cells: Sequence[str]) -> FloatArray:  # -> (n,) s
    """Times of dates (`2026-01-31T10:11:12.5Z`, with or without a zone) or of times of day (`10:11:12.5`)."""
    fast = _by_arrow(cells)
    if fast is not None:
        return fast
    seconds = np.array([_seconds(cell.strip()) for cell in cells], dtype=float)
    if np.nanmax(seconds, initial=0.0) < 2 * _DAY_S:  # times of day: midnight passes
        steps = np.diff(seconds, prepend=seconds[:1])
        seconds = seconds + _DAY_S * np.cumsum(np.nan_to_num(steps) < -_DAY_S / 2)
    return seconds


def _by_arrow(cells: Sequence[str]) -> FloatArray | None:
    import pyarrow as pa
    import pyarrow.compute as pc

    text = pa.array(cells, pa.string())
    for pattern, plain in _PLAINER:
        text = pc.replace_substring_regex(text, pattern, plain)
    for zone in (None, "UTC"):
        try:
            stamps = pc.cast(pc.cast(text, pa.timestamp("ns", zone)), pa.int64())
        except pa.ArrowException:
            continue
        whole = stamps.to_numpy(zero_copy_only=False)
        return whole // 1_000_000_000 + (whole % 1_000_000_000) * 1e-9
    return None


def _seconds(cell: str) -> float:
    written = _DATE.fullmatch(cell)
    if written is None:
        of_day = _TIME_OF_DAY.fullmatch(cell)
        if of_day is None:
            return float("nan")
        hours, minutes, seconds, fraction = of_day.groups()
        return int(hours) * 3600 + int(minutes) * 60 + int(seconds) + float(f"0.{fraction or 0}")
    y, m, d, one, mark, two, year, hours, minutes, seconds, fraction, noon, sign, zone_h, zone_m = (
        written.groups()
    )
    if y is None:
        y, m, d = (year, one, two) if mark == "/" else (year, two, one)
    hour = int(hours) % 12 + 12 * (noon.lower() == "pm") if noon else int(hours)
    offset = timedelta(hours=int(zone_h), minutes=int(zone_m or 0)) if sign else timedelta()
    try:
        zone = timezone(-offset if sign == "-" else offset) if sign else UTC
        whole = datetime(int(y), int(m), int(d), hour, int(minutes), int(seconds), tzinfo=zone)
    except ValueError:
        return float("nan")
    return whole.timestamp() + float(f"0.{fraction or 0}")


CUT = "The last line is cut off and was left out."
#: Rows at the end of a text that show how numbers are written.
ROWS_BEFORE = 50
_QUOTED = re.compile(r'"[^"]*"')


def even_rows(lines: list[str], layout: TableLayout) -> tuple[list[str], Sequence[int], list[str]]:
    """Rows with equally many cells."""
    whole_end = not lines[-1].strip()
    first, width = layout.first_row, layout.width
    end = len(lines)
    while end > first and not lines[end - 1].strip():
        end -= 1
    rows = lines[first:end]
    numbers: Sequence[int] = range(first, end)
    mark = "\t" if layout.separator == " " else layout.separator
    if layout.separator == " ":
        rows = ["\t".join(row.replace('"', "").split()) for row in rows]
    counts = [separators_in(row, mark) for row in rows]
    usual = Counter(counts).most_common(1)[0][0] if counts else 0
    header = lines[layout.header].strip() if layout.header >= 0 else None
    notes = [] if whole_end else _end_notes(rows, counts, usual, mark, end)
    is_cut = notes[:1] == [CUT]
    # Separators behind the last column make empty columns, which do no harm.
    if usual >= width - 1 and counts.count(usual) == len(rows) and header not in rows:
        return (rows[:-1], numbers[:-1], notes) if is_cut else (rows, numbers, notes)
    even, indices, short, long, repeated = [], [], 0, 0, 0
    for at, (row, count) in enumerate(zip(rows, counts, strict=True)):
        if not row.strip(mark + " "):
            continue
        if row.strip() == header or (header and row.startswith(header[:40]) and row.strip()[:1].isalpha()):
            repeated += 1
            continue
        if is_cut and at == len(rows) - 1:
            continue
        cells_needed = width - 1
        if count < cells_needed:
            short += count < usual
            row += mark * (cells_needed - count)
        elif count > cells_needed:
            cells = split_line(row, mark)
            if any(cells[width:]):
                long += 1
                continue
            row = mark.join(cell.replace(mark, " ") for cell in cells[:width])
        even.append(row)
        indices.append(first + at)
    if repeated:
        headers = amount(
            repeated, "repeated header among the rows was", "repeated headers among the rows were"
        )
        notes.append(f"{headers} left out.")
    if short:
        rows_are = amount(short, "row is", "rows are")
        notes.append(f"{rows_are} shorter than the others; what is lacking is treated as missing.")
    if long:
        rows_were = amount(
            long, "row with more cells than columns was", "rows with more cells than columns were"
        )
        notes.append(f"{rows_were} left out.")
    return even, indices, notes


def _end_notes(rows: list[str], counts: list[int], usual: int, mark: str, line: int) -> list[str]:
    """What is to be said of a text that does not end with a line's end."""
    if not rows:
        return []
    cells = [row.rsplit(mark, 1)[-1] for row in rows[-ROWS_BEFORE:]]
    if counts[-1] < usual or is_cut_number(cells):
        return [CUT]
    return [
        f"The file ends without a line break; if it was cut off, what came behind line {line} is missing."
    ]


def is_cut_number(cells: Sequence[str], fewest: int = 3) -> bool:
    """Whether the last of a column's cells has fewer decimals than all before it, which have equally many."""
    *before, last = [cell.strip().strip('"').replace(",", ".").partition(".")[2] for cell in cells]
    decimals = {len(digits) for digits in before if digits.isdigit()}
    return len(before) >= fewest and len(decimals) == 1 and all(before) and len(last) < min(decimals)


def separators_in(row: str, mark: str) -> int:
    """How many separators a row has outside quotes."""
    return (_QUOTED.sub("", row) if '"' in row else row).count(mark)


#: Cells without a value, in lower case.
MISSING = ("", "nan", "na", "n/a", "none", "null", "-", "--", "#n/a", "+nan", "-nan")
#: A column with a larger share of cells that are not numbers is refused.
_WRONG = 0.05
_PLAIN = r"^[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d{1,3})?$"
_WITH_COMMA = r"^[+-]?\d*,\d+([eE][+-]?\d{1,3})?$"


class Sheet:
    """A table of text."""

    def __init__(
        self, path: Path, layout: TableLayout, table: Any, line_numbers: Sequence[int], notes: list[str]
    ) -> None:
        self.path = path
        self.layout = layout
        self.notes = notes
        self._table = table
        self._line_numbers = line_numbers
        self._numbers: dict[int, FloatArray] = {}

    def __len__(self) -> int:
        return self._table.num_rows

    def unit(self, column: int) -> str:
        """Unit of a column as the file states it, "" where it does not."""
        return self.layout.units[column] if column < len(self.layout.units) else ""

    def name(self, column: int) -> str:
        """Name of a column for messages."""
        written = self.layout.names[column] if self.layout.names else ""
        return f"column {written or column + 1}"

    def line(self, row: int) -> int:
        """Line of the file (from 1) in which a row stands."""
        return self._line_numbers[row] + 1

    def texts(self, column: int) -> list[str]:
        """Cells of a column as text, without blanks around them."""
        return self._trimmed(column).to_pylist()

    def numbers(self, column: int) -> FloatArray:  # -> (n,)
        """A column of numbers."""
        if column not in self._numbers:
            self._numbers[column] = self._read_numbers(column)
        return self._numbers[column]

    def vectors(self, columns: Sequence[int]) -> FloatArray:
        """Columns of numbers side by side, shape (n, number of columns)."""
        return np.stack([self.numbers(column) for column in columns], axis=1)

    def times(self, column: int) -> tuple[FloatArray, bool]:  # -> times (n,), dates
        """A column of numbers, or of dates."""
        sample = [cell for cell in self.texts(column)[:50] if cell]
        if not any(re.search(r"\d[-/.:]\d+[-/.:]\d", cell) for cell in sample):
            return self.numbers(column), False
        cells = self.texts(column)
        seconds = seconds_of_dates(cells)
        filled = np.array([cell.lower() not in MISSING for cell in cells])
        wrong = np.flatnonzero(filled & ~np.isfinite(seconds))
        if len(wrong) > max(_WRONG * np.count_nonzero(filled), 1):
            raise self._wrong(column, wrong, int(np.count_nonzero(filled)), "time")
        return seconds, True

    def refuse_nameless(self, most: int = 0) -> None:
        """Refuse a header with fewer names than the rows have cells: whose are the names then?"""
        names = self.layout.names
        named = max((at + 1 for at, name in enumerate(names) if name), default=0)
        nameless = range(named, self.layout.width) if names else range(0)
        filled = sum(1 for column in nameless if any(self.texts(column)[:20]))
        if filled > most:
            raise RecordingError(
                f"{self.path}: the header (line {self.layout.header + 1}) names {named} columns, and the rows"
                f" have {self.layout.width}; export the file again, or describe it in a recording.toml."
            )

    def _trimmed(self, column: int) -> Any:
        import pyarrow.compute as pc

        return pc.utf8_trim_whitespace(self._table.column(column).combine_chunks())

    def _read_numbers(self, column: int) -> FloatArray:
        import pyarrow as pa
        import pyarrow.compute as pc

        text = self._trimmed(column)
        empty = pc.is_in(pc.utf8_lower(text), value_set=pa.array(MISSING))
        text = pc.if_else(empty, pa.scalar(None, pa.string()), text)
        try:
            numbers = pc.cast(text, pa.float64())
        except pa.ArrowException:
            comma = pc.match_substring_regex(text, _WITH_COMMA)
            text = pc.if_else(comma, pc.replace_substring(text, ",", ".", max_replacements=1), text)
            plain = pc.match_substring_regex(text, _PLAIN)
            text = pc.if_else(plain, text, pa.scalar(None, pa.string()))
            numbers = pc.cast(text, pa.float64())
        values = np.array(numbers.to_numpy(zero_copy_only=False), dtype=float)
        filled = ~empty.to_numpy(zero_copy_only=False)
        wrong = np.flatnonzero(filled & ~np.isfinite(values))
        if len(wrong):
            values[wrong] = np.nan
            if len(wrong) > max(_WRONG * np.count_nonzero(filled), 1):
                raise self._wrong(column, wrong, int(np.count_nonzero(filled)), "number")
            self._note_wrong(column, wrong)
        return values

    def _cell(self, column: int, row: int) -> str:
        return shown(self._table.column(column)[row].as_py(), 40)

    def _wrong(self, column: int, rows: np.ndarray, filled: int, what: str) -> RecordingError:
        first = int(rows[0])
        return RecordingError(
            f"{self.path}, line {self.line(first)}: '{self._cell(column, first)}' in"
            f" {shown(self.name(column), 60)} is not a {what}, like {len(rows):,} of its {filled:,} cells,"
            " too many to leave out; correct the cells, or export the file again."
        )

    def _note_wrong(self, column: int, rows: np.ndarray) -> None:
        count = "1 cell" if len(rows) == 1 else f"{len(rows):,} cells"
        self.notes.append(
            f"{count} of {shown(self.name(column), 60)} {'is' if len(rows) == 1 else 'are'} not a number"
            f" and treated as missing ('{self._cell(column, int(rows[0]))}' in line"
            f" {self.line(int(rows[0]))})."
        )


def read_sheet(path: Path, expected: str = "a table", quote: bool = True) -> Sheet:
    """Read a delimited text file, or an Excel workbook."""
    check_input(path, RecordingError)
    try:
        raw = path.read_bytes()
    except OSError as error:
        raise RecordingError(f"{path} cannot be read: {error.strerror or error}.") from error
    text = workbook_text(path) if is_workbook(raw[:HEAD_BYTES]) else decode(raw)
    if refused := no_table(raw[:HEAD_BYTES], text if len(text) < HEAD_BYTES else ""):
        raise RecordingError(f"{path} {refused}")
    if not text.strip():
        what = "is empty" if not raw.strip() else "is not text"
        raise RecordingError(f"{path} {what}, but should be {expected}; export it again.")
    return sheet_of_text(path, text, expected, quote=quote)


def sheet_of_text(
    path: Path, text: str, expected: str = "a table", layout: TableLayout | None = None, quote: bool = True
) -> Sheet:
    """The table in a text (see `read_sheet`)."""
    if "\r" in text:
        text = text.replace("\r\n", "\n").replace("\r", "\n")
    lines = text.split("\n")
    check_lines(path, lines)
    layout = layout or layout_of(lines)
    if layout is None:
        seen = shown(" | ".join(line for line in lines[:4] if line.strip()))
        begins = f"; it begins: {seen}" if quote else "; name the right file."
        raise RecordingError(f"{path} should be {expected}, but no rows of numbers were found{begins}")
    rows, numbers, notes = even_rows(lines, layout)
    if not rows:
        raise RecordingError(
            f"{path} should be {expected}, but has no rows below its header; export it again."
        )
    table = _parse(path, rows, layout)
    return Sheet(path, layout, table, numbers, notes)


def _parse(path: Path, rows: list[str], layout: TableLayout) -> Any:
    """An Arrow table of text columns."""
    import pyarrow as pa
    from pyarrow import csv as arrow_csv

    mark = "\t" if layout.separator == " " else layout.separator
    names = [str(at) for at in range(max(layout.width, separators_in(rows[0], mark) + 1 if rows else 0))]
    data = "\n".join(rows).encode("utf-8", errors="replace")
    try:
        return arrow_csv.read_csv(
            pa.BufferReader(data),
            arrow_csv.ReadOptions(
                column_names=names, block_size=max(1 << 20, len(data) + 1), use_threads=False
            ),
            arrow_csv.ParseOptions(
                delimiter=mark,
                invalid_row_handler=lambda _: "skip",
            ),
            arrow_csv.ConvertOptions(
                column_types=dict.fromkeys(names, pa.string()), strings_can_be_null=False
            ),
        )
    except pa.ArrowException as error:
        raise RecordingError(f"{path} cannot be read as a table: {shown(str(error), 120)}.") from error
