"""The report's tables, as HTML."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from html import escape

import numpy as np

from calib.motion.estimates import ArmEstimates

from ..calibration import ArmCalibration
from ..evaluation.rejected import rejected
from ..evaluation.summary import gap_summaries, recovery_figures
from ..evaluation.validate import Validation
from ..io.result.usable import LIMIT, usable
from ..result import Recovery
from .summary import WEAK_M

#: Figures of a recovery that have a place of their own on the page.
ELSEWHERE = (
    *("camera_sigma_m", "camera_effective_sigma_m", "joint_bias_m", "joint_bias_sigma_m"),
    *("accelerometer_bias", "gyroscope_bias", "given", "max_sigma_m"),
)
#: A longer table is cut, and says so.
MOST_ROWS = 500


def table(columns: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """An HTML table; every cell is escaped."""
    kept = list(rows)
    head = "".join(f"<th>{escape(column)}</th>" for column in columns)
    body = "".join(
        "<tr>" + "".join(f"<td>{escape(_cell(value))}</td>" for value in row) + "</tr>"
        for row in kept[:MOST_ROWS]
    )
    more = f"<p>{len(kept) - MOST_ROWS} rows more are left out.</p>" if len(kept) > MOST_ROWS else ""
    return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>{more}"


def _cell(value: object) -> str:
    if value is None or (isinstance(value, float) and not np.isfinite(value)):
        return "–"
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _cm(value: float | None) -> str | None:
    return None if value is None else f"{100 * value:.2f}"


def overview(recovery: Recovery) -> str:
    """What was recovered, in numbers."""
    figures = recovery_figures(recovery)
    sigma = figures["sigma_m"]
    assert isinstance(sigma, dict)
    offset = None
    if np.isfinite(recovery.clock_offset_s):
        offset = f"{1000 * recovery.clock_offset_s:.1f} ms"
        if np.isfinite(recovery.clock_offset_sigma_s):
            offset += f" ± {1000 * recovery.clock_offset_sigma_s:.1f} ms"
    rows = [
        ("method", recovery.method),
        ("arm", recovery.side or "not stated"),
        ("samples of the forearm sensor", len(recovery)),
        ("sample rate, Hz", figures["rate_hz"]),
        ("samples without the camera", recovery.occluded.sum()),
        ("samples without an answer", len(recovery) - int(recovery.answered.sum())),
        ("position, standard deviation while seen (median), cm", _cm(sigma["visible"]["median"])),
        ("position, standard deviation in gaps (median), cm", _cm(sigma["occluded"]["median"])),
        ("position, standard deviation in gaps (largest), cm", _cm(sigma["occluded"]["max"])),
        ("sensor's clock minus camera's clock", offset),
    ]
    if (unsure := _too_uncertain(recovery)) is not None:
        rows.append(("samples marked as too uncertain to use", unsure))
    rows += [
        (name.replace("_", " "), _plain(value))
        for name, value in recovery.figures.items()
        if name not in ELSEWHERE
    ]
    return table(("what", "value"), rows)


def _too_uncertain(recovery: Recovery) -> str | None:
    limit = recovery.figures.get(LIMIT)
    if limit is None:
        return None
    unsure = int(recovery.answered.sum() - usable(recovery).sum())
    return f"{unsure} (above {100 * float(str(limit)):g} cm)"


def set_aside(recovery: Recovery) -> str:
    """What was set aside of the camera's samples, a row a reason and joint."""
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
        return "<p>Nothing: every sample that called itself tracked took part.</p>"
    columns = ("reason", "in words", "joint", "samples", "of its tracked ones", "first, s", "last, s")
    return table(columns, rows)


def camera(found: ArmEstimates) -> str:
    """Noise and constant errors of the camera's joints; "" where they are not known."""
    if not found.camera:
        return ""
    rows = [
        (joint, f"{100 * each.sample_m:.2f}", f"{100 * each.bias_m:.2f}" if each.bias_m > 0 else None)
        for joint, each in found.camera.items()
    ]
    columns = ("camera's joint", "noise of a sample, cm an axis", "constant error against the others, cm")
    return table(columns, rows)


def gaps(recovery: Recovery) -> str:
    """The gaps, one a row."""
    found = gap_summaries(recovery)
    if not found:
        return "<p>There is no gap.</p>"
    rows = [
        (
            number,
            f"{each.gap.start_s:.2f}",
            f"{each.gap.length_s:.2f}",
            _cm(each.sigma_max_m),
            None if each.sigma_max_deg is None else f"{each.sigma_max_deg:.2f}",
            "one side only" if each.gap.open_start or each.gap.open_end else "both sides",
            f"{100 * each.answered:.0f} %",
            "take with care" if _weak(each.sigma_max_m) or each.gap.open_start or each.gap.open_end else "",
        )
        for number, each in enumerate(found, start=1)
    ]
    columns = (
        "gap",
        "start, s",
        "length, s",
        "largest standard deviation, cm",
        "of the orientation, degrees",
        "camera saw the arm on",
        "answered",
        "",
    )
    return table(columns, rows)


def _weak(sigma_m: float | None) -> bool:
    return sigma_m is not None and sigma_m > WEAK_M


def validation(found: Validation) -> str:
    """Errors against the reference."""
    rows = [
        (
            name,
            figures.samples,
            _cm(figures.position_rms_m),
            _cm(figures.position_p95_m),
            _cm(figures.position_max_m),
            figures.orientation_rms_deg,
            figures.orientation_max_deg,
            figures.nees,
            None if figures.coverage_95 is None else f"{100 * figures.coverage_95:.0f} %",
        )
        for name, figures in (
            ("all samples", found.all),
            ("in gaps", found.occluded),
            ("while seen", found.visible),
        )
    ]
    columns = (
        "",
        "samples",
        "position rms, cm",
        "95 % below, cm",
        "largest, cm",
        "orientation rms, degrees",
        "largest, degrees",
        "NEES",
        "inside the 95 % region",
    )
    parts = (found.all, found.occluded, found.visible)
    joints = [(name, *[_cm(part.joint_rms_m.get(name)) for part in parts]) for name in found.all.joint_rms_m]
    if not joints:
        return table(columns, rows)
    heads = ("joint", "all samples, rms, cm", "in gaps, cm", "while seen, cm")
    return table(columns, rows) + table(heads, joints)


def calibration(found: ArmCalibration | None, figures: Mapping[str, object]) -> str:
    """How the sensor sits on the arm, the arm's measures, and the sensor's biases."""
    if found is None:
        return "<p>This method needs none.</p>"
    rows: list[tuple[object, ...]] = [
        (f"{joint}, in the sensor's axes", _vector(lever.position_m, 1), _vector(lever.sigma_m, 2), "cm")
        for joint, lever in found.lever_arms.items()
    ]
    if found.upper_arm is not None:
        length = found.upper_arm
        rows.append(("shoulder to elbow", f"{100 * length.value_m:.1f}", f"{100 * length.sigma_m:.2f}", "cm"))
    for name, value, unit in (
        ("accelerometer bias", figures.get("accelerometer_bias", found.accelerometer_bias), "m/s²"),
        ("gyroscope bias", figures.get("gyroscope_bias", found.gyroscope_bias), "rad/s"),
    ):
        if isinstance(value, list | np.ndarray):
            rows.append((name, ", ".join(f"{item:.4f}" for item in value), None, unit))
    if not rows:
        return "<p>None was given, and none was needed.</p>"
    return table(("what", "value (x, y, z)", "standard deviation", "unit"), rows)


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
