"""Small drawings that need no program: they print, follow the page's scheme, and fit a phone."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from html import escape

import numpy as np

from ..array_types import FloatArray
from .sheet import headed

#: Margin left and right of the marks, % of the width.
_EDGE = 4.0
#: Heights, pixels.
_ROW, _NARROW_ROW, _SESSIONS, _BARS = 42, 34, 116, 92
#: More marks than this show no numbers, and more names do not fit below.
_MOST_NUMBERS, _MOST_NAMES = 12, 12


@dataclass(frozen=True)
class Mark:
    """A value with its interval; nan where it has none."""

    name: str  # Label below it: a session, the number of a movement
    value: float  # In the unit of the chart
    low: float = math.nan  # In the unit of the chart
    high: float = math.nan  # In the unit of the chart
    text: str = ""  # The value in words


@dataclass(frozen=True)
class Strip:
    """A row of a chart: a bar from one mark to another, on a scale that all rows share."""

    name: str  # What it is, and its values in words
    text: str  # What it is, and its values in words
    start: Mark  # Ends of the bar, each with its interval
    end: Mark  # Ends of the bar, each with its interval


def charted(heading: str, caption: str, drawing: str) -> str:
    """A heading, a caption and a drawing that stay together on paper."""
    return f'<div class="together">{headed(heading, caption)}{drawing}</div>'


#: The word for what is not to be trusted.
NOT_TRUSTED = "not to be trusted"


def badge(word: str, kind: str = "") -> str:
    """A word in the colour of its meaning, with a sign for those who do not see colours."""
    sign, kind = _BADGES.get(word, (_SIGNS.get(kind, ""), kind or "open"))
    return f'<span class="word {kind}">{sign}{escape(word)}</span>'


_SIGNS = {"care": "! ", "wrong": "✕ "}
_BADGES = {
    NOT_TRUSTED: ("✕ ", "wrong"),
    "clearly more": ("▲ ", "more"),
    "clearly less": ("▼ ", "less"),
    "no clear change": ("● ", "same"),
    "no clear difference": ("● ", "same"),
    "reached": ("✓ ", "same"),
    "not reached": ("– ", "open"),
    "cannot be assessed": ("? ", "open"),
}


def strips(rows: Sequence[Strip], low: float, high: float, ticks: Iterable[float], unit: str) -> str:
    """Bars on a shared scale, each with the intervals of its ends."""
    ticks = list(ticks)
    each = _ROW if len(rows) <= 3 else _NARROW_ROW
    height = each * len(rows) + 20

    def x(value: float) -> str:
        return f"{_EDGE + (100 - 2 * _EDGE) * (np.clip(value, low, high) - low) / (high - low):.2f}%"

    parts = [
        f'<line class="grid" x1="{x(tick)}" x2="{x(tick)}" y1="0" y2="{height - 18}"/>'
        f'<text class="tick" x="{x(tick)}" y="{height - 4}" text-anchor="middle">'
        f"{tick:g}{escape(unit)}</text>"
        for tick in ticks
    ]
    for number, row in enumerate(rows):
        top = each * number
        parts.append(f'<text x="0" y="{top + 14}">{escape(row.name)}</text>')
        parts.append(
            f'<text class="value" x="100%" y="{top + 14}" text-anchor="end">{escape(row.text)}</text>'
        )
        if not math.isfinite(row.start.value) or not math.isfinite(row.end.value):
            continue
        y = top + 24
        width = f"calc({x(row.end.value)} - {x(row.start.value)})"
        parts.append(
            f'<rect class="bar" x="{x(row.start.value)}" y="{y - 5}" height="10" style="width:{width}"/>'
        )
        parts += [_whisker_across(x(m.low), x(m.high), y) for m in (row.start, row.end) if _has(m)]
    return _svg("".join(parts), height, ", ".join(f"{row.name}: {row.text}" for row in rows))


def sessions(marks: Sequence[Mark], *, reference: bool = True, words: str = "") -> str:
    """Values one beside the other, each with its interval; pale: the interval of the first."""
    low, high = _scale([end for mark in marks for end in (mark.value, mark.low, mark.high)])
    top, bottom = 26.0, _SESSIONS - 22.0

    def y(value: float) -> float:
        return bottom - (bottom - top) * (value - low) / (high - low)

    parts = []
    known = [mark for mark in marks if math.isfinite(mark.value)]
    if reference and known and _has(known[0]):
        first = known[0]
        parts.append(
            f'<rect class="first" x="0" width="100%" y="{y(first.high):.1f}"'
            f' height="{max(y(first.low) - y(first.high), 1):.1f}"/>'
        )
    count = len(marks)
    if count > _MOST_NUMBERS and known:
        parts += [
            f'<text class="tick" x="0" y="{y(mark.value) + 4:.1f}">{escape(mark.text)}</text>'
            for mark in (min(known, key=lambda each: each.value), max(known, key=lambda each: each.value))
        ]
    step = max(1, math.ceil(count / _MOST_NAMES))
    left = 9.0 if count > _MOST_NUMBERS else 0.0  # room for the numbers
    for place, mark in enumerate(marks):
        x = f"{left + (100 - left) * (place + 0.5) / count:.2f}%"
        if place % step == 0:
            name = _short(mark.name, 60 // count + 3)
            parts.append(
                f'<text class="tick" x="{x}" y="{_SESSIONS - 5}" text-anchor="middle">{escape(name)}</text>'
            )
        if not math.isfinite(mark.value):
            parts.append(
                f'<text class="tick" x="{x}" y="{0.5 * (top + bottom):.0f}" text-anchor="middle">?</text>'
            )
            continue
        above = y(mark.value)
        if _has(mark):
            parts.append(_whisker_up(x, y(mark.low), y(mark.high)))
            above = min(above, y(mark.high))
        parts.append(f'<circle class="dot" cx="{x}" cy="{y(mark.value):.1f}" r="4.5"/>')
        if count <= _MOST_NUMBERS and mark.text:
            parts.append(
                f'<text class="value" x="{x}" y="{above - 7:.1f}" text-anchor="middle">'
                f"{escape(mark.text)}</text>"
            )
    return _svg("".join(parts), _SESSIONS, words)


def bars(marks: Sequence[Mark], unit: str, words: str = "") -> str:
    """Bars from zero one beside the other, each with its interval."""
    _, high = _scale([0.0, *(end for mark in marks for end in (mark.value, mark.high))])
    bottom = _BARS - 18.0

    def y(value: float) -> float:
        return bottom - (bottom - 14.0) * max(value, 0.0) / high

    count, parts = len(marks), [f'<text class="tick" x="0" y="10">{high:.3g}{escape(unit)}</text>']
    step = max(1, math.ceil(count / 6))
    for place, mark in enumerate(marks):
        left, middle = 100 * (place + 0.1) / count, 100 * (place + 0.5) / count
        if math.isfinite(mark.value):
            parts.append(
                f'<rect class="bar" x="{left:.2f}%" width="{80 / count:.2f}%" y="{y(mark.value):.1f}"'
                f' height="{bottom - y(mark.value):.1f}"/>'
            )
        if _has(mark) and mark.high > mark.low:
            parts.append(_whisker_up(f"{middle:.2f}%", y(mark.low), y(mark.high)))
        if place % step == 0:
            parts.append(
                f'<text class="tick" x="{left:.2f}%" y="{_BARS - 4}" text-anchor="middle">'
                f"{escape(mark.name)}</text>"
            )
    parts.append(f'<line class="grid" x1="0" x2="100%" y1="{bottom}" y2="{bottom}"/>')
    return _svg("".join(parts), _BARS, words)


def _svg(inside: str, height: int, words: str) -> str:
    return (
        f'<svg class="chart" role="img" aria-label="{escape(words)}" width="100%" height="{height}">'
        f"{inside}</svg>"
    )


def _whisker_across(low: str, high: str, y: float) -> str:
    return f'<line class="whisker" x1="{low}" x2="{high}" y1="{y}" y2="{y}"/>' + "".join(
        f'<line class="whisker" x1="{x}" x2="{x}" y1="{y - 6}" y2="{y + 6}"/>' for x in (low, high)
    )


def _whisker_up(x: str, low: float, high: float) -> str:
    return f'<line class="whisker" x1="{x}" x2="{x}" y1="{low:.1f}" y2="{high:.1f}"/>'


def _has(mark: Mark) -> bool:
    return math.isfinite(mark.low) and math.isfinite(mark.high)


def _scale(values: Sequence[float] | FloatArray) -> tuple[float, float]:
    """Ends of a scale that shows all values, with some room."""
    finite = [value for value in values if math.isfinite(value)]
    if not finite:
        return 0.0, 1.0
    low, high = min(finite), max(finite)
    room = 0.08 * (high - low) or 0.1 * abs(high) or 1.0
    return low - room, high + room


def _short(text: str, most: int) -> str:
    return text if len(text) <= most else f"{text[: max(most - 1, 1)]}…"
