"""What the answer is worth, in figures and in words. Every function is pure."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from smoother.array_types import FloatArray

from ..verdict import Verdict
from .world_calibration import WorldCalibration, rotation_degrees, tilt_covariance

#: Sigma of the camera's tilt that is good for `smooth`, or still of use, degrees.
GOOD_DEG, USABLE_DEG = 0.3, 1.0
#: A heading that is known less than this is as good as free, degrees.
FREE_DEG = 15.0


@dataclass(frozen=True)
class WorldAccuracy:
    """Standard deviations, degrees.

    Attributes
    ----------
    rotation_deg : ndarray, shape (3,), degrees
        Of camera from base IMU about the camera's axes.
    tilt_deg : float, degrees
        Of down in the camera, an axis, for a camera that stands as in the poses (the worst of them).
    heading_deg : float, degrees
        Of the turn between camera and base IMU about the vertical.
    mounting_deg : ndarray, shape (3,), degrees
        Of the panel's IMU on the panel, about the IMU's axes.
    off_deg : float, degrees
        How far that mounting is from lined up.
    """

    rotation_deg: FloatArray
    tilt_deg: float
    heading_deg: float
    mounting_deg: FloatArray
    off_deg: float

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
        "not good enough": "not better than a camera that is taken to stand level",
    }[grade]
    return Verdict(
        grade, f"{grade}: {tilt}: {use}.", _findings(calibration, sigma), _next(calibration, sigma)
    )


def _findings(calibration: WorldCalibration, sigma: WorldAccuracy) -> tuple[str, ...]:
    sentences = []
    if sigma.heading_free:
        sentences.append(
            "The heading between camera and base IMU is free: neither a magnetometer nor a turn of the "
            "camera tells it. Gravity holds as long as the camera stands about as it stood in these poses."
        )
    else:
        sentences.append(
            f"The heading between camera and base IMU is known to {sigma.heading_deg:.1f} degrees."
        )
    if calibration.by_eye:
        sentences.append(
            "The poses do not tell how the IMU sits on the panel: it was taken as lined up with the panel's "
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
            "Tilt the panel by 30 to 40 degrees, in each pose another way; rolls alone leave a turn open."
        )
    elif not sigma.heading_free and sigma.tilt_deg > GOOD_DEG:
        advice.append("Take more poses, the camera tilted anew for each, and hold each for two seconds.")
    return tuple(advice)
