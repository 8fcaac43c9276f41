"""A result beside its reference: error over time, joint angles, their agreement, table I."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from ..array_types import FloatArray
from ..evaluation.agreement import WORDS, Agreement, AngleComparison, unwound_deg
from ..evaluation.validate import Validation, sample_errors
from ..recording import Truth
from ..result import Recovery
from .decimate import decimate
from .sheet import in_cm, table
from .style import (
    CAMERA,
    JOINT_COLOURS,
    OCCLUDED,
    TRUTH,
    VISIBLE,
    curve,
    dots,
    dress,
    seen_and_recovered,
    shade,
)

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
_TABLE = (
    "The layout in which Jatesiktat and Ang (2017) state the errors of their wrist IMU with a Kinect: the"
    " camera's own skeleton beside the recovered motion, over the whole recording."
)


def compared(recovery: Recovery, truth: Truth, validation: Validation) -> Iterator[Section]:
    """The sections of a comparison; the titles say where the reference was aligned."""
    yield validation.title("Error over time"), _OVER_TIME, error_over_time(recovery, truth), _gaps(validation)
    if validation.angles is not None and validation.angles.compared:
        figures = _angle_table(validation)
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
    if validation.table is not None and any(row.answer is not None for row in validation.table.rows):
        yield validation.title("Errors in the layout of table I"), _TABLE, None, _table_one(validation)


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
        for label, part, colour in (
            ("while seen", ~recovery.occluded, VISIBLE),
            ("in gaps", recovery.occluded, OCCLUDED),
        ):
            chosen = np.flatnonzero(part & np.isfinite(difference))
            chosen = chosen[decimate(np.zeros(len(chosen), bool), 1500)]
            samples = dots(mean[chosen], difference[chosen], label, colour, 4, legendgroup=label)
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


def _gaps(validation: Validation) -> str:
    rows = [
        (
            f"{gap.start_s:.2f}",
            f"{gap.length_s:.2f}",
            in_cm(figures.position_rms_m),
            in_cm(figures.position_p95_m),
            in_cm(figures.position_max_m),
            figures.orientation_rms_deg,
            figures.orientation_max_deg,
            figures.nees,
        )
        for gap, figures in validation.gaps
        if figures.position_rms_m is not None or figures.orientation_rms_deg is not None
    ]
    heads = ("gap at, s", "length, s", "rms, cm", "95 % below, cm", "largest, cm")
    return table((*heads, "rms, degrees", "largest, degrees", "NEES"), rows) if rows else ""


def _angle_table(validation: Validation) -> str:
    parts = {"all": "all samples", "occluded": "in gaps", "visible": "while seen"}
    assert validation.angles is not None
    rows = []
    for name in validation.angles.compared:
        for part, words in parts.items():
            agreement = validation.angle_figures[part][name]
            if agreement.samples:
                limits = f"{_number(agreement.limits_low)} to {_number(agreement.limits_high)}"
                interval = f"{_number(agreement.icc_low, 3)} to {_number(agreement.icc_high, 3)}"
                figures = (_number(agreement.rmse), _number(agreement.bias), limits)
                icc = (_number(agreement.icc, 3), interval)
                rows.append((WORDS[name], words, *figures, *icc, agreement.samples))
    heads = ("angle", "", "RMSE, degrees", "bias", "limits of agreement", "ICC(A,1)", "95 % interval")
    carrying = validation.angles.carrying_truth_deg
    more = "" if carrying is None else f"<p>Passthrough angle of the reference: {carrying:.1f} degrees.</p>"
    return table((*heads, "samples"), rows) + more


def _table_one(validation: Validation) -> str:
    assert validation.table is not None
    rows = []
    for row in validation.table.rows:
        digits = 5 if "meter" in row.errors else 2
        gain = None if row.reduction is None else f"{100 * row.reduction:.2f}%"
        rows.append((row.errors, row.figure, _number(row.camera, digits), _number(row.answer, digits), gain))
    heads = ("", "", "Camera's skeleton", "Recovered", "Error reduction")
    return f"{table(heads, rows)}<p>{validation.table.note}</p>"


def _number(value: float | None, digits: int = 2) -> str:
    return "–" if value is None else f"{value:.{digits}f}"
