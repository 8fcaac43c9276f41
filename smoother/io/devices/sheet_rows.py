"""Rows of a table of text, made equally wide."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence

from .head import amount
from .table_layout import TableLayout, split_line

CUT = "The last line is cut off and was left out."
#: Rows at the end of a text that show how numbers are written.
ROWS_BEFORE = 50
_QUOTED = re.compile(r'"[^"]*"')


def even_rows(lines: list[str], layout: TableLayout) -> tuple[list[str], Sequence[int], list[str]]:
    """Rows with equally many cells.

    Parameters
    ----------
    lines : list of str
        All lines of the text; the last is "" where the text ends with a line's end.
    layout : TableLayout
        Where the table is.

    Returns
    -------
    rows : list of str
        Without blank lines, repeated headers and a last line that is cut off; short ones are filled up.
    numbers : sequence of int
        Index of each row's line.
    notes : list of str
        What was done, a sentence each.
    """
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
        notes.append(f"{rows_are} shorter than the others; what is lacking counts as missing.")
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
    """Whether the last of a column's cells has fewer decimals than all before it, which have equally many.

    `fewest`: cells before it that it takes to say so; some programs leave out a last zero.
    """
    *before, last = [cell.strip().strip('"').replace(",", ".").partition(".")[2] for cell in cells]
    decimals = {len(digits) for digits in before if digits.isdigit()}
    return len(before) >= fewest and len(decimals) == 1 and all(before) and len(last) < min(decimals)


def separators_in(row: str, mark: str) -> int:
    """How many separators a row has outside quotes."""
    return (_QUOTED.sub("", row) if '"' in row else row).count(mark)
