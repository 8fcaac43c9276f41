"""The forearm and its sensor drawn from the lever arms, and the page of `calibrate forearm`."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from calib.forearm.forearm_frame import forearm_frame
from calib.forearm.forearm_summary import (
    AGREE,
    Compared,
    compare,
    next_time,
    open_questions,
    verdict,
)
from calib.forearm.held_pose import ForearmCalibration
from calib.motion.motion_calibration import ArmEstimates
from calib.motion.motion_summary import Evidence

from ..array_types import FloatArray
from ..calibration import LeverArm
from ..recording import JOINTS, Recording
from .sheet import Page, figure, listing, tabulated
from .style import AXIS_COLOURS, JOINT_COLOURS, OCCLUDED, VISIBLE, axis_names, curve, dots, dress

#: The sensor is drawn as a cube of this size with axes of this length, cm.
CUBE_CM, AXIS_CM = 2.0, 4.5
#: Ellipses hold 95 of 100 cases of two coordinates, at this many sigmas; of one coordinate these many.
SIGMAS, SIGMAS_OF_ONE = 2.448, 1.96
_CHAIN = ("elbow", "wrist", "hand")


def mount(estimates: ArmEstimates | None) -> go.Figure | None:
    """The forearm from the side and from above, with the sensor and its axes; None without a lever arm."""
    if estimates is None or not estimates.calibration.lever_arms:
        return None
    levers = estimates.calibration.lever_arms
    along, away = directions(estimates)
    names = ("from the side", "from above, the sensor towards you")
    if estimates.frame is None:
        names = ("seen from one side", "seen from another")
    views = tuple(zip(names, (away, np.cross(away, along)), strict=True))
    figure = make_subplots(
        rows=2,
        cols=1,
        subplot_titles=[name for name, _ in views],
        shared_xaxes=True,
        vertical_spacing=0.13,
    )
    for row, (_, up) in enumerate(views, start=1):
        onto = np.stack([along, up])
        for trace in _traces(estimates, onto):
            trace.update(showlegend=False)
            figure.add_trace(trace, row=row, col=1)
        _arrows(figure, onto, row)
        _lengths(figure, estimates, onto, row)
    places = 100 * np.array([np.zeros(3), *[lever.position_m for lever in levers.values()]])
    reach = places @ along
    sides = np.concatenate([places @ up for _, up in views])
    widest = 100 * SIGMAS * max(float(np.max(lever.sigma_m)) for lever in levers.values())
    half = max(np.abs(sides).max() + max(2.5, widest + 0.5), 0.5 * AXIS_CM + 4.0)
    margin = max(5.0, widest + 1.0)
    low, high = min(reach.min(), -AXIS_CM) - margin, max(reach.max(), AXIS_CM) + margin
    figure.update_xaxes(range=[low, high], constrain="domain")
    for row in (1, 2):
        figure.update_yaxes(
            range=[-half, half],
            scaleanchor="x" if row == 1 else "x2",
            title_text="cm",
            constrain="domain",
            row=row,
            col=1,
        )
    axis = "along the forearm, cm (0 = the sensor)" if estimates.frame is not None else "cm (0 = the sensor)"
    figure.update_xaxes(title_text=axis, row=2, col=1)
    height = 190 + 2 * 960 * 2 * half / (high - low)
    return dress(figure, int(np.clip(height, 420, 900)), head=40, meta={"wide": True})


def directions(estimates: ArmEstimates) -> tuple[FloatArray, FloatArray]:
    """Unit vectors in {A}: along the forearm, and from it to the sensor (or any across it)."""
    levers = estimates.calibration.lever_arms
    if estimates.frame is not None:
        along = estimates.frame.direction
        away = -(levers["elbow"].position_m - along * (levers["elbow"].position_m @ along))
    else:
        farthest = max((lever.position_m for lever in levers.values()), key=np.linalg.norm)
        size = float(np.linalg.norm(farthest))
        along = farthest / size if size > 0 else np.array([1.0, 0.0, 0.0])
        away = np.zeros(3)
    if np.linalg.norm(away) < 0.003:
        least = np.eye(3)[int(np.argmin(np.abs(along)))]
        away = least - along * (least @ along)
    return along, away / np.linalg.norm(away)


def ellipse(lever: LeverArm, onto: FloatArray, sigmas: float = SIGMAS) -> FloatArray:
    """Outline (n, 2), cm, of a lever arm's uncertainty in a view whose axes are the rows of `onto` (2, 3)."""
    spread = onto * lever.sigma_m
    values, axes = np.linalg.eigh(spread @ spread.T)
    turn = np.linspace(0, 2 * np.pi, 49)
    circle = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    return 100 * (onto @ lever.position_m + sigmas * (circle * np.sqrt(np.maximum(values, 0))) @ axes.T)


def _traces(estimates: ArmEstimates, onto: FloatArray) -> list[go.Scatter]:
    levers = estimates.calibration.lever_arms
    chain = [joint for joint in _CHAIN if joint in levers]
    bones = 100 * np.array([onto @ levers[joint].position_m for joint in chain]).reshape(-1, 2)
    traces = [curve(bones[:, 0], bones[:, 1], None, "#9a8f86", 9, opacity=0.5, hoverinfo="skip")]
    for joint, lever in levers.items():
        edge = ellipse(lever, onto)
        colour = JOINT_COLOURS[joint]
        outline = curve(edge[:, 0], edge[:, 1], None, colour, 1.2, fill="toself", opacity=0.5)
        place = 100 * onto @ lever.position_m
        dot = dots(place[:1], place[1:], joint, colour, 8, text=[joint], textposition="bottom center")
        traces += [outline.update(hoverinfo="skip"), dot.update(mode="markers+text")]
    corners = np.array(list(itertools.product((-0.5, 0.5), repeat=3))) * CUBE_CM @ onto.T
    hull = corners[_hull(corners)]
    cube = curve(hull[:, 0], hull[:, 1], "sensor", "#333333", 1.5)
    return [*traces, cube.update(fill="toself", fillcolor="rgba(60, 60, 60, 0.35)")]


def _hull(points: FloatArray) -> list[int]:
    """Corners of the convex hull, closed."""
    from scipy.spatial import ConvexHull

    corners = ConvexHull(points).vertices.tolist()
    return [*corners, corners[0]]


def _arrows(figure: go.Figure, onto: FloatArray, row: int) -> None:
    for axis, (name, colour) in enumerate(AXIS_COLOURS.items()):
        tip = AXIS_CM * onto[:, axis]
        label = ["", name] if np.linalg.norm(tip) > 0.2 * AXIS_CM else ["", ""]
        arrow = curve([0, tip[0]], [0, tip[1]], None, colour, 3, showlegend=False, hoverinfo="skip")
        arrow.update(text=label, textfont={"color": colour, "size": 15}, textposition=_beyond(tip))
        figure.add_trace(arrow.update(mode="lines+text"), row=row, col=1)


def _beyond(tip: FloatArray) -> str:
    """Where a label stands so that it lies beyond the tip."""
    if abs(tip[0]) > abs(tip[1]):
        return "middle right" if tip[0] > 0 else "middle left"
    return "top center" if tip[1] > 0 else "bottom center"


def _lengths(figure: go.Figure, estimates: ArmEstimates, onto: FloatArray, row: int) -> None:
    """Lengths beside what they measure; the sensor's distance only where it is seen."""
    levers, frame = estimates.calibration.lever_arms, estimates.frame
    if frame is None:
        return
    elbow, wrist = (100 * onto @ levers[joint].position_m for joint in ("elbow", "wrist"))
    _label(figure, elbow + 0.4 * (wrist - elbow), _cm(frame.length_m, frame.length_sigma_m), row, -16)
    if "hand" in levers:
        hand = 100 * onto @ levers["hand"].position_m
        length = float(np.linalg.norm(levers["hand"].position_m - levers["wrist"].position_m))
        _label(figure, 0.5 * (wrist + hand), f"{100 * length:.1f} cm", row, -16)
    if row == 1:
        along = frame.direction
        foot = levers["elbow"].position_m - along * (levers["elbow"].position_m @ along)
        end = 100 * onto @ foot
        line = curve([0, end[0]], [0, end[1]], None, "#333333", 1.5, "dot", showlegend=False)
        figure.add_trace(line.update(hoverinfo="skip"), row=row, col=1)
        distance = f"{_cm(frame.distance_m, frame.distance_sigma_m)} from the forearm's axis"
        _label(figure, 0.55 * end, distance, row, 0, "right")
        if estimates.calibration.upper_arm is not None:
            length, sigma = estimates.calibration.upper_arm.value_m, estimates.calibration.upper_arm.sigma_m
            _label(figure, elbow, f"upper arm {_cm(length, sigma)}", row, 34)


def _label(
    figure: go.Figure, at: FloatArray, text: str, row: int, shift: int, anchor: str = "center"
) -> None:
    figure.add_annotation(
        x=at[0],
        y=at[1],
        text=text,
        showarrow=False,
        xanchor=anchor,
        xshift=-8 if anchor == "right" else 0,
        yshift=shift,
        row=row,
        col=1,
    )


def _cm(value_m: float, sigma_m: float) -> str:
    return f"{100 * value_m:.1f} ± {100 * SIGMAS_OF_ONE * sigma_m:.1f} cm"


def forearm_page(calibration: ForearmCalibration, recording: Recording) -> Page:
    """The page of a forearm calibration."""
    rows = compare(calibration)
    return Page(
        f"Forearm from a held pose: {recording.name}",
        f"Arm: {recording.side or 'not named'}. Times are the camera's, seconds after the recording's zero.",
        verdict(calibration, rows),
        _sections(recording, calibration, rows),
    )


def _sections(recording: Recording, calibration: ForearmCalibration, rows: list[Compared]) -> Iterator[str]:
    yield listing("For the next recording", next_time(calibration, rows))
    yield figure(
        "The held pose",
        "The arm as the camera saw it on average in the pose: from the front (as the camera sees it) and"
        " from the side. The arrows are the forearm's axes: y to the wrist, x to the back of the hand.",
        pose_views(recording, calibration),
    )
    yield figure(
        "Joints in the pose",
        "Distance of the joints from their mean over the pose: a held pose shows only noise.",
        pose_residuals(recording, calibration),
    )
    if rows:
        yield figure(
            "Pose against motion",
            f"Difference between pose and motion in combined standard deviations; beyond {AGREE:g}"
            " (dashed) an assumption is violated.",
            agreement(rows),
        )
        table = [
            (
                row.name,
                f"{row.pose:.1f} ± {SIGMAS_OF_ONE * row.pose_sigma:.1f} {row.unit}",
                f"{row.motion:.1f} ± {SIGMAS_OF_ONE * row.motion_sigma:.1f} {row.unit}"
                if row.motion_sigma
                else "counted from it",
                f"{row.apart:.1f}",
                "agree" if row.agrees else "do not agree",
            )
            for row in rows
        ]
        columns = ("measure", "pose", "motion", "sigmas apart", "")
        yield tabulated("Measures", "95 of 100 errors are below each ±.", columns, table)
    plot = mount(_as_found(calibration))
    if plot is not None:
        yield figure(
            "Sensor mounting on the arm",
            "From the pose. The dark square is the sensor; ellipses and ± contain 95 of 100 cases.",
            plot,
        )
    yield listing("What stayed open", open_questions(calibration), "Nothing stayed open.")


def _as_found(calibration: ForearmCalibration) -> ArmEstimates:
    nothing = Evidence(float("nan"), {}, float("nan"), float("nan"))
    return ArmEstimates(calibration.calibration, forearm_frame(calibration.calibration), (), nothing, ())


def pose_views(recording: Recording, calibration: ForearmCalibration) -> go.Figure:
    """The mean pose seen along the camera's z axis and along its x axis, cm."""
    names = axis_names(recording.camera_frame)
    plot = make_subplots(rows=1, cols=2, subplot_titles=("from the camera", "from the side"))
    chain = [k for k in range(4) if np.isfinite(calibration.pose.position[k]).all()]
    places = 100 * calibration.pose.position
    middle = 0.5 * (places[1] + places[2])
    for column, (across, upright) in enumerate(((0, 1), (2, 1)), start=1):
        bones = curve(places[chain, across], places[chain, upright], None, "#9a8f86", 7, showlegend=False)
        plot.add_trace(bones, row=1, col=column)
        for k, joint in enumerate(JOINTS):
            if np.isfinite(places[k]).all():
                dot = dots(places[k, [across]], places[k, [upright]], joint, JOINT_COLOURS[joint], 10)
                plot.add_trace(dot.update(showlegend=column == 1), row=1, col=column)
        for axis, name in enumerate("xyz"):
            tip = middle + 12 * calibration.R_K_F[:, axis]
            ends = np.array([middle, tip])
            arrow = curve(ends[:, across], ends[:, upright], None, "#333333", 2, showlegend=False)
            plot.add_trace(arrow.update(mode="lines+text", text=["", name]), row=1, col=column)
        plot.update_xaxes(title_text=f"{names[across]}, cm", row=1, col=column)
        plot.update_yaxes(
            title_text=f"{names[upright]}, cm",
            scaleanchor="x" if column == 1 else "x2",
            row=1,
            col=column,
        )
    return dress(plot, 420)


def pose_residuals(recording: Recording, calibration: ForearmCalibration) -> go.Figure:
    """How far each joint is from its mean, frame by frame, mm."""
    plot, rows = go.Figure(), calibration.pose.frames
    t = recording.arm.t_s[rows]
    for k, joint in enumerate(JOINTS):
        away = 1e3 * np.linalg.norm(recording.arm.joint(joint)[rows] - calibration.pose.position[k], axis=1)
        if np.isfinite(away).any():
            plot.add_trace(curve(t, away, joint, JOINT_COLOURS[joint]))
    plot.update_xaxes(title_text="time, s")
    plot.update_yaxes(title_text="mm", rangemode="tozero")
    return dress(plot, 300)


def agreement(rows: list[Compared]) -> go.Figure:
    """Differences in sigmas as bars."""
    colours = [VISIBLE if row.agrees else OCCLUDED for row in rows]
    plot = go.Figure(
        go.Bar(
            x=[row.apart for row in rows], y=[row.name for row in rows], orientation="h", marker_color=colours
        )
    )
    plot.add_vline(AGREE, line_dash="dash", line_color="#111111")
    plot.update_xaxes(title_text="sigmas apart", rangemode="tozero")
    plot.update_yaxes(autorange="reversed")
    return dress(plot, 120 + 34 * len(rows))
