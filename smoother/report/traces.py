"""Curves over time: coordinates, angles, uncertainty, camera residuals; agreement with a reference."""

from __future__ import annotations

import numpy as np
import plotly.graph_objects as go

from ..angles import AngleTable
from ..angles.definitions import arm_angles
from ..array_types import BoolArray, FloatArray
from ..error_radius import error_radius
from ..evaluation.validate import sample_errors
from ..recording import JOINTS, CameraFrame, Truth
from ..result import Recovery
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
    over_time,
    seen_and_recovered,
)

#: Of a normal number 95 of 100 lie within this many standard deviations.
Z_95 = 1.96
#: Samples of an angle farther apart than this are not joined, degrees.
MOST_STEP_DEG = 120.0
#: Most residuals of a joint that are drawn.
MOST_RESIDUALS = 1200


def _thinned(chosen: BoolArray, most: int) -> np.ndarray:
    """Places where something is true, at most `most`."""
    index = np.flatnonzero(chosen)
    return index[decimate(np.zeros(len(index), bool), most)]


def _around(t: FloatArray, low: FloatArray, high: FloatArray) -> go.Scatter:
    """The band that contains 95 of 100 true values."""
    x, y = band(t, low, high)
    line = {"width": 0}
    return go.Scatter(x=x, y=y, name="95 %", fill="toself", fillcolor=BAND, line=line, hoverinfo="skip")


def coordinates(recovery: Recovery, shown: list[Point], frame: CameraFrame | None) -> go.Figure:
    """Coordinates over time with a band that contains 95 of 100 true values; buttons choose the point."""
    index = decimate(recovery.occluded)
    t, occluded, trusted = recovery.t_s[index], recovery.occluded[index], recovery.trusted[index]
    rows, owner = [], []
    for axis, title in enumerate(axis_names(frame)):
        traces: list[go.Scatter] = []
        for point in shown:
            value = point.position[index, axis]
            half = Z_95 * np.where(trusted, point.sigma[index, axis], np.nan)
            mine = [_around(t, value - half, value + half)]
            if len(point.camera):
                mine.append(dots(point.camera_t_s, point.camera[:, axis], "camera", CAMERA, 3))
            mine += seen_and_recovered(t, value, occluded, trusted)
            if len(point.truth):
                at = decimate(np.zeros(len(point.truth), bool))
                mine.append(reference_line(point.truth_t_s[at], point.truth[at, axis]))
            owner += [point.name] * len(mine)
            traces += [trace.update(visible=point is shown[0]) for trace in mine]
        rows.append((f"{title}, m", traces))
    buttons = [
        {"label": point.name, "method": "update", "args": [{"visible": [n == point.name for n in owner]}]}
        for point in shown
    ]
    menu: dict[str, object] = {"type": "buttons", "direction": "right", "buttons": buttons}
    menu |= {"x": 0, "xanchor": "left", "y": 1.01, "yanchor": "bottom"}
    figure = over_time(recovery, rows, 220, head=90)
    return figure.update_layout(updatemenus=[menu] if len(shown) > 1 else [])


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


def residuals(recovery: Recovery) -> go.Figure | None:
    """Distance of each camera sample from the answer, by joint; None where the method keeps none."""
    samples = recovery.residuals
    if samples is None:
        return None
    parts = [np.isfinite(batch.residual).all(axis=2) for batch in samples.batches()]
    answered = np.concatenate(parts) if parts else np.zeros((0, len(JOINTS)), bool)
    sentences = np.array([label(reason.sentence) for reason in samples.reasons])
    rows = []
    for joint in np.flatnonzero(answered.any(axis=0)).tolist():
        known, name = answered[:, joint], JOINTS[joint]
        used = _thinned(samples.used[:, joint] & known, MOST_RESIDUALS)
        aside = ~samples.used[:, joint] & known & (samples.reason[:, joint] != 0)
        rejected = _thinned(aside, MOST_RESIDUALS // 2)
        used_cm, rejected_cm = (
            100 * np.linalg.norm(samples.residual[:, joint][each], axis=1) for each in (used, rejected)
        )
        crosses = dots(samples.t_s[rejected], rejected_cm, "rejected", OCCLUDED, 6, symbol="x")
        crosses.update(text=sentences[samples.reason[rejected, joint]])
        drawn = [dots(samples.t_s[used], used_cm, name, JOINT_COLOURS[name], 3), crosses]
        rows.append((f"{name}, cm", [trace for trace in drawn if len(trace.x)]))
    if not rows:
        return None
    return over_time(recovery, rows, 120, head=60).update_yaxes(rangemode="tozero")
