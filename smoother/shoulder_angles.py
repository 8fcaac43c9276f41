"""Angles of the shoulder from an IMU on the upper arm, with their sigmas.

Source: Wu et al., J Biomech 38:981-992 (2005), section 2.4.7, by `joint_angles.arm_angles`. The humerus turns
with that IMU, so its axial rotation is there for a straight elbow as well: the axis of elbow flexion is
the mean over the recording, seen from the IMU (`ArmCalibration.R_U_B`). Without an IMU on the trunk it counts
as upright and facing the camera; with one the angles are there relative to it as well.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from .array_types import FloatArray, IntArray
from .joint_angles import arm_angles, wrapped_deg
from .linalg import rotate_covariance
from .result import Recovery
from .rotation import Rotation

SHOULDER_ANGLES = ("shoulder_plane", "shoulder_elevation", "shoulder_rotation")
TRUNK_ANGLES = ("shoulder_plane_trunk", "shoulder_elevation_trunk", "shoulder_rotation_trunk")
#: Step of the numerical derivatives, rad.
STEP_RAD = 1e-4
#: The thorax's own axes: down, and where it faces (ISB).
DOWN_T, FORWARD_T = np.array([0.0, -1.0, 0.0]), np.array([1.0, 0.0, 0.0])

Angles = dict[str, FloatArray]


def shoulder_angles(
    recovery: Recovery,
) -> tuple[Angles, Angles]:  # angles dict of (N,) deg, sigmas dict of (N,) deg
    """The shoulder's angles of a recovery with an upper-arm IMU, to an upright trunk that faces the
    camera.
    """
    humerus = _humerus(recovery)
    if humerus is None or not np.isfinite(recovery.gravity_direction).all():
        return _unknown(SHOULDER_ANGLES, len(recovery))
    rows, R_K_U, covariance = humerus

    def angles_of(axes: FloatArray) -> FloatArray:
        return _angles(axes, recovery.side, recovery.gravity_direction, None)

    return _with_sigma(SHOULDER_ANGLES, len(recovery), rows, R_K_U, covariance, angles_of)


def trunk_angles(
    recovery: Recovery,
) -> tuple[Angles, Angles]:  # angles dict of (N,) deg, sigmas dict of (N,) deg
    """The shoulder's angles relative to the thorax by an IMU on the trunk."""
    humerus, trunk = _humerus(recovery), recovery.trunk
    if humerus is None or trunk is None:
        return _unknown(TRUNK_ANGLES, len(recovery))
    rows, R_K_U, covariance = humerus
    both = np.isfinite(trunk.quaternion[rows]).all(axis=1)
    rows, R_K_U, covariance = rows[both], R_K_U[both], covariance[both]
    if not len(rows):
        return _unknown(TRUNK_ANGLES, len(recovery))
    R_K_T = Rotation.from_quat(trunk.quaternion[rows], scalar_first=True).as_matrix()
    mount = np.diag(trunk.mount_sigma_rad**2)
    covariance = covariance + trunk.covariance[rows] + rotate_covariance(R_K_T, mount)

    def angles_of(axes: FloatArray) -> FloatArray:
        return _angles(np.swapaxes(R_K_T, 1, 2) @ axes, recovery.side, DOWN_T, FORWARD_T)

    return _with_sigma(TRUNK_ANGLES, len(recovery), rows, R_K_U, covariance, angles_of)


def _humerus(recovery: Recovery) -> tuple[IntArray, FloatArray, FloatArray] | None:
    """Samples (k,) with an answer, the bone's axes `R_K_U` there, and the covariance of their turning."""
    upper, calibration = recovery.upper, recovery.calibration
    if upper is None or calibration is None or calibration.R_U_B is None:
        return None
    known = np.flatnonzero(np.isfinite(upper.quaternion).all(axis=1))
    if not len(known):
        return None
    R_K_U = Rotation.from_quat(upper.quaternion[known], scalar_first=True).as_matrix() @ calibration.R_U_B.T
    mount = np.diag(upper.mount_sigma_rad**2)
    return known, R_K_U, upper.pose_covariance[known][:, 3:, 3:] + rotate_covariance(R_K_U, mount)


def _unknown(names: tuple[str, ...], count: int) -> tuple[Angles, Angles]:
    return {name: np.full(count, np.nan) for name in names}, {name: np.full(count, np.nan) for name in names}


def _with_sigma(
    names: tuple[str, ...],
    count: int,
    rows: IntArray,
    R_K_U: FloatArray,
    covariance: FloatArray,
    angles_of: Callable[[FloatArray], FloatArray],
) -> tuple[Angles, Angles]:
    """Angles at some rows, and their sigmas by derivatives; large ones are no more than half a turn."""
    angles, sigmas = _unknown(names, count)
    at = angles_of(R_K_U)
    slope = np.empty((len(names), len(rows), 3))
    for axis in range(3):
        turned = Rotation.from_rotvec(STEP_RAD * np.eye(3)[axis]).as_matrix() @ R_K_U
        slope[:, :, axis] = wrapped_deg(angles_of(turned) - at) / STEP_RAD
    variance = np.einsum("kni,nij,knj->kn", slope, covariance, slope)
    for k, name in enumerate(names):
        angles[name][rows], sigmas[name][rows] = at[k], np.minimum(np.sqrt(variance[k]), 180.0)
    return angles, sigmas


def _angles(axes: FloatArray, side: str, down: FloatArray, forward: FloatArray | None) -> FloatArray:
    """The three angles (3, n), degrees, of humeri with these axes (n, 3, 3)."""
    up, lateral = axes[:, :, 1], axes[:, :, 2]
    joints = {"shoulder": up, "elbow": np.zeros_like(up), "wrist": -up}
    angles = arm_angles(joints, len(up), None, side, down, forward=forward, flexion_axis=lateral)
    return np.stack([angles[name] for name in SHOULDER_ANGLES])
