"""A table laid out for the width of a terminal: no word is broken, whatever the width."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from rich.console import RenderableType

Cells = Sequence[Sequence[str]]
#: A longer word (a path) may be broken.
LONGEST_WORD = 32
#: What a column takes besides its text, and a table besides its columns: with lines, and without.
_LINED, _PLAIN = (3, 1), (2, 0)


def laid_out(title: str, columns: Sequence[str], cells: Cells, width: int) -> RenderableType:
    """A table that fits into `width` characters with its words whole.

    With lines between the columns where there is room; else without; else turned, its rows as columns; else
    a paragraph for each row.

    Parameters
    ----------
    title : str
        Above the table.
    columns : sequence of str, length n
        Heads.
    cells : sequence of sequence of str, shape (rows, n)
        The first of a row says what the row is.
    width : int, characters
        Of the terminal.

    Returns
    -------
    table : rich renderable
        For rich's console.
    """
    from rich.console import Group
    from rich.text import Text

    heading = Text(title, style="bold")
    for needed in (_whole_widths, _whole_cells, _word_widths):
        for lined in (True, False):
            if sum(needed(columns, cells)) <= _room(len(columns), width, lined):
                return Group(heading, _table(columns, cells, width, lined))
    turned = list(zip(columns, *cells, strict=True))
    if cells and sum(_whole_widths(turned[0], turned[1:])) <= _room(len(turned[0]), width, lined=False):
        return Group(heading, _table(turned[0], turned[1:], width, lined=False))
    return Group(heading, *_paragraphs(columns, cells))


def _room(count: int, width: int, lined: bool) -> int:
    """Characters that are left for the text of so many columns."""
    column, ends = _LINED if lined else _PLAIN
    return width - column * count - ends


def _whole_widths(columns: Sequence[str], cells: Cells) -> list[int]:
    """Widths at which heads and cells stand on one line each."""
    return [max(map(_whole, texts)) for texts in zip(columns, *cells, strict=True)]


def _whole_cells(columns: Sequence[str], cells: Cells) -> list[int]:
    """Widths at which cells do, and heads are broken between words."""
    texts = list(zip(*cells, strict=True)) or [()] * len(columns)
    return [
        max(_longest_word(column), *map(_whole, below), 0)
        for column, below in zip(columns, texts, strict=True)
    ]


def _word_widths(columns: Sequence[str], cells: Cells) -> list[int]:
    """Widths at which cells are broken between words, too."""
    return [max(map(_longest_word, texts)) for texts in zip(columns, *cells, strict=True)]


def _whole(text: str) -> int:
    return max((len(line) for line in text.splitlines()), default=0)


def _longest_word(text: str) -> int:
    return min(max((len(word) for word in text.split()), default=0), LONGEST_WORD)


def _table(columns: Sequence[str], cells: Cells, width: int, lined: bool) -> RenderableType:
    from rich import box
    from rich.table import Table
    from rich.text import Text

    widths = _word_widths(columns, cells)
    for wanted in (_whole_cells(columns, cells), _whole_widths(columns, cells)):
        for place in sorted(range(len(widths)), key=lambda k: wanted[k] - widths[k]):  # numbers before prose
            left = _room(len(columns), width, lined) - sum(widths)
            widths[place] += max(min(wanted[place] - widths[place], left), 0)
    table = Table(
        box=box.HEAVY_HEAD if lined else box.SIMPLE_HEAD,
        padding=(0, 1) if lined else (0, 1, 0, 0),
        show_edge=lined,
        pad_edge=lined,
    )
    for place, column in enumerate(columns):
        numbers = all(_is_number(row[place]) for row in cells)
        justify: Literal["left", "right"] = "right" if numbers else "left"
        table.add_column(Text(column), justify=justify, overflow="fold", width=widths[place])
    for row in cells:
        table.add_row(*[Text(text) for text in row])
    return table


def _is_number(text: str) -> bool:
    try:
        float(text.strip("-+% ") or 0)
    except ValueError:
        return False
    return True


def _paragraphs(columns: Sequence[str], cells: Cells) -> Iterator[RenderableType]:
    """Every row by itself: its first cell, then a line for each of the others."""
    from rich.text import Text

    for first, *others in cells:
        yield Text(f"{columns[0]} {first}".strip())
        for name, text in zip(columns[1:], others, strict=True):
            yield Text(f"  {name}: {text}".rstrip())
