"""The views in which Rerun shows a result."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...array_types import FloatArray
from .rerun_arm import TIMELINE, RerunArm, middle_and_radius

#: How far back the trail reaches, s.
TRAIL_S = 2.0
#: Direction from the arm to the eye, in the level frame: before the person, to one side, above.
_EYE = np.array([0.80, -0.52, 0.30])
#: Distance of the eye, in radii of what is drawn, and at the least, m.
_FAR, _NEAR_M = 1.45, 0.7


def views(rr: Any, arms: list[RerunArm], R_W_K: FloatArray, upright: bool) -> Any:
    """The blueprint: the arm in space and its gaps on the left, curves on the right.

    Parameters
    ----------
    rr : module
        The package `rerun`.
    arms : list of RerunArm
        What is shown.
    R_W_K : ndarray, shape (3, 3)
        From the camera's axes to the level frame's.
    upright : bool
        `R_W_K` is by gravity: z is up.

    Returns
    -------
    Blueprint
    """
    rrb = rr.blueprint
    curves = [(f"{point}_{axis}", f"{point} {axis}, m") for point in _points(arms) for axis in "xyz"]
    if any(arm.has_flexion for arm in arms):
        curves.append(("elbow_flexion", "elbow flexion, degrees"))
    curves.append(("sigma", "sigma, cm"))
    whose = ", ".join(f"{arm.color_name}: {arm.name}" for arm in arms) if len(arms) > 1 else ""
    plots = [
        rrb.TimeSeriesView(
            origin=f"curves/{path}",
            name=f"{name} ({whose})" if whose and path != "sigma" else name,
            axis_x=rrb.TimeAxis(view_range=whole_recording(rr), zoom_lock=False),
            axis_y=rrb.ScalarAxis(range=(0.0, 1.1 * top_sigma_cm(arms))) if path == "sigma" else None,
            plot_legend=rrb.PlotLegend("RightTop", visible=path == "sigma" and len(arms) == 1),
        )
        for path, name in curves
    ]
    gaps = rrb.StateTimelineView(origin="gaps", name="gaps")
    notes = rrb.TextDocumentView(origin="notes", name="notes")
    left = rrb.Vertical(_space(rr, arms, R_W_K, upright), rrb.Tabs(gaps, notes), row_shares=[4, 1])
    return rrb.Blueprint(
        rrb.Horizontal(left, rrb.Vertical(*plots), column_shares=[1, 1]),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline=TIMELINE),
        auto_views=False,
    )


def whole_recording(rr: Any) -> Any:
    """A range of times from the first to the last, wherever the cursor is."""
    return rr.TimeRange(start=rr.TimeRangeBoundary.infinite(), end=rr.TimeRangeBoundary.infinite())


def top_sigma_cm(arms: list[RerunArm]) -> float:
    """The largest sigma of an axis that is shown; its curve begins at zero."""
    tops = []
    for arm in arms:
        for batch in arm.recovery.batches():
            variance = np.einsum("nii->ni", arm.point_of(batch)[1])
            tops.append(np.max(variance[np.isfinite(variance)], initial=0.0))
    return max(100.0 * float(np.sqrt(max(tops, default=0.0))), 0.1)


def _points(arms: list[RerunArm]) -> list[str]:
    return list(dict.fromkeys(arm.point for arm in arms))


def _space(rr: Any, arms: list[RerunArm], R_W_K: FloatArray, upright: bool) -> Any:
    rrb = rr.blueprint
    place, radius = middle_and_radius(arms)
    middle = R_W_K @ place
    trail = rr.VisibleTimeRange(
        TIMELINE,
        start=rr.TimeRangeBoundary.cursor_relative(seconds=-TRAIL_S),
        end=rr.TimeRangeBoundary.cursor_relative(),
    )
    eye = None
    if upright:
        there = middle + max(_FAR * radius, _NEAR_M) * _EYE
        eye = rrb.EyeControls3D(
            kind=rrb.Eye3DKind.Orbital, position=there, look_target=middle, eye_up=[0, 0, 1]
        )
    return rrb.Spatial3DView(
        origin="scene",
        name="blue: seen, orange: recovered, dark red: not to be trusted, grey: the camera's",
        overrides={f"{arm.space}/trail": rrb.VisibleTimeRanges(trail) for arm in arms},
        eye_controls=eye,
    )
