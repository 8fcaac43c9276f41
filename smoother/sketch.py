"""Small pictures as inline SVG, for objects that show themselves in a notebook."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

import numpy as np

from .array_types import FloatArray
from .linalg import runs

WIDTH, HEIGHT, LEFT, TOP, BOTTOM = 640, 170, 46, 18, 20
#: Told apart by people who see few colours, too (Okabe and Ito).
COLOURS = ("#0072B2", "#D55E00", "#009E73")
SHADE = "#E69F00"
#: Points of a line; more are not seen at this width.
MOST_POINTS = 400


@dataclass(frozen=True)
class Line:
    """A line over time."""

    name: str  # For the legend
    values: FloatArray  # (n,): at the sketch's times; nan where there is none
    sigma: FloatArray | None = None  # (n,): A band of two of them is drawn on both sides


def lines_svg(
    t_s: FloatArray,
    lines: Sequence[Line],
    shaded: Sequence[tuple[float, float]],
    caption: str,  # t_s (n,) s
) -> str:
    """Lines over time, with times that are shaded."""
    finite = [line.values[np.isfinite(line.values)] for line in lines]
    if len(t_s) < 2 or not any(len(values) for values in finite):
        return ""
    low, high = min(v.min() for v in finite if len(v)), max(v.max() for v in finite if len(v))
    low, high = (low, high) if high > low else (low - 0.5, high + 0.5)
    right, floor = WIDTH - 4.0, HEIGHT - BOTTOM

    def x(t: FloatArray) -> FloatArray:
        return LEFT + (right - LEFT) * (np.asarray(t) - t_s[0]) / (t_s[-1] - t_s[0])

    def y(value: FloatArray) -> FloatArray:
        return np.clip(floor - (floor - TOP) * (np.asarray(value) - low) / (high - low), TOP, floor)

    parts = []
    for start, end in x(np.clip(np.reshape(shaded, (-1, 2)), t_s[0], t_s[-1])).tolist():
        parts.append(
            f'<rect x="{start:.1f}" y="{TOP}" width="{max(end - start, 0.5):.1f}" height="{floor - TOP}"'
            f' fill="{SHADE}" opacity=".3"/>'
        )
    for line, colour in zip(lines, COLOURS, strict=False):
        for run in runs(np.isfinite(line.values)):
            across = x(t_s[run])
            if line.sigma is not None:
                band = 2.0 * np.nan_to_num(line.sigma[run])
                above, below = y(line.values[run] + band), y(line.values[run] - band)
                outline = np.concatenate([across, across[::-1]]), np.concatenate([above, below[::-1]])
                parts.append(f'<polygon points="{_points(*outline)}" fill="{colour}" opacity=".25"/>')
            points = _points(across, y(line.values[run]))
            parts.append(f'<polyline points="{points}" fill="none" stroke="{colour}" stroke-width="1.2"/>')
    for place, (line, colour) in enumerate(zip(lines, COLOURS, strict=False)):
        at = right - 22 * (len(lines) - place)
        parts.append(f'<text x="{at}" y="12" fill="{colour}">{line.name}</text>')
    for value, height in ((low, floor), (high, TOP + 8)):
        parts.append(f'<text x="{LEFT - 4}" y="{height}" text-anchor="end">{value:.2f}</text>')
    parts.append(f'<text x="{LEFT}" y="{HEIGHT - 5}">{t_s[0]:.1f} s</text>')
    parts.append(f'<text x="{right}" y="{HEIGHT - 5}" text-anchor="end">{t_s[-1]:.1f} s</text>')
    parts.append(f'<text x="{LEFT}" y="12">{escape(caption)}</text>')
    return (
        f'<svg viewBox="0 0 {WIDTH} {HEIGHT}" width="{WIDTH}" height="{HEIGHT}" role="img"'
        f' aria-label="{escape(caption)}" style="max-width:100%;font:11px sans-serif" fill="currentColor">'
        f"{''.join(parts)}</svg>"
    )


def lines_text(lines: Sequence[str]) -> str:
    """Lines as text, those after the first indented."""
    return "\n  ".join(lines)


def card_html(lines: Sequence[str], *parts: str) -> str:
    """Lines as a paragraph, the first of them bold, and what follows below (HTML)."""
    first, *others = map(escape, lines)
    return f"<p><b>{first}</b><br>{'<br>'.join(others)}</p>{''.join(parts)}"


def even_rows(count: int) -> slice:
    """At most some hundred of this many rows, evenly."""
    return slice(0, count, max(-(-count // MOST_POINTS), 1))


def about_median(values: FloatArray) -> FloatArray:
    """Values less their median, so that the axes of a place can share a sketch."""
    finite = values[np.isfinite(values)]
    return values - np.median(finite) if len(finite) else values


def table_html(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A plain table."""
    head = "".join(f"<th>{escape(name)}</th>" for name in columns)
    body = "".join("<tr>" + "".join(f"<td>{escape(text)}</td>" for text in row) + "</tr>" for row in rows)
    return f"<table><tr>{head}</tr>{body}</table>"


def _points(x: FloatArray, y: FloatArray) -> str:
    return " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x.tolist(), y.tolist(), strict=True))
