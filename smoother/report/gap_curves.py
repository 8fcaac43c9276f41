"""`write_gap_curves`: error against gap length with its spread, every method a line, as one page."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence

import numpy as np
import plotly.graph_objects as go

from ..evaluation.gap_table import GapSpread, GapTable, spread_by_length
from .method_styles import PLAIN, STYLES, faint, line_of
from .sheet import figure, in_cm, label, listing, tabulated, write_sheet
from .style import dress

Spreads = dict[float, dict[str, GapSpread]]


def write_gap_curves(
    table: GapTable,
    name: str,
    path: str | os.PathLike[str],
    *,
    notes: tuple[str, ...] = (),
    force: bool = False,
) -> None:
    """Write the errors in hidden gaps as one HTML page that needs no network and no other file.

    Parameters
    ----------
    table : GapTable
        As `evaluate_gaps` gives it.
    name : str
        Of the recording.
    path : path-like
        The page to write.
    notes : tuple of str
        Of the recording.
    force : bool
        Overwrite a page that exists.

    Raises
    ------
    UnoccludeError
        The page exists and `force` is not given, or it cannot be written.
    """
    spreads = spread_by_length(table.rows)
    gaps = sum(next(iter(methods.values())).gaps for methods in spreads.values())
    against = next((row.reference for row in table.rows if row.reference), "truth")
    reference = (
        "the truth" if against == "truth" else f"what the camera saw of the {against}, its noise included"
    )
    write_sheet(
        path,
        f"Error against gap length: {name}",
        f"{gaps} gaps were made where the camera saw the arm, and recovered; compared with {reference}.",
        verdict(spreads),
        _sections(spreads, (*notes, *table.notes)),
        force=force,
    )


def verdict(spreads: Spreads) -> list[str]:
    """How long a gap can be trusted, and to what, in sentences."""
    sentences, before = [], 0.0
    for limit_cm in (1, 2, 5, 10):
        longest = _longest_within(spreads, "graph", limit_cm / 100)
        if longest is not None and longest > before:
            before = longest
            sentences.append(
                f"Up to {longest:g} s the graph recovers three of four gaps to {limit_cm} cm rms or better"
            )
    if not sentences and any("graph" in methods for methods in spreads.values()):
        sentences.append(
            "At none of these lengths are three of four gaps recovered to 10 cm rms by the graph"
        )
    for length, methods in spreads.items():
        known = {name: spread.median_m for name, spread in methods.items() if spread.median_m is not None}
        if len(known) > 1:
            ranked = sorted(known, key=lambda name: known[name])[:3]
            words = ", ".join(f"{name} {100 * known[name]:.1f}" for name in ranked)
            sentences.append(f"Gaps of {length:g} s, median over gaps of the error, cm: {words}")
    return sentences or ["No gap has an answer."]


def _longest_within(spreads: Spreads, method: str, limit_m: float) -> float | None:
    """The longest length up to which the upper quartile stays within a limit at every length, s."""
    longest = None
    for length, methods in spreads.items():
        high = methods[method].high_m if method in methods else None
        if high is None or high > limit_m or methods[method].failed > methods[method].gaps / 4:
            break
        longest = length
    return longest


def curves(spreads: Spreads) -> go.Figure:
    """Median of the gaps' rms against their length, quartiles as a band for the graph, as bars else."""
    plot = go.Figure()
    names = list(dict.fromkeys(name for methods in spreads.values() for name in methods))
    for place, name in enumerate(reversed(names)):  # the first on top of the others
        known = [
            (length, methods[name])
            for length, methods in spreads.items()
            if name in methods and methods[name].median_m is not None
        ]
        if not known:
            continue
        x = np.array([length for length, _ in known])
        low, median, high = (
            100 * np.array([getattr(spread, field) for _, spread in known])
            for field in ("low_m", "median_m", "high_m")
        )
        shift = 1.0 if name == "graph" else 1.012 ** (place - len(names) / 2)  # bars beside each other
        trace = go.Scatter(x=x * shift, y=median, name=label(name), mode="lines+markers", line=line_of(name))
        if name == "graph":
            plot.add_trace(_band(x, low, high, name))
        else:
            bars = {"array": high - median, "arrayminus": median - low, "thickness": 1, "width": 2}
            trace.update(error_y={"type": "data", "symmetric": False, **bars})
        plot.add_trace(trace)
    ticks = [f"{length:g}" for length in spreads]
    plot.update_xaxes(type="log", title_text="gap, s", tickvals=list(spreads), ticktext=ticks)
    values = [
        100 * each for methods in spreads.values() for spread in methods.values() for each in _drawn(spread)
    ]
    marks = decades(values)
    plot.update_yaxes(
        type="log",
        title_text="error in a gap, rms, cm",
        tickvals=marks,
        ticktext=[f"{mark:g}" for mark in marks],
    )
    dress(plot, 620, head=70)
    return plot.update_layout(legend={"traceorder": "reversed"})


def _drawn(spread: GapSpread) -> list[float]:
    return [value for value in (spread.low_m, spread.median_m, spread.high_m) if value]


def decades(values: Sequence[float]) -> list[float]:
    """Ticks of a logarithmic axis about values: 1, 2 and 5 of each power of ten, more if few lie inside."""
    if not values:
        return []
    low, high = int(np.floor(np.log10(min(values)))), int(np.ceil(np.log10(max(values))))
    leads = (1, 2, 5) if max(values) > 10 * min(values) else (1, 1.5, 2, 3, 4, 5, 7)
    return [float(f"{lead}e{power}") for power in range(low, high + 1) for lead in leads]


def _band(x: np.ndarray, low: np.ndarray, high: np.ndarray, name: str) -> go.Scatter:
    colour, _ = STYLES.get(name, PLAIN)
    outline = {"x": np.concatenate([x, x[::-1]]), "y": np.concatenate([high, low[::-1]])}
    trace = go.Scatter(**outline, mode="lines", fill="toself", fillcolor=faint(colour, 0.2))
    return trace.update(line={"width": 0}, showlegend=False, hoverinfo="skip")


def _sections(spreads: Spreads, notes: tuple[str, ...]) -> Iterator[str]:
    yield figure("Error against gap length", _CURVES, curves(spreads))
    rows = [
        (
            f"{length:g}",
            name,
            *[
                in_cm(value)
                for value in (spread.median_m, spread.low_m, spread.high_m, spread.rms_m, spread.worst_m)
            ],
            spread.gaps,
            spread.failed or None,
        )
        for length, methods in spreads.items()
        for name, spread in sorted(methods.items(), key=_by_median)
    ]
    columns = (
        "gap, s",
        "method",
        "median of gaps, cm",
        "25 %",
        "75 %",
        "rms over gaps",
        "worst gap",
        "gaps",
        "failed",
    )
    yield tabulated("The figures", _TABLE, columns, rows)
    yield listing("Notes", dict.fromkeys(notes), "There is nothing to note.")


def _by_median(entry: tuple[str, GapSpread]) -> float:
    median = entry[1].median_m
    return float("inf") if median is None else median


_CURVES = (
    "Each gap's error is its root mean square; lines join the medians over the gaps of a length. Bars (for"
    " the graph a band) reach from the 25 % to the 75 % quartile. Both axes are logarithmic. Click a name to"
    " hide its line."
)
_TABLE = (
    "Each gap counts once, with its rms: median, quartiles, root mean square and the worst over the gaps of a"
    " length, the best median first. (The terminal's median is over all samples of these gaps.)"
)
