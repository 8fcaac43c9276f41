"""Figures for a paper: curves with their 95 % bands, Bland-Altman plots, curves over a repetition."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ..array_types import FloatArray
from ..errors import UnoccludeError
from ..evaluation.agreement import WORDS
from ..linalg import runs
from ..result import Recovery

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


#: What is drawn unless somebody says otherwise, of what the recovery has.
USUAL = ("elbow_flexion", "shoulder_elevation", "wrist", "error_95")
#: A column of most journals is so wide, a page twice as much, cm; a row is so high.
PAGE_CM, ROW_CM, CM_PER_INCH = 17.0, 3.6, 2.54
#: A normal error is smaller than this many sigmas in 95 of 100 cases.
SIGMAS_95 = 1.96
#: More points than this across a page are not seen.
MOST_POINTS = 6000
#: Colours that people with any colour vision tell apart, also in grey (Okabe and Ito, 2008).
COLOURS = ("#0072B2", "#D55E00", "#009E73")
STYLE: Any = {"font.size": 8, "axes.linewidth": 0.6, "lines.linewidth": 0.9, "svg.fonttype": "none"}


def plot_recovery(
    recovery: Recovery,
    what: Sequence[str] = USUAL,
    *,
    from_s: float | None = None,
    to_s: float | None = None,
    width_cm: float = PAGE_CM,
) -> Figure:
    """Draw curves over time, one below the other, each with its 95 % band."""
    try:
        from matplotlib import rc_context
        from matplotlib.figure import Figure
    except ImportError as error:
        raise UnoccludeError("plot() needs matplotlib; install it by `pip install matplotlib`") from error

    start_s, end_s = -np.inf if from_s is None else from_s, np.inf if to_s is None else to_s
    first, last = np.searchsorted(recovery.t_s, [start_s, end_s]).tolist()
    if last - first < 2:
        raise UnoccludeError(
            f"{recovery.name}: there is no sample to draw between {start_s:g} and {end_s:g} s"
        )
    some = recovery.rows(np.linspace(first, last - 1, min(last - first, MOST_POINTS)).round().astype(int))
    curves = {name: curve for name in what if (curve := _curves(some, name)) is not None}
    if what is not USUAL and (missing := [name for name in what if name not in curves]):
        raise UnoccludeError(
            f"{recovery.name}: {', '.join(missing)} cannot be drawn: {_reason(some, missing[0])}"
        )
    if not curves:
        raise UnoccludeError(f"{recovery.name}: there is no answer to draw")
    with rc_context(STYLE):
        size = (width_cm / CM_PER_INCH, (ROW_CM * len(curves) + 1.0) / CM_PER_INCH)
        figure = Figure(figsize=size, dpi=200, layout="constrained")
        rows = figure.subplots(len(curves), 1, sharex=True, squeeze=False)[:, 0]
        for axes, (label, lines) in zip(rows, curves.values(), strict=True):
            _draw(axes, some, label, lines)
        rows[-1].set_xlabel("time, s")
        rows[0].set_title(_title(recovery), fontsize=8, loc="left")
    return figure


#: Name, values and standard deviation (none for what is a distance already).
Lines = list[tuple[str, FloatArray, FloatArray | None]]


def _curves(some: Recovery, name: str) -> tuple[str, Lines] | None:
    """Label of the axis and lines of something; None where the recovery has none of it."""
    if name == "error_95":
        value = 100.0 * some.error_95_m
        return ("95 % within, cm", [("", value, None)]) if np.isfinite(value).any() else None
    if name == "imu" or name in some.joints:
        position = some.position if name == "imu" else some.joints[name]
        spread = some.pose_covariance[:, :3, :3] if name == "imu" else some.joint_covariance[name]
        sigma = np.sqrt(np.einsum("nii->ni", spread))
        if not np.isfinite(position).any():
            return None
        label = f"{'IMU' if name == 'imu' else name}, m"
        return label, [(axis, position[:, k], sigma[:, k]) for k, axis in enumerate("xyz")]
    angles = some.angles()
    turned = angles.values.get(name)
    if turned is None or not np.isfinite(turned).any():
        return None
    return f"{WORDS.get(name, name.replace('_', ' '))}, deg", [("", turned, angles.sigmas[name])]


def _reason(some: Recovery, name: str) -> str:
    angles = some.angles()
    if name in angles.reasons:
        return angles.reasons[name]
    there = [*angles.values, *some.joints, "imu", "error_95"]
    return f"the recovery has {', '.join(there)}"


def _draw(axes: Axes, some: Recovery, label: str, lines: Lines) -> None:
    t = some.t_s
    for run in runs(some.occluded):
        axes.axvspan(t[run.start], t[run.stop - 1], color="0.9", linewidth=0)
    for (name, value, sigma), colour in zip(lines, COLOURS, strict=False):
        # a pause of the IMU is not a line
        broken = np.where(
            np.diff(t, prepend=t[0]) > max(1.0, 5 * float(np.median(np.diff(t)))), np.nan, value
        )
        axes.plot(t, broken, color=colour, label=name)
        if sigma is not None:
            wide = SIGMAS_95 * sigma
            axes.fill_between(t, broken - wide, broken + wide, color=colour, alpha=0.25, linewidth=0)
    if not some.trusted.all():
        for run in runs(~some.trusted):
            axes.axvspan(t[run.start], t[run.stop - 1], color="#CC0000", alpha=0.15, linewidth=0)
    axes.set_ylabel(label)
    axes.set_xlim(t[0], t[-1])
    axes.spines[["top", "right"]].set_visible(False)
    if len(lines) > 1:
        axes.legend(
            loc="lower right",
            bbox_to_anchor=(1.0, 1.0),
            borderaxespad=0.0,
            frameon=False,
            ncols=len(lines),
            fontsize=7,
        )
    elif lines[0][2] is None:
        axes.set_ylim(bottom=0.0)


def _title(recovery: Recovery) -> str:
    """Whose arm, what is shaded; and that it is not to be trusted, where it is not."""
    title = f"{recovery.name}, {recovery.arm_label}; hidden from the camera: grey; band: 95 %"
    if recovery.estimates.trusted is False:
        return f"NOT TO BE TRUSTED. {title}"
    return title if recovery.trusted.all() else f"{title}; not to be trusted: red"
