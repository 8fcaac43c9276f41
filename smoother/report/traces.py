"""Curves over time: coordinates, angles, uncertainty; agreement with a reference.

How the report's figures look: colours, axes, shaded gaps, and fewer points where the eye needs no more.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import plotly.graph_objects as go
from numpy.typing import ArrayLike
from plotly.subplots import make_subplots
from scipy.ndimage import binary_dilation

from ..angles import AngleTable
from ..angles.definitions import arm_angles
from ..array_types import BoolArray, FloatArray, IntArray
from ..error_radius import error_radius
from ..evaluation.validate import sample_errors
from ..linalg import runs
from ..recording import CameraFrame, Truth
from ..result import Recovery
from ..result.untrusted import partly_untrusted, untrusted_times
from .sheet import capitalised

#: Most points of one drawn line.
MOST_POINTS = 4000
#: Share of them that the gaps may take.
GAP_SHARE = 0.6


def decimate(important: BoolArray, most: int = MOST_POINTS) -> IntArray:  # important bool (n,) -> int (m,)
    """Samples to draw: at most `most`, evenly spaced, closer together where it is important."""
    count = len(important)
    if count <= most:
        return np.arange(count)
    wide = binary_dilation(important, np.ones(21))  # with their edges
    inside, outside = np.flatnonzero(wide), np.flatnonzero(~wide)
    budget_inside = min(len(inside), int(GAP_SHARE * most))
    ends = np.array([0, count - 1])
    chosen = [_every(inside, budget_inside), _every(outside, most - budget_inside - 2), ends]
    return np.unique(np.concatenate(chosen))


def _every(index: IntArray, most: int) -> IntArray:
    if len(index) <= most or most <= 0:
        return index[: max(most, 0)]
    return index[np.linspace(0, len(index) - 1, most).round().astype(np.int64)]


def split_line(values: FloatArray, occluded: BoolArray) -> tuple[FloatArray, FloatArray]:
    """A line's visible and its occluded part (N, ...), nan where it is the other; they meet at the edges."""
    edge = occluded.copy()
    edge[:-1] |= occluded[1:]
    edge[1:] |= occluded[:-1]
    shape = (-1,) + (1,) * (values.ndim - 1)
    visible = np.where(occluded.reshape(shape), np.nan, values)
    hidden = np.where(edge.reshape(shape), values, np.nan)
    return visible, hidden


def band(t_s: FloatArray, low: FloatArray, high: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Outline (x, y) of the area between two curves: a closed loop each run without nan, nan between."""
    finite = np.isfinite(low) & np.isfinite(high) & np.isfinite(t_s)
    x: list[FloatArray] = []
    y: list[FloatArray] = []
    for part in runs(finite):
        x += [t_s[part], t_s[part][::-1], np.array([np.nan])]
        y += [high[part], low[part][::-1], np.array([np.nan])]
    if not x:
        return np.zeros(0), np.zeros(0)
    return np.concatenate(x), np.concatenate(y)


#: Told apart by readers with any colour vision.
VISIBLE, OCCLUDED, TRUTH, CAMERA = "#0072B2", "#D55E00", "#111111", "#8a8a8a"
#: What is not to be trusted; its lines are dotted, too.
UNTRUSTED = "#b00020"
SHADE, SHADE_UNTRUSTED = "rgba(213, 94, 0, 0.13)", "rgba(176, 0, 32, 0.24)"
BAND = "rgba(0, 114, 178, 0.20)"
JOINT_COLOURS = {
    "shoulder": "#CC79A7",
    "elbow": "#009E73",
    "wrist": "#0072B2",
    "hand": "#E69F00",
    "strap": "#56B4E9",
}
#: More shaded gaps than this make a page slow.
MOST_SHADES = 400

_MEANING = {
    CameraFrame.KINECT: ("left", "up", "away"),
    CameraFrame.OPTICAL: ("right", "down", "away"),
    CameraFrame.ZUP: ("", "", "up"),
}


_AXIS = {"gridcolor": "#e4e7ea", "zerolinecolor": "#cccccc", "automargin": True, "title": {"standoff": 8}}
#: Plain, and without a background, so that a page in dark colours shows through.
_TEMPLATE = go.layout.Template(
    layout={
        "paper_bgcolor": "rgba(0, 0, 0, 0)",
        "plot_bgcolor": "rgba(0, 0, 0, 0)",
        "colorway": [*JOINT_COLOURS.values(), CAMERA],
        "xaxis": _AXIS,
        "yaxis": _AXIS,
        "modebar": {"bgcolor": "rgba(0, 0, 0, 0)", "color": "#9a9a9a", "activecolor": VISIBLE},
    }
)


def axis_names(frame: CameraFrame | None) -> tuple[str, str, str]:
    """Names of the camera's axes with their directions, for axis titles (without unit)."""
    meanings = _MEANING[frame] if frame is not None else ("", "", "")
    x, y, z = (
        f"{axis} ({meaning})" if meaning else axis for axis, meaning in zip("xyz", meanings, strict=True)
    )
    return x, y, z


def dress(figure: go.Figure, height: int, head: int = 50, **layout: Any) -> go.Figure:
    """Give a figure the report's plain look; `head` is the room above it for the legend, pixels."""
    figure.update_layout(
        template=_TEMPLATE,
        height=height,
        margin={"l": 70, "r": 20, "t": head, "b": 50},
        font={"family": "system-ui, sans-serif", "size": 13},
        legend={"orientation": "h", "yanchor": "top", "y": 0.995, "yref": "container", "x": 0},
        hovermode="closest",
        **layout,
    )
    return figure


def curve(
    x: ArrayLike,
    y: ArrayLike,
    name: str | None,
    colour: str,
    width: float | None = None,
    dash: str | None = None,
    **more: Any,
) -> go.Scatter:
    """A line."""
    line = {"color": colour, "width": width, "dash": dash}
    return go.Scatter(x=x, y=y, name=name, mode="lines", line=line, **more)


def dots(
    x: ArrayLike, y: ArrayLike, name: str | None, colour: str | None, size: float, **more: Any
) -> go.Scatter:
    """Points, by default discs; `symbol` is another mark for all or for each of them."""
    marker = {"color": colour, "size": size, "symbol": more.pop("symbol", None)}
    return go.Scatter(x=x, y=y, name=name, mode="markers", marker=marker, **more)


def seen_and_recovered(
    t: ArrayLike,  # (n,)
    values: FloatArray,  # (n,)
    occluded: BoolArray,  # bool (n,)
    trusted: BoolArray,  # bool (n,)
) -> list[go.Scatter]:
    """The lines of a value: where the camera saw the arm, where it was recovered, where it is not trusted."""
    values, distrusted = split_line(values, ~trusted)
    wrong = [curve(t, distrusted, "not to be trusted", UNTRUSTED, 1.8, "dot")]
    if not trusted.any():
        return wrong
    visible, hidden = split_line(values, occluded)
    lines = [curve(t, visible, "seen", VISIBLE, 1.8), curve(t, hidden, "recovered", OCCLUDED, 1.8)]
    return lines if trusted.all() else [*lines, *wrong]


def over_time(
    recovery: Recovery,
    rows: Sequence[tuple[str, Sequence[go.Scatter]]],
    row_px: int,
    *,
    head: int = 50,
    titles_above: bool = False,
) -> go.Figure:
    """Traces over one time axis, a row each title, the gaps shaded; each name stands once in the legend."""
    height, count = head + 50 + row_px * len(rows), len(rows)
    figure = make_subplots(
        rows=count,
        cols=1,
        shared_xaxes=True,
        vertical_spacing=(30 if titles_above else 16) / (row_px * count) if count > 1 else 0.0,
        subplot_titles=[title for title, _ in rows] if titles_above else None,
    )
    figure.update_annotations(x=0, xanchor="left", font={"size": 13})
    named: set[str] = set()
    for row, (title, traces) in enumerate(rows, start=1):
        for trace in traces:
            trace.update(legendgroup=trace.name, showlegend=trace.name not in named)
            named.add(trace.name)
            figure.add_trace(trace, row=row, col=1)
        if not titles_above:
            figure.update_yaxes(title_text=title, row=row, col=1)
    figure.update_xaxes(title_text="time, s", row=count, col=1)
    _shade(figure, recovery)
    return dress(figure, height, head=head)


def _shade(figure: go.Figure, recovery: Recovery) -> None:
    """Shade the gaps over the whole height (the longest if very many), and show the player's time there."""
    both = sorted(zip(recovery.gaps, recovery.gap_verdicts, strict=True), key=lambda each: -each[0].length_s)
    gaps = [(gap.start_s, gap.end_s, verdict.trusted) for gap, verdict in both[:MOST_SHADES]]
    red = [(start, end) for start, end, trusted in gaps if not trusted]
    if partly_untrusted(recovery):
        red += untrusted_times(recovery)
    plain = {"type": "path", "xref": "x", "yref": "paper", "layer": "below", "line": {"width": 0}}
    plain |= {"fillrule": "nonzero"}
    shapes = []
    good = [(start, end) for start, end, trusted in gaps if trusted]
    for each, colour in ((good, SHADE), (red, SHADE_UNTRUSTED)):
        # as one shape: hundreds of them are slow to draw; what overlaps is filled once
        path = " ".join(f"M {start:.4f},0 V 1 H {end:.4f} V 0 Z" for start, end in each)
        shapes += [{**plain, "path": path, "fillcolor": colour}] if path else []
    figure.update_layout(shapes=shapes, meta={"time": True})


def interval_bars(value: Sequence[float], low: Sequence[float], high: Sequence[float]) -> dict[str, Any]:
    """Plotly's error bars for 95 % intervals; none where an end is nan."""
    middle = np.asarray(value, float)
    ends = {"array": np.asarray(high, float) - middle, "arrayminus": middle - np.asarray(low, float)}
    known = np.isfinite(ends["array"]) & np.isfinite(ends["arrayminus"])
    ends = {name: np.where(known, each, 0.0) for name, each in ends.items()}
    return {"type": "data", "symmetric": False, "thickness": 1.5, "width": 4, "color": TRUTH, **ends}


def values_with_intervals(
    at: Iterable[float], value: Sequence[float], low: Sequence[float], high: Sequence[float]
) -> go.Scatter:
    """A dot for each value with its 95 % interval."""
    dots = go.Scatter(x=list(at), y=value, mode="markers", error_y=interval_bars(value, low, high))
    return dots.update(marker_color=VISIBLE)


#: Of a normal number 95 of 100 lie within this many standard deviations.
Z_95 = 1.96
#: Samples of an angle farther apart than this are not joined, degrees.
MOST_STEP_DEG = 120.0


def _thinned(chosen: BoolArray, most: int) -> np.ndarray:
    """Places where something is true, at most `most`."""
    index = np.flatnonzero(chosen)
    return index[decimate(np.zeros(len(index), bool), most)]


def _around(t: FloatArray, low: FloatArray, high: FloatArray) -> go.Scatter:
    """The band that contains 95 of 100 true values."""
    x, y = band(t, low, high)
    line = {"width": 0}
    return go.Scatter(x=x, y=y, name="95 %", fill="toself", fillcolor=BAND, line=line, hoverinfo="skip")


#: Most camera samples of a joint that are drawn.
MOST_DOTS = 1500


def coordinates(recovery: Recovery, truth: Truth | None, frame: CameraFrame | None) -> go.Figure:
    """Coordinates of the joint that the camera sees best, else of the IMU, with bands of 95 of 100 values."""
    arm = recovery.arm
    seen = [joint for joint in ("wrist", "elbow", "hand") if joint in recovery.joints]
    name = next((joint for joint in seen if arm.tracked(joint).any()), "strap")
    position, covariance = recovery.position, recovery.pose_covariance[:, :3, :3]
    reference = None if truth is None else truth.position
    if name != "strap":
        unknown = np.full((len(recovery), 3, 3), np.nan)
        position, covariance = recovery.joints[name], recovery.joint_covariance.get(name, unknown)
        reference = None if truth is None else truth.joints.get(name)
    frames = _thinned(arm.tracked(name), MOST_DOTS)
    index = decimate(recovery.occluded)
    t, occluded, trusted = recovery.t_s[index], recovery.occluded[index], recovery.trusted[index]
    sigma = np.sqrt(np.einsum("nii->ni", covariance[index]))
    rows = []
    for axis, title in enumerate(axis_names(frame)):
        value = position[index, axis]
        half = Z_95 * np.where(trusted, sigma[:, axis], np.nan)
        traces = [_around(t, value - half, value + half)]
        if len(frames):
            traces.append(dots(arm.t_s[frames], arm.joint(name)[frames, axis], "camera", CAMERA, 3))
        traces += seen_and_recovered(t, value, occluded, trusted)
        if truth is not None and reference is not None:
            at = decimate(np.zeros(len(truth), bool))
            traces.append(reference_line(truth.t_s[at], reference[at, axis]))
        rows.append((f"{'IMU' if name == 'strap' else name} {title}, m", traces))
    return over_time(recovery, rows, 220, head=90)


def reference_line(t: FloatArray, values: FloatArray) -> go.Scatter:
    """The reference's own curve."""
    return curve(t, values, "reference", TRUTH, 1.2, "dash")


def angles(recovery: Recovery, table: AngleTable, truth: Truth | None = None) -> go.Figure | None:
    """The joint angles over time, a row each, with 95 of 100 true values in the band; None without any."""
    shown = [angle for angle in table.angles if np.isfinite(table.values[angle.name]).any()]
    if not shown:
        return None
    down = recovery.gravity_direction if np.isfinite(recovery.gravity_direction).all() else None
    reference = {} if truth is None else arm_angles(truth.joints, len(truth), None, recovery.side, down)
    index = decimate(recovery.occluded)
    t, trusted = recovery.t_s[index], recovery.trusted[index]
    rows, ranges = [], []
    for angle in shown:
        half = Z_95 * np.where(trusted, table.sigmas[angle.name][index], np.nan)
        value, breaks = _unwrapped(table.values[angle.name][index])
        low, high = float(np.nanmin(value)), float(np.nanmax(value))
        room = max(0.12 * (high - low), 4.0)  # a wide band is cut off
        ranges.append([low - room, high + room])
        traces = []
        if np.isfinite(half).any():
            traces.append(
                _around(t, np.maximum(value - half, low - 400), np.minimum(value + half, high + 400))
            )
        whole = np.where(breaks, np.nan, value)
        traces += seen_and_recovered(t, whole, recovery.occluded[index], trusted)
        if truth is not None and np.isfinite(reference.get(angle.name, np.nan)).any():
            at = decimate(np.zeros(len(truth), bool))
            true, _ = _unwrapped(reference[angle.name][at])
            true += 360.0 * np.round((np.nanmedian(value) - np.nanmedian(true)) / 360.0)
            traces.append(reference_line(truth.t_s[at], true))
        rows.append((f"{capitalised(angle.title)}, degrees", traces))
    figure = over_time(recovery, rows, 128, head=84, titles_above=True)
    for row, ends in enumerate(ranges, start=1):
        figure.update_yaxes(range=ends, nticks=5, row=row, col=1)
    return figure


def _unwrapped(value: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Angles (n,), degrees, without jumps of a whole turn; nan stays. And where nothing joins two samples."""
    known = np.flatnonzero(np.isfinite(value))
    out = value.copy()
    out[known] = np.degrees(np.unwrap(np.radians(value[known])))
    if len(known):
        out[known] -= 360.0 * np.round(np.median(out[known]) / 360.0)
    breaks = np.zeros(len(value), bool)
    breaks[known[1:]] = np.abs(np.diff(out[known])) > MOST_STEP_DEG
    return out, breaks


def uncertainty(recovery: Recovery, truth: Truth | None) -> go.Figure | None:
    """Within which distance and angle 95 of 100 errors lie, over time, and the errors of a truth; or None."""
    within_deg = np.degrees(error_radius(recovery.pose_covariance[:, 3:, 3:]))
    within = [np.where(recovery.trusted, each, np.nan) for each in (100 * recovery.error_95_m, within_deg)]
    errors = None if truth is None else sample_errors(recovery, truth)
    if not np.isfinite(within[0]).any() and errors is None:
        return None
    index = decimate(recovery.occluded)
    t = recovery.t_s[index]
    traces = [[curve(t, each[index], "95 of 100 errors lie below", VISIBLE, 1.8)] for each in within]
    if errors is not None:
        for row, each in zip(traces, (100 * errors.distance_m, errors.angle_deg), strict=True):
            row.append(curve(t, each[index], "error against the reference", TRUTH, 1.1))
        hidden = "legendonly" if np.isfinite(errors.distance_m).any() else True
        for joint, of_joint in errors.joints.items():
            distance, colour = 100 * of_joint.distance_m[index], JOINT_COLOURS.get(joint, CAMERA)
            traces[0].append(curve(t, distance, f"{joint}, error", colour, 1.1, visible=hidden))
    figure = over_time(
        recovery, list(zip(("position, cm", "orientation, degrees"), traces, strict=True)), 190
    )
    return figure.update_yaxes(rangemode="tozero")
