"""A study's persons together: the table of measures, curves over a repetition, a file for statistics."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from ..angles import JOINT_ANGLES
from ..evaluation.group import (
    GroupMeasure,
    GroupWaveform,
    Spread,
    group_measures,
    group_waveforms,
    write_long,
)
from .sheet import Html, figure, headed, table
from .style import BAND, CAMERA, VISIBLE, band, curve, dress

if TYPE_CHECKING:
    import pyarrow as pa

#: Single recordings that are drawn behind a mean.
MOST_CURVES = 60
_TITLES = {angle.name: angle.title for angle in JOINT_ANGLES}


def group_sections(rows: pa.Table, long: Sequence[Mapping[str, Any]], page: Path) -> Iterator[str]:
    """The group's table and curves; beside the page its file in long format. Nothing without measures.

    Parameters
    ----------
    rows : pyarrow.Table
        Of the study.
    long : sequence of mapping
        Its measures in long format (`evaluation.group.LONG`).
    page : Path
        Where the page is to be; the file is called after it.
    """
    if long:
        file = page.with_name(f"{page.stem}_measures.csv")
        write_long(long, file)
        yield _table(group_measures(long), file.name)
    waves = group_waveforms(rows.select(["waveforms"]).to_pylist())
    if waves:
        yield figure("Angles over a repetition", _WAVES, _drawn(waves))


_WAVES = (
    "From the beginning of a repetition (0 %) to its end. Thin grey: the mean of each recording; blue: the"
    " mean of the recordings, the band one standard deviation between them (of a single recording: between"
    " its repetitions). What is not to be trusted is left out."
)


def _table(measures: list[GroupMeasure], file: str) -> str:
    """Mean, spread and change of each measure."""
    several = any(each.last.count for each in measures)
    tasks = any(each.task for each in measures)
    heads = [
        *("arm", *(["task"] if tasks else []), "measure", "persons", "mean (SD)"),
        *(["last session, mean (SD)", "persons with both", "change (95 % interval)"] if several else []),
    ]
    cells = [
        (
            each.side or None,
            *([each.task] if tasks else []),
            f"{each.name}, {each.unit}".removesuffix(", "),
            each.first.count,
            _spread(each.first),
            *([_spread(each.last), each.last.count, _change(each)] if several else []),
        )
        for each in measures
    ]
    first = " of the first session" if several else ""
    link = f'<a href="{escape(quote(file))}">{escape(file)}</a>'
    caption = Html(
        f"Over the persons, mean and standard deviation{first}; the change is that from a person's first"
        " session to the last, its mean over the persons with its interval by Student's t. Recordings that"
        f" are not to be trusted are left out. All measures of all sessions, for R or SPSS: {link}, one"
        " measure of one session per row, with a column <code>trusted</code>."
    )
    return headed("The group", caption) + table(heads, cells)


def _spread(each: Spread) -> str | None:
    if not each.count:
        return None
    return f"{each.mean:.3g}" + (f" ({each.sd:.2g})" if math.isfinite(each.sd) else "")


def _change(each: GroupMeasure) -> str | None:
    if not math.isfinite(each.change):
        return None
    interval = f" ({each.low:+.3g} to {each.high:+.3g})" if math.isfinite(each.low) else ""
    return f"{each.change:+.3g}{interval}"


def _drawn(waves: list[GroupWaveform]) -> go.Figure:
    columns = min(2, len(waves))
    lines = -(-len(waves) // columns)
    titles = [
        f"{each.side} {_TITLES[each.angle]}, degrees: {len(each.curves)} recording"
        f"{'s' if len(each.curves) > 1 else ''}, {each.repetitions} repetitions".strip()
        for each in waves
    ]
    plot = make_subplots(rows=lines, cols=columns, subplot_titles=titles, vertical_spacing=0.24 / lines)
    plot.update_annotations(font={"size": 13})
    for number, each in enumerate(waves):
        row, column = number // columns + 1, number % columns + 1
        share = np.linspace(0, 100, len(each.mean))
        x, y = band(share, each.mean - each.sd, each.mean + each.sd)
        around = go.Scatter(x=x, y=y, fill="toself", fillcolor=BAND, line={"width": 0}, hoverinfo="skip")
        single = [curve(share, one, None, CAMERA, 0.8, hoverinfo="skip") for one in each.curves[:MOST_CURVES]]
        for trace in (*single, around, curve(share, each.mean, "mean", VISIBLE, 2.2)):
            plot.add_trace(trace, row=row, col=column)
        plot.update_xaxes(title_text="repetition, %", row=row, col=column)
    return dress(plot, 60 + 280 * lines, head=40, showlegend=False)
