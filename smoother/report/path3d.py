"""Two flat views of the path, and the instants at which the arm is drawn on paper."""

from __future__ import annotations

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from ..array_types import BoolArray, FloatArray, IntArray
from ..recording import CameraFrame, Truth
from ..result import Recovery
from .decimate import decimate, split_line
from .space import upwards
from .style import OCCLUDED, TRUTH, UNTRUSTED, VISIBLE, axis_names, curve, dress

#: How many arms are drawn.
MOST_ARMS = 8
#: The joints of an arm in a row.
CHAIN = ("shoulder", "elbow", "wrist", "hand")


def flat_views(recovery: Recovery, truth: Truth | None, frame: CameraFrame | None) -> go.Figure:
    """The same path in two flat views: as the camera sees it, and from the side."""
    names = [f"{name}, m" for name in axis_names(frame)]
    # right, up of each view, as (axis, drawn backwards)
    views = {
        CameraFrame.KINECT: (((0, True), (1, False)), ((2, False), (1, False))),
        CameraFrame.OPTICAL: (((0, False), (1, True)), ((2, False), (1, True))),
    }.get(frame or CameraFrame.ZUP, _upright(upwards(frame, recovery.gravity_direction)))
    titles = (
        ("as the camera sees it", "from the side")
        if frame in (CameraFrame.KINECT, CameraFrame.OPTICAL)
        else None
    )
    figure = make_subplots(rows=1, cols=2, subplot_titles=titles)
    index = decimate(recovery.occluded)
    good, distrusted = split_line(recovery.position[index], ~recovery.trusted[index])
    visible, hidden = split_line(good, recovery.occluded[index])
    lines = [("seen", visible, VISIBLE, "solid"), ("recovered", hidden, OCCLUDED, "solid")]
    if np.isfinite(distrusted).any():
        lines = [line for line in lines if np.isfinite(line[1]).any()]
        lines.append(("not to be trusted", distrusted, UNTRUSTED, "dot"))
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


def _upright(up: FloatArray) -> tuple[tuple[tuple[int, bool], tuple[int, bool]], ...]:
    """Two views of axes that nobody named: the one that gravity says points up is drawn upwards."""
    upright = int(np.argmax(np.abs(up)))
    across = [axis for axis in range(3) if axis != upright]
    return tuple(((axis, False), (upright, bool(up[upright] < 0))) for axis in across)


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
