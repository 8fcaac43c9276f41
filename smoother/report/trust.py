"""Whether the stated uncertainty is consistent with the errors, and which camera samples were rejected."""

from __future__ import annotations

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from ..evaluation.advice import rejected
from ..evaluation.align import truth_at
from ..evaluation.coverage import LEVELS, StatedAndActual, stated_and_actual
from ..measurements.visibility import Reason
from ..recording import JOINTS, Truth
from ..result import Recovery
from .decimate import decimate
from .sheet import label
from .style import CAMERA, JOINT_COLOURS, OCCLUDED, VISIBLE, curve, dots, dress, shade

#: Colours of the reasons for which samples are rejected, in the order of their frequency.
REASON_COLOURS = ("#D55E00", "#0072B2", "#CC79A7", "#009E73", "#E69F00", "#56B4E9", "#7a3fb0")

#: Most samples of a joint that took part and are drawn.
MOST_USED = 1000


def against_truth(recovery: Recovery, truth: Truth | None) -> dict[str, StatedAndActual]:
    """Position errors with what was stated of them, in gaps and while seen; empty without a reference."""
    if truth is None or not len(truth):
        return {}
    reference = truth_at(truth, recovery.t_s)
    error = np.where(reference.score[:, None], recovery.position - reference.position, np.nan)
    parts = {"in gaps": recovery.occluded, "while seen": ~recovery.occluded}
    by_part = {
        name: stated_and_actual(error[part], recovery.pose_covariance[part, :3, :3])
        for name, part in parts.items()
    }
    return {name: errors for name, errors in by_part.items() if len(errors.squared)}


def calibration_curves(
    camera: dict[str, StatedAndActual], truth: dict[str, StatedAndActual]
) -> go.Figure | None:
    """Coverage curve, and actual error against stated sigma: a row for the camera, one for a reference."""
    colours = {**JOINT_COLOURS, "in gaps": OCCLUDED, "while seen": VISIBLE}
    rows = [(name, part) for name, part in (("camera", camera), ("reference", truth)) if part]
    if not rows:
        return None
    of = {"camera": "distance to camera samples", "reference": "errors against the reference"}
    titles = [
        f"{what}<br>({of[name]})"
        for name, _ in rows
        for what in ("inside the stated region", "stated and actual")
    ]
    figure = make_subplots(
        rows=len(rows), cols=2, subplot_titles=titles, vertical_spacing=0.2, horizontal_spacing=0.1
    )
    for row, (_, parts) in enumerate(rows, start=1):
        ideal = curve([0, 100], [0, 100], "consistent", CAMERA, 1.2, "dash", showlegend=row == 1)
        figure.add_trace(ideal, row=row, col=1)
        largest = 0.0
        for name, errors in parts.items():
            words = f"errors {name}" if name not in JOINT_COLOURS else name
            stated, actual = errors.binned()
            inside = curve(100 * LEVELS, 100 * errors.coverage(), words, colours[name], 2)
            sizes = curve(100 * stated, 100 * actual, words, colours[name], 2, showlegend=False)
            figure.add_trace(inside.update(legendgroup=words), row=row, col=1)
            figure.add_trace(sizes.update(legendgroup=words, mode="lines+markers"), row=row, col=2)
            largest = max(largest, *(100 * stated), *(100 * actual)) if len(stated) else largest
        ends = [0, 1.08 * max(largest, 0.1)]
        figure.add_trace(curve(ends, ends, None, CAMERA, 1.2, "dash", showlegend=False), row=row, col=2)
        figure.update_xaxes(title_text="stated to lie inside, %", range=[0, 100], row=row, col=1)
        figure.update_yaxes(title_text="do lie inside, %", range=[0, 100], row=row, col=1)
        figure.update_xaxes(title_text="stated sigma, cm an axis", range=ends, row=row, col=2)
        figure.update_yaxes(title_text="actual rms, cm an axis", range=ends, row=row, col=2)
    return dress(figure, 110 + 350 * len(rows), head=80)


def share_inside(camera: dict[str, StatedAndActual], truth: dict[str, StatedAndActual]) -> str:
    """The shares inside the 95 % region, in a sentence."""
    parts = []
    if camera:
        squared = np.concatenate([errors.squared for errors in camera.values()])
        whole = StatedAndActual(squared, squared, squared)
        parts.append(f"{100 * whole.inside(0.95):.0f} % of the camera's samples")
    parts += [f"{100 * errors.inside(0.95):.0f} % of the errors {name}" for name, errors in truth.items()]
    return f"Inside the region that should hold 95 % lie {', '.join(parts)}." if parts else ""


def timeline(recovery: Recovery) -> go.Figure | None:
    """When samples were rejected, a line a joint, a colour a reason; None where none were."""
    samples = recovery.residuals
    rows = rejected(recovery)
    if samples is None or not rows:
        return None
    figure = go.Figure()
    joints = [joint for joint in JOINTS if samples.used[:, JOINTS.index(joint)].any()]
    joints += [row.joint for row in rows if row.joint not in joints]
    joints = [joint for joint in JOINTS if joint in joints]
    for joint in joints:
        index = np.flatnonzero(samples.used[:, JOINTS.index(joint)])
        index = index[decimate(np.zeros(len(index), bool), MOST_USED)]
        ticks = dots(samples.t_s[index], [joint] * len(index), "used", "#c9d3da", 8, symbol="line-ns-open")
        ticks.update(legendgroup="used", showlegend=joint == joints[0], hoverinfo="skip")
        figure.add_trace(ticks)
    reasons = list(dict.fromkeys((row.reason, row.why) for row in rows))
    for number, (reason, why) in enumerate(reasons):
        at, column = np.nonzero(samples.reason == samples.reasons.index(Reason(reason, why)))
        chosen = decimate(np.zeros(len(at), bool), 2 * MOST_USED)
        colour, names = REASON_COLOURS[number % len(REASON_COLOURS)], [JOINTS[i] for i in column[chosen]]
        ticks = dots(
            samples.t_s[at[chosen]],
            names,
            label(reason),
            colour,
            20,
            symbol="line-ns-open",
            text=label(Reason(reason, why).sentence),
        )
        figure.add_trace(ticks.update(marker_line_width=1.6))
    shade(figure, recovery)
    figure.update_yaxes(categoryorder="array", categoryarray=joints[::-1])
    figure.update_xaxes(title_text="time, s")
    return dress(figure, 150 + 55 * len(joints))
