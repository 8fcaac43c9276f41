"""Pages of every method beside the others: over each other in the gaps, and error against gap length."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from ..array_types import FloatArray
from ..evaluation.compare import Comparison
from ..evaluation.gap_table import GapSpread, GapTable, spread_by_length
from ..measurements.visibility import Gap
from ..recording import Recording
from ..table import centimetres
from .sheet import Page, figure, label, listing, rendered, tabulated
from .style import CAMERA, SHADE, TRUTH, axis_names, dots, dress

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


def faint(colour: str, opacity: float) -> str:
    """A colour #rrggbb as rgba."""
    red, green, blue = (int(colour[i : i + 2], 16) for i in (1, 3, 5))
    return f"rgba({red}, {green}, {blue}, {opacity:g})"


#: Gaps drawn at most: half of them the longest, half those in which the best method is worst.
MOST_GAPS = 6
#: Time shown on both sides of a gap, s.
AROUND_S = 0.6


def comparison_page(comparison: Comparison, recording: Recording) -> Page:
    """A comparison on one page."""
    return Page(
        comparison.title(f"Methods compared: {recording.name}"),
        f"{len(comparison.rows)} methods, {len(comparison.gaps)} gaps, the {_point(comparison)} compared"
        " with the truth.",
        verdict(comparison),
        sections(comparison, recording),
    )


def verdict(comparison: Comparison) -> list[str]:
    """What the comparison says, in sentences."""
    errors = {
        row.method: figures.position_rms_m
        for row in comparison.rows
        if (figures := comparison.figures(row, comparison.part)) is not None
        and figures.position_rms_m is not None
    }
    if not errors:
        return ["No method has a result that can be compared with the truth."]
    ranked = [f"{name} {100 * error:.1f}" for name, error in errors.items()]
    sentences = [f"Error of the {_point(comparison)} {comparison.where}, rms, cm: {', '.join(ranked)}."]
    best = next(iter(errors))
    if "graph" in errors and len(errors) > 1:
        others = {name: error for name, error in errors.items() if name != "graph"}
        nearest = min(others, key=lambda name: others[name])
        ratio = others[nearest] / errors["graph"]
        if best == "graph" and ratio > 1.05:
            sentences.append(
                f"The graph is the most accurate; the next, {nearest}, has {ratio:.2f} times its error."
            )
        elif ratio >= 1 / 1.05:
            sentences.append(f"graph and {nearest} are equally accurate ({100 * (ratio - 1):+.0f} %).")
        else:
            sentences.append(
                f"{nearest} is more accurate than the graph here: its error is {ratio:.2f} times as large."
                " Every method is given the calibration and the clock that the graph estimated."
            )
    sentences.append(comparison.camera_words + ".")
    return sentences


def sections(comparison: Comparison, recording: Recording) -> Iterator[str]:
    """The sections about one arm, as HTML."""
    yield from map(rendered, comparison.tables)
    for gap in chosen_gaps(comparison):
        yield figure(
            f"Gap at {gap.start_s:.2f} s, {gap.length_s:.2f} s long",
            _CURVES,
            in_gap(comparison, recording, gap),
        )
    not_drawn = len(comparison.gaps) - min(len(comparison.gaps), MOST_GAPS)
    more = (
        [f"{not_drawn} gaps more are not drawn: the longest are, and those with the largest errors"]
        if not_drawn
        else []
    )
    yield listing("Notes", [*more, *recording.notes, *comparison.notes], "There is nothing to note.")


def chosen_gaps(comparison: Comparison) -> list[Gap]:
    """The gaps to draw, in order of time."""
    if len(comparison.gaps) <= MOST_GAPS:
        return list(comparison.gaps)
    longest = sorted(comparison.gaps, key=lambda gap: -gap.length_s)[: MOST_GAPS // 2]
    worst = sorted(
        (gap for gap in comparison.gaps if gap not in longest), key=lambda gap: -_error_in(comparison, gap)
    )
    return sorted([*longest, *worst[: MOST_GAPS - len(longest)]], key=lambda gap: gap.start_s)


def _error_in(comparison: Comparison, gap: Gap) -> float:
    path = comparison.rows[0].path
    inside = (comparison.t_s >= gap.start_s) & (comparison.t_s <= gap.end_s)
    if path is None:
        return 0.0
    off = np.linalg.norm(path[inside] - comparison.reference[inside], axis=1)
    return float(np.nanmax(off)) if np.isfinite(off).any() else 0.0


def in_gap(comparison: Comparison, recording: Recording, gap: Gap) -> go.Figure:
    """Coordinates of the compared point and every method's error, in one gap and a little around it."""
    shown = (comparison.t_s >= gap.start_s - AROUND_S) & (comparison.t_s <= gap.end_s + AROUND_S)
    t, true = comparison.t_s[shown], comparison.reference[shown]
    plot = make_subplots(rows=4, cols=1, shared_xaxes=True, vertical_spacing=0.035)
    _camera(plot, comparison, recording, t)
    for row in reversed(comparison.rows):  # the best on top of the others
        if row.path is None:
            continue
        path = row.path[shown]
        for axis, values in enumerate([*path.T, 100 * np.linalg.norm(path - true, axis=1)]):
            _line(plot, axis, t, values, row.method, line_of(row.method))
    for axis, values in enumerate(true.T):
        _line(plot, axis, t, values, "truth", {"color": TRUTH, "width": 1.6, "dash": "dash"})
    for axis, name in enumerate(axis_names(recording.camera_frame)):
        plot.update_yaxes(title_text=f"{name}, m", row=axis + 1, col=1)
    plot.update_yaxes(title_text="error, cm", rangemode="tozero", row=4, col=1)
    plot.update_xaxes(title_text="time, s", row=4, col=1)
    plot.add_vrect(gap.start_s, gap.end_s, fillcolor=SHADE, line_width=0, layer="below", row="all", col=1)
    dress(plot, 820, head=90)
    return plot.update_layout(legend={"traceorder": "reversed"}, modebar={"orientation": "v"})


def _line(
    plot: go.Figure, axis: int, t: FloatArray, values: FloatArray, name: str, line: dict[str, object]
) -> None:
    trace = go.Scatter(
        x=t.astype(np.float32), y=values.astype(np.float32), name=name, mode="lines", line=line
    )
    trace.update(legendgroup=name, showlegend=axis == 0)
    plot.add_trace(trace, row=axis + 1, col=1)


def _camera(plot: go.Figure, comparison: Comparison, recording: Recording, t: FloatArray) -> None:
    """What the camera tracked of the compared point, on the IMU's clock."""
    joint = "strap" if comparison.point == "sensor" else comparison.point
    offset = comparison.clock_offset_s if np.isfinite(comparison.clock_offset_s) else 0.0
    at = recording.arm.t_s + offset
    tracked = recording.arm.tracked(joint) & (at >= t[0]) & (at <= t[-1]) if len(t) else np.zeros(0, bool)
    if not tracked.any():
        return
    for axis in range(3):
        samples = dots(at[tracked], recording.arm.joint(joint)[tracked, axis], "camera", CAMERA, 4)
        samples.update(legendgroup="camera", showlegend=axis == 0)
        plot.add_trace(samples, row=axis + 1, col=1)


def _point(comparison: Comparison) -> str:
    return "forearm sensor" if comparison.point == "sensor" else comparison.point


_CURVES = (
    "The shaded time is hidden from the camera. The dashed line is the truth. Click a name to hide its"
    " curve, double-click to isolate it. The lowest plot is the distance from the truth."
)


Spreads = dict[float, dict[str, GapSpread]]


def gap_curves_page(table: GapTable, name: str, notes: Sequence[str] = ()) -> Page:
    """The errors in hidden gaps on one page."""
    spreads = spread_by_length(table.rows)
    gaps = sum(next(iter(methods.values())).gaps for methods in spreads.values())
    against = next((row.reference for row in table.rows if row.reference), "truth")
    reference = (
        "the truth" if against == "truth" else f"what the camera saw of the {against}, its noise included"
    )
    return Page(
        f"Error against gap length: {name}",
        f"{gaps} gaps were made where the camera saw the arm, and recovered; compared with {reference}.",
        gap_verdict(spreads),
        _sections(spreads, (*notes, *table.notes)),
    )


def gap_verdict(spreads: Spreads) -> list[str]:
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
        sentences.append("The graph does not recover three of four gaps to 10 cm rms at any of these lengths")
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
    yield figure("Error against gap length", _GAP_CURVES, curves(spreads))
    rows = [
        (
            f"{length:g}",
            name,
            *[
                centimetres(value)
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


_GAP_CURVES = (
    "Each gap's error is its root mean square; lines join the medians over the gaps of a length. Bars (for"
    " the graph a band) reach from the 25 % to the 75 % quartile. Both axes are logarithmic. Click a name to"
    " hide its line."
)
_TABLE = (
    "Each gap counts once, with its rms: median, quartiles, root mean square and the worst over the gaps of a"
    " length, the best median first. (The terminal's median is over all samples of these gaps.)"
)
