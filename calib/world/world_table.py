"""What camera to base IMU is worth, its tables in the file, and gravity in a recording by them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from smoother.array_types import FloatArray
from smoother.errors import CalibrationError
from smoother.recording import CameraFrame, ImuStream, Recording

from ..file import CalibrationFile
from ..imu.sensor import sensor_of
from ..protocol import Answer, Verdict
from .world_calibration import WorldCalibration, rotation_degrees, tilt_covariance

#: Sigma of the camera's tilt that is good for `smooth`, or still of use, degrees.
GOOD_DEG, USABLE_DEG = 0.3, 1.0
#: A heading that is known less than this is as good as free, degrees.
FREE_DEG = 15.0


@dataclass(frozen=True)
class WorldAccuracy:
    """Standard deviations, degrees."""

    rotation_deg: FloatArray  # (3,) degrees: of camera from base IMU about the camera's axes
    # Of down in the camera, per axis, for a camera placed as in the poses (the worst of them)
    tilt_deg: float
    heading_deg: float  # Of the turn between camera and base IMU about the vertical
    mounting_deg: FloatArray  # (3,) degrees: of the panel's IMU on the panel, about the IMU's axes
    off_deg: float  # How far that mounting is from lined up

    @property
    def heading_free(self) -> bool:
        """Nothing of use is known about the heading."""
        return self.heading_deg > FREE_DEG


def accuracy(calibration: WorldCalibration) -> WorldAccuracy:
    """Sigmas of rotation, tilt, heading and mounting."""
    covariance = calibration.solution.covariance
    bias = calibration.solution.at.rest[:3]
    forces = [pose.base.acc - bias for pose in calibration.poses]
    tilts = [np.trace(tilt_covariance(calibration.R_K_B, covariance[:6, :6], acc)) / 2 for acc in forces]
    up = calibration.R_K_B @ np.mean([acc / np.linalg.norm(acc) for acc in forces], axis=0)
    up /= np.linalg.norm(up)
    return WorldAccuracy(
        rotation_deg=np.degrees(np.sqrt(np.diag(covariance)[:3])),
        tilt_deg=float(np.degrees(np.sqrt(max(tilts)))),
        heading_deg=float(np.degrees(np.sqrt(up @ covariance[:3, :3] @ up))),
        mounting_deg=np.degrees(np.sqrt(np.diag(covariance)[6:])),
        off_deg=rotation_degrees(calibration.R_P_I),
    )


def verdict(calibration: WorldCalibration) -> Verdict:
    """Good or not, for what, and what to record next."""
    sigma = accuracy(calibration)
    grade = "not good enough"
    if sigma.tilt_deg <= USABLE_DEG:
        grade = "good" if sigma.tilt_deg <= GOOD_DEG else "usable"
    tilt = f"the camera's tilt is known to {sigma.tilt_deg:.2f} degrees (one sigma)"
    use = {
        "good": "good for `smooth`, which takes gravity from the base IMU",
        "usable": "of use for `smooth`, which weighs gravity from the base IMU by this sigma",
        "not good enough": "not better than assuming a level camera",
    }[grade]
    return Verdict(
        grade, f"{grade}: {tilt}: {use}.", _findings(calibration, sigma), _next(calibration, sigma)
    )


def _findings(calibration: WorldCalibration, sigma: WorldAccuracy) -> tuple[str, ...]:
    sentences = []
    if sigma.heading_free:
        sentences.append(
            "The heading between camera and base IMU is undetermined: neither a magnetometer nor a"
            " rotation of the camera shows it. Gravity is valid while the camera is placed about as in"
            " these poses."
        )
    else:
        sentences.append(
            f"The heading between camera and base IMU is known to {sigma.heading_deg:.1f} degrees."
        )
    if calibration.by_eye:
        sentences.append(
            "The poses do not show how the IMU sits on the panel: it was taken as lined up with the panel's "
            "axes to 3 degrees, as in the published method."
        )
    else:
        sentences.append(
            f"The IMU on the panel is {sigma.off_deg:.1f} degrees off the panel's axes "
            f"(+- {float(np.linalg.norm(sigma.mounting_deg)):.1f})."
        )
    return (*sentences, *calibration.notes)


def _next(calibration: WorldCalibration, sigma: WorldAccuracy) -> tuple[str, ...]:
    advice = []
    if calibration.by_eye:
        advice.append(
            "Hold the panel in at least four different poses: rolled by 90 degrees in the image, and tilted."
        )
    if sigma.heading_free:
        advice.append(
            "To have the heading, turn and tilt the camera with its base IMU by 30 degrees or more between "
            "some poses, the panel in view."
        )
    if not calibration.by_eye and sigma.mounting_deg.max() > GOOD_DEG:
        advice.append(
            "Tilt the panel by 30 to 40 degrees, in another direction in each pose; rolls alone leave"
            " one rotation undetermined."
        )
    elif not sigma.heading_free and sigma.tilt_deg > GOOD_DEG:
        advice.append("Take more poses, the camera tilted anew for each, and hold each for two seconds.")
    return tuple(advice)


NAME = "camera_from_base"


@dataclass(frozen=True)
class CameraFromBase:
    """The base IMU on the camera, as a calibration file has it."""

    R_K_B: FloatArray  # (3, 3): base IMU axes to camera axes; camera optical, x right, y down, z forward
    accelerometer_bias: FloatArray  # (3,) m/s^2: in {B}
    covariance: FloatArray  # (6, 6): of a small rotation in {K} (rad), and of the bias (m/s^2)
    # The base IMU's own calibration (`[imu.base]`) was taken off before
    accelerometer_corrected: bool = False


def world_answer(calibration: WorldCalibration) -> Answer:
    """Camera from base IMU in the form that every calibration answers in."""
    sigma, words, tables = accuracy(calibration), verdict(calibration), calibration_tables(calibration)
    heading = ("the heading between camera and base IMU",) if sigma.heading_free else ()
    mounting = ("how the IMU sits on the panel",) if calibration.by_eye else ()
    return Answer(
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
    """The base IMU on the camera."""
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
        what = f"lacks {error}" if isinstance(error, KeyError) else f"contains a wrong value ({error})"
        raise CalibrationError(
            f"{file.source}: [{NAME}] {what}; run `unocclude calibrate world` again."
        ) from None
    finite = np.isfinite(q).all() and np.isfinite(bias).all() and np.isfinite(covariance).all()
    sound = finite and abs(np.linalg.norm(q) - 1) < 1e-3 and np.linalg.eigvalsh(covariance)[0] > -1e-9
    if not sound:
        raise CalibrationError(
            f"{file.source}: [{NAME}] has no unit quaternion [qw, qx, qy, qz] with its covariance; "
            "run `unocclude calibrate world` again."
        )
    R_K_B = Rotation.from_quat(np.roll(q, -1)).as_matrix()
    return CameraFromBase(R_K_B, bias, covariance, bool(table.get("accelerometer_corrected", False)))


def _quaternion(R: Rotation) -> list[float]:
    return [float(value) for value in np.roll(R.as_quat(canonical=True), 1)]


#: What a bias drifts with temperature, m/s^2; axes of the skeleton against those of the images, rad.
_DRIFT_M_S2, _SKELETON_RAD = 0.02, np.radians(0.05)
#: A camera that tilts by more than this in a recording did not stand still, rad.
_MOVED_RAD = np.radians(0.7)
#: So much of a recording is looked at together, s.
_PART_S = 600
#: Optical axes (x right, y down, z forward) to those of the skeleton.
_FROM_OPTICAL = {CameraFrame.OPTICAL: np.eye(3), CameraFrame.KINECT: np.diag([-1.0, -1.0, 1.0])}


def with_gravity(recording: Recording, file: CalibrationFile) -> Recording:
    """The recording with down in the camera from its base IMU, where both know it."""
    known = read_table(file)
    if known is None or recording.base_imu is None or len(recording.base_imu) == 0:
        return recording
    if recording.camera_frame not in _FROM_OPTICAL:
        return _noted(recording, "The base IMU was not used: the camera's axes of the recording are unknown.")
    sensor = sensor_of(file, recording.base_imu.name)
    if (sensor is not None and sensor.accelerometer is not None) != known.accelerometer_corrected:
        return _noted(
            recording,
            "The base IMU was not used: its accelerometer's calibration is newer or older than "
            "[camera_from_base]; run `unocclude calibrate world` again.",
        )
    down, sigma, moved = down_of(known, recording.base_imu)
    note = f"Gravity in the camera is from the base IMU, good to {np.degrees(sigma):.1f} degrees."
    if moved > _MOVED_RAD:
        note += f" The camera was tilted by up to {np.degrees(moved):.1f} degrees while it recorded."
    to_skeleton = _FROM_OPTICAL[recording.camera_frame]
    held = replace(recording, gravity_hint=to_skeleton @ down, gravity_sigma_rad=sigma)
    return _noted(held, note)


def down_of(known: CameraFromBase, base: ImuStream) -> tuple[FloatArray, float, float]:
    """Down in {K} (3,) by the base IMU, its sigma (rad per axis), and how far the camera tilted (rad)."""
    means = _means(base)
    acc = np.median(means, axis=0) - known.accelerometer_bias
    each = (means - known.accelerometer_bias) / np.linalg.norm(means, axis=1)[:, None]
    up = acc / np.linalg.norm(acc)
    away = np.linalg.norm(np.cross(each, up), axis=1)
    moved = float(np.percentile(away, 95)) if len(away) > 1 else 0.0
    drifted = known.covariance.copy()
    drifted[3:, 3:] += _DRIFT_M_S2**2 * np.eye(3)
    variance = np.trace(tilt_covariance(known.R_K_B, drifted, acc)) / 2
    sigma = float(np.sqrt(variance + _SKELETON_RAD**2 + (moved if moved > _MOVED_RAD else 0.0) ** 2))
    return -known.R_K_B @ up, sigma, moved


def _means(base: ImuStream) -> FloatArray:
    """Specific force (seconds, 3) averaged over each second that has samples, a part at a time."""
    second = np.floor(base.t_s - base.t_s[0]).astype(int)
    means = []
    for start in range(0, int(second[-1]) + 1, _PART_S):
        rows = slice(*np.searchsorted(second, [start, start + _PART_S]).tolist())
        _, inverse = np.unique(second[rows], return_inverse=True)
        count = np.bincount(inverse)
        means += [np.stack([np.bincount(inverse, base.acc[rows, i]) / count for i in range(3)], axis=1)]
    return np.concatenate(means)


def _noted(recording: Recording, note: str) -> Recording:
    return replace(recording, notes=(*recording.notes, note))
