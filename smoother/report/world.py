"""The page of `calibrate world`: verdict, the base IMU on the camera, what is left of each pose."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence

import numpy as np
import plotly.graph_objects as go

from calib.world.world_calibration import WorldCalibration
from calib.world.world_table import accuracy, pose_rows, verdict

from ..array_types import FloatArray
from .sheet import figure, label, listing, tabulated, write_sheet
from .space import cloud, polyline, space, view_of
from .style import AXIS_COLOURS, OCCLUDED, TRUTH, VISIBLE, dress


def write_world_report(
    path: str | os.PathLike[str],
    calibration: WorldCalibration,
    *,
    notes: Sequence[str] = (),
    force: bool = False,
) -> None:
    """Write the page of how the base IMU sits on the camera.

    Parameters
    ----------
    path : path-like
        The page to write.
    calibration : WorldCalibration
        See `calib.world.world_calibration.calibrate_world`.
    notes : sequence of str
        Of the input.
    force : bool
        Overwrite a page that exists.

    Raises
    ------
    UnoccludeError
        The page exists and `force` is not given, or it cannot be written.
    """
    poses = len(calibration.poses)
    write_sheet(
        path,
        "Camera from base IMU, by the panel",
        f"{poses} pose{'s' if poses > 1 else ''} of the panel. Axes of the camera: x right, y down, z away.",
        [verdict(calibration).sentence],
        _sections(calibration, notes),
        force=force,
    )


def _sections(calibration: WorldCalibration, notes: Sequence[str]) -> Iterator[str]:
    judgement = verdict(calibration)
    yield listing(
        "What to record next", judgement.next, "Nothing is missing: record the next session likewise."
    )
    yield _answer(calibration)
    yield listing("What else was found", judgement.findings)
    yield on_the_camera(
        "The base IMU on the camera",
        "Solid: the camera's axes. Dashed: those of the IMU on it, turned as the answer says. The large dots"
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
        for row in pose_rows(calibration)
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


def _answer(calibration: WorldCalibration) -> str:
    sigma, at = accuracy(calibration), calibration.solution.at
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
    rows = pose_rows(calibration)
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
        pose_rows(calibration),
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
