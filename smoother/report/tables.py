"""The report's tables."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any

import numpy as np

from calib.motion import ArmEstimates

from ..error_radius import error_radius
from ..evaluation.advice import rejected
from ..evaluation.summary import (
    GapSummary,
    camera_consistency,
    certainty_figures,
    consistency,
    gap_summaries,
    recovery_figures,
)
from ..evaluation.validate import Validation, sample_errors
from ..recording import Truth
from ..result import Estimates, Recovery
from ..result.untrusted import certain
from ..table import Table, centimetres, fixed, percent, tabulated
from .sheet import NOT_TRUSTED, badge
from .summary import WIDE_M

#: Figures of a recovery that another section of the page shows.
_ELSEWHERE = (
    *("camera_sigma_m", "camera_effective_sigma_m", "joint_bias_m", "joint_bias_sigma_m"),
    *("accelerometer_bias", "gyroscope_bias", "given", "max_sigma_m"),
    *("untrusted", "self_check", "pairing", "cameras"),
)
WITHDRAWN = "withdrawn: the result is not to be trusted"


def overview(recovery: Recovery) -> Table:
    """What was recovered, in numbers."""
    figures = recovery_figures(recovery)
    error = certainty_figures(recovery, recovery.trusted)["error_95_m"]
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
    further = {name: value for name, value in recovery.estimates.plain().items() if name not in _ELSEWHERE}
    rows += [(name.replace("_", " "), value) for name, value in _leaves(further, ", ")]
    return Table("Figures", ("what", "value"), rows)


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


def settings(config: dict[str, object]) -> Table:
    """The effective configuration, a setting a row."""
    return Table("Settings", ("setting", "value"), list(_leaves(config, ".")))


def _leaves(values: Mapping[Any, Any], between: str) -> Iterator[tuple[str, str]]:
    """Values under their whole names as cells show them; numbers short, what is no text as JSON writes it."""
    for name, value in values.items():
        if isinstance(value, np.ndarray | np.generic):
            value = value.tolist()
        if isinstance(value, Mapping) and value:
            yield from ((f"{name}{between}{rest}", each) for rest, each in _leaves(value, between))
        elif isinstance(value, list | tuple):
            yield name, ", ".join(each for _, each in _leaves(dict(enumerate(value)), between))
        elif isinstance(value, float):
            yield name, f"{value:.6g}"
        else:
            yield name, value if isinstance(value, str) else json.dumps(value, default=str)


def rejections(recovery: Recovery) -> Table:
    """Rejected camera samples, one row per reason and joint."""
    columns: dict[str, str | Callable[[Any], object]] = {
        "reason": "reason",
        "in words": "why",
        "joint": "joint",
        "samples": "count",
        "of its tracked ones": lambda row: percent(row["share"]),
        "first, s": lambda row: f"{row['first_s']:.2f}",
        "last, s": lambda row: f"{row['last_s']:.2f}",
    }
    return tabulated("Rejected camera samples", rejected(recovery), columns)


def consistent(recovery: Recovery, truth: Truth | None) -> Table:
    """Whether what is stated holds: for the camera's joints, and for the sensor against a reference."""
    parts = {f"camera's {joint}": each for joint, each in camera_consistency(recovery).items()}
    if truth is not None and len(truth):
        errors = sample_errors(recovery, truth).difference_m
        for name, rows in (("in gaps", recovery.occluded), ("while seen", ~recovery.occluded)):
            parts[f"errors {name}"] = consistency(errors[rows], recovery.pose_covariance[rows, :3, :3])
    columns = {"of": "of", "samples": "samples", "inside 50 %": "inside_50", "inside 95 %": "inside_95"}
    columns |= {"stated sigma, cm per axis": "stated_m", "actual rms, cm per axis": "actual_m"}
    known = [{"of": name, **found} for name, found in parts.items() if found["samples"]]
    return tabulated("Whether sigma is consistent with the errors", known, columns)


def camera(estimates: ArmEstimates) -> Table:
    """Noise and constant errors of the camera's joints."""
    return tabulated(
        "Errors of the camera's joints",
        estimates.camera.items(),
        {
            "camera's joint": lambda row: row[0],
            "noise of a sample, cm per axis": lambda row: centimetres(row[1].sample_m),
            "constant error against the others, cm": lambda row: centimetres(row[1].bias_m or None),
        },
    )


def gaps(recovery: Recovery, validation: Validation | None = None) -> Table:
    """The gaps, one per row; with the errors in them where there is a reference."""
    errors = {} if validation is None else {gap.start_s: figures for gap, figures in validation.gaps}
    true = {start: centimetres(figures.position_p95_m) for start, figures in errors.items()}

    def stated(summary: GapSummary, value: float | None, digits: int = 1) -> str | None:
        """What is not withdrawn."""
        return None if summary.trusted is False else fixed(value, digits)

    columns: dict[str, Callable[[tuple[int, GapSummary]], object]] = {
        "gap": lambda row: row[0],
        "start, s": lambda row: f"{row[1].start_s:.2f}",
        "length, s": lambda row: f"{row[1].length_s:.2f}",
        "position within, cm": lambda row: stated(row[1], row[1].error_95_m and 100 * row[1].error_95_m, 2),
        "against the reference, cm": lambda row: true.get(row[1].start_s),
        "orientation within, degrees": lambda row: stated(row[1], row[1].orientation_95_deg),
        "elbow flexion ±, degrees": lambda row: stated(
            row[1], row[1].sigma_max_flexion_deg and 1.96 * row[1].sigma_max_flexion_deg
        ),
        "camera saw the arm on": lambda row: "one side only" if row[1].one_sided else "both sides",
        "answered": lambda row: percent(row[1].answered),
        "": lambda row: _remark(row[1]),
    }
    if not any(true.values()):
        del columns["against the reference, cm"]
    return tabulated("Gaps", enumerate(gap_summaries(recovery), start=1), columns)


def _remark(summary: GapSummary) -> str:
    """The last cell of a gap: whether to trust it, and why not."""
    if summary.trusted is False:
        return badge(NOT_TRUSTED) + " " + "; ".join(summary.reasons)
    return "take with care" if summary.one_sided or summary.is_wider_than(WIDE_M) else ""


def calibration(recovery: Recovery) -> Table:
    """Sensor mounting on the arm, the arm's measures, and the sensor's biases."""
    arm, estimates = recovery.calibration, recovery.estimates
    rows: list[tuple[object, ...]] = []
    for joint, lever in () if arm is None else arm.lever_arms.items():
        radius = error_radius(np.diag(np.asarray(lever.sigma_m) ** 2))
        rows.append(
            (
                f"{joint}, in the sensor's axes",
                _vector(lever.position_m, 1),
                f"{100 * float(radius):.1f}",
                "cm",
            )
        )
    if arm is not None and (length := arm.upper_arm) is not None:
        rows.append(("shoulder to elbow", f"{100 * length.value_m:.1f}", f"{196 * length.sigma_m:.1f}", "cm"))
    for name, unit in (("accelerometer_bias", "m/s²"), ("gyroscope_bias", "rad/s")):
        value = None if arm is None else getattr(estimates, name) or getattr(arm, name)
        if value is not None:
            rows.append((name.replace("_", " "), ", ".join(f"{item:.4f}" for item in value), None, unit))
    columns = ("what", "value (x, y, z)", "within (95 of 100 cases)", "unit")
    return Table("Sensor mounting on the arm", columns, rows)


def _vector(metres: Iterable[float] | None, decimals: int) -> str | None:
    return None if metres is None else ", ".join(f"{100 * item:.{decimals}f}" for item in metres)
