"""What camera to mocap is worth, in figures and words, and its table `[camera_from_mocap]`."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from smoother.array_types import FloatArray
from smoother.linalg import skew

from ..file import CalibrationFile
from ..protocol import Answer, Verdict
from .definition import Frame
from .panel_calibration import PanelCalibration

#: From the panel's places this far away the answer is judged, m: the volume in which an arm moves.
WITHIN_M = 1.0
#: Two sigmas of a position that are good for comparing arm motion to a centimetre, or still usable, m.
GOOD_M, USABLE_M = 0.003, 0.010
#: Two sigmas of the rotation likewise, degrees.
GOOD_DEG, USABLE_DEG = 0.3, 1.0
#: Misfits (squared residuals over what is expected) from which poses contradict each other.
CONTRADICTS = 4.0
#: The panel's definition is off by more than this, m.
DEFINITION_M = 0.002
#: Enough poses, and enough spread of their normals, degrees.
ENOUGH_POSES, ENOUGH_SPREAD_DEG = 4, 15.0


@dataclass(frozen=True)
class PanelAccuracy:
    """Standard deviations of the answer."""

    rotation_deg: FloatArray  # (3,) degrees: about the camera's axes
    translation_m: FloatArray  # (3,) m: of the mocap's origin in the camera frame
    at_panel_m: FloatArray  # (3,) m: of a point in the middle of the panel's places
    within_m: float  # Square root of the trace for the worst point `WITHIN_M` away from there
    # (6, 6): Of a small rotation about the camera's axes (rad) and of the translation (m)
    covariance: FloatArray


def accuracy(calibration: PanelCalibration) -> PanelAccuracy:
    """Sigmas of the answer at the mocap's origin, at the panel and about it."""
    solution = calibration.solution
    transform = solution.camera_from_mocap
    middle = np.mean([found.points_K.mean(axis=0) for found in calibration.seen], axis=0)
    at_origin = _moved(solution.covariance, transform.origin)
    at_panel = _moved(solution.covariance, middle)[3:, 3:]
    about = middle + WITHIN_M * np.array([*np.eye(3), *-np.eye(3)])
    within = max(float(np.trace(_moved(solution.covariance, point)[3:, 3:])) for point in about)
    return PanelAccuracy(
        rotation_deg=np.degrees(np.sqrt(np.diag(solution.covariance)[:3])),
        translation_m=np.sqrt(np.diag(at_origin)[3:]),
        at_panel_m=np.sqrt(np.diag(at_panel)),
        within_m=float(np.sqrt(within)),
        covariance=at_origin,
    )


def verdict(calibration: PanelCalibration) -> Verdict:
    """Whether the answer is good, for what, and what to record next."""
    found = accuracy(calibration)
    rotation = 2 * float(np.linalg.norm(found.rotation_deg))
    position = 2 * found.within_m
    misfit = calibration.solution.misfit
    good = rotation <= GOOD_DEG and position <= GOOD_M and misfit < CONTRADICTS
    usable = rotation <= USABLE_DEG and position <= USABLE_M and misfit < 3 * CONTRADICTS
    grade = "good" if good else "usable" if usable else "not good enough"
    use = {
        "good": "good for comparing arm motion with motion capture to a centimetre and a degree",
        "usable": "usable for comparing arm motion with motion capture to some centimetres",
        "not good enough": "not good enough for comparing with motion capture; record again as follows",
    }[grade]
    sentence = (
        f"Rotation within {rotation:.2f} degrees, positions within"
        f" {2e3 * float(np.linalg.norm(found.at_panel_m)):.1f} mm at the panel and {1e3 * position:.1f} mm"
        f" {WITHIN_M:.0f} m away from it (two sigmas): {use}."
    )
    return Verdict(grade, sentence, tuple(_findings(calibration)), tuple(_next(calibration, grade)))


def _findings(calibration: PanelCalibration) -> list[str]:
    solution, poses = calibration.solution, len(calibration.seen)
    sentences = []
    if np.isfinite(solution.depth_offset_sigma_m):
        offset, sigma = 1e3 * solution.depth_offset_m, 1e3 * solution.depth_offset_sigma_m
        length = "long" if offset > 0 else "short"
        sentences.append(
            f"The camera's depth is {abs(offset):.1f} +- {sigma:.1f} mm too {length}, by the markers'"
            " spacing; the result is corrected for it."
        )
    else:
        sentences.append(
            "A constant depth error of the camera is ignored: one pose separates it from the markers'"
            f" spacing only as {1e3 * solution.offset_apart_m:+.1f} +-"
            f" {1e3 * solution.offset_apart_sigma_m:.1f} mm, and it would pass into the distance; several"
            " poses would show it."
        )
    if solution.misfit > CONTRADICTS:
        pose, marker = np.unravel_index(
            np.argmax(solution.marker_residuals_m), solution.marker_residuals_m.shape
        )
        worst = 1e3 * solution.marker_residuals_m[pose, marker]
        sentences.append(
            f"The residuals are {np.sqrt(solution.misfit):.1f} times what the stated noise makes expected,"
            f" and sigma is widened for it; the worst is marker {calibration.labels[pose][marker]} of"
            f" {calibration.names[pose]}, {worst:.1f} mm off: try without that pose."
        )
    shape = max(_definition_misfit(calibration))
    if shape > DEFINITION_M:
        sentences.append(
            f"The mocap markers' distances differ from the panel's definition by {1e3 * shape:.1f} mm rms;"
            " the definition only shows which marker is which, so the result is not affected."
        )
    tilted = [
        name for name, each in zip(calibration.names, calibration.seen, strict=True) if each.tilt_deg > 45
    ]
    if tilted:
        sentences.append(
            f"{', '.join(tilted)}: turned more than 45 degrees from the camera, where depth is poor."
        )
    apart, mean = _published_apart(calibration), ", mean of the poses" if poses > 1 else ""
    sentences.append(
        "The published method (principal components of regions) has too few depth points along the arms."
        if apart is None
        else f"The published method (principal components of regions{mean})"
        f" differs from the result by {apart[0]:.2f} degrees and {1e3 * apart[1]:.1f} mm at the panel."
    )
    return sentences


def _next(calibration: PanelCalibration, grade: str) -> list[str]:
    seen = calibration.seen
    sentences = []
    if len(seen) < ENOUGH_POSES:
        sentences.append(
            f"Record {ENOUGH_POSES} to 8 poses instead of {len(seen)}: error falls with their number, and the"
            " depth's constant error is found."
        )
    normals = np.array([each.plane.normal for each in seen])
    spread = max(
        (float(np.degrees(np.arccos(np.clip(a @ b, -1, 1)))) for a, b in combinations(normals, 2)),
        default=0.0,
    )
    if len(seen) > 1 and spread < ENOUGH_SPREAD_DEG:
        sentences.append(
            f"Tilt the panel about 20 degrees to different sides: its normals differ by {spread:.0f} degrees."
        )
    far = [each.distance_m for each in seen]
    if max(far) > 2.5:
        sentences.append(
            f"Hold the panel nearer than 2.5 m (farthest {max(far):.1f} m): depth is better there."
        )
    if len(seen) > 1:
        middles = np.array([each.points_K.mean(axis=0) for each in seen])
        if float(np.ptp(middles, axis=0).max()) < 0.3:
            sentences.append("Spread the poses over the volume in which the arm will move.")
    if not sentences:
        sentences.append(
            "Nothing more is needed; record again when camera or mocap has been moved."
            if grade == "good"
            else "Record more poses with the panel still, facing the camera within 30 degrees, 1 to 2 m away."
        )
    return sentences


def _definition_misfit(calibration: PanelCalibration) -> list[float]:
    pairs = np.array(list(combinations(range(4), 2)))
    markers_P = calibration.panel.markers_P
    wanted = np.linalg.norm(markers_P[pairs[:, 0]] - markers_P[pairs[:, 1]], axis=1)
    found = [np.linalg.norm(at[pairs[:, 0]] - at[pairs[:, 1]], axis=1) for at in calibration.markers_E]
    return [float(np.sqrt(np.mean((each - wanted) ** 2))) for each in found]


def _published_apart(calibration: PanelCalibration) -> tuple[float, float] | None:
    """Degrees, and metres at the panel's places; None where there is no such answer."""
    ours, theirs = calibration.solution.camera_from_mocap, calibration.published
    if theirs is None:
        return None
    angle = np.arccos(np.clip((np.trace(ours.R @ theirs.R.T) - 1) / 2, -1, 1))
    middle = np.mean(np.concatenate(calibration.markers_E), axis=0)
    apart = (ours.R - theirs.R) @ middle + ours.origin - theirs.origin
    return float(np.degrees(angle)), float(np.linalg.norm(apart))


def _moved(covariance: FloatArray, point: FloatArray) -> FloatArray:
    """Covariance (6, 6) of the small rotation and of what it and the shift do to a point in {K}."""
    J = np.eye(6)
    J[3:, :3] = -skew(point)
    return np.asarray(J @ covariance @ J.T)


NAME = "camera_from_mocap"


def panel_answer(calibration: PanelCalibration) -> Answer:
    """Camera from mocap in the form that every calibration answers in."""
    words, table = verdict(calibration), calibration_table(calibration)
    solution = calibration.solution
    known = bool(np.isfinite(solution.depth_offset_sigma_m))
    return Answer(
        verdict=words,
        open_questions=() if known else ("a constant error of the camera's depth",),
        table=CalibrationFile().with_table(NAME, table),
        figures={NAME: table, "words": words.words},
    )


def calibration_table(calibration: PanelCalibration) -> dict[str, Any]:
    """Plain values of the answer: p_camera = R p_mocap + t, m; camera optical, x right, y down, z forward."""
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


def transform_values(transform: Frame) -> dict[str, list[float]]:
    """Rotation (qw, qx, qy, qz) and translation (m)."""
    quaternion = Rotation.from_matrix(transform.R).as_quat(canonical=True, scalar_first=True)
    return {"rotation": quaternion.tolist(), "translation": transform.origin.tolist()}


def _rms(values: np.ndarray) -> float:
    return _rounded(float(np.sqrt(np.mean(np.square(values)))))


def _rounded(value: float) -> float:
    """Four digits: residuals are for reading."""
    return float(f"{value:.4g}")
