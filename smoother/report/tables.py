"""The report's tables, as HTML."""

from __future__ import annotations

import json
from collections.abc import Sequence
from html import escape

import numpy as np

from calib.motion import ArmEstimates

from ..calibration import ArmCalibration
from ..error_radius import error_radius
from ..evaluation.advice import rejected
from ..evaluation.measure_agreement import agreement_table, pair_table
from ..evaluation.metrics import Figures
from ..evaluation.summary import GapSummary, error_figures, gap_summaries, recovery_figures
from ..evaluation.validate import Validation
from ..result import Estimates, Recovery
from ..result.untrusted import certain
from ..table import centimetres
from .chart import NOT_TRUSTED, badge
from .sheet import Html, bullets, rendered, table
from .summary import WIDE_M

#: Figures of a recovery that another section of the page shows.
ELSEWHERE = (
    *("camera_sigma_m", "camera_effective_sigma_m", "joint_bias_m", "joint_bias_sigma_m"),
    *("accelerometer_bias", "gyroscope_bias", "given", "max_sigma_m"),
    *("untrusted", "self_check", "pairing", "cameras"),
)
WITHDRAWN = "withdrawn: the result is not to be trusted"


def overview(recovery: Recovery) -> str:
    """What was recovered, in numbers."""
    figures = recovery_figures(recovery)
    error = error_figures(recovery, recovery.trusted)
    offset = None
    if np.isfinite(recovery.clock_offset_s):
        offset = f"{1000 * recovery.clock_offset_s:.1f} ms"
        if np.isfinite(recovery.clock_offset_sigma_s):
            offset += f" ± {1960 * recovery.clock_offset_sigma_s:.1f} ms (95 of 100 cases)"
    withdrawn = WITHDRAWN if recovery.estimates.trusted is False else None
    rows: list[tuple[str, object]] = [
        ("method", recovery.method),
        ("arm", recovery.side or "not stated"),
        ("samples of the forearm sensor", len(recovery)),
        ("sample rate, Hz", figures["rate_hz"]),
        ("samples without the camera", recovery.occluded.sum()),
        ("samples without an answer", len(recovery) - int(recovery.answered.sum())),
        *(
            (f"position, 95 of 100 errors below, {words}, cm", withdrawn or centimetres(error[part][which]))
            for words, part, which in _ERRORS
        ),
        ("samples that are not to be trusted", int(np.count_nonzero(~recovery.trusted))),
        *_proofs(recovery.estimates),
        ("sensor's clock minus camera's clock", offset),
    ]
    if (unsure := _too_uncertain(recovery)) is not None:
        rows.append(("samples marked as too uncertain to use", unsure))
    rows += [
        (name.replace("_", " "), _plain(value))
        for name, value in recovery.estimates.plain().items()
        if name not in ELSEWHERE
    ]
    return table(("what", "value"), rows)


_ERRORS = (
    ("while seen", "visible", "all"),
    ("in gaps", "occluded", "all"),
    ("at the least certain moment of a gap", "occluded", "max"),
)


def _proofs(estimates: Estimates) -> list[tuple[str, object]]:
    """Rows of the self-check and of the pairing; none where there is neither."""
    rows: list[tuple[str, object]] = []
    check, pairing = estimates.self_check, estimates.pairing
    if check is not None and check.stretches:
        lost = f", {check.unanswered} not recovered" if check.unanswered else ""
        rows.append(("self-check: times that the arm was hidden", f"{check.stretches}{lost}"))
        if np.isfinite(check.inside_95):
            rows.append(
                ("self-check: samples inside the stated 95 % region", f"{100 * check.inside_95:.0f} %")
            )
        rows.append(("self-check: sigma in gaps multiplied by", check.sigma_factor))
    if pairing is not None:
        chance = f" (chance agreement {100 * pairing.chance:.2g} %)" if np.isfinite(pairing.chance) else ""
        words = "shown by the motion" if pairing.proved else f"not proved{chance}"
        rows.append(("skeleton and sensor are of one motion", words))
    return rows


def _too_uncertain(recovery: Recovery) -> str | None:
    limit = recovery.estimates.max_sigma_m
    if limit is None:
        return None
    unsure = int(recovery.answered.sum() - certain(recovery).sum())
    return f"{unsure} (above {100 * limit:g} cm)"


def rejections(recovery: Recovery) -> str:
    """Rejected camera samples, one row per reason and joint."""
    rows = [
        (
            row.reason,
            row.why,
            row.joint,
            row.count,
            f"{100 * row.share:.1f} %",
            f"{row.first_s:.2f}",
            f"{row.last_s:.2f}",
        )
        for row in rejected(recovery)
    ]
    if not rows:
        return "<p>Nothing: all tracked samples were used.</p>"
    columns = ("reason", "in words", "joint", "samples", "of its tracked ones", "first, s", "last, s")
    return table(columns, rows)


def camera(estimates: ArmEstimates) -> str:
    """Noise and constant errors of the camera's joints; "" where they are not known."""
    if not estimates.camera:
        return ""
    rows = [
        (joint, centimetres(error.sample_m), centimetres(error.bias_m) if error.bias_m > 0 else None)
        for joint, error in estimates.camera.items()
    ]
    columns = ("camera's joint", "noise of a sample, cm per axis", "constant error against the others, cm")
    return table(columns, rows)


def cameras(recovery: Recovery) -> str:
    """Where each camera of several stands, and what it saw, one per row."""
    length_s = float(recovery.t_s[-1] - recovery.t_s[0]) if len(recovery) > 1 else float("nan")
    rows = [
        (
            each.name,
            None if each.p_K_C_m is None else ", ".join(f"{100 * x:.0f}" for x in each.p_K_C_m),
            None if each.sigma_m is None else centimetres(each.sigma_m),
            None if each.sigma_deg is None else f"{each.sigma_deg:.2f}",
            None if each.offset_s is None else f"{1000 * each.offset_s:.1f}",
            f"{100 * sum(b - a for a, b in each.seen_s) / length_s:.0f} %" if each.takes_part else None,
            f"left out: {each.reason}" if each.reason else "is used",
        )
        for each in recovery.estimates.cameras
    ]
    columns = (
        *("camera", "place in the first one's frame, cm", "sigma, cm per axis", "sigma, degrees per axis"),
        *("first clock less its own, ms", "saw the forearm", "remark"),
    )
    return table(columns, rows)


def gaps(recovery: Recovery, validation: Validation | None = None) -> str:
    """The gaps, one per row; with the errors in them where there is a reference."""
    errors = {} if validation is None else {gap.start_s: figures for gap, figures in validation.gaps}
    true = [_p95(errors.get(summary.gap.start_s)) for summary in gap_summaries(recovery)]
    with_errors = any(each is not None for each in true)
    summaries = gap_summaries(recovery)
    if not summaries:
        return "<p>There is no gap.</p>"
    rows = [
        (
            number,
            f"{summary.gap.start_s:.2f}",
            f"{summary.gap.length_s:.2f}",
            *_stated(summary, [true[number - 1]] if with_errors else []),
            "one side only" if summary.one_sided else "both sides",
            f"{100 * summary.answered:.0f} %",
            _remark(summary),
        )
        for number, summary in enumerate(summaries, start=1)
    ]
    columns = (
        "gap",
        "start, s",
        "length, s",
        "position within, cm",
        *(["against the reference, cm"] if with_errors else []),
        "orientation within, degrees",
        "elbow flexion ±, degrees",
        "camera saw the arm on",
        "answered",
        "",
    )
    return table(columns, rows)


def _stated(summary: GapSummary, true: Sequence[str | None]) -> tuple[str | None, ...]:
    """What is stated of a gap, and its error where it is known; withdrawn where it is not to be trusted."""
    if summary.trusted is False:
        return None, *true, None, None
    deg, flexion_deg = summary.orientation_95_deg, summary.sigma_max_flexion_deg
    return (
        centimetres(summary.error_95_m),
        *true,
        None if deg is None else f"{deg:.1f}",
        None if flexion_deg is None else f"{1.96 * flexion_deg:.1f}",
    )


def _p95(figures: Figures | None) -> str | None:
    """What 95 % of the errors in a gap lie below, cm."""
    return None if figures is None else centimetres(figures.position_p95_m)


def _remark(summary: GapSummary) -> str:
    """The last cell of a gap: whether to trust it, and why not."""
    if summary.trusted is False:
        return Html(f"{badge(NOT_TRUSTED)} {escape('; '.join(summary.reasons))}")
    return "take with care" if summary.one_sided or summary.is_wider_than(WIDE_M) else ""


def validation(comparison: Validation, recovery: Recovery) -> str:
    """Errors against the reference."""
    joints = comparison.joint_errors
    errors = comparison.errors(recovery)
    sensor = table(errors.columns, errors.rows)
    if joints.rows and comparison.all.position_rms_m is None and comparison.all.orientation_rms_deg is None:
        sensor = "<p>The reference has joints only.</p>"
    return sensor + rendered(joints)


def measured(comparison: Validation) -> str:
    """The measures of answer and reference, and how well they agree; "" where there are none."""
    measures = comparison.measures
    if measures is None:
        return ""
    below = rendered(pair_table(comparison.title("Measures against the reference"), measures), _MEASURED)
    below += rendered(agreement_table(comparison.title("How well the measures agree"), measures), _AGREED)
    return below + bullets(measures.notes)


_MEASURED = (
    "The same functions on the answer and on the reference, over the session. Inside: the answer's 95 %"
    " interval contains the reference's value."
)
_AGREED = (
    "Answer minus reference over recordings or movements. Limits of agreement: 95 % of differences lie"
    " between them. ICC(2,1): 1 where both agree as well as subjects differ. MDC95, minimal detectable"
    " change: two sessions without any change differ by less, 95 times of 100 (1.96 sqrt(2) SEM; the"
    " reference is treated as free of error)."
)


def calibration(arm: ArmCalibration | None, estimates: Estimates) -> str:
    """Sensor mounting on the arm, the arm's measures, and the sensor's biases."""
    if arm is None:
        return "<p>This method needs none.</p>"
    rows: list[tuple[object, ...]] = [
        (f"{joint}, in the sensor's axes", _vector(lever.position_m, 1), _within(lever.sigma_m), "cm")
        for joint, lever in arm.lever_arms.items()
    ]
    if arm.upper_arm is not None:
        length = arm.upper_arm
        rows.append(("shoulder to elbow", f"{100 * length.value_m:.1f}", f"{196 * length.sigma_m:.1f}", "cm"))
    for name, value, unit in (
        ("accelerometer bias", estimates.accelerometer_bias or arm.accelerometer_bias, "m/s²"),
        ("gyroscope bias", estimates.gyroscope_bias or arm.gyroscope_bias, "rad/s"),
    ):
        if value is not None:
            rows.append((name, ", ".join(f"{item:.4f}" for item in value), None, unit))
    if not rows:
        return "<p>None was given, and none was needed.</p>"
    return table(("what", "value (x, y, z)", "within (95 of 100 cases)", "unit"), rows)


def _within(sigma_m: np.ndarray) -> str:
    return f"{100 * float(error_radius(np.diag(np.asarray(sigma_m) ** 2))):.1f}"


def _vector(metres: np.ndarray, decimals: int) -> str:
    return ", ".join(f"{100 * item:.{decimals}f}" for item in metres)


def settings(config: dict[str, object]) -> str:
    """The effective configuration, a setting a row."""
    rows = []
    for section, values in config.items():
        if isinstance(values, dict):
            rows += [(f"{section}.{name}", _plain(value)) for name, value in values.items()]
        else:
            rows.append((section, _plain(values)))
    return table(("setting", "value"), rows) if rows else "<p>None is stated.</p>"


def _plain(value: object) -> str:
    """A setting or a figure in a cell; numbers short, the rest as JSON writes it."""
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, list | tuple):
        return ", ".join(_plain(item) for item in value)
    if isinstance(value, dict):
        return "; ".join(f"{name} {_plain(item)}" for name, item in value.items())
    return value if isinstance(value, str) else json.dumps(value, default=str)
