"""Figures for a paper: curves over time with their 95 % bands."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ..angles.definitions import ANGLE_TITLES
from ..array_types import FloatArray
from ..errors import UnoccludeError
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
    drawable = _drawable(some)
    if what is USUAL:
        what = [name for name in what if name in drawable]
    if missing := [name for name in what if name not in drawable]:
        why = some.angles().reasons.get(missing[0], f"the recovery has {', '.join(drawable)}")
        raise UnoccludeError(f"{recovery.name}: {', '.join(missing)} cannot be drawn: {why}")
    if not what:
        raise UnoccludeError(f"{recovery.name}: there is no answer to draw")
    curves = [drawable[name] for name in what]
    with rc_context(STYLE):
        size = (width_cm / CM_PER_INCH, (ROW_CM * len(curves) + 1.0) / CM_PER_INCH)
        figure = Figure(figsize=size, dpi=200, layout="constrained")
        rows = figure.subplots(len(curves), 1, sharex=True, squeeze=False)[:, 0]
        for axes, (label, lines) in zip(rows, curves, strict=True):
            _draw(axes, some, label, lines)
        rows[-1].set_xlabel("time, s")
        title = f"{recovery.name}, {recovery.arm_label}; hidden from the camera: grey; band: 95 %"
        if recovery.estimates.trusted is False:
            title = f"NOT TO BE TRUSTED. {title}"
        elif not recovery.trusted.all():
            title = f"{title}; not to be trusted: red"
        rows[0].set_title(title, fontsize=8, loc="left")
    return figure


#: Name, values and standard deviation (none for what is a distance already).
Lines = list[tuple[str, FloatArray, FloatArray | None]]


def _drawable(some: Recovery) -> dict[str, tuple[str, Lines]]:
    """By name what can be drawn: label of the axis, and lines."""
    angles = some.angles()
    found: dict[str, tuple[str, Lines]] = {
        name: (f"{ANGLE_TITLES[name]}, deg", [("", turned, angles.sigmas[name])])
        for name, turned in angles.values.items()
    }
    unknown = np.full((len(some), 3, 3), np.nan)
    points = {name: (each, some.joint_covariance.get(name, unknown)) for name, each in some.joints.items()}
    points["imu"] = some.position, some.pose_covariance[:, :3, :3]
    for name, (position, spread) in points.items():
        sigma = np.sqrt(np.einsum("nii->ni", spread))
        axes: Lines = [(axis, position[:, k], sigma[:, k]) for k, axis in enumerate("xyz")]
        found[name] = f"{'IMU' if name == 'imu' else name}, m", axes
    found["error_95"] = "95 % within, cm", [("", 100.0 * some.error_95_m, None)]
    return {name: each for name, each in found.items() if np.isfinite(each[1][0][1]).any()}


def _draw(axes: Axes, some: Recovery, label: str, lines: Lines) -> None:
    t = some.t_s
    for run in runs(some.occluded):
        axes.axvspan(t[run.start], t[run.stop - 1], color="0.9", linewidth=0)
    for (name, value, sigma), colour in zip(lines, COLOURS, strict=False):
        pause_s = max(1.0, 5 * float(np.median(np.diff(t))))  # over which there is no line
        broken = np.where(np.diff(t, prepend=t[0]) > pause_s, np.nan, value)
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
        axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), frameon=False, ncols=len(lines), fontsize=7)
    elif lines[0][2] is None:
        axes.set_ylim(bottom=0.0)
