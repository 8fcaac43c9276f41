"""The path in space, which the reader can turn, and two flat views of it."""

from __future__ import annotations

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from ..recording import BoolArray, CameraFrame, FloatArray, IntArray, Truth
from ..result import Recovery
from .decimate import decimate, split_line
from .style import OCCLUDED, TRUTH, VISIBLE, axis_names, curve, curve_3d, dress

#: How many arms are drawn.
MOST_ARMS = 8
_CHAIN = ("shoulder", "elbow", "wrist", "hand")


def path_in_space(recovery: Recovery, truth: Truth | None, frame: CameraFrame | None) -> go.Figure:
    """The sensor's path in 3D: visible and occluded, the truth dashed, the arm at some instants."""
    figure = go.Figure()
    index = decimate(recovery.occluded)
    visible, hidden = split_line(recovery.position[index], recovery.occluded[index])
    for name, values, colour in (("seen", visible, VISIBLE), ("recovered", hidden, OCCLUDED)):
        figure.add_trace(curve_3d(values, name, colour, 4))
    if truth is not None and len(truth):
        positions = truth.position[decimate(np.zeros(len(truth), bool))]
        figure.add_trace(curve_3d(positions, "reference", TRUTH, 3, "dash"))
    for name, occluded, colour in (("arm, seen", False, VISIBLE), ("arm, recovered", True, OCCLUDED)):
        chain = arm_lines(recovery, instants(recovery, occluded))
        if len(chain):
            arm = curve_3d(chain, name, colour, 6)
            arm.update(mode="lines+markers", marker={"size": 3, "color": colour}, opacity=0.45)
            figure.add_trace(arm)
    x, y, z = (f"{name}, m" for name in axis_names(frame))
    up = _up(recovery, frame)
    figure.update_layout(
        scene={
            "aspectmode": "data",
            "xaxis": {"title": {"text": x}},
            "yaxis": {"title": {"text": y}},
            "zaxis": {"title": {"text": z}},
            "camera": {"up": _xyz(up), "eye": _xyz(_eye(recovery, up, frame)), "center": _xyz(-0.1 * up)},
        }
    )
    dress(figure, 680, head=30)
    figure.update_layout(margin={"l": 0, "r": 0, "b": 0})
    return figure


def flat_views(recovery: Recovery, truth: Truth | None, frame: CameraFrame | None) -> go.Figure:
    """The same path in two flat views: as the camera sees it, and from the side."""
    names = [f"{name}, m" for name in axis_names(frame)]
    # right, up of each view, as (axis, drawn backwards)
    views = {
        CameraFrame.KINECT: (((0, True), (1, False)), ((2, False), (1, False))),
        CameraFrame.OPTICAL: (((0, False), (1, True)), ((2, False), (1, True))),
    }.get(frame or CameraFrame.ZUP, (((0, False), (2, False)), ((1, False), (2, False))))
    titles = (
        ("as the camera sees it", "from the side")
        if frame in (CameraFrame.KINECT, CameraFrame.OPTICAL)
        else None
    )
    figure = make_subplots(rows=1, cols=2, subplot_titles=titles)
    index = decimate(recovery.occluded)
    visible, hidden = split_line(recovery.position[index], recovery.occluded[index])
    lines = [("seen", visible, VISIBLE, "solid"), ("recovered", hidden, OCCLUDED, "solid")]
    if truth is not None and len(truth):
        lines.append(("reference", truth.position[decimate(np.zeros(len(truth), bool))], TRUTH, "dot"))
    for column, ((right, mirrored), (upward, flipped)) in enumerate(views, start=1):
        for name, values, colour, dash in lines:
            line = curve(values[:, right], values[:, upward], name, colour, 1.6, dash, legendgroup=name)
            figure.add_trace(line.update(showlegend=column == 1), row=1, col=column)
        figure.update_xaxes(
            title_text=names[right], autorange="reversed" if mirrored else True, row=1, col=column
        )
        figure.update_yaxes(
            title_text=names[upward],
            autorange="reversed" if flipped else True,
            scaleanchor="x" if column == 1 else "x2",
            row=1,
            col=column,
        )
    return dress(figure, 450, head=75)


def instants(recovery: Recovery, occluded: bool) -> IntArray:
    """Samples at which the arm is drawn: middles of the longest gaps, or spread over what is seen."""
    answered: BoolArray = np.all(np.isfinite(recovery.position), axis=1)
    if occluded:
        longest = sorted(recovery.gaps, key=lambda gap: -gap.length_s)[: MOST_ARMS // 2]
        middles = [0.5 * (gap.start_s + gap.end_s) for gap in longest]
        chosen = np.searchsorted(recovery.t_s, middles)
        chosen = np.clip(chosen, 0, max(len(recovery) - 1, 0)).astype(np.int64)
        return chosen[answered[chosen]] if len(chosen) and len(recovery) else np.zeros(0, np.int64)
    seen = np.flatnonzero(answered & ~recovery.occluded)
    if not len(seen):
        return seen
    return seen[np.linspace(0, len(seen) - 1, MOST_ARMS // 2 + 2).astype(int)[1:-1]]


def arm_lines(recovery: Recovery, index: IntArray) -> FloatArray:
    """The arm's joints in a row for each sample, nan between arms (K, 3)."""
    joints = [name for name in _CHAIN if name in recovery.joints]
    if len(joints) < 2 or not len(index):
        return np.zeros((0, 3))
    arms = np.stack([recovery.joints[name][index] for name in joints], axis=1)
    gap = np.full((len(index), 1, 3), np.nan)
    return np.concatenate([arms, gap], axis=1).reshape(-1, 3)


def _up(recovery: Recovery, frame: CameraFrame | None) -> FloatArray:
    down = recovery.gravity_direction
    if np.isfinite(down).all() and np.linalg.norm(down) > 0:
        return -down / np.linalg.norm(down)
    return -(frame or CameraFrame.ZUP).down


def _eye(recovery: Recovery, up: FloatArray, frame: CameraFrame | None) -> FloatArray:
    """Look from the camera's side, a little from above and beside it."""
    position = recovery.position[np.isfinite(recovery.position).all(axis=1)]
    back = -np.median(position, axis=0) if len(position) else np.array([1.0, 1.0, 0.5])
    if frame not in (CameraFrame.KINECT, CameraFrame.OPTICAL):
        back = np.array([1.2, -1.4, 0.3])
    back = back - up * (back @ up)
    length = np.linalg.norm(back)
    back = back / length if length > 1e-9 else np.cross(up, [0.3, 0.5, 0.8])
    return 2.3 * back + 0.7 * up + 1.1 * np.cross(up, back)


def _xyz(vector: FloatArray) -> dict[str, float]:
    return {axis: float(value) for axis, value in zip("xyz", vector, strict=True)}
