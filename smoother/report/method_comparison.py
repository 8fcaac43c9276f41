"""Pages of every method beside the others: over each other in the gaps, and error against gap length."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import plotly.graph_objects as go

from ..array_types import FloatArray
from ..evaluation.compare import Comparison
from ..evaluation.gaps import GapTable
from ..measurements.visibility import Gap
from ..recording import Recording
from .sheet import Page, PageSection, capitalised, caption, label, notes, rendered
from .style import CAMERA, TRUTH, axis_names, curve, dots, dress, interval_bars, over_time

#: Colour and plotly dash of each method; strong methods in strong colours.
STYLES: dict[str, tuple[str, str]] = {
    "graph": ("#D55E00", "solid"),
    "rts": ("#0072B2", "solid"),
    "gaussian-process": ("#009E73", "solid"),
    "linear-drift": ("#CC79A7", "solid"),
    "ukf": ("#56B4E9", "dash"),
    "multirate-kalman": ("#B8860B", "dash"),
    "kalman": ("#7F5AA8", "dash"),
    "pchip": ("#777777", "dot"),
    "camera-only": ("#444444", "dot"),
    "hold": ("#B0B0B0", "dot"),
}
#: For a method without a style of its own.
PLAIN = ("#777777", "solid")


def line_of(method: str) -> dict[str, object]:
    """Plotly's line for a method."""
    colour, dash = STYLES.get(method, PLAIN)
    return {"color": colour, "dash": dash, "width": 3.2 if method == "graph" else 1.5}


#: Gaps drawn at most.
MOST_GAPS = 6
#: Time shown on both sides of a gap, s.
AROUND_S = 0.6


def comparison_page(compared: Sequence[tuple[Recording, Comparison]]) -> Page:
    """The comparisons of a recording's arms on one page, arm by arm."""
    recording, first = compared[0]
    names = [f"{capitalised(one.arm_label)}: " if len(compared) > 1 else "" for one, _ in compared]
    arms = f", {len(compared)} arms" if len(compared) > 1 else f", {len(first.graph.gaps)} gaps"
    return Page(
        first.alignment.titled(f"Methods compared: {recording.name}"),
        f"{len(first.methods)} methods{arms}; the {_point(first)} compared with the truth.",
        [f"{name}{text}" for name, (_, one) in zip(names, compared, strict=True) for text in verdict(one)],
        [
            replace(section, heading=f"{name}{section.heading}")
            for name, (recording, one) in zip(names, compared, strict=True)
            for section in sections(one, recording)
        ],
    )


def verdict(comparison: Comparison) -> list[str]:
    """What the comparison says, in sentences."""
    errors = comparison.rms_m
    if not errors:
        return ["No method has a result that can be compared with the truth."]
    ranked = ", ".join(f"{name} {100 * error:.1f}" for name, error in errors.items())
    sentences = [f"Error of the {_point(comparison)} {comparison.where}, rms, cm: {ranked}."]
    others = {name: error for name, error in errors.items() if name != "graph"}
    if "graph" in errors and others:
        nearest = min(others, key=lambda name: others[name])
        sentences.append(
            f"The error of {nearest}, the best other method, is {others[nearest] / errors['graph']:.2f} times"
            " that of the graph. All methods are given the calibration and the clock that the graph found."
        )
    return [*sentences, f"{comparison.camera_words}."]


def sections(comparison: Comparison, recording: Recording) -> Iterator[PageSection]:
    """The sections about one arm."""
    for what, table in zip(("errors", "joints", "lag"), comparison.tables, strict=True):
        yield rendered(table, caption(f"Methods: {what}"))
    longest = sorted(comparison.graph.gaps, key=lambda gap: -gap.length_s)[:MOST_GAPS]
    for gap in sorted(longest, key=lambda gap: gap.start_s):
        heading = f"Gap at {gap.start_s:.2f} s, {gap.length_s:.2f} s long"
        yield PageSection(heading, caption("Methods: one gap"), in_gap(comparison, recording, gap))
    not_drawn = len(comparison.graph.gaps) - len(longest)
    more = [f"{not_drawn} gaps more are not drawn: the longest are"] if not_drawn else []
    yield notes([*more, *recording.notes, *comparison.notes])


def in_gap(comparison: Comparison, recording: Recording, gap: Gap) -> go.Figure:
    """Coordinates of the compared point and every method's error, in one gap and a little around it."""
    shown = (comparison.graph.t_s >= gap.start_s - AROUND_S) & (comparison.graph.t_s <= gap.end_s + AROUND_S)
    t, true = comparison.graph.t_s[shown], comparison.reference[shown]
    joint = "strap" if comparison.point == "sensor" else comparison.point
    offset = comparison.graph.clock_offset_s if np.isfinite(comparison.graph.clock_offset_s) else 0.0
    at = recording.arm.t_s + offset
    tracked = recording.arm.tracked(joint) & (at >= gap.start_s - AROUND_S) & (at <= gap.end_s + AROUND_S)
    camera = recording.arm.joint(joint)[tracked]
    answered = reversed(comparison.validated.items())
    paths = {name: each.path[shown] for name, each in answered if each.point == comparison.point}

    def lines(values: dict[str, FloatArray]) -> list[go.Scatter]:  # the best on top of the others
        drawn = {name: {"name": name, "mode": "lines", "line": line_of(name)} for name in values}
        return [go.Scatter(x=t, y=value, **drawn[name]) for name, value in values.items()]

    rows = []
    for axis, title in enumerate(axis_names(recording.camera_frame)):
        seen = dots(at[tracked], camera[:, axis], "camera", CAMERA, 4)
        known = curve(t, true[:, axis], "truth", TRUTH, 1.6, "dash")
        answers = lines({name: path[:, axis] for name, path in paths.items()})
        rows.append((f"{title}, m", [seen, *answers, known]))
    errors = {name: 100 * np.linalg.norm(path - true, axis=1) for name, path in paths.items()}
    rows.append(("error, cm", lines(errors)))
    plot = over_time(replace(comparison.graph, gaps=(gap,)), rows, 170, head=90)
    plot.update_yaxes(rangemode="tozero", row=4, col=1)
    return plot.update_layout(legend={"traceorder": "reversed"}, modebar={"orientation": "v"})


def _point(comparison: Comparison) -> str:
    return "forearm sensor" if comparison.point == "sensor" else comparison.point


#: By length of gap (s), rising, and method: `GapGroup.spread`.
Spreads = dict[float, dict[str, dict[str, Any]]]


def gap_curves_page(table: GapTable, name: str, remarks: Sequence[str] = ()) -> Page:
    """The errors in hidden gaps on one page."""
    spreads = {
        length: {method: group.spread for method, group in table.lengths[length].items()}
        for length in sorted(table.lengths)
    }
    gaps = sum(len(next(iter(methods.values())).rows) for methods in table.lengths.values())
    against = table.reference
    reference = (
        "the truth" if against == "truth" else f"what the camera saw of the {against}, its noise included"
    )
    return Page(
        f"Error against gap length: {name}",
        f"{gaps} gaps were made where the camera saw the arm, and recovered; compared with {reference}.",
        gap_verdict(spreads),
        [
            PageSection("Error against gap length", plot=curves(spreads)),
            rendered(table.table()),
            notes(dict.fromkeys((*remarks, *table.notes))),
        ],
    )


def gap_verdict(spreads: Spreads) -> list[str]:
    """How long a gap can be trusted, and to what, in sentences."""
    sentences, before = [], 0.0
    for limit_cm in (1, 2, 5, 10):
        longest = 0.0  # up to which the upper quartile stays within the limit at every length, s
        for length, methods in spreads.items():
            graph = methods.get("graph")
            if graph is None or graph["high_m"] is None or graph["high_m"] > limit_cm / 100:
                break
            if graph["failed"] > graph["gaps"] / 4:
                break
            longest = length
        if longest > before:
            before = longest
            sentences.append(
                f"Up to {longest:g} s the graph recovers three of four gaps to {limit_cm} cm rms or better"
            )
    if not sentences and any("graph" in methods for methods in spreads.values()):
        sentences.append("The graph does not recover three of four gaps to 10 cm rms at any of these lengths")
    return sentences or ["The table has the errors of each method."]


def curves(spreads: Spreads) -> go.Figure:
    """Median of the gaps' rms against their length, with the quartiles as bars."""
    plot = go.Figure()
    names = list(dict.fromkeys(name for methods in spreads.values() for name in methods))
    for place, name in enumerate(reversed(names)):  # the first on top of the others
        known = {
            length: spread
            for length, methods in spreads.items()
            if (spread := methods.get(name)) is not None and spread["median_m"] is not None
        }
        if not known:
            continue
        median, low, high = (
            [100 * (spread[part] or np.nan) for spread in known.values()]
            for part in ("median_m", "low_m", "high_m")
        )
        shift = 1.0 if name == "graph" else 1.012 ** (place - len(names) / 2)  # bars beside each other
        line = line_of(name)
        bars = interval_bars(median, low, high) | {"color": line["color"], "thickness": 1}
        trace = go.Scatter(x=[length * shift for length in known], y=median, name=label(name), line=line)
        plot.add_trace(trace.update(mode="lines+markers", error_y=bars))
    ticks = [f"{length:g}" for length in spreads]
    plot.update_xaxes(type="log", title_text="gap, s", tickvals=list(spreads), ticktext=ticks)
    plot.update_yaxes(type="log", title_text="error in a gap, rms, cm", exponentformat="none")
    dress(plot, 620, head=70)
    return plot.update_layout(legend={"traceorder": "reversed"}, showlegend=True)
