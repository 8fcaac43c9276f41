"""Angles of the shoulder from an IMU on the upper arm, with their sigmas.

Source: Wu et al., J Biomech 38:981-992 (2005), section 2.4.7, by `joint_angles.arm_angles`. The humerus turns
with that IMU, so its axial rotation is there for a straight elbow as well: the axis of elbow flexion is
the mean over the recording, seen from the IMU (`ArmCalibration.R_U_B`). The trunk counts as upright and
facing the camera.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from .joint_angles import arm_angles, wrapped_deg
from .linalg import rotate_covariance
from .recording import FloatArray
from .result import Recovery

SHOULDER_ANGLES = ("shoulder_plane", "shoulder_elevation", "shoulder_rotation")
#: Step of the numerical derivatives, rad.
STEP_RAD = 1e-4


def shoulder_angles(recovery: Recovery) -> tuple[dict[str, FloatArray], dict[str, FloatArray]]:
    """The shoulder's angles of a recovery with an upper-arm IMU.

    Parameters
    ----------
    recovery : Recovery
        Of N samples.

    Returns
    -------
    angles, sigmas : dict of str to ndarray, shape (N,), deg
        By the names in `SHOULDER_ANGLES`; nan where that IMU, its mounting or gravity is not known. Near a
        hanging arm the plane and the rotation are hardly determined, and their sigmas say so.
    """
    count = len(recovery)
    upper, calibration = recovery.upper, recovery.calibration
    angles = {name: np.full(count, np.nan) for name in SHOULDER_ANGLES}
    sigmas = {name: np.full(count, np.nan) for name in SHOULDER_ANGLES}
    if upper is None or calibration is None or calibration.R_U_B is None:
        return angles, sigmas
    known = np.flatnonzero(np.isfinite(upper.quaternion).all(axis=1))
    if not len(known) or not np.isfinite(recovery.gravity_direction).all():
        return angles, sigmas
    R_K_U = Rotation.from_quat(upper.quaternion[known], scalar_first=True).as_matrix() @ calibration.R_U_B.T
    mount = np.diag(upper.mount_sigma_rad**2)
    covariance = upper.pose_covariance[known][:, 3:, 3:] + rotate_covariance(R_K_U, mount)
    at = _angles(R_K_U, recovery)
    slope = np.empty((len(SHOULDER_ANGLES), len(known), 3))
    for axis in range(3):
        turned = Rotation.from_rotvec(STEP_RAD * np.eye(3)[axis]).as_matrix() @ R_K_U
        slope[:, :, axis] = wrapped_deg(_angles(turned, recovery) - at) / STEP_RAD
    variance = np.einsum("kni,nij,knj->kn", slope, covariance, slope)
    for k, name in enumerate(SHOULDER_ANGLES):
        angles[name][known], sigmas[name][known] = at[k], np.minimum(np.sqrt(variance[k]), 180.0)
    return angles, sigmas


def _angles(R_K_U: FloatArray, recovery: Recovery) -> FloatArray:
    """The three angles (3, n) of humeri with the axes R_K_U (n, 3, 3), degrees."""
    up, lateral = R_K_U[:, :, 1], R_K_U[:, :, 2]
    joints = {"shoulder": up, "elbow": np.zeros_like(up), "wrist": -up}
    angles = arm_angles(
        joints, len(up), None, recovery.side, recovery.gravity_direction, flexion_axis=lateral
    )
    return np.stack([angles[name] for name in SHOULDER_ANGLES])
