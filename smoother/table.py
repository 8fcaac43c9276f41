"""A result as a table: written once, then shown on a terminal, on a page, in Markdown or in JSON."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Table:
    """Rows of figures under columns whose names have units; None and nan stand for what is not known."""

    title: str
    columns: Sequence[str]
    rows: Sequence[Sequence[object]]

    def markdown(self) -> str:
        """The table in Markdown, without its title."""
        lines = [self.columns, ["---"] * len(self.columns), *self.rows]
        return "".join(f"| {' | '.join(map(cell_text, line))} |\n" for line in lines)


def tabulated(
    title: str, rows: Iterable[Any], columns: Mapping[str, str | Callable[[Any], object]] | str
) -> Table:
    """Figures in SI under headings: by their keys, whose ends are the units, or by functions.

    Keys alone, in one text, are their own headings: `length_s` is "length, s", `length_s=gap_s` "gap, s".
    """
    if isinstance(columns, str):
        columns = dict(map(_under_its_key, columns.split()))
    return Table(title, list(columns), [[_figure(row, key) for key in columns.values()] for row in rows])


#: Units at the end of a key: by what people's number is larger, their unit, its decimals.
_UNITS: dict[str, tuple[float, str, int]] = {
    "_m": (100.0, "cm", 2),
    "_s": (1.0, "s", 2),
    "_deg": (1.0, "deg", 1),
    "_hz": (1.0, "Hz", 1),
    "_share": (100.0, "%", 0),
}


def _under_its_key(text: str) -> tuple[str, Callable[[Any], object]]:
    """A heading, and what stands under it of a row."""
    key, _, name = text.partition("=")
    name = name or key
    end = next((end for end in _UNITS if name.endswith(end)), "")
    factor, unit, digits = _UNITS.get(end, (1.0, "", 0))

    def shown(row: Any) -> object:
        value = row.get(key) if isinstance(row, Mapping) else getattr(row, key)
        if isinstance(value, bool):
            return "yes" if value else "no"
        if isinstance(value, list | tuple):
            return ", ".join(map(cell_text, value))
        return fixed(factor * value, digits) if unit and isinstance(value, int | float) else value

    return ", ".join(filter(None, (name.removesuffix(end).replace("_", " "), unit))), shown


def _figure(row: Any, key: str | Callable[[Any], object]) -> object:
    if not isinstance(key, str):
        return key(row)
    value = row.get(key) if isinstance(row, Mapping) else getattr(row, key)
    if key.endswith("_m"):
        return centimetres(value)
    if key.endswith(("coverage_95", "inside_50", "inside_95", "_share")):
        return percent(value)
    return f"{value:g}" if key.endswith("length_s") else value


def cell_text(value: object, nothing: str = "-") -> str:
    """A value as tables show it; `nothing` where there is none."""
    if value is None or (isinstance(value, float) and not math.isfinite(value)):
        return nothing
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def centimetres(metres: float | None) -> str | None:
    """A length for a cell, in cm."""
    return None if metres is None or not math.isfinite(metres) else f"{100 * metres:.2f}"


def percent(share: float | None) -> str | None:
    """A share for a cell."""
    return None if share is None or not math.isfinite(share) else f"{100 * share:.0f} %"


def fixed(value: float | None, digits: int = 2) -> str | None:
    """A number for a cell, with `digits` decimals."""
    return None if value is None or not math.isfinite(value) else f"{value:.{digits}f}"
