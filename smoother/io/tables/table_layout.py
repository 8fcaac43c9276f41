"""How a table is laid out: separator, preamble, header, units, first row; a workbook as text."""

from __future__ import annotations

import csv
import re
import zipfile
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import date, datetime, time
from functools import lru_cache
from itertools import islice
from pathlib import Path
from statistics import median
from typing import Any

from ...errors import RecordingError, UnoccludeError
from ...runtime.packages import extra_module
from .units import is_unit, split_unit

#: Separators in the order in which they are believed where two fit; the last is any number of blanks.
SEPARATORS = (";", "\t", "|", ",", " ")
#: This many lines at the beginning settle the layout.
LAYOUT_LINES = 400
#: How columns put stem and axis together.
AXIS_FORMS = ("{} {}", "{}_{}", "{}{}", "{}.{}", "{}-{}", "{}[{}]", "{}({})", "{}/{}", "{} {}-axis")
_NUMBER = re.compile(
    r"[+-]?(\d+(\.\d*|,\d+)?|[.,]\d+)([eE][+-]?\d+)?|[+-]?nan|[+-]?inf(inity)?|null", re.IGNORECASE
)
_STAMP = re.compile(
    r"\d{4}[-/.]\d\d?[-/.]\d\d?\b.*|\d\d?[-/.]\d\d?[-/.]\d{4}\b.*|\d\d?:\d\d(:\d\d([.,:_]\d+)?)?"
)
#: This many lines may be between the names and the rows; cells of them that state no unit.
_BELOW_NAMES, _NO_UNIT = 3, ("", "-", "--", "n/a", "none", "no_units", "nounits", "unitless")
_SEP_LINE = re.compile(r'"?sep=.{0,3}', re.IGNORECASE)


@dataclass(frozen=True)
class TableLayout:
    """Where in a text the table is."""

    separator: str  # One of `SEPARATORS`
    preamble: tuple[str, ...]  # Lines above the header, without `sep=` and blank lines
    names: tuple[str, ...]  # Column names as written, `width` of them ("" = none)
    units: tuple[str, ...]  # By column, from the line of units or from brackets behind the name
    labels: tuple[str, ...]  # Names for comparing: without bracketed units, lower case, single blanks
    header: int  # Index of the header's line; -1 where there is none
    first_row: int  # Index of the first line of data
    width: int  # Number of columns

    def find(self, *labels: str) -> int | None:
        """Number of the first column (from 0) that has one of these labels; the first label first."""
        for label in labels:
            if label in self.labels:
                return self.labels.index(label)
        return None

    def axes(self, *stems: str, signs: Sequence[str] = ("xyz",)) -> tuple[int, int, int] | None:
        """Numbers of the columns of a vector, labelled by one of these stems and the axes' signs."""
        for stem in stems:
            for form in AXIS_FORMS:
                for sign in signs:
                    columns = [self.find(form.format(stem, axis).strip()) for axis in sign]
                    if None not in columns:
                        return columns[0], columns[1], columns[2]  # type: ignore[return-value]
        return None

    def stated(self, *subjects: str) -> str:
        """The preamble's value of a subject ("120Hz" behind "OutputRate:"), "" where it has none."""
        for line in self.preamble:
            plain = line.strip().lstrip("/#%").strip().strip('"')
            for subject in subjects:
                if plain.lower().startswith(subject):
                    return plain[len(subject) :].strip(' :=,;\t"')
        return ""

    def stated_number(self, *subjects: str) -> float | None:
        """The number that the preamble states of a subject; None where it states none above zero."""
        number = re.match(r"\d+(?:[.,]\d+)?", self.stated(*subjects))
        value = float(number.group().replace(",", ".")) if number else 0.0
        return value if value > 0 else None


def split_line(line: str, separator: str) -> list[str]:
    """The cells of one line, without blanks and quotes around them."""
    if separator == " ":
        return line.replace('"', "").split()
    if '"' in line:
        try:
            cells = next(csv.reader([line], delimiter=separator, skipinitialspace=True), [])
        except csv.Error:
            cells = line.split(separator)
        return [cell.strip().strip('"').strip() for cell in cells]
    return [cell.strip() for cell in line.split(separator)]


def is_data(cell: str) -> bool:
    """Whether a cell is a number or a time."""
    return bool(_NUMBER.fullmatch(cell) or _STAMP.fullmatch(cell))


def layout_of(lines: Sequence[str]) -> TableLayout | None:
    """Find the table in a text."""
    return _layout_of(tuple(lines[:LAYOUT_LINES]))


@lru_cache(maxsize=16)
def _layout_of(lines: tuple[str, ...]) -> TableLayout | None:
    filled = [line for line in lines if line.strip()]
    sample = filled[len(filled) // 2 :][-60:]
    separator = _separator(sample)
    if separator is None:
        return None
    counts = [_count(split_line(line, separator)) for line in sample]
    typical_data, typical_text = median(c[0] for c in counts), median(c[1] for c in counts)
    width = Counter(len(split_line(line, separator)) for line in sample).most_common(1)[0][0]

    def is_row(line: str) -> bool:
        data, text = _count(split_line(line, separator))
        return data > typical_data / 2 and text <= typical_text + max(1, width // 4)

    first = _first_row(lines, is_row)
    if first is None:
        return None
    # Rows in which most sensors have no value yet stand between the header and the first full row.
    while first > 0 and _is_sparse_row(split_line(lines[first - 1], separator), width):
        first -= 1
    header, units_line = _header(lines, first, separator, width)
    if header >= 0 and _is_numbering(split_line(lines[first], separator)):
        first = next((at for at in range(first + 1, len(lines)) if lines[at].strip()), first)
    written = _stripped(split_line(lines[header], separator)) if header >= 0 else []
    if written:
        written[0] = re.sub(r"^(#+|%+|//+)\s*", "", written[0])
        if separator == " " and not written[0]:  # "# t ax ay": the mark stood alone
            written = written[1:]
    if not all(cell or separator != " " for cell in _stripped(split_line(lines[first], separator))):
        return None
    data_width = len(_stripped_to(split_line(lines[first], separator), len(written)))
    width = max(len(written), min(width, data_width) if written else width)
    names = tuple(written + [""] * (width - len(written))) if written else ()
    under = split_line(lines[units_line], separator) if units_line >= 0 else []
    under = ["" if cell.lower() in _NO_UNIT else cell for cell in under] + [""] * (width - len(under))
    parts = [split_unit(name) for name in names]
    return TableLayout(
        separator,
        tuple(line for line in lines[: max(header, 0) if names else first] if _is_preamble(line)),
        names,
        tuple(below or behind for (_, behind), below in zip(parts, under, strict=False)) or ("",) * width,
        tuple(" ".join(label.lower().split()) for label, _ in parts),
        header,
        first,
        width,
    )


def _separator(sample: list[str]) -> str | None:
    """The separator that makes most lines equally wide rows of numbers."""
    best, best_score = None, 0.3
    for separator in SEPARATORS:
        rows = [split_line(line, separator) for line in sample]
        widths = Counter(len(row) for row in rows if len(row) > 1)
        if not widths:
            continue
        width = widths.most_common(1)[0][0]
        shares = [data / max(data + text, 1) for data, text in (_count(r) for r in rows if len(r) == width)]
        score = sum(shares) / len(rows)
        if score > best_score + 1e-9:
            best, best_score = separator, score
    return best


def _count(cells: list[str]) -> tuple[int, int]:
    """Number of cells with data, and with other text."""
    data = sum(1 for cell in cells if cell and is_data(cell))
    return data, sum(1 for cell in cells if cell) - data


def _first_row(lines: tuple[str, ...], is_row: Callable[[str], bool]) -> int | None:
    """Index of the first line of data that another follows, or that is the last one."""
    filled = [at for at, line in enumerate(lines) if line.strip()]
    for at, following in zip(filled, [*filled[1:], None], strict=True):
        if is_row(lines[at]) and (following is None or is_row(lines[following])):
            return at
    return None


def _is_sparse_row(cells: list[str], width: int) -> bool:
    data, text = _count(cells)
    return data >= 1 and text == 0 and len(cells) >= width


def _header(lines: tuple[str, ...], first: int, separator: str, width: int) -> tuple[int, int]:
    """Indices of the header and of the line of units; -1 where there is none."""
    rows = ((at, split_line(lines[at], separator)) for at in range(first - 1, -1, -1))
    above = list(islice(((at, cells) for at, cells in rows if any(cells)), 1 + _BELOW_NAMES))
    headers = [at for at, cells in above if _is_header(cells, width) and not _is_units_line(cells)]
    units = -1
    for at, cells in above if len(above) > 1 else ():
        if _is_units_line(cells):
            units = at if units < 0 or _is_blank(lines[units], separator) else units
        elif at not in headers or not (_repeats(cells) and at != headers[-1]):
            return (at if at in headers else -1), units
    if units >= 0 or not above:
        return -1, units
    return (above[0][0] if _is_header(above[0][1], width) else -1), -1


def _repeats(cells: list[str]) -> bool:
    filled = [cell for cell in cells if cell]
    return len(filled) >= 4 and 2 * len(set(filled)) <= len(filled)


def _is_blank(line: str, separator: str) -> bool:
    """Whether a line of units states none."""
    return all(cell.lower() in _NO_UNIT for cell in split_line(line, separator))


def _is_numbering(cells: list[str]) -> bool:
    """Whether a line counts the columns."""
    counted = [str(at) for at in range(len(cells) + 1)]
    return len(cells) >= 4 and cells in (counted[:-1], counted[1:])


def _is_units_line(cells: list[str]) -> bool:
    filled = [cell for cell in cells if cell]
    return bool(filled) and sum(map(is_unit, filled)) > len(filled) / 2


def _is_header(cells: list[str], width: int) -> bool:
    data, text = _count(cells)
    return text >= 2 and text > 4 * data and len(cells) >= width / 2 and not _SEP_LINE.fullmatch(cells[0])


def _is_preamble(line: str) -> bool:
    return bool(line.strip()) and not _SEP_LINE.fullmatch(line.strip().strip('"'))


def _stripped(cells: list[str]) -> list[str]:
    """Without the empty cells behind the last one."""
    return _stripped_to(cells, 0)


def _stripped_to(cells: list[str], least: int) -> list[str]:
    end = len(cells)
    while end > least and not cells[end - 1]:
        end -= 1
    return cells[:end]


#: Between the cells: no cell holds it.
SEPARATOR = "\t"
#: Rows at a sheet's beginning by which it is chosen.
_LOOKED_AT = 60
#: Bytes that a workbook may have when it is unpacked, and this many times its own beyond the next: a sheet
#: of Excel's last row with ten columns has 370 MB, packed to a tenth; a file of some kB can claim any number.
_LARGEST, _MOST_PACKED, _SMALL = 400_000_000, 100, 10_000_000
#: Bytes of the parts that are kept in memory: texts of cells, and the rest but sheets and pictures.
_MOST_TEXTS, _MOST_OTHERS = 40_000_000, 10_000_000
#: More columns are no table of a sensor or a skeleton's; a longer line, characters, is no row of one.
MOST_COLUMNS, LONGEST_LINE = 10_000, 1 << 20
#: This many texts are kept for the next reader of the same workbook.
_KEPT = 4


#: A zip's entry of a workbook: its name is some 26 bytes behind the mark.
_OF_WORKBOOK = re.compile(rb"PK\x03\x04.{6,26}(?:xl/|\[Content_Types\])", re.DOTALL)


def is_workbook(raw: bytes) -> bool:
    """Whether a file's beginning is that of an Excel workbook (.xlsx)."""
    return raw.startswith(b"PK\x03\x04") and bool(_OF_WORKBOOK.search(raw))


def workbook_text(path: Path, rows: int | None = None) -> str:
    """The rows of a workbook's table as lines of text."""
    about = path.stat()
    return _text(path, rows, about.st_mtime_ns, about.st_size)


@lru_cache(maxsize=_KEPT)
def _text(path: Path, rows: int | None, mtime_ns: int, size: int) -> str:
    try:
        openpyxl = extra_module("openpyxl", "openpyxl", "xlsx")
    except UnoccludeError as error:
        raise RecordingError(f"{path} is an Excel workbook; {error}, or save it as CSV") from error
    try:
        _check_size(path)
        book = openpyxl.load_workbook(path, read_only=True, data_only=True)
        try:
            sheets = [sheet for sheet in book.worksheets if sheet.sheet_state == "visible"]
            if not sheets:
                raise RecordingError(f"{path} is a workbook without a sheet of cells; save it as CSV.")
            for sheet in sheets:
                sheet.reset_dimensions()  # some programs state the wrong ones
            sheet = max(sheets, key=_numbers)
            lines = (_line(path, row) for row in islice(sheet.iter_rows(values_only=True), rows))
            return "\n".join(lines) + "\n"
        finally:
            book.close()
    except RecordingError:
        raise
    except Exception as error:  # a damaged workbook fails anywhere
        raise RecordingError(
            f"{path} is an Excel workbook that cannot be read ({type(error).__name__}); save it again, or as"
            " CSV."
        ) from error


def unpacked_size(path: Path) -> int:
    """Bytes of a workbook's parts as its directory states them, which no part exceeds when it is read."""
    with zipfile.ZipFile(path) as parts:
        return sum(part.file_size for part in parts.infolist())


def _check_size(path: Path) -> None:
    with zipfile.ZipFile(path) as parts:
        sizes = {part.filename.lstrip("/"): part.file_size for part in parts.infolist()}
    texts = sum(size for name, size in sizes.items() if name.endswith("sharedStrings.xml"))
    loose = ("xl/worksheets/", "xl/media/", "xl/drawings/", "xl/charts/")
    others = sum(size for name, size in sizes.items() if not name.startswith(loose)) - texts
    total = sum(sizes.values())
    packed = path.stat().st_size
    if total > min(_LARGEST, _SMALL + _MOST_PACKED * packed) or texts > _MOST_TEXTS or others > _MOST_OTHERS:
        raise RecordingError(
            f"{path} is a workbook of {total / 1e6:,.0f} MB unpacked (from {packed / 1e6:,.1f} MB), which is"
            " more than is read; save the sheet with the measurements as CSV."
        )


def _numbers(sheet: Any) -> int:
    """How many numbers the first rows of a sheet contain."""
    rows = islice(sheet.iter_rows(values_only=True), _LOOKED_AT)
    return sum(isinstance(value, int | float) for row in rows for value in row)


def _line(path: Path, row: tuple[Any, ...]) -> str:
    cells = [_cell(value) for value in row]
    while cells and not cells[-1]:
        cells.pop()
    line = SEPARATOR.join(cells)
    check_lines(path, [line])
    return line


def check_lines(path: Path, lines: Sequence[str]) -> None:
    """Refuse lines that no table has, before they are parted: a million columns would take all memory."""
    longest = max(map(len, lines), default=0)
    if longest > LONGEST_LINE:
        raise RecordingError(
            f"{path} has a line of {longest:,} characters, and rows of tables with up to {LONGEST_LINE:,} are"
            " read; export it with one row per line."
        )
    for line in lines if longest > MOST_COLUMNS else ():
        columns = 1 + max(line.count(mark) for mark in SEPARATORS[:-1])
        if line.count(" ") >= MOST_COLUMNS:
            columns = max(columns, len(line.split()))
        if columns > MOST_COLUMNS:
            raise RecordingError(
                f"{path} has a row of {columns:,} columns, and tables with up to {MOST_COLUMNS:,} are read;"
                " export the columns of the sensor or the skeleton alone."
            )


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
