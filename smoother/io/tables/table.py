"""Tables in text and workbooks as devices and spreadsheets write them, read fast and forgivingly.

A file's beginning, by which its format is recognised, and how it is shown in a message.
"""

from __future__ import annotations

import codecs
import csv
import re
import zipfile
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from itertools import islice, product
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from ...array_types import BoolArray, FloatArray
from ...errors import RecordingError, UnoccludeError
from ...runtime.inputs import check_input, marked_encoding
from ...runtime.packages import extra_module
from .units import UNITS, plain_unit, split_unit

if TYPE_CHECKING:
    from ..recording.streams import ImuSamples, SkeletonTable

#: What a file holds: sensors, skeletons, or both.
Tables: TypeAlias = "list[ImuSamples] | list[SkeletonTable] | list[ImuSamples | SkeletonTable]"
#: So much of a file is read to recognise it, bytes; this many rows of a workbook.
HEAD_BYTES, HEAD_ROWS = 65_536, 500
#: So much of a file is shown in a message at most, characters.
SHOWN_CHARACTERS = 200
#: Separators in the order in which they are believed where two fit; the last is any number of blanks.
SEPARATORS = (";", "\t", "|", ",", " ")
#: This many lines at the beginning settle the layout.
LAYOUT_LINES = 400
#: How a line above a table states a rate.
_RATE_LINES = (r"(\d+(?:\.\d+)?)\W*hz\b", r"(?:rate|freq|fps)\D*(\d+(?:\.\d+)?)", r"^(\d+(?:\.\d+)?)\W*$")
_OTHER_RATES = r"cut|pass|band|corner|filter\W*\d|baud|bit|heart"
#: Cells without a value, in lower case; Windows and spreadsheets have spellings of their own.
_MISSING = r"^([-+]?(nan(\(.*\))?|inf(inity)?|1\.?#(ind|qnan|snan|inf).*)|#?n/?a|none|null|missing|-+|\*+)?$"
#: More columns are no table of a sensor or a skeleton's; a longer line, characters, is no row of one.
MOST_COLUMNS, LONGEST_LINE = 10_000, 1 << 20
CUT = "The last line is cut off and was left out."
#: A column with a larger share of cells that are not numbers is refused.
_WRONG = 0.05


@dataclass(frozen=True)
class FileHead:
    """What is seen of a file to recognise its format."""

    path: Path  # The file; its name is for messages only and recognises nothing
    raw: bytes  # Its first 64 kB
    text: str  # The same decoded (UTF-8, UTF-16, a byte-order mark taken off), or a workbook's first rows
    lines: tuple[str, ...]  # The text's whole lines
    trouble: str = ""  # Why a workbook cannot be read; "" where it can

    @cached_property
    def table(self) -> DeviceTable | None:
        """The table at its beginning; None where there is none."""
        return layout_of(self.lines, self.path) if self.text else None


@dataclass(frozen=True)
class Format:
    """A layout of files: how a file of it is recognised, and read."""

    key: str  # Its name on the command line (`xsens-dot`)
    title: str  # Its name in sentences ("Xsens DOT export")
    kind: str  # What it contains: "imu", "skeleton" or "recording" (both)
    recognised_by: str  # What in a file gives it away, for `unocclude import formats`
    recognises: Callable[[FileHead], bool]  # Never raises
    read: Callable[[Path], Tables]  # Reads the whole file
    described: bool = False  # By a person, who named the columns: others are not missed


def begins(*marks: bytes) -> Callable[[FileHead], bool]:
    """Recognises files by their first bytes: one of these."""
    return lambda head: head.raw.startswith(marks)


def read_bytes(path: Path, most: int = -1) -> bytes:
    """The bytes of a file, or the first of them."""
    check_input(path, RecordingError)
    try:
        with path.open("rb") as stream:
            return stream.read(most)
    except FileNotFoundError:
        raise RecordingError(f"{path} does not exist; check the name.") from None
    except IsADirectoryError:
        raise RecordingError(f"{path} is a folder; name the file in it.") from None
    except OSError as error:
        raise RecordingError(f"{path} cannot be read: {error.strerror or error}.") from error


def read_head(path: Path) -> FileHead:
    """Read a file's beginning."""
    raw, trouble = read_bytes(path, HEAD_BYTES), ""
    if not raw:
        raise RecordingError(f"{path} is empty; export or copy it again.")
    if is_workbook(raw):
        try:
            text = workbook_text(path, HEAD_ROWS)
        except RecordingError as error:  # other files of its folder can be of use
            text, trouble = "", str(error)
        return FileHead(path, raw, text, tuple(text.splitlines()), trouble)
    text = decode(raw)
    whole = text if len(raw) < HEAD_BYTES else text[: text.rfind("\n") + 1] or text
    return FileHead(path, raw, text, tuple(whole.splitlines()))


#: Among the first characters, more of these than one in this many are not text.
_CONTROL_SHARE = 0.02
#: Dashes that are used as a minus: before a number or the digits of an exponent, not between two numbers.
_DASH = re.compile(r"(?:(?<!\w)|(?<=\d[eE]))[\u2012\u2013](?=[.,]?\d)")


def decode(raw: bytes) -> str:
    """A file's bytes as text without byte-order mark, with plain minus signs; "" where they are not text."""
    encoding = marked_encoding(raw)
    if encoding is None and len(raw) >= 4:  # UTF-16 without a mark: every other byte of plain text is zero
        zeros, half = [raw[start:400:2].count(0) for start in (0, 1)], len(raw[:400]) // 2
        for own, name in ((1, "utf-16-le"), (0, "utf-16-be")):
            encoding = name if zeros[own] > 0.8 * half and not zeros[1 - own] else encoding
    if encoding is None and b"\0" in raw:
        return ""
    try:
        # The last character may be cut in two by the end of the head.
        text = codecs.getincrementaldecoder(encoding or "utf-8")().decode(raw)
    except UnicodeDecodeError:
        text = raw.decode("cp1252", errors="replace")
    start = text[:4000]
    if sum(ord(each) < 32 and each not in "\t\r\n\f" for each in start) > _CONTROL_SHARE * len(start):
        return ""
    return _DASH.sub("-", text.replace("\u2212", "-"))


def no_table(raw: bytes, text: str) -> str:
    """What is plainly no table to read, and what to do: goes behind the file's name; "" for others."""
    if raw.startswith(b"\xd0\xcf\x11\xe0"):
        return "is an Excel workbook of the old kind; save it as .xlsx or CSV."
    if raw.startswith(b"PK\x03\x04") and not is_workbook(raw):
        return "is an archive (zip, or a spreadsheet); unpack it, or save it as CSV."
    lines = [line for line in text.splitlines() if line.strip()]
    names = r"[^\d;,\t][^;,\t]*([;,\t]\s*[^\d\s;,\t+.-][^;,\t]*)+"
    is_header = len(lines) == 1 and re.fullmatch(names, lines[0])
    return "has a header and has no rows; export it again." if is_header else ""


def shown(text: str, characters: int = SHOWN_CHARACTERS) -> str:
    """Text as a message can show it: no control characters, no more than this many characters."""
    plain = " ".join("".join(c if c.isprintable() else " " for c in text[: 8 * characters]).split())
    return plain if len(plain) <= characters else plain[: characters - 2] + ".."


def first_rows(head: FileHead, characters: int = SHOWN_CHARACTERS) -> str:
    """The first rows of a file for a message, or its first bytes where it is not text."""
    if not head.text:
        return f"bytes {head.raw[:16].hex(' ')} .."
    return shown(" | ".join(line for line in head.lines[:4] if line.strip()), characters)


# ------------------------------------------------------------------------------------------------- the table


@dataclass(eq=False)
class DeviceTable:
    """A table of a text: where it is, its columns, and their cells when they are asked for."""

    path: Path
    separator: str  # One of `SEPARATORS`
    preamble: tuple[str, ...]  # Lines above the header, without `sep=` and blank lines
    names: tuple[str, ...]  # Column names as written, `width` of them ("" = none); () without a header
    units: tuple[str, ...]  # By column, from the line of units or from brackets behind the name
    labels: tuple[str, ...]  # Names for comparing: without bracketed units, lower case, single blanks
    header: int  # Index of the header's line; -1 where there is none
    first_row: int  # Index of the first line of data
    width: int  # Number of columns
    lines: Sequence[str] = ()  # Of the text, until the cells are read
    notes: list[str] = field(default_factory=list)  # What was dropped, one sentence each
    strict: bool = False  # Refuse any cell that is not a number
    _numbers: dict[int, FloatArray] = field(default_factory=dict)
    _line_numbers: Sequence[int] = ()

    @cached_property
    def cells(self) -> Any:
        """An Arrow table of text."""
        import pyarrow as pa
        from pyarrow import csv as arrow_csv

        rows, self._line_numbers, notes = _even_rows(_first_table(list(self.lines), self), self)
        self.notes += notes
        self.lines = ()
        if not rows:
            raise RecordingError(f"{self.path} has no rows below its header; export it again.")
        mark = "\t" if self.separator == " " else self.separator
        names = [str(at) for at in range(max(self.width, _separators_in(rows[0], mark) + 1))]
        data = "\n".join(rows).encode("utf-8", errors="replace")
        size, types = max(1 << 20, len(data) + 1), dict.fromkeys(names, pa.string())
        try:
            return arrow_csv.read_csv(
                pa.BufferReader(data),
                arrow_csv.ReadOptions(column_names=names, block_size=size, use_threads=False),
                arrow_csv.ParseOptions(delimiter=mark, invalid_row_handler=lambda _: "skip"),
                arrow_csv.ConvertOptions(column_types=types, strings_can_be_null=False),
            )
        except pa.ArrowException as error:
            said = shown(str(error), 120)
            raise RecordingError(f"{self.path} cannot be read as a table: {said}.") from error

    def __len__(self) -> int:
        return self.cells.num_rows

    def find(self, *labels: str) -> int | None:
        """Number of the first column (from 0) that has one of these labels; the first label first."""
        return next((self.labels.index(label) for label in labels if label in self.labels), None)

    def axes(self, *forms: str, signs: Sequence[str] = ("xyz",)) -> tuple[int, int, int] | None:
        """Columns of a vector by labels of one of these forms (`{}` is the axis) and the axes' signs."""
        for form, sign in product(forms, signs):
            x, y, z = (self.find(form.format(axis)) for axis in sign)
            if x is not None and y is not None and z is not None:
                return x, y, z
        return None

    def stated(self, *subjects: str) -> str:
        """The preamble's value of a subject ("120Hz" behind "OutputRate:"), "" where it has none."""
        plain = (line.strip().lstrip("/#%").strip().strip('"') for line in self.preamble)
        found = ((line, each) for line in plain for each in subjects if line.lower().startswith(each))
        return next((line[len(each) :].strip(' :=,;\t"') for line, each in found), "")

    def above_rate_hz(self) -> float | None:
        """The rate that a line above the table states, by its word or as a number alone (Vicon); or None."""
        comma = r"(?!)" if self.separator == "," else r"(?<=\d),(?=\d)(?!000)"  # of decimals
        plain = (re.sub(comma, ".", line.strip().lower()) for line in self.preamble)
        lines = [line for line in plain if not re.search(_OTHER_RATES, line)]
        found = (re.search(form, line) for form, line in product(_RATE_LINES, lines))
        return next((float(number[1]) or None for number in found if number), None)

    def name(self, column: int) -> str:
        """Name of a column for messages."""
        written = self.names[column] if self.names else ""
        return f"column {written or column + 1}"

    def line(self, row: int) -> int:
        """Line of the file (from 1) in which a row stands."""
        return self._line_numbers[row] + 1

    def texts(self, column: int) -> list[str]:
        """Cells of a column as text, without blanks around them."""
        return self._trimmed(column).to_pylist()

    def vectors(self, columns: Sequence[int]) -> FloatArray:
        """Columns of numbers side by side, shape (n, number of columns)."""
        return np.stack([self.numbers(column) for column in columns], axis=1)

    def times(self, column: int) -> tuple[FloatArray, bool]:  # -> times (n,), dates
        """A column of numbers, or of dates."""
        cells = self.texts(column)
        sample = [cell for cell in cells[:50] if cell]
        if not any(re.search(r"\d[-/.:]\d+[-/.:]\d", cell) for cell in sample):
            return self.numbers(column), False
        seconds = seconds_of_dates(cells)
        filled = np.array([not re.match(_MISSING, cell.lower()) for cell in cells])
        self._refuse_many(column, np.flatnonzero(filled & ~np.isfinite(seconds)), int(filled.sum()), "time")
        return seconds, True

    def is_numeric(self, column: int) -> bool:
        """Whether most cells of a column are numbers."""
        try:
            return bool(np.isfinite(self.numbers(column)).mean() > 0.5)
        except RecordingError:
            return False

    def numbers(self, column: int) -> FloatArray:  # -> (n,)
        """A column of numbers; empty cells, and few that are no numbers, are nan."""
        if column not in self._numbers:
            self._numbers[column] = self._read_numbers(column)
        return self._numbers[column]

    def refuse_nameless(self, most: int = 0) -> None:
        """Refuse a header with fewer names than the rows have cells: whose are the names then?"""
        named = max((at + 1 for at, name in enumerate(self.names) if name), default=0)
        nameless = range(named, self.width) if self.names else range(0)
        if sum(any(self.texts(column)[:20]) for column in nameless) > most:
            raise RecordingError(
                f"{self.path}: the header (line {self.header + 1}) names {named} columns, and the rows"
                f" have {self.width}; export the file again, or describe it in a recording.toml."
            )

    def _trimmed(self, column: int) -> Any:
        import pyarrow.compute as pc

        return pc.utf8_trim_whitespace(self.cells.column(column).combine_chunks())

    def _read_numbers(self, column: int) -> FloatArray:
        import pyarrow as pa
        import pyarrow.compute as pc

        text, nothing = self._trimmed(column), pa.scalar(None, pa.string())
        empty = pc.match_substring_regex(pc.utf8_lower(text), _MISSING)
        text = pc.if_else(empty, nothing, text)
        try:
            numbers = pc.cast(text, pa.float64())
        except pa.ArrowException:
            comma = pc.match_substring_regex(text, r"^[+-]?\d*,\d+([eE][+-]?\d{1,3})?$")
            text = pc.if_else(comma, pc.replace_substring(text, ",", ".", max_replacements=1), text)
            text = pc.replace_substring_regex(text, r"(\d\.?)[dD]([+-]?\d)", r"\1e\2")  # Fortran's exponents
            plain = pc.match_substring_regex(text, r"^[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d{1,3})?$")
            numbers = pc.cast(pc.if_else(plain, text, nothing), pa.float64())
        values = np.array(numbers.to_numpy(zero_copy_only=False), dtype=float)
        filled = ~empty.to_numpy(zero_copy_only=False)
        wrong = np.flatnonzero(filled & ~np.isfinite(values))
        if len(wrong):
            values[wrong] = np.nan
            first = self._refuse_many(column, wrong, int(filled.sum()), "number")
            self.notes.append(
                f"Cells of {shown(self.name(column), 60)} that are no numbers, treated as missing:"
                f" {len(wrong)} ('{first}' in line {self.line(int(wrong[0]))})."
            )
        return values

    def _refuse_many(self, column: int, wrong: np.ndarray, filled: int, what: str) -> str:
        """Refuse a column with too many wrong cells; the first of them."""
        if not len(wrong):
            return ""
        first = shown(self.cells.column(column)[int(wrong[0])].as_py(), 40)
        if len(wrong) > (0 if self.strict else max(_WRONG * filled, 1)):
            raise RecordingError(
                f"{self.path}, line {self.line(int(wrong[0]))}: '{first}' in {shown(self.name(column), 60)}"
                f" is not a {what}, like {len(wrong):,} of its {filled:,} cells, too many to leave out;"
                " correct the cells, or export the file again."
            )
        return first


def file_text(path: Path) -> str:
    """The text of a file, or the rows of a workbook; "" where it is neither."""
    raw = read_bytes(path)
    text = workbook_text(path) if is_workbook(raw[:HEAD_BYTES]) else decode(raw)
    if refused := no_table(raw[:HEAD_BYTES], text if len(text) < HEAD_BYTES else ""):
        raise RecordingError(f"{path} {refused}")
    return text.replace("\r\n", "\n").replace("\r", "\n")


def read_table(
    path: Path,
    expected: str = "a table",
    quote: bool = True,
    strict: bool = False,
    separator: str | None = None,
    skip: int | None = None,  # Lines above the header, where they are stated
    text: str | None = None,  # Of the file, where it is there already
) -> DeviceTable:
    """Read a delimited text file, or an Excel workbook; its layout is looked for."""
    if text is None:
        text = file_text(path)
        if not text.strip():
            what = "is not text" if path.stat().st_size else "is empty"
            raise RecordingError(f"{path} {what}, but should be {expected}; export it again.")
    lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    _check_lines(path, lines)
    if skip and not any(line.strip() for line in lines[skip:]):
        raise RecordingError(f"{path} has no rows below the first {skip}; correct skip_rows.")
    table = layout_of(lines, path, separator, skip)
    if table is None:
        seen = shown(" | ".join(line for line in lines[:4] if line.strip()))
        seen = f"; it begins: {seen}" if quote else "; name the right file."
        raise RecordingError(f"{path} should be {expected}, but no rows of numbers were found{seen}")
    table.strict = strict
    len(table)  # reads the cells, and drops the lines
    return table


def _check_lines(path: Path, lines: Sequence[str]) -> None:
    """Refuse lines that no table has, before they are parted: a million columns would take all memory."""
    longest = max(map(len, lines), default=0)
    if longest > LONGEST_LINE:
        raise RecordingError(
            f"{path} has a line of {longest:,} characters ({LONGEST_LINE:,} are read); export a row per line."
        )
    for line in lines if longest > MOST_COLUMNS else ():
        columns = max(1 + max(line.count(mark) for mark in SEPARATORS[:-1]), len(line.split()))
        if columns > MOST_COLUMNS:
            raise RecordingError(
                f"{path} has a row of {columns:,} columns (read are {MOST_COLUMNS:,}); export those needed."
            )


# ------------------------------------------------------------------------------------------------- its rows

_QUOTED = re.compile(r'"[^"]*"')
#: Rows before the last one that show that its number is cut off; in a table that is refused; most.
_FEWEST, _FEWEST_STRICT, _ROWS_BEFORE = 3, 20, 50


def _first_table(lines: list[str], table: DeviceTable) -> list[str]:
    """The lines down to a blank one behind which another table begins, of words and names (Vicon)."""
    header, at = lines[table.header] if table.header >= 0 else "", table.first_row
    with suppress(ValueError):  # there is no blank line any more
        for _ in range(_BLANK_LINES):
            at = lines.index("", at) + 1
            begin = [line for line in lines[at : at + _GROUP_ROWS] if line.strip()]
            cells = [_count(split_line(line, table.separator)) for line in begin]
            names = next((words for numbers, words in cells if numbers + words > 2), 0)
            if begin and begin[0] != header and not cells[0][0] and names > 2:
                said = f"A second table begins in line {at + 1} ('{shown(lines[at], 40)}') and was not read;"
                table.notes.append(f"{said} save it in a file of its own to use it.")
                return [*lines[: at - 1], ""]
    return lines


def _even_rows(lines: list[str], table: DeviceTable) -> tuple[list[str], Sequence[int], list[str]]:
    """Rows with equally many cells, the lines they stand in, and what was done."""
    first, width, mark = table.first_row, table.width, table.separator
    end = next((at for at in range(len(lines), first, -1) if lines[at - 1].strip()), first)
    rows = lines[first:end]
    if mark == " ":
        mark, rows = "\t", ["\t".join(row.replace('"', "").split()) for row in rows]
    else:
        rows = [row.replace(f'{mark} "', f'{mark}"') if '"' in row else row for row in rows]
    counts = [_separators_in(row, mark) for row in rows]
    usual = Counter(counts).most_common(1)[0][0] if counts else 0
    header = lines[table.header].strip() if table.header >= 0 else None
    ends = rows and lines[-1].strip()
    notes = [_end_note(rows, counts[-1] < usual, mark, end, table.strict)] if ends else []
    if notes == [CUT]:
        rows, counts = rows[:-1], counts[:-1]
    # Separators behind the last column make empty columns, which do no harm.
    is_wide = usual == width - 1 if table.strict else usual >= width - 1
    if is_wide and counts.count(usual) == len(rows) and header not in rows:
        return rows, range(first, first + len(rows)), notes
    even: list[str] = []
    indices: list[int] = []
    short = long = repeated = 0
    for line, (row, count) in enumerate(zip(rows, counts, strict=True), first):
        if not row.strip(mark + " "):
            continue
        if row.strip() == header or (header and row.startswith(header[:40]) and row.strip()[:1].isalpha()):
            repeated += 1
            continue
        # Where blanks part the cells, it is not clear which of a row are missing.
        unclear = count < width - 1 and table.separator == " "
        if table.strict and (unclear or any(split_line(row, mark)[width:])):
            raise RecordingError(
                f"{table.path}, line {line + 1}: {count + 1} cells where there are {width}; correct it."
            )
        if count < width - 1:
            short += count < usual
            row += mark * (width - 1 - count)
        elif count > width - 1:
            cells = split_line(row, mark)
            if any(cells[width:]):
                long += 1
                continue
            row = mark.join(cell.replace(mark, " ") for cell in cells[:width])
        even.append(row)
        indices.append(line)
    said = (
        ("Repeated headers among the rows, left out", repeated),
        ("Rows shorter than the others, what is lacking treated as missing", short),
        ("Rows with more cells than columns, left out", long),
    )
    return even, indices, notes + [f"{what}: {count}." for what, count in said if count]


def _end_note(rows: list[str], is_short: bool, mark: str, line: int, strict: bool) -> str:
    """What is to be said of a text that does not end with a line's end."""
    # a number is cut off if it has fewer decimals than all before it, which have equally many
    cells = [row.rsplit(mark, 1)[-1].strip().strip('"') for row in rows[-_ROWS_BEFORE:]]
    *before, last = [cell.replace(",", ".").partition(".")[2] for cell in cells]
    decimals = {len(digits) for digits in before if digits.isdigit()}
    shows = len(before) >= (_FEWEST_STRICT if strict else _FEWEST) and len(decimals) == 1 and all(before)
    if is_short or (shows and len(last) < min(decimals)):
        return CUT
    return f"The file ends without a line break; if it was cut off, what came behind line {line} is missing."


def _separators_in(row: str, mark: str) -> int:
    """How many separators a row has outside quotes."""
    return (_QUOTED.sub("", row) if '"' in row else row).count(mark)


def split_line(line: str, separator: str) -> list[str]:
    """The cells of one line, without blanks and quotes around them."""
    if separator == " ":
        return line.replace('"', "").split()
    cells = line.split(separator)
    if '"' in line:
        with suppress(csv.Error):
            cells = next(csv.reader([line], delimiter=separator, skipinitialspace=True), [])
        cells = [cell.strip().strip('"') for cell in cells]
    return [cell.strip() for cell in cells]


# ------------------------------------------------------------------------------------ where in a text it is

_DATA = re.compile(
    r"[+-]?(\d+(\.\d*|,\d+)?|[.,]\d+)(e[+-]?\d+)?|[+-]?nan|[+-]?inf(inity)?|null"
    r"|\d{4}[-/.]\d\d?[-/.]\d\d?\b.*|\d\d?[-/.]\d\d?[-/.]\d{4}\b.*|\d\d?:\d\d([.,]\d+|:\d\d([.,:_]\d+)?)?",
    re.IGNORECASE,
)
#: Rows above the names that name groups, at most; names that repeat then; blank lines that are looked behind.
_GROUP_ROWS, _REPEATED, _BLANK_LINES = 6, 3, 20
#: This many lines may be between the names and the rows; cells of them that state no unit.
_BELOW_NAMES, _NO_UNIT = 3, ("", "-", "--", "n/a", "none", "no_units", "nounits", "unitless")
_SEP_LINE = re.compile(r'"?sep=.{0,3}"?', re.IGNORECASE)


def plain_label(text: str) -> str:
    """A column's name for comparing: in lower case, with single blanks."""
    return " ".join(text.lower().split())


def layout_of(
    lines: Sequence[str], path: Path = Path(), separator: str | None = None, skip: int | None = None
) -> DeviceTable | None:
    """Find the table in a text; its cells are not read yet. Below `skip` lines its header follows at once."""
    start = ("",) * (skip or 0) + tuple(lines[skip or 0 : (skip or 0) + LAYOUT_LINES])
    places = [at for at, line in enumerate(start) if line.strip()]
    sample = [start[at] for at in places[len(places) // 2 :][-60:]]
    separator = separator or _separator(sample)
    if separator is None or not sample:
        return None
    rows = {at: split_line(start[at], separator) for at in places}
    width = Counter(len(split_line(line, separator)) for line in sample).most_common(1)[0][0]
    if skip is None:
        counts = [_count(split_line(line, separator)) for line in sample]
        found = _rows_of(rows, counts, width)
    else:
        data, text = _count(rows[places[0]])
        header, first = (places[0] if text > data else -1), places[0]
        if header >= 0:  # and lines of units and the like
            below = (at for at in places[1 : 2 + _BELOW_NAMES] if _count(rows[at])[0])
            first = next(below, places[1] if len(places) > 2 + _BELOW_NAMES else len(start))
        found = (header, -1, first) if first < len(start) else None
    if found is None:
        return None
    header, units_line, first = found
    written = _stripped(rows[header]) if header >= 0 else []
    if written:
        written[0] = re.sub(r"^(#+|%+|//+)\s*", "", written[0])
        if separator == " " and not written[0]:  # "# t ax ay": the mark stood alone
            written = written[1:]
        block = [at for at in range(header - _GROUP_ROWS, header) if rows.keys() >= {*range(at, header)}]
        written = _told_apart(written, [rows[at] for at in block])
    data_width = len(_stripped(rows[first], len(written)))
    width = max(len(written), min(width, data_width) if written else width)
    names = tuple(written + [""] * (width - len(written))) if written else ()
    under = rows[units_line] if units_line >= 0 else []
    under = ["" if cell.lower() in _NO_UNIT else cell for cell in under] + [""] * (width - len(under))
    parts = [split_unit(name) for name in names]
    above = start[: max(header, 0) if names else first]
    return DeviceTable(
        path,
        separator,
        tuple(line for line in above if line.strip() and not _SEP_LINE.fullmatch(line.strip())),
        names,
        tuple(below or behind for (_, behind), below in zip(parts, under, strict=False)) or ("",) * width,
        tuple(plain_label(label) for label, _ in parts),
        header,
        first,
        width,
        lines,
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
        # blanks within a cell, as between a date and a time, part none
        if score > best_score + (0.1 if separator == " " and best is not None else 1e-9):
            best, best_score = separator, score
    return best


def _count(cells: list[str]) -> tuple[int, int]:
    """Number of cells with data (a number or a time), and with other text."""
    filled = [cell for cell in cells if cell]
    data = sum(bool(_DATA.fullmatch(cell)) for cell in filled)
    return data, len(filled) - data


def _rows_of(
    rows: dict[int, list[str]], counts: list[tuple[int, int]], width: int
) -> tuple[int, int, int] | None:
    """Indices of the header and the line of units (-1 where there is none), and of the first row."""
    typical_data, typical_text = median(c[0] for c in counts), median(c[1] for c in counts)

    def is_row(at: int) -> bool:
        data, text = _count(rows[at])
        return data > typical_data / 2 and text <= typical_text + max(1, width // 4)

    # the first line of data that another follows, or that is the last one
    places = list(rows)
    pairs = zip(places, [*places[1:], None], strict=True)
    first = next((at for at, after in pairs if is_row(at) and (after is None or is_row(after))), None)
    if first is None:
        return None
    # Rows in which most sensors have no value yet stand between the header and the first full row.
    while len(cells := rows.get(first - 1, [])) >= width and _count(cells)[0] and not _count(cells)[1]:
        first -= 1
    above = [(at, rows[at]) for at in places if at < first and any(rows[at])][: -2 - _BELOW_NAMES : -1]
    header, units_line = _header(rows, above, width)
    cells, counted = rows[first], [str(at) for at in range(len(rows[first]) + 1)]
    if header >= 0 and len(cells) >= 4 and cells in (counted[:-1], counted[1:]):  # it counts the columns
        first = next((at for at in places if at > first), first)
    return header, units_line, first


def _header(rows: dict[int, list[str]], above: list[tuple[int, list[str]]], width: int) -> tuple[int, int]:
    """Indices of the header and of the line of units among the lines above; -1 where there is none."""
    headers = [at for at, cells in above if _is_header(cells, width) and not _is_units_line(cells)]
    units = -1
    for at, cells in above if len(above) > 1 else ():
        filled = [cell for cell in cells if cell]
        if _is_units_line(cells):
            is_blank = units >= 0 and all(cell.lower() in _NO_UNIT for cell in rows[units])
            units = at if units < 0 or is_blank else units
        elif not (at in headers[:-1] and len(filled) >= 4 and len(set(filled)) < 3):
            return (at if at in headers else -1), units
    if units >= 0 or not above:
        return -1, units
    return (above[0][0] if _is_header(above[0][1], width) else -1), -1


def _told_apart(names: list[str], above: list[list[str]]) -> list[str]:
    """Names that repeat (X, Y, Z) with what the rows above say of them: a marker, a sensor."""
    count, first = Counter(filter(None, names)), names
    if sum(count.values()) - len(count) < _REPEATED:
        return names
    for cells in above:
        numbers, words = _count(cells)
        if words < 2 or numbers > words or len(cells) < len(names) / 2:
            continue
        group, joined = "", []
        for name, once, cell in zip(names, first, cells + [""] * len(names), strict=False):
            group = cell or group
            joined.append(name if count[once] == 1 else f"{group} {name}")
        names = joined if len(set(joined)) > len(set(names)) else names
    return names


def _is_units_line(cells: list[str]) -> bool:
    filled = [cell for cell in cells if cell]
    return bool(filled) and sum(plain_unit(cell) in UNITS for cell in filled) > len(filled) / 2


def _is_header(cells: list[str], width: int) -> bool:
    data, text = _count(cells)
    return text >= 2 and text > 4 * data and len(cells) >= width / 2 and not _SEP_LINE.fullmatch(cells[0])


def _stripped(cells: list[str], least: int = 0) -> list[str]:
    """Without the empty cells behind the last one, but no fewer than that."""
    filled = [at + 1 for at, cell in enumerate(cells) if cell]
    return cells[: max([least, *filled[-1:]])]


# ---------------------------------------------------------------------------------------------------- dates

#: A date and a time, or a time of day alone.
_DATE = (
    r"^\s*(?:(?:(?P<y>\d{4})[-/.](?P<m>\d\d?)[-/.](?P<d>\d\d?)"
    r"|(?P<a>\d\d?)(?P<mark>[-/.])(?P<b>\d\d?)[-/.](?P<Y>\d{4}))[ T_]+)?"
    r"(?P<hour>\d\d?)(?P<colon>[:.])(?P<minute>\d\d)(?:[:.](?P<second>\d\d)(?:[.,:_](?P<part>\d{1,15})\d*)?)?"
    r"\s*(?P<noon>[AaPp][Mm])?\s*(?:Z|UTC|GMT)?\s*(?:(?P<sign>[+-])(?P<zone>\d\d?):?(?P<minutes>\d\d)?)?\s*$"
)
_DAY_S = 86_400.0


def seconds_of_dates(cells: Sequence[str]) -> FloatArray:  # -> (n,) s
    """Times of dates (`2026-01-31T10:11:12.5Z`, with or without a zone) or of times of day (`10:11:12.5`)."""
    import pyarrow as pa
    import pyarrow.compute as pc

    # spreadsheets show times of day as 12:34.5, without the hour
    texts = pa.array(cells, pa.string())
    whole = pc.replace_substring_regex(texts, r"^\s*(\d\d?:\d\d[.,]\d+)\s*$", r"0:\1")
    found = pc.extract_regex(whole, _DATE)

    def text(name: str) -> Any:
        return pc.fill_null(pc.struct_field(found, name), "")

    def number(name: str) -> FloatArray:
        return np.asarray(pc.cast(pc.binary_join_element_wise("0", text(name), ""), pa.float64()))

    def has(name: str, *what: str) -> BoolArray:
        return np.asarray(pc.is_in(text(name), pa.array(what)))

    # 01/31/2026, unless some first number is no month; 31.01.2026 elsewhere
    is_american = has("mark", "/") & ~(number("a") > 12).any()
    month = number("m") + np.where(is_american, number("a"), number("b"))
    day = number("d") + np.where(is_american, number("b"), number("a"))
    hour = np.where(
        has("noon", ""), number("hour"), number("hour") % 12 + 12 * has("noon", "pm", "PM", "Pm", "pM")
    )
    zone = np.where(has("sign", "-"), -60, 60) * (60 * number("zone") + number("minutes"))
    seconds = 3600 * hour + 60 * number("minute") + number("second")
    months = (12 * (number("y") + number("Y") - 1970) + month - 1).astype("M8[M]")
    date = months.astype("M8[D]") + (day - 1).astype(np.int64)
    is_time = (hour < 24) & (number("minute") < 60) & (number("second") < 60) & (np.abs(zone) < _DAY_S)
    is_date = (date.astype("M8[M]") == months) & (month >= 1) & (month <= 12)
    is_dated = ~has("y", "") | ~has("mark", "")
    seconds += np.where(is_dated, date.astype(np.int64) * _DAY_S - zone, 0.0)
    seconds += number("part") / 10.0 ** np.asarray(pc.utf8_length(text("part")))
    seconds[~(is_time & np.where(is_dated, is_date, has("colon", ":") & ~has("second", "")))] = np.nan
    if np.nanmax(seconds, initial=0.0) < 2 * _DAY_S:  # times of day: midnight passes, or an hour
        steps, wrap_s = np.diff(seconds, prepend=seconds[:1]), _DAY_S if whole.equals(texts) else 3600.0
        seconds = seconds + wrap_s * np.cumsum(np.nan_to_num(steps) < -wrap_s / 2)
    return seconds


# ------------------------------------------------------------------------------------------------ workbooks

#: Rows at a sheet's beginning by which it is chosen.
_LOOKED_AT = 60
#: Bytes that a workbook may have when it is unpacked, and this many times its own beyond the next: a sheet
#: of Excel's last row with ten columns has 370 MB, packed to a tenth; a file of some kB can claim any number.
_LARGEST, _MOST_PACKED, _SMALL = 400_000_000, 100, 10_000_000
#: Bytes of the parts that are kept in memory: texts of cells, and the rest but sheets and pictures.
_MOST_TEXTS, _MOST_OTHERS = 40_000_000, 10_000_000
#: A zip's entry of a workbook: its name is some 26 bytes behind the mark.
_OF_WORKBOOK = re.compile(rb"PK\x03\x04.{6,26}(?:xl/|\[Content_Types\])", re.DOTALL)


def is_workbook(raw: bytes) -> bool:
    """Whether a file's beginning is that of an Excel workbook (.xlsx)."""
    return raw.startswith(b"PK\x03\x04") and bool(_OF_WORKBOOK.search(raw))


def workbook_text(path: Path, rows: int | None = None) -> str:
    """The rows of a workbook's table as lines of text, its cells parted by tabs."""
    about = path.stat()
    return _workbook_text(path, rows, about.st_mtime_ns, about.st_size)


@lru_cache(maxsize=4)
def _workbook_text(path: Path, rows: int | None, mtime_ns: int, size: int) -> str:
    try:
        openpyxl = extra_module("openpyxl", "openpyxl", "xlsx")
    except UnoccludeError as error:
        raise RecordingError(f"{path} is an Excel workbook; {error}, or save it as CSV") from error
    try:
        _check_size(path, size)
        book = openpyxl.load_workbook(path, read_only=True, data_only=True)
        try:
            sheets = [sheet for sheet in book.worksheets if sheet.sheet_state == "visible"]
            if not sheets:
                raise RecordingError(f"{path} is a workbook without a sheet of cells; save it as CSV.")
            for sheet in sheets:
                sheet.reset_dimensions()  # some programs state the wrong ones
            heads = [islice(sheet.iter_rows(values_only=True), _LOOKED_AT) for sheet in sheets]
            numbers = [sum(isinstance(v, int | float) for row in rows for v in row) for rows in heads]
            lines = []
            for row in islice(sheets[int(np.argmax(numbers))].iter_rows(values_only=True), rows):
                lines.append("\t".join(_stripped([_cell(value) for value in row])))
                _check_lines(path, lines[-1:])
            return "\n".join(lines) + "\n"
        finally:
            book.close()
    except RecordingError:
        raise
    except Exception as error:  # a damaged workbook fails anywhere
        raise RecordingError(
            f"{path} is an Excel workbook that cannot be read ({type(error).__name__}); save it as CSV."
        ) from error


def part_sizes(path: Path) -> dict[str, int]:
    """Bytes of a workbook's parts as its directory states them, which no part exceeds when it is read."""
    with zipfile.ZipFile(path) as parts:
        return {part.filename.lstrip("/"): part.file_size for part in parts.infolist()}


def _check_size(path: Path, packed: int) -> None:
    sizes = part_sizes(path)
    texts = sum(size for name, size in sizes.items() if name.endswith("sharedStrings.xml"))
    loose = ("xl/worksheets/", "xl/media/", "xl/drawings/", "xl/charts/")
    others = sum(size for name, size in sizes.items() if not name.startswith(loose)) - texts
    total = sum(sizes.values())
    if total > min(_LARGEST, _SMALL + _MOST_PACKED * packed) or texts > _MOST_TEXTS or others > _MOST_OTHERS:
        raise RecordingError(
            f"{path} is a workbook of {total / 1e6:,.0f} MB unpacked (from {packed / 1e6:,.1f} MB), which is"
            " more than is read; save the sheet with the measurements as CSV."
        )


def _cell(value: Any) -> str:
    """A cell as text."""
    if value is None:
        return ""
    whole = isinstance(value, float) and value.is_integer() and abs(value) < 1e15
    return str(int(value)) if whole or isinstance(value, bool) else " ".join(str(value).split())
