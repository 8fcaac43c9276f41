"""The page of `calibrate panel`: verdict, images with what was detected, cloud and planes, residuals."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import plotly.graph_objects as go

from calib.panel.images import View, drawn_depth, drawn_spots
from calib.panel.panel_calibration import PanelCalibration, SeenPanel
from calib.panel.panel_table import accuracy, pose_cells, pose_rows, transform_values, verdict

from ..array_types import FloatArray
from .sheet import figure, label, listing, picture, tabulated, write_sheet
from .space import cloud, face, polyline, space, view_of
from .style import AXIS_COLOURS, JOINT_COLOURS, OCCLUDED, TRUTH, VISIBLE, dress

#: Depth points drawn of all poses together.
MOST_POINTS = 12_000
#: Poses whose images are shown, the worst first.
MOST_PICTURES = 6
#: Length of the drawn axes, m.
AXIS_M = 0.15
_GROUPS = (
    ("all of the panel", VISIBLE),
    ("along x", OCCLUDED),
    ("along y", JOINT_COLOURS["elbow"]),
)


def write_panel_report(
    path: str | os.PathLike[str],
    calibration: PanelCalibration,
    views: Sequence[View],
    *,
    force: bool = False,
) -> None:
    """Write the page of a calibration from the marker panel.

    Parameters
    ----------
    path : path-like
        The page to write.
    calibration : PanelCalibration
        The calibration.
    views : sequence of View
        The images that it was made of, in the same order.
    force : bool
        Overwrite a page that exists.
    """
    judgement, poses = verdict(calibration), len(calibration.seen)
    write_sheet(
        path,
        "Camera from motion capture, by the marker panel",
        f"{poses} pose{'s' if poses > 1 else ''} of the panel. Axes are the camera's: x right, y down, z"
        " away.",
        [judgement.sentence],
        _sections(calibration, views),
        force=force,
    )


def _sections(calibration: PanelCalibration, views: Sequence[View]) -> Iterator[str]:
    judgement = verdict(calibration)
    yield listing("What to record next", judgement.next)
    yield _answer(calibration)
    yield listing("What else was found", judgement.findings)
    yield in_space(
        "The panel in space",
        "Depth points that took part, in the colour of their group, the fitted plane of every pose, the"
        " markers as the camera has them (dots) and as motion capture has them, put there by the answer"
        " (crosses). Drag to turn, Ctrl and the wheel to come closer; the boxes below hide.",
        calibration,
    )
    yield figure(
        "Where the markers miss",
        "Distance of every motion capture marker, put into the camera frame by the answer, from where its ray"
        " meets the panel's plane. Bars of one pose that stand out: panel or images moved between the two"
        " systems. One marker that stands out in every pose: its centre is not where the panel's plane is.",
        misses(calibration),
    )
    yield _poses(calibration)
    yield from _pictures(calibration, views)


def _answer(calibration: PanelCalibration) -> str:
    sigma, ours = accuracy(calibration), transform_values(calibration.solution.camera_from_mocap)
    rows = [
        ("rotation qw, qx, qy, qz", _numbers(ours["rotation"], 6), _numbers(sigma.rotation_deg, 3) + " deg"),
        ("translation, m", _numbers(ours["translation"], 5), _numbers(1e3 * sigma.translation_m, 2) + " mm"),
        ("sigma at the panel", "", _numbers(1e3 * sigma.at_panel_m, 2) + " mm"),
    ]
    if calibration.published is not None:
        theirs = transform_values(calibration.published)
        rows += [
            ("published: rotation", _numbers(theirs["rotation"], 6), ""),
            ("published: translation, m", _numbers(theirs["translation"], 5), ""),
        ]
    return tabulated(
        "The answer",
        "A point of motion capture in the camera frame: p_camera = R p_mocap + t. Sigmas are one standard"
        " deviation about and along the camera's axes; that of t is at the mocap's origin, which may be far"
        " from the panel. The published method's answer (principal components) is for comparison.",
        ("", "value", "sigma x, y, z"),
        rows,
    )


def _poses(calibration: PanelCalibration) -> str:
    columns = ("pose", "markers", "distance, m", "tilt, deg", "pixels rms", "markers, mm", "plane, mm")
    rows = [
        (row["pose"], ", ".join(row["markers"]), *pose_cells(row), row["depth_pixels"])
        for row in pose_rows(calibration)
    ]
    return tabulated(
        "Poses",
        "Residuals (root mean square) of the four markers by pose: in the image, in space, and along the"
        " plane's normal. Markers are named in the order of the panel's definition. Depth noise is that of"
        " one pixel.",
        (*columns, "depth noise, mm", "depth pixels"),
        rows,
    )


def _pictures(calibration: PanelCalibration, views: Sequence[View]) -> Iterator[str]:
    worst = np.argsort(-np.sqrt(np.mean(calibration.solution.marker_residuals_m**2, axis=1)), kind="stable")
    shown = sorted(worst[:MOST_PICTURES].tolist())
    for number in shown:
        panel, view = calibration.seen[number], views[number]
        others = len(panel.blobs) - 4
        left_out = f" {others} other bright spots were left out (orange)." if others else ""
        yield picture(
            f"{calibration.names[number]}: infrared",
            f"Rings: the markers that were found, numbered as in the panel's definition.{left_out}",
            drawn_spots(view.infrared, panel.blobs, panel.spots),
        )
        regions = panel.regions
        yield picture(
            f"{calibration.names[number]}: depth",
            "Pixels that took part: blue for the plane, orange along x, green along y; red ones lie off the"
            " plane and were left out, black ones have no depth.",
            drawn_depth(view.depth_m, regions.pixels, regions.along_x, regions.along_y, panel.plane.inliers),
        )


def in_space(heading: str, caption: str, calibration: PanelCalibration) -> str:
    """Depth points, planes, markers and axes of all poses, to be turned."""
    items: list[dict[str, Any]] = []
    most = MOST_POINTS // len(calibration.seen)
    for number, panel in enumerate(calibration.seen):
        items += [cloud(points, name, colour, 2) for name, colour, points in _clouds(panel, most)]
        items.append(face(_corners(calibration, panel), "plane", "#8a8a8a"))
        words = list(calibration.labels[number])
        items.append(cloud(panel.points_K, "camera's markers", TRUTH, 8, words=words))
        transform = calibration.solution.camera_from_mocap
        at = calibration.markers_E[number] @ transform.R.T + transform.origin
        items.append(cloud(at, "mocap's markers", OCCLUDED, 8, symbol="x", words=words))
        for axis, colour in enumerate(AXIS_COLOURS.values()):
            ends = np.array([panel.frame.origin, panel.frame.origin + AXIS_M * panel.frame.R[:, axis]])
            items.append(polyline(ends, f"panel's {'xyz'[axis]}", colour, 3))
    for axis, colour in enumerate(AXIS_COLOURS.values()):
        ends = np.array([np.zeros(3), AXIS_M * np.eye(3)[axis]])
        items.append(polyline(ends, "camera", colour, 2, dash=True))
    points = np.concatenate([np.zeros((1, 3)), *(_corners(calibration, panel) for panel in calibration.seen)])
    # seen from behind the camera, a little to the side and from above
    view = view_of(points, np.array([0.0, -1.0, 0.0]), np.array([-0.5, -0.5, -1.2]))
    view |= {"axes_at": [0.0, 0.0, 0.0], "axes_length": AXIS_M}
    return space(heading, caption, items, view, axes=("x (right)", "y (down)", "z (away)"))


def misses(calibration: PanelCalibration) -> go.Figure:
    """Residual of every marker, a group of bars a pose."""
    plot = go.Figure()
    colours = [VISIBLE, OCCLUDED, JOINT_COLOURS["elbow"], JOINT_COLOURS["shoulder"]]
    for k in range(4):
        plot.add_trace(
            go.Bar(
                x=[label(name) for name in calibration.names],
                y=1e3 * calibration.solution.marker_residuals_m[:, k],
                name=f"marker {k + 1} of the panel",
                marker_color=colours[k],
                customdata=[label(labels[k]) for labels in calibration.labels],
                hovertemplate="%{customdata}: %{y:.2f} mm<extra></extra>",
            )
        )
    dress(plot, 380, head=70, barmode="group")
    plot.update_yaxes(title="distance, mm")
    return plot


def _clouds(panel: SeenPanel, most: int) -> Iterator[tuple[str, str, np.ndarray]]:
    regions, inliers = panel.regions, panel.plane.inliers
    points = np.column_stack([regions.rays, np.ones(len(regions.rays))]) * regions.depth_m[:, None]
    step = max(1, int(inliers.sum()) // most)
    decimated = np.zeros(len(inliers), bool)
    decimated[np.flatnonzero(inliers)[::step]] = True
    rest = ~regions.along_x & ~regions.along_y
    for (name, colour), chosen in zip(_GROUPS, (rest, regions.along_x, regions.along_y), strict=True):
        yield name, colour, points[decimated & chosen].astype(np.float32)


def _corners(calibration: PanelCalibration, panel: SeenPanel) -> FloatArray:
    """Corners (4, 3) of the panel on the fitted plane."""
    (x0, y0), (x1, y1) = calibration.panel.extent_P
    corners = np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])
    at = panel.frame.origin + corners @ panel.frame.R[:, :2].T
    return np.asarray(at / (at @ panel.plane.theta)[:, None])


def _numbers(values: Sequence[float] | np.ndarray, digits: int) -> str:
    return ", ".join(f"{float(value):.{digits}f}" for value in values)
