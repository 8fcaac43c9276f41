"""The page of a person's measures over the sessions: what changed clearly, what did not, what is open."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import plotly.graph_objects as go

from ..evaluation.progress import (
    LESS,
    MORE,
    UNCLEAR,
    UNKNOWN,
    Change,
    PersonProgress,
    Series,
    SessionValue,
    first_of,
    interval,
    quantity,
    scaled,
    shown_unit,
    worded,
)
from ..table import Table, percent
from .sheet import NO_DIAGNOSIS, Html, Page, PageSection, badge, explained, label, limits, rendered
from .style import BAND, VISIBLE, dress, interval_bars

#: Figures of a page, rows of its table, and sentences of its limits.
MOST_FIGURES, MOST_ROWS, MOST_LIMITS = 5, 16, 6


def progress_page(progress: PersonProgress) -> Page:
    """The page of a person's sessions."""
    count = len(progress.sessions)
    return Page(
        f"Progress of {progress.person}",
        f"{_arms(progress)}{count} session{'s' if count != 1 else ''}: {_named(progress)}",
        _verdict(progress),
        _sections(progress),
    )


def _arms(progress: PersonProgress) -> str:
    sides = list(dict.fromkeys(each.side for each in progress.series if each.side))
    return f"{' and '.join(sides).capitalize()} arm{'s' if len(sides) > 1 else ''}, " if sides else ""


def _named(progress: PersonProgress) -> str:
    """The sessions, with days where they are known; the middle ones of many are left out."""
    names = [
        f"{_short(name)} (day {day:.0f})" if math.isfinite(day) else _short(name)
        for name, day in zip(progress.sessions, progress.days, strict=True)
    ]
    return ", ".join(names if len(names) <= 8 else [*names[:3], "…", *names[-3:]])


def _verdict(progress: PersonProgress) -> Iterator[str]:
    changes = [each.change for each in progress.main if each.change is not None]
    if not progress.sessions:
        yield "No session can be used; the reasons are below"
    elif not changes:
        yield "There is one session only, so nothing can be compared"
    else:
        first, last = (_short(progress.sessions[place]) for place in (0, -1))
        clear = len(progress.clear)
        unclear = sum(change.word == UNCLEAR for change in changes)
        unknown = sum(change.word == UNKNOWN for change in changes)
        yield (
            f"From session {first} to session {last}: {clear or 'none'} of {len(changes)} measures changed"
            f" clearly, {unclear or 'none'} show{'s' if unclear == 1 else ''} no clear change"
            + (f", {unknown} could not be assessed" if unknown else "")
        )
        for word in (MORE, LESS):
            names = [
                _label(each, progress) for each in progress.clear if each.change and each.change.word == word
            ]
            if names:
                others = len(names) - 4
                more = f" and {others} other{'s' if others > 1 else ''}" if others > 0 else ""
                yield f"{word.capitalize()}: {'; '.join(names[:4])}{more}"
        if (compared := len(progress.compared)) >= 10 and clear:
            yield (
                f"Of {compared} measures about {0.05 * compared:.0f} would be called clear by chance alone;"
                f" after correction for that, {_standing(progress)}"
            )
    yield NO_DIAGNOSIS
    yield (
        "A clear change is one that errors of the measurement do not explain. A person also varies from day"
        " to day, with effort, pain and how the task was given: two sessions alone do not show a trend"
    )


def _standing(progress: PersonProgress) -> str:
    """Clear changes that stay clear when all measures count together."""
    stand = [
        _label(each, progress)
        for each in progress.clear
        if each.change is not None and each.change.p_together < 0.05
    ]
    if not stand:
        return "none of them remains clear"
    more = " and others" if len(stand) > 3 else ""
    return f"{'; '.join(stand[:3])}{more} {'remain' if len(stand) > 1 else 'remains'} clear"


def _sections(progress: PersonProgress) -> Iterator[PageSection]:
    shown = _shown(progress)
    if shown:
        yield _drawn(progress, shown)
    rows = [*progress.clear]  # what changed stands first, whatever is cut
    rows += [each for each in progress.main if each.change is not None and each not in progress.clear]
    yield _table(progress, rows)
    about: dict[str, list[str]] = {}
    for each in progress.main:
        for sentence in each.change.limits if each.change is not None else ():
            about.setdefault(sentence, []).append(_label(each, progress))
    counted = [
        f"{sentence} ({', '.join(names) if len(names) <= 2 else f'{len(names)} measures'})"
        for sentence, names in sorted(about.items(), key=lambda item: -len(item[1]))
    ]
    yield limits([*progress.left_out, *progress.notes, *counted], MOST_LIMITS)
    terms = ["interval", "recovered", *(["clear", "unclear", "unknown"] if rows else [])]
    if any(each.change is not None and math.isfinite(each.change.mdc95) for each in rows):
        terms.append("mdc")
    yield explained(terms, [each.key for each in (*shown, *rows[:MOST_ROWS])])


def _shown(progress: PersonProgress) -> list[Series]:
    """What is drawn: the first measures that have values, of each arm and task in turn."""
    main = [each for each in progress.main if any(math.isfinite(value.value) for value in each.values)]
    keys = first_of(list(dict.fromkeys(each.key for each in main)), MOST_FIGURES)
    return [each for key in keys for each in main if each.key == key][:MOST_FIGURES]


def _drawn(progress: PersonProgress, shown: Sequence[Series]) -> PageSection:
    """A panel of each measure: its sessions with their intervals, and whether it changed."""
    caption = (
        "One dot per session, with its 95 % interval as a line. The pale band is the interval of the first"
        " session."
    )
    if len(progress.sessions) == 1:
        caption = "The session's value, with its 95 % interval as a line."
    return PageSection("The main measures", caption, panels=[_panel(series, progress) for series in shown])


def _panel(series: Series, progress: PersonProgress) -> tuple[Html, go.Figure]:
    """A measure over the sessions with its intervals, under its name, and whether it changed."""
    unit, change = shown_unit(series.unit), series.change
    title = Html("<h3>{}{}</h3>").format(_label(series, progress), f" ({unit})" if unit else "")
    if change is not None:
        title += Html("<p>{} {}</p>").format(badge(change.word), _difference(change, series.unit))
    found = {value.session: value for value in series.values}
    values = [found.get(name, SessionValue("", math.nan, math.nan)) for name in progress.sessions]
    value, low, high = (
        [scaled(getattr(each, part), series.unit) for each in values] for part in ("value", "low", "high")
    )
    bars = interval_bars(value, low, high)
    dots = go.Scatter(x=list(range(len(value))), y=value, mode="markers", error_y=bars)
    figure = go.Figure(dots.update(marker={"color": VISIBLE, "size": 8}))
    if len(value) > 1 and math.isfinite(low[0]):
        figure.add_hrect(low[0], high[0], fillcolor=BAND, line_width=0, layer="below")
    every = range(0, len(value), max(1, math.ceil(len(value) / 12)))
    names = [label(_short(progress.sessions[place], 9)) for place in every]
    figure.update_xaxes(tickvals=list(every), ticktext=names)
    return title, dress(figure, 150, head=8, showlegend=False)


def _difference(change: Change, unit: str) -> str:
    """The change with its interval; "" where there is none."""
    if not math.isfinite(change.difference):
        return ""
    text = quantity(change.difference, unit, signed=True)
    between = interval(change.low, change.high, unit, signed=True)
    return f"{text} ({between})" if between else text


def _table(progress: PersonProgress, rows: Sequence[Series]) -> PageSection:
    columns = ("measure", "first", "last", "change", "95 % interval", "in words", "recovered")
    cells = []
    for each in rows[:MOST_ROWS]:
        if (change := each.change) is None:
            continue
        shares = [value.recovered_share for value in (change.first, change.last)]
        cells.append(
            (
                _label(each, progress),
                *(worded(each.key, value.value, each.unit) for value in (change.first, change.last)),
                quantity(change.difference, each.unit, signed=True),
                interval(change.low, change.high, each.unit, signed=True) or None,
                badge(change.word),
                percent(max((share for share in shares if math.isfinite(share)), default=None)),
            )
        )
    more = len(rows) - MOST_ROWS
    caption = "The last session against the first, what changed clearly in front." + (
        f" {more} measures more are in the tables (--csv)." if more > 0 else ""
    )
    return rendered(Table("All changes", columns, cells, caption))


def _label(series: Series, progress: PersonProgress) -> str:
    """The measure's name, with arm and task where there are several."""
    several = len({each.side for each in progress.series}) > 1
    parts = (series.name, f"{series.side} arm" if several and series.side else "", _short(series.task))
    return ", ".join(part for part in parts if part)


def _short(text: str, most: int = 24) -> str:
    return text if len(text) <= most else f"{text[: most - 1]}…"
