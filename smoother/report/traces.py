"""Curves over time: coordinates, angles, uncertainty, what the camera disagrees with."""

from __future__ import annotations

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from ..angles import AngleTable
from ..array_types import BoolArray, FloatArray, IntArray
from ..error_radius import error_radius
from ..evaluation.validate import sample_errors
from ..joint_angles import arm_angles
from ..recording import JOINTS, CameraFrame, Truth
from ..result import FrameResiduals, Recovery
from .player import Point
from .sheet import capitalised, label
from .style import (
    BAND,
    CAMERA,
    JOINT_COLOURS,
    OCCLUDED,
    TRUTH,
    VISIBLE,
    axis_names,
    band,
    curve,
    decimate,
    dots,
    dress,
    seen_and_recovered,
    shade,
)

#: Of a normal number 95 of 100 lie within this many standard deviations.
Z_95 = 1.96
#: Samples of an angle farther apart than this are not joined, degrees.
MOST_STEP_DEG = 120.0
#: Most residuals of a joint that are drawn; every dot is an element of the page.
MOST_RESIDUALS = 1200
_TIME = "time, s"


def coordinates(recovery: Recovery, shown: list[Point], frame: CameraFrame | None) -> go.Figure:
    """Coordinates over time with a band that contains 95 of 100 true values; buttons choose the point."""
    figure = make_subplots(rows=3, cols=1, shared_xaxes=True, vertical_spacing=0.04)
    index = decimate(recovery.occluded)
    t, occluded, trusted = recovery.t_s[index], recovery.occluded[index], recovery.trusted[index]
    owner: list[str] = []
    for point in shown:
        for axis in range(3):
            for trace in _coordinate(point, axis, t, index, occluded, trusted):
                trace.update(visible=point is shown[0], showlegend=axis == 0)
                figure.add_trace(trace, row=axis + 1, col=1)
                owner.append(point.name)
    for axis, name in enumerate(axis_names(frame)):
        figure.update_yaxes(title_text=f"{name}, m", row=axis + 1, col=1)
    figure.update_xaxes(title_text=_TIME, row=3, col=1)
    shade(figure, recovery)
    buttons = [
        {
            "label": point.name,
            "method": "update",
            "args": [{"visible": [name == point.name for name in owner]}],
        }
        for point in shown
    ]
    menu: dict[str, object] = {"type": "buttons", "direction": "right", "buttons": buttons}
    menu |= {"x": 0, "xanchor": "left", "y": 1.01, "yanchor": "bottom"}
    return dress(figure, 800, head=90, updatemenus=[menu] if len(shown) > 1 else [])


def _coordinate(
    point: Point, axis: int, t: FloatArray, index: np.ndarray, occluded: BoolArray, trusted: BoolArray
) -> list[go.Scatter]:
    """Band where it is trusted, camera samples, line seen, line recovered and truth of one coordinate."""
    value, sigma = point.position[index, axis], np.where(trusted, point.sigma[index, axis], np.nan)
    x, y = band(t, value - Z_95 * sigma, value + Z_95 * sigma)
    traces = [
        go.Scatter(x=x, y=y, name="95 %", fill="toself", fillcolor=BAND, line={"width": 0}, hoverinfo="skip")
    ]
    if len(point.camera):
        traces.append(dots(point.camera_t_s, point.camera[:, axis], "camera", CAMERA, 3))
    traces += seen_and_recovered(t, value, occluded, trusted=trusted)
    if len(point.truth):
        rows = decimate(np.zeros(len(point.truth), bool))
        traces.append(curve(point.truth_t_s[rows], point.truth[rows, axis], "reference", TRUTH, 1.2, "dash"))
    return traces


def angles(recovery: Recovery, table: AngleTable, truth: Truth | None = None) -> go.Figure | None:
    """The joint angles over time, a row each, with 95 of 100 true values in the band; None without any."""
    shown = [angle for angle in table.angles if np.isfinite(table.values[angle.name]).any()]
    if not shown:
        return None
    titles = [f"{capitalised(angle.title)}, degrees" for angle in shown]
    head, row_height = 84, 128
    height = head + 50 + row_height * len(shown)
    figure = make_subplots(
        rows=len(shown),
        cols=1,
        shared_xaxes=True,
        vertical_spacing=30 / (height - head - 50) if len(shown) > 1 else 0.0,
        subplot_titles=titles,
    )
    figure.update_annotations(x=0, xanchor="left", font={"size": 13})
    reference = (
        {} if truth is None else arm_angles(truth.joints, len(truth), None, recovery.side, _down(recovery))
    )
    index = decimate(recovery.occluded)
    t, trusted = recovery.t_s[index], recovery.trusted[index]
    named: set[str] = set()
    for row, angle in enumerate(shown, start=1):
        value = table.values[angle.name][index]
        half = Z_95 * np.where(trusted, table.sigmas[angle.name][index], np.nan)
        value, breaks = _unwrapped(value)
        low, high = _range(value)
        traces = []
        if np.isfinite(half).any():
            x, y = band(t, np.maximum(value - half, low - 400), np.minimum(value + half, high + 400))
            around = go.Scatter(x=x, y=y, fill="toself", fillcolor=BAND, line={"width": 0}, hoverinfo="skip")
            traces.append(around.update(name="95 %"))
        traces += seen_and_recovered(
            t, np.where(breaks, np.nan, value), recovery.occluded[index], trusted=trusted
        )
        if truth is not None and np.isfinite(reference.get(angle.name, np.nan)).any():
            rows = decimate(np.zeros(len(truth), bool))
            true, _ = _unwrapped(reference[angle.name][rows])
            true += 360.0 * np.round((np.nanmedian(value) - np.nanmedian(true)) / 360.0)
            traces.append(curve(truth.t_s[rows], true, "reference", TRUTH, 1.2, "dash"))
        for trace in traces:
            trace.update(legendgroup=trace.name, showlegend=trace.name not in named)
            named.add(trace.name)
            figure.add_trace(trace, row=row, col=1)
        figure.update_yaxes(range=[low, high], nticks=5, row=row, col=1)
    figure.update_xaxes(title_text=_TIME, row=len(shown), col=1)
    shade(figure, recovery)
    return dress(figure, height, head=head)


def _down(recovery: Recovery) -> FloatArray | None:
    return recovery.gravity_direction if np.isfinite(recovery.gravity_direction).all() else None


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


def _range(value: FloatArray) -> tuple[float, float]:
    """What a row shows: the angle itself, with room; a wide band is cut off."""
    low, high = float(np.nanmin(value)), float(np.nanmax(value))
    room = max(0.12 * (high - low), 4.0)
    return low - room, high + room


def uncertainty(recovery: Recovery, truth: Truth | None) -> go.Figure | None:
    """Within which distance and angle 95 of 100 errors lie, over time, and the errors of a truth; or None."""
    within_cm = np.where(recovery.trusted, 100 * recovery.error_95_m, np.nan)
    within_deg = np.where(
        recovery.trusted, np.degrees(error_radius(recovery.pose_covariance[:, 3:, 3:])), np.nan
    )
    errors = None if truth is None else sample_errors(recovery, truth)
    if not np.isfinite(within_cm).any() and errors is None:
        return None
    figure = make_subplots(rows=2, cols=1, shared_xaxes=True, vertical_spacing=0.07)
    index = decimate(recovery.occluded)
    t = recovery.t_s[index]
    error_cm = None if errors is None else 100 * errors.distance_m
    error_deg = None if errors is None else errors.angle_deg
    rows = (("position, cm", within_cm, error_cm), ("orientation, degrees", within_deg, error_deg))
    for row, (name, within, error) in enumerate(rows, start=1):
        lines = [curve(t, within[index], "95 of 100 errors lie below", VISIBLE, 1.8)]
        if error is not None:
            lines.append(curve(t, error[index], "error against the reference", TRUTH, 1.1))
        for line in lines:
            figure.add_trace(line.update(showlegend=row == 1), row=row, col=1)
        figure.update_yaxes(title_text=name, rangemode="tozero", row=row, col=1)
    figure.update_xaxes(title_text=_TIME, row=2, col=1)
    shade(figure, recovery)
    return dress(figure, 480)


def residuals(recovery: Recovery) -> go.Figure | None:
    """Distance of each camera sample from the answer, by joint; None where the method keeps none."""
    samples = recovery.residuals
    if samples is None:
        return None
    parts = [np.isfinite(batch.residual).all(axis=2) for batch in samples.batches()]
    answered = np.concatenate(parts) if parts else np.zeros((0, len(JOINTS)), bool)
    drawn = np.flatnonzero(answered.any(axis=0)).tolist()
    if not drawn:
        return None
    figure = make_subplots(rows=len(drawn), cols=1, shared_xaxes=True, vertical_spacing=0.03)
    for row, i in enumerate(drawn, start=1):
        for trace in _residual(samples, answered[:, i], i):
            figure.add_trace(trace, row=row, col=1)
        figure.update_yaxes(title_text=f"{JOINTS[i]}, cm", rangemode="tozero", row=row, col=1)
    figure.update_xaxes(title_text=_TIME, row=len(drawn), col=1)
    figure.add_trace(_crosses(np.array([None]), np.array([None])), row=1, col=1)
    shade(figure, recovery)
    return dress(figure, 160 + 120 * len(drawn))


def _residual(samples: FrameResiduals, answered: BoolArray, joint: int) -> list[go.Scatter]:
    def distance_cm(index: IntArray) -> FloatArray:
        return 100 * np.linalg.norm(samples.residual[:, joint][index], axis=1)

    aside = ~samples.used[:, joint] & answered & (samples.reason[:, joint] != 0)
    index = np.flatnonzero(samples.used[:, joint] & answered)
    index = index[decimate(np.zeros(len(index), bool), MOST_RESIDUALS)]
    name = JOINTS[joint]
    traces = [dots(samples.t_s[index], distance_cm(index), name, JOINT_COLOURS[name], 3)]
    index = np.flatnonzero(aside)
    index = index[decimate(np.zeros(len(index), bool), MOST_RESIDUALS // 2)]
    if len(index):
        crosses = _crosses(samples.t_s[index], distance_cm(index))
        sentences = np.array([label(reason.sentence) for reason in samples.reasons])
        crosses.update(text=sentences[samples.reason[index, joint]], showlegend=False)
        traces.append(crosses)
    return traces


def _crosses(x: np.ndarray, y: np.ndarray) -> go.Scatter:
    return dots(x, y, "rejected", OCCLUDED, 6, symbol="x")
