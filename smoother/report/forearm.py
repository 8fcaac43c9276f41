"""The page of `calibrate forearm`: the pose drawn, pose against motion, what to record next."""

from __future__ import annotations

import os
from collections.abc import Iterator

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from calib.forearm.forearm_frame import forearm_frame
from calib.forearm.forearm_summary import AGREE, Compared, compare, next_time, open_questions, verdict
from calib.forearm.held_pose import ForearmCalibration
from calib.motion.motion_calibration import ArmEstimates
from calib.motion.motion_summary import Evidence

from ..recording import JOINTS, Recording
from .mount import mount
from .sheet import figure, listing, tabulated, write_sheet
from .style import JOINT_COLOURS, OCCLUDED, VISIBLE, axis_names, curve, dots, dress


def write_forearm_report(
    path: str | os.PathLike[str],
    recording: Recording,
    calibration: ForearmCalibration,
    *,
    force: bool = False,
) -> None:
    """Write the page of a forearm calibration."""
    rows = compare(calibration)
    subtitle = (
        f"Arm: {recording.side or 'not named'}. Times are the camera's, seconds after the recording's zero."
    )
    title = f"Forearm from a held pose: {recording.name}"
    write_sheet(
        path,
        title,
        subtitle,
        verdict(calibration, rows),
        _sections(recording, calibration, rows),
        force=force,
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
        "Distance of the joints from their mean over the pose: a pose that is held shows noise and"
        " nothing else.",
        pose_residuals(recording, calibration),
    )
    if rows:
        yield figure(
            "Pose against motion",
            f"Difference of pose and motion in standard deviations of both; beyond {AGREE:g} (dashed) an"
            " assumption broke.",
            agreement(rows),
        )
        table = [
            (
                row.name,
                f"{row.pose:.1f} ± {row.pose_sigma:.1f} {row.unit}",
                f"{row.motion:.1f} ± {row.motion_sigma:.1f} {row.unit}"
                if row.motion_sigma
                else "counted from it",
                f"{row.apart:.1f}",
                "agree" if row.agrees else "do not agree",
            )
            for row in rows
        ]
        columns = ("measure", "pose", "motion", "sigmas apart", "")
        yield tabulated("Measures", "Each with its standard deviation.", columns, table)
    plot = mount(_as_found(calibration))
    if plot is not None:
        yield figure(
            "How the sensor sits on the arm",
            "By the pose. The dark square is the sensor with its axes; ellipses are two standard deviations.",
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
