"""Curves over time: coordinates, angles, uncertainty, what the camera disagrees with."""

from __future__ import annotations

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from ..array_types import BoolArray, FloatArray, IntArray
from ..evaluation.validate import sample_errors
from ..joint_angles import arm_angles, elbow_flexion_sigma
from ..linalg import unit
from ..recording import JOINTS, CameraFrame, Truth
from ..result import FrameResiduals, Recovery
from .player import Point
from .sheet import label
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

FLEXION = "elbow flexion"
#: Most residuals of a joint that are drawn; every dot is an element of the page.
MOST_RESIDUALS = 1200
_TIME = "time, s"


def coordinates(recovery: Recovery, shown: list[Point], frame: CameraFrame | None) -> go.Figure:
    """Coordinates over time with their band of two sigmas; buttons choose the point."""
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
    x, y = band(t, value - 2 * sigma, value + 2 * sigma)
    traces = [
        go.Scatter(
            x=x, y=y, name="+- 2 sigma", fill="toself", fillcolor=BAND, line={"width": 0}, hoverinfo="skip"
        )
    ]
    if len(point.camera):
        traces.append(dots(point.camera_t_s, point.camera[:, axis], "camera", CAMERA, 3))
    traces += seen_and_recovered(t, value, occluded, trusted=trusted)
    if len(point.truth):
        rows = decimate(np.zeros(len(point.truth), bool))
        traces.append(curve(point.truth_t_s[rows], point.truth[rows, axis], "reference", TRUTH, 1.2, "dash"))
    return traces


def angles(recovery: Recovery) -> go.Figure | None:
    """Elbow flexion and the forearm's elevation over time, or None without elbow and wrist."""
    rows = [(name, value) for name, value in _angles(recovery).items() if np.isfinite(value).any()]
    if not rows:
        return None
    figure = make_subplots(rows=len(rows), cols=1, shared_xaxes=True, vertical_spacing=0.07)
    index = decimate(recovery.occluded)
    t, trusted = recovery.t_s[index], recovery.trusted[index]
    sigma_deg = np.where(trusted, elbow_flexion_sigma(recovery)[index], np.nan)
    for row, (name, value) in enumerate(rows, start=1):
        if name == FLEXION and np.isfinite(sigma_deg).any():
            x, y = band(t, value[index] - 2 * sigma_deg, value[index] + 2 * sigma_deg)
            around = go.Scatter(x=x, y=y, fill="toself", fillcolor=BAND, line={"width": 0}, hoverinfo="skip")
            figure.add_trace(around.update(name="+- 2 sigma"), row=row, col=1)
        for line in seen_and_recovered(t, value[index], recovery.occluded[index], trusted=trusted):
            figure.add_trace(line.update(showlegend=row == 1), row=row, col=1)
        figure.update_yaxes(title_text=f"{name}, degrees", row=row, col=1)
    figure.update_xaxes(title_text=_TIME, row=len(rows), col=1)
    shade(figure, recovery)
    return dress(figure, 180 + 190 * len(rows))


def _angles(recovery: Recovery) -> dict[str, FloatArray]:
    """Angles (N,) by name, degrees: elbow flexion (0 = straight), forearm above the horizontal."""
    joints, down = recovery.joints, recovery.gravity_direction
    if "elbow" not in joints or "wrist" not in joints:
        return {}
    rise = np.clip(-unit(joints["wrist"] - joints["elbow"]) @ down, -1, 1)
    return {
        FLEXION: arm_angles(joints, len(recovery))["elbow_flexion"],
        "forearm elevation": np.degrees(np.arcsin(rise)),
    }


def uncertainty(recovery: Recovery, truth: Truth | None) -> go.Figure | None:
    """Stated uncertainty over time and, with a truth, the error beside it; None without either.

    What is stated where the answer is not to be trusted is left out.
    """
    sigma_cm = np.where(recovery.trusted, 100 * recovery.worst_sigma_m, np.nan)
    sigma_deg = np.where(recovery.trusted, recovery.sigma_deg, np.nan)
    errors = None if truth is None else sample_errors(recovery, truth)
    if not np.isfinite(sigma_cm).any() and errors is None:
        return None
    figure = make_subplots(rows=2, cols=1, shared_xaxes=True, vertical_spacing=0.07)
    index = decimate(recovery.occluded)
    t = recovery.t_s[index]
    error_cm = None if errors is None else 100 * errors.distance_m
    error_deg = None if errors is None else errors.angle_deg
    rows = (("position, cm", sigma_cm, error_cm), ("orientation, degrees", sigma_deg, error_deg))
    for row, (name, sigma, error) in enumerate(rows, start=1):
        lines = [curve(t, sigma[index], "sigma", VISIBLE, 1.8)]
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
