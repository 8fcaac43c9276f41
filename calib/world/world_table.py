"""The tables `[camera_from_base]`, `[panel_from_imu]` and `[world]` of a calibration file."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from smoother.array_types import FloatArray
from smoother.errors import CalibrationError

from ..file import CalibrationFile
from ..protocol import Answer
from .world_accuracy import accuracy, verdict
from .world_calibration import WorldCalibration

NAME = "camera_from_base"


@dataclass(frozen=True)
class CameraFromBase:
    """The base IMU on the camera, as a calibration file has it.

    Attributes
    ----------
    R_K_B : ndarray, shape (3, 3)
        Base IMU axes to camera axes; camera optical, x right, y down, z forward.
    accelerometer_bias : ndarray, shape (3,), m/s^2
        In {B}.
    covariance : ndarray, shape (6, 6)
        Of a small rotation in {K} (rad), and of the bias (m/s^2).
    accelerometer_corrected : bool
        The base IMU's own calibration (`[imu.base]`) was taken off before.
    """

    R_K_B: FloatArray
    accelerometer_bias: FloatArray
    covariance: FloatArray
    accelerometer_corrected: bool = False


def world_answer(calibration: WorldCalibration) -> Answer:
    """Camera from base IMU in the form that every calibration answers in.

    Parameters
    ----------
    calibration : WorldCalibration
        See `calibrate_world`.

    Returns
    -------
    answer : Answer
        Its tables are `camera_from_base`, `panel_from_imu` and `world`.
    """
    sigma, words, tables = accuracy(calibration), verdict(calibration), calibration_tables(calibration)
    heading = ("the heading between camera and base IMU",) if sigma.heading_free else ()
    mounting = ("how the IMU sits on the panel",) if calibration.by_eye else ()
    return Answer(
        estimate={
            "R_K_B": calibration.R_K_B,
            "R_P_I": calibration.R_P_I,
            "accelerometer_bias": calibration.solution.at.rest[:3],
        },
        sigma={
            "R_K_B": np.radians(sigma.rotation_deg),
            "R_P_I": np.radians(sigma.mounting_deg),
            "accelerometer_bias": np.sqrt(np.diag(calibration.solution.covariance)[3:6]),
        },
        verdict=words,
        open_questions=(*heading, *mounting),
        table=CalibrationFile(tables=tables),
        figures={**tables, "words": words.words},
    )


def calibration_tables(calibration: WorldCalibration) -> dict[str, dict[str, Any]]:
    """Plain values of the answer, by table; quaternions are qw, qx, qy, qz, sigmas one standard deviation."""
    sigma, sentences, at = accuracy(calibration), verdict(calibration), calibration.solution.at
    return {
        NAME: {
            "rotation": _quaternion(at.R_K_B),
            "rotation_sigma_deg": sigma.rotation_deg.tolist(),
            "accelerometer_bias": at.rest[:3].tolist(),
            "covariance": calibration.solution.covariance[:6, :6].tolist(),
            "accelerometer_corrected": calibration.accelerometer_corrected,
        },
        "panel_from_imu": {
            "rotation": _quaternion(at.R_P_I),
            "rotation_sigma_deg": sigma.mounting_deg.tolist(),
            "lined_up_by_eye": calibration.by_eye,
        },
        "world": {
            "tilt_sigma_deg": sigma.tilt_deg,
            "heading": "free" if sigma.heading_free else "known",
            "heading_sigma_deg": sigma.heading_deg,
            "poses": len(calibration.poses),
            "grade": sentences.grade,
            "verdict": sentences.sentence,
            "residuals": pose_rows(calibration),
        },
    }


def pose_rows(calibration: WorldCalibration) -> list[dict[str, Any]]:
    """Down in the camera and what is left of each pose."""
    solution = calibration.solution
    up_W = np.array([0.0, 0.0, 1.0])
    down = -(solution.at.R_K_B * solution.at.R_W_B.inv()).apply(up_W)
    return [
        {
            "pose": pose.name,
            "down": [round(float(x), 6) for x in down[i]],
            "rotation_deg": round(float(np.degrees(np.linalg.norm(solution.camera_rad[i]))), 4),
            "worst_sigma": round(float(solution.worst_sigma[i]), 2),
            "rest_s": round(min(pose.panel.length_s, pose.base.length_s), 2),
        }
        for i, pose in enumerate(calibration.poses)
    ]


def read_table(file: CalibrationFile) -> CameraFromBase | None:
    """The base IMU on the camera.

    Parameters
    ----------
    file : CalibrationFile
        As read from disk.

    Returns
    -------
    table : CameraFromBase or None
        None where the file does not say.

    Raises
    ------
    CalibrationError
        The table is there, and a value of it is wrong.
    """
    table = file.tables.get(NAME)
    if table is None:
        return None
    try:
        q = np.array(table["rotation"], float).reshape(4)
        bias = np.array(table.get("accelerometer_bias", [0.0, 0.0, 0.0]), float).reshape(3)
        if "covariance" in table:
            covariance = np.array(table["covariance"], float).reshape(6, 6)
        else:
            sigma = np.radians(np.array(table["rotation_sigma_deg"], float).reshape(3))
            covariance = np.diag(np.r_[sigma**2, np.zeros(3)])
    except (KeyError, TypeError, ValueError) as error:
        what = f"lacks {error}" if isinstance(error, KeyError) else f"holds a wrong value ({error})"
        raise CalibrationError(
            f"{file.source}: [{NAME}] {what}; run `unocclude calibrate world` again."
        ) from None
    finite = np.isfinite(q).all() and np.isfinite(bias).all() and np.isfinite(covariance).all()
    sound = finite and abs(np.linalg.norm(q) - 1) < 1e-3 and np.linalg.eigvalsh(covariance)[0] > -1e-9
    if not sound:
        raise CalibrationError(
            f"{file.source}: [{NAME}] holds no unit quaternion [qw, qx, qy, qz] with its covariance; "
            "run `unocclude calibrate world` again."
        )
    R_K_B = Rotation.from_quat(np.roll(q, -1)).as_matrix()
    return CameraFromBase(R_K_B, bias, covariance, bool(table.get("accelerometer_corrected", False)))


def _quaternion(R: Rotation) -> list[float]:
    return [float(value) for value in np.roll(R.as_quat(canonical=True), 1)]
