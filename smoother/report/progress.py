"""The page of a person's measures over the sessions: what changed clearly, what did not, what is open."""

from __future__ import annotations

import math
from collections.abc import Iterator

import plotly.graph_objects as go

from ..evaluation.progress import SESSIONS_VARY, PersonProgress, Series, SessionValue
from ..evaluation.words import first_of, interval, quantity, scaled, shown_unit
from .sheet import NO_DIAGNOSIS, Html, Page, PageSection, badge, caption, explained, label, limits, rendered
from .style import BAND, dress, values_with_intervals

#: Figures of a page, rows of its table, and sentences of its limits.
MOST_FIGURES, MOST_ROWS, MOST_LIMITS = 5, 16, 6


def progress_page(progress: PersonProgress) -> Page:
    """The page of a person's sessions."""
    sides = list(dict.fromkeys(each.side for each in progress.series if each.side))
    arms = f"{' and '.join(sides).capitalize()} arm{'s' if len(sides) > 1 else ''}, " if sides else ""
    count = len(progress.sessions)
    names = [
        f"{_short(name)} (day {day:.0f})" if math.isfinite(day) else _short(name)
        for name, day in zip(progress.sessions, progress.days, strict=True)
    ]
    named = ", ".join(names if count <= 8 else [*names[:3], "…", *names[-3:]])
    return Page(
        f"Progress of {progress.person}",
        f"{arms}{count} session{'s' if count != 1 else ''}: {named}",
        [*progress.sentences(), NO_DIAGNOSIS, SESSIONS_VARY],
        _sections(progress),
    )


def _sections(progress: PersonProgress) -> Iterator[PageSection]:
    main = [each for each in progress.main if any(math.isfinite(value.value) for value in each.values)]
    keys = first_of(list(dict.fromkeys(each.key for each in main)), MOST_FIGURES)
    shown = [each for key in keys for each in main if each.key == key][:MOST_FIGURES]
    if shown:
        about = caption("Several sessions" if len(progress.sessions) > 1 else "One session")
        yield PageSection("The main measures", about, panels=[_panel(each, progress) for each in shown])
    more = len(progress.changed) - MOST_ROWS
    left = f" {more} measures more are in the tables (--csv)." if more > 0 else ""
    yield rendered(progress.table("All changes", MOST_ROWS), caption("All changes", more=left))
    yield limits([*progress.left_out, *progress.notes, *progress.limits], MOST_LIMITS)
    terms = ["interval", "recovered", *(["clear", "unclear", "unknown"] if progress.changed else [])]
    if any(math.isfinite(change.mdc95) for _, change in progress.changed):
        terms.append("mdc")
    yield explained(terms, [each.key for each in (*shown, *progress.main)])


def _panel(series: Series, progress: PersonProgress) -> tuple[Html, go.Figure]:
    """A measure over the sessions with its intervals, under its name, and whether it changed."""
    unit, change = shown_unit(series.unit), series.change
    title = Html("<h3>{}{}</h3>").format(progress.label(series), f" ({unit})" if unit else "")
    if change is not None:
        found = quantity(change.difference, series.unit, signed=True)
        between = interval(change.low, change.high, series.unit, signed=True)
        said = f"{found} ({between})" if between else found if math.isfinite(change.difference) else ""
        title += Html("<p>{} {}</p>").format(badge(change.word), said)
    by_name = {value.session: value for value in series.values}
    values = [by_name.get(name, SessionValue("", math.nan, math.nan)) for name in progress.sessions]
    numbers = [
        [scaled(getattr(each, part), series.unit) for each in values] for part in ("value", "low", "high")
    ]
    low, high = numbers[1][0], numbers[2][0]
    figure = go.Figure(values_with_intervals(range(len(values)), *numbers).update(marker_size=8))
    if len(values) > 1 and math.isfinite(low):
        figure.add_hrect(low, high, fillcolor=BAND, line_width=0, layer="below")
    every = range(0, len(values), max(1, math.ceil(len(values) / 12)))
    names = [label(_short(progress.sessions[place], 9)) for place in every]
    figure.update_xaxes(tickvals=list(every), ticktext=names)
    return title, dress(figure, 150, head=8, showlegend=False)


def _short(text: str, most: int = 24) -> str:
    return text if len(text) <= most else f"{text[: most - 1]}…"
