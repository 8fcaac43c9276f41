"""The pages of `calibrate panel` and `calibrate world`: images, planes, the base IMU, residuals by pose."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import plotly.graph_objects as go

from calib.panel import panel_table
from calib.panel.images import View, drawn_depth, drawn_spots
from calib.panel.panel_calibration import PanelCalibration, SeenPanel
from calib.panel.panel_table import pose_cells, transform_values
from calib.world import world_table
from calib.world.world_calibration import WorldCalibration

from ..array_types import FloatArray
from .sheet import Page, figure, label, listing, picture, tabulated
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


def panel_page(calibration: PanelCalibration, views: Sequence[View]) -> Page:
    """The page of a calibration from the marker panel; `views` are the images of its poses, in that order."""
    poses = len(calibration.seen)
    return Page(
        "Camera from motion capture, by the marker panel",
        f"{poses} pose{'s' if poses > 1 else ''} of the panel. Axes are the camera's: x right, y down, z"
        " away.",
        [panel_table.verdict(calibration).sentence],
        _panel_sections(calibration, views),
    )


def _panel_sections(calibration: PanelCalibration, views: Sequence[View]) -> Iterator[str]:
    judgement = panel_table.verdict(calibration)
    yield listing("What to record next", judgement.next)
    yield _panel_answer(calibration)
    yield listing("What else was found", judgement.findings)
    yield in_space(
        "The panel in space",
        "Depth points that were used, in the colour of their group, the fitted plane of every pose, the"
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


def _panel_answer(calibration: PanelCalibration) -> str:
    sigma, ours = panel_table.accuracy(calibration), transform_values(calibration.solution.camera_from_mocap)
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
        for row in panel_table.pose_rows(calibration)
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
            "Pixels that were used: blue for the plane, orange along x, green along y; red ones lie off the"
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


def world_page(calibration: WorldCalibration, notes: Sequence[str] = ()) -> Page:
    """The page of how the base IMU sits on the camera; `notes` are of the input."""
    poses = len(calibration.poses)
    return Page(
        "Camera from base IMU, by the panel",
        f"{poses} pose{'s' if poses > 1 else ''} of the panel. Axes of the camera: x right, y down, z away.",
        [world_table.verdict(calibration).sentence],
        _world_sections(calibration, notes),
    )


def _world_sections(calibration: WorldCalibration, notes: Sequence[str]) -> Iterator[str]:
    judgement = world_table.verdict(calibration)
    yield listing(
        "What to record next", judgement.next, "Nothing is missing: record the next session in the same way."
    )
    yield _world_answer(calibration)
    yield listing("What else was found", judgement.findings)
    yield on_the_camera(
        "The base IMU on the camera",
        "Solid: the camera's axes. Dashed: those of the IMU on it, turned as solved. The large dots"
        " are down as each pose has it (the pose's name is under the pointer): far apart where the camera was"
        " tilted between poses, which is what gives the heading. Drag to turn.",
        calibration,
    )
    yield figure(
        "What is left of each pose",
        "Above: by how much the panel's rotation in the image misses the answer. Below: the largest misfit of"
        " a pose in standard deviations; one that stands out was not still, or its images are of another"
        " moment.",
        misfits(calibration),
    )
    rows = [
        (
            row["pose"],
            ", ".join(f"{value:.4f}" for value in row["down"]),
            f"{row['rotation_deg']:.3f}",
            f"{row['worst_sigma']:.1f}",
            f"{row['rest_s']:.1f}",
        )
        for row in world_table.pose_rows(calibration)
    ]
    columns = (
        "pose",
        "down in the camera",
        "left of its rotation, degrees",
        "worst misfit, sigmas",
        "rest, s",
    )
    yield tabulated("Poses", "Down is a unit vector in the camera's axes.", columns, rows)
    yield listing("Notes", dict.fromkeys(notes), "There is nothing to note.")


def _world_answer(calibration: WorldCalibration) -> str:
    sigma, at = world_table.accuracy(calibration), calibration.solution.at
    bias = np.sqrt(np.diag(calibration.solution.covariance)[3:6])
    rows = [
        ("camera from base IMU, qw, qx, qy, qz", _quaternion(calibration.R_K_B), _three(sigma.rotation_deg)),
        ("panel from its IMU, qw, qx, qy, qz", _quaternion(calibration.R_P_I), _three(sigma.mounting_deg)),
        ("tilt of the camera, degrees", "", f"{sigma.tilt_deg:.2f}"),
        ("heading, degrees", "free" if sigma.heading_free else "", _heading(sigma.heading_deg)),
        (
            "bias of the base accelerometer, m/s²",
            ", ".join(f"{value:.4f}" for value in at.rest[:3]),
            ", ".join(f"{value:.4f}" for value in bias),
        ),
    ]
    return tabulated(
        "The answer",
        "A vector of the IMU in the camera's axes: v_camera = R v_imu. Sigmas are one standard deviation,"
        " rotations in degrees about the camera's axes (the panel's IMU: about its own).",
        ("", "value", "sigma"),
        rows,
    )


def on_the_camera(heading: str, caption: str, calibration: WorldCalibration) -> str:
    """Axes of camera and base IMU, and down in every pose, to be turned."""
    items = []
    for axis, (name, colour) in enumerate(AXIS_COLOURS.items()):
        for R, words, dash in ((np.eye(3), "camera", False), (calibration.R_K_B, "base IMU", True)):
            ends = np.array([np.zeros(3), R[:, axis]])
            items.append(polyline(ends, f"{words}'s {name}", colour, 3, dash=dash))
    rows = world_table.pose_rows(calibration)
    down = np.array([row["down"] for row in rows], float)
    items += [polyline(np.array([np.zeros(3), 0.96 * each]), "down", TRUTH, 1) for each in down]
    items.append(cloud(0.96 * down, "down", TRUTH, 9, words=[row["pose"] for row in rows]))
    corners = 1.15 * np.vstack([np.eye(3), -np.eye(3)])
    # seen from behind the camera, a little to the side and from above
    view = view_of(corners, np.array([0.0, -1.0, 0.0]), np.array([-0.6, -0.6, -1.2]))
    view |= {"axes_at": [0.0, 0.0, 0.0], "axes_length": 1.0, "grid": False}
    return space(heading, caption, items, view, axes=("x (right)", "y (down)", "z (away)"))


def misfits(calibration: WorldCalibration) -> go.Figure:
    """Residual rotation and largest misfit, a bar a pose."""
    from plotly.subplots import make_subplots

    plot, rows = (
        make_subplots(rows=2, cols=1, shared_xaxes=True, vertical_spacing=0.08),
        world_table.pose_rows(calibration),
    )
    names = [label(row["pose"]) for row in rows]
    for number, (key, colour) in enumerate((("rotation_deg", VISIBLE), ("worst_sigma", OCCLUDED)), start=1):
        bars = go.Bar(x=names, y=[row[key] for row in rows], marker_color=colour, showlegend=False)
        plot.add_trace(bars, row=number, col=1)
    plot.update_yaxes(title_text="rotation, degrees", rangemode="tozero", row=1, col=1)
    plot.update_yaxes(title_text="misfit, sigmas", rangemode="tozero", row=2, col=1)
    return dress(plot, 420, head=20)


def _heading(sigma_deg: float) -> str:
    return f"{sigma_deg:.1f}" if sigma_deg < 90 else "–"


def _three(values: FloatArray) -> str:
    return ", ".join(f"{value:.2f}" for value in values)


def _quaternion(R: FloatArray) -> str:
    from scipy.spatial.transform import Rotation

    return ", ".join(f"{value:.5f}" for value in np.roll(Rotation.from_matrix(R).as_quat(canonical=True), 1))
