"""Whether sigma is consistent with the errors, rejected samples, and a result beside its reference."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from ..array_types import FloatArray
from ..evaluation.advice import rejected
from ..evaluation.agreement import WORDS, Agreement, AngleComparison, unwound_deg
from ..evaluation.coverage import LEVELS, StatedAndActual, stated_and_actual
from ..evaluation.metrics import truth_at
from ..evaluation.validate import Validation, sample_errors
from ..measurements.visibility import Reason
from ..recording import JOINTS, Truth
from ..result import Recovery
from .sheet import label, rendered
from .style import (
    CAMERA,
    JOINT_COLOURS,
    OCCLUDED,
    TRUTH,
    VISIBLE,
    curve,
    decimate,
    dots,
    dress,
    seen_and_recovered,
    shade,
)

#: Colours of the reasons for which samples are rejected, in the order of their frequency.
REASON_COLOURS = ("#D55E00", "#0072B2", "#CC79A7", "#009E73", "#E69F00", "#56B4E9", "#7a3fb0")

#: Most samples of a joint that were used and are drawn.
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
        figure.update_xaxes(title_text="stated sigma, cm per axis", range=ends, row=row, col=2)
        figure.update_yaxes(title_text="actual rms, cm per axis", range=ends, row=row, col=2)
    return dress(figure, 110 + 350 * len(rows), head=80)


def share_inside(camera: dict[str, StatedAndActual], truth: dict[str, StatedAndActual]) -> str:
    """The shares inside the 95 % region, in a sentence."""
    parts = []
    if camera:
        squared = np.concatenate([errors.squared for errors in camera.values()])
        whole = StatedAndActual(squared, squared, squared)
        parts.append(f"{100 * whole.inside(0.95):.0f} % of the camera's samples")
    parts += [f"{100 * errors.inside(0.95):.0f} % of the errors {name}" for name, errors in truth.items()]
    return f"Inside the region that should contain 95 % are {', '.join(parts)}." if parts else ""


def timeline(recovery: Recovery) -> go.Figure | None:
    """When samples were rejected, one line per joint, one colour per reason; None where none were."""
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


#: A heading, its caption and what to draw below it (None: nothing to draw), then HTML that follows.
Section = tuple[str, str, go.Figure | None, str]

_OVER_TIME = (
    "Distance between answer and reference, and the angle between their orientations, sample by sample; gaps"
    " are shaded. Joints are behind the legend: click on a name."
)
_ANGLES = (
    "Angles in the order of the ISB's recommendation (Wu et al. 2005), the reference as a dashed line."
    " Where an angle has no meaning (pronation of a straight arm, plane of elevation of one that hangs)"
    " nothing is drawn. The thorax is not seen: shoulder angles are relative to gravity and to a person who"
    " faces the camera."
)
_BLAND_ALTMAN = (
    "Bland and Altman: answer minus reference over the mean of both, a dot a sample. The solid line is"
    " the bias, the dashed lines the limits of agreement (bias -+ 1.96 standard"
    " deviations): 95 of 100 differences lie between."
)


def compared(recovery: Recovery, truth: Truth, validation: Validation) -> Iterator[Section]:
    """The sections of a comparison; the titles state where the reference was aligned."""
    gaps = rendered(validation.gap_errors)
    yield validation.title("Error over time"), _OVER_TIME, error_over_time(recovery, truth), gaps
    if validation.angles is not None and validation.angles.compared:
        carrying = validation.angles.carrying_truth_deg
        figures = rendered(validation.angle_errors)
        if carrying is not None:
            figures += f"<p>Carrying angle of the reference: {carrying:.1f} degrees.</p>"
        yield (
            validation.title("Joint angles, answer and reference"),
            _ANGLES,
            angle_curves(recovery, validation.angles),
            figures,
        )
        yield (
            validation.title("Agreement of the joint angles"),
            _BLAND_ALTMAN,
            bland_altman(recovery, validation.angles, validation.angle_figures["all"]),
            "",
        )


def error_over_time(recovery: Recovery, truth: Truth) -> go.Figure:
    """Position and orientation errors over time, with the joints' to be switched on."""
    errors = sample_errors(recovery, truth)
    figure = make_subplots(rows=2, cols=1, shared_xaxes=True, vertical_spacing=0.06)
    index = decimate(recovery.occluded)
    t, occluded, trusted = recovery.t_s[index], recovery.occluded[index], recovery.trusted[index]
    for row, values in ((1, 100 * errors.distance_m), (2, errors.angle_deg)):
        if not np.isfinite(values).any():
            continue
        for line in seen_and_recovered(t, values[index], occluded, 1.6, "sensor, ", trusted=trusted):
            figure.add_trace(line.update(showlegend=row == 1, legendgroup=line.name), row=row, col=1)
    hidden = bool(np.isfinite(errors.distance_m).any())
    for joint, distance in errors.joint_distance_m.items():
        line = curve(t, 100 * distance[index], joint, JOINT_COLOURS.get(joint, CAMERA), 1.6)
        figure.add_trace(line.update(visible="legendonly" if hidden else True), row=1, col=1)
    figure.update_yaxes(title_text="position error, cm", rangemode="tozero", row=1, col=1)
    figure.update_yaxes(title_text="orientation error, degrees", rangemode="tozero", row=2, col=1)
    figure.update_xaxes(title_text="time, s", row=2, col=1)
    shade(figure, recovery)
    return dress(figure, 560)


def angle_curves(recovery: Recovery, angles: AngleComparison) -> go.Figure:
    """Angles of answer and reference over time, a row an angle."""
    names = angles.compared
    figure = make_subplots(rows=len(names), cols=1, shared_xaxes=True, vertical_spacing=0.03)
    index = decimate(recovery.occluded)
    t, occluded, trusted = recovery.t_s[index], recovery.occluded[index], recovery.trusted[index]
    for row, name in enumerate(names, start=1):
        answer, true = _unwound(angles, name)
        lines = seen_and_recovered(t, answer[index], occluded, 1.6, trusted=trusted)
        for line in [*lines, curve(t, true[index], "reference", TRUTH, 1.2, "dash")]:
            figure.add_trace(line.update(showlegend=row == 1), row=row, col=1)
        figure.update_yaxes(title_text=_broken(WORDS[name]), row=row, col=1)
    figure.update_xaxes(title_text="time, s", row=len(names), col=1)
    shade(figure, recovery)
    return dress(figure, 120 + 170 * len(names))


def bland_altman(recovery: Recovery, angles: AngleComparison, figures: dict[str, Agreement]) -> go.Figure:
    """Difference over mean, a panel an angle."""
    names = angles.compared
    columns = min(2, len(names))
    rows = -(-len(names) // columns)
    figure = make_subplots(
        rows=rows,
        cols=columns,
        subplot_titles=[WORDS[name] for name in names],
        vertical_spacing=0.28 / rows,
        horizontal_spacing=0.1,
    )
    for number, name in enumerate(names):
        row, column = number // columns + 1, number % columns + 1
        answer, true = _unwound(angles, name)
        mean, difference = 0.5 * (answer + true), answer - true
        for which, part, colour in (
            ("while seen", ~recovery.occluded, VISIBLE),
            ("in gaps", recovery.occluded, OCCLUDED),
        ):
            chosen = np.flatnonzero(part & np.isfinite(difference))
            chosen = chosen[decimate(np.zeros(len(chosen), bool), 1500)]
            samples = dots(mean[chosen], difference[chosen], which, colour, 4, legendgroup=which)
            samples.update(showlegend=number == 0, marker_opacity=0.5)
            figure.add_trace(samples, row=row, col=column)
        agreement = figures[name]
        for value, dash in (
            (agreement.bias, "solid"),
            (agreement.limits_low, "dash"),
            (agreement.limits_high, "dash"),
        ):
            if value is not None:
                line = {"color": TRUTH, "width": 1.2, "dash": dash}
                text = f"{value:+.1f}"
                figure.add_hline(value, line=line, annotation_text=text, row=row, col=column)
        figure.update_xaxes(title_text="mean of both, degrees", row=row, col=column)
        figure.update_yaxes(title_text="answer - reference, degrees", row=row, col=column)
    return dress(figure, 80 + 330 * rows, head=70)


def _unwound(angles: AngleComparison, name: str) -> tuple[FloatArray, FloatArray]:
    """Answer and reference without jumps of a full turn; nan where either has none."""
    answer, true = angles.answer[name].copy(), angles.truth[name].copy()
    both = np.isfinite(answer) & np.isfinite(true)
    answer[both], true[both] = unwound_deg(answer[both], true[both])
    answer[~both], true[~both] = np.nan, np.nan
    return answer, true


def _broken(words: str) -> str:
    """A title in lines short enough for a low panel."""
    first, *rest = words.split(" ")
    return f"{first}<br>{' '.join(rest)}, deg" if rest else f"{first}, deg"
