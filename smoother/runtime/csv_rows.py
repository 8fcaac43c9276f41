"""Rows of CSV: a text that a spreadsheet would run as a formula is escaped, and read back as it was."""

from __future__ import annotations

import csv
from collections.abc import Iterable
from typing import Any, TextIO

#: What begins a formula or a command of a spreadsheet (OWASP, "CSV Injection").
_FORMULA = ("=", "+", "-", "@", "\t", "\r", "\n")


def write_rows(file: TextIO, rows: Iterable[Iterable[Any]]) -> None:
    """Write rows; texts that are no numbers are escaped by an apostrophe where they begin a formula."""
    csv.writer(file, lineterminator="\n").writerows([_cell(value) for value in row] for row in rows)


def _cell(value: Any) -> Any:
    if not isinstance(value, str) or not value.lstrip(" '").startswith(_FORMULA):
        return value
    try:
        float(value)
    except ValueError:
        return f"'{value}"
    return value


def read_cell(text: str) -> str:
    """A text as it was before `write_rows`."""
    return text[1:] if text.startswith("'") and text.lstrip(" '").startswith(_FORMULA) else text
