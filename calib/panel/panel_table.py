"""The table `[camera_from_mocap]` of a calibration file."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from ..file import CalibrationFile
from ..protocol import Answer
from .frame import Frame
from .panel_accuracy import accuracy, verdict
from .panel_calibration import PanelCalibration

NAME = "camera_from_mocap"


def panel_answer(calibration: PanelCalibration) -> Answer:
    """Camera from mocap in the form that every calibration answers in.

    Parameters
    ----------
    calibration : PanelCalibration
        See `calibrate_panel`.

    Returns
    -------
    answer : Answer
        Its table is `camera_from_mocap`.
    """
    sigma, words, table = accuracy(calibration), verdict(calibration), calibration_table(calibration)
    solution = calibration.solution
    known = bool(np.isfinite(solution.depth_offset_sigma_m))
    return Answer(
        estimate={
            "R_K_E": solution.camera_from_mocap.R,
            "t_K_E": solution.camera_from_mocap.origin,
            "depth_offset": solution.depth_offset_m,
        },
        sigma={
            "R_K_E": np.radians(sigma.rotation_deg),
            "t_K_E": sigma.translation_m,
            "depth_offset": solution.depth_offset_sigma_m,
        },
        verdict=words,
        open_questions=() if known else ("a constant error of the camera's depth",),
        table=CalibrationFile().with_table(NAME, table),
        figures={NAME: table, "words": words.words},
    )


def calibration_table(calibration: PanelCalibration) -> dict[str, Any]:
    """Plain values of the answer: p_camera = R p_mocap + t, m; camera optical, x right, y down, z forward.

    Sigmas are one standard deviation; the covariance is of a small rotation about the camera's axes (rad) and
    the translation (m). The published method's answer stands beside in `published`.
    """
    found, said, solution = accuracy(calibration), verdict(calibration), calibration.solution
    table: dict[str, Any] = transform_values(solution.camera_from_mocap)
    table |= {
        "rotation_sigma_deg": found.rotation_deg.tolist(),
        "translation_sigma_m": found.translation_m.tolist(),
        "position_sigma_at_panel_m": found.at_panel_m.tolist(),
        "covariance": found.covariance.tolist(),
        "poses": len(calibration.seen),
        "misfit": _rounded(solution.misfit),
        "grade": said.grade,
        "verdict": said.sentence,
    }
    if np.isfinite(solution.depth_offset_sigma_m):
        table["depth_offset_m"] = float(solution.depth_offset_m)
        table["depth_offset_sigma_m"] = float(solution.depth_offset_sigma_m)
    table["residuals"] = pose_rows(calibration)
    if calibration.published is not None:
        table["published"] = transform_values(calibration.published)
    return table


def pose_rows(calibration: PanelCalibration) -> list[dict[str, Any]]:
    """Residuals and circumstances of every pose."""
    solution = calibration.solution
    rows = []
    for number, seen in enumerate(calibration.seen):
        pixels = calibration.lens.focal_px * solution.ray_residuals[number]
        rows.append(
            {
                "pose": calibration.names[number],
                "markers": list(calibration.labels[number]),
                "distance_m": round(seen.distance_m, 4),
                "tilt_deg": round(seen.tilt_deg, 2),
                "pixels_rms": _rms(pixels),
                "markers_rms_m": _rms(solution.marker_residuals_m[number]),
                "plane_rms_m": _rms(solution.plane_residuals_m[number]),
                "depth_noise_m": _rounded(seen.plane.noise_m),
                "depth_pixels": int(seen.plane.inliers.sum()),
            }
        )
    return rows


def pose_cells(row: dict[str, Any]) -> tuple[str, ...]:
    """Of a row of `pose_rows`, as text: distance m, tilt degrees, pixels; markers, plane, depth noise mm."""
    in_mm = (1e3 * row["markers_rms_m"], 1e3 * row["plane_rms_m"])
    return (
        *(f"{row['distance_m']:.2f}", f"{row['tilt_deg']:.0f}", f"{row['pixels_rms']:.3f}"),
        *(f"{value:.2f}" for value in in_mm),
        f"{1e3 * row['depth_noise_m']:.1f}",
    )


def transform_values(transform: Frame) -> dict[str, list[float]]:
    """Rotation (qw, qx, qy, qz) and translation (m)."""
    quaternion = Rotation.from_matrix(transform.R).as_quat(canonical=True, scalar_first=True)
    return {"rotation": quaternion.tolist(), "translation": transform.origin.tolist()}


def _rms(values: np.ndarray) -> float:
    return _rounded(float(np.sqrt(np.mean(np.square(values)))))


def _rounded(value: float) -> float:
    """Four digits: residuals are for reading."""
    return float(f"{value:.4g}")
