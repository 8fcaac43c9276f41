"""The sensor on the forearm over time: what turns the arm's core under the strap into the sensor's place."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from smoother.array_types import FloatArray
from smoother.calibration import ArmCalibration, Length
from smoother.errors import CalibrationError
from smoother.result import Recovery

from ..file import CalibrationFile
from ..forearm.forearm_frame import forearm_frame

#: Core of the forearm to the sensor where nobody measured it, m.
USUAL_RADIUS = Length(0.035, 0.008)


@dataclass(frozen=True)
class Mounted:
    """The sensor on the forearm over time.

    Attributes
    ----------
    t_s : ndarray, shape (N,), s
        On the camera's clock, s after `origin_ns`.
    R_K_A : ndarray, shape (N, 3, 3)
        Maps a vector from the IMU's axes {A} to the camera's {K}.
    origin_ns : int, ns
        Zero of the times.
    from_core : ndarray, shape (3,), m
        From the forearm's core to the sensor in {A}.
    sigma_m : float, m
        Of that vector, an axis.
    along : ndarray, shape (3,), optional
        Unit vector elbow to wrist in {A}, or None.
    radius_m : float, m
        Core to the strap's surface.
    """

    t_s: FloatArray
    R_K_A: FloatArray
    origin_ns: int
    from_core: FloatArray
    sigma_m: float
    along: FloatArray | None
    radius_m: float


def held_radius(file: CalibrationFile, side: str) -> Length | None:
    """Core of the forearm to the sensor, r, of the held pose of an arm; None where the file has none."""
    table = file.tables.get("forearm", {})
    own = table.get(side or "any") if isinstance(table, dict) else None
    if not isinstance(own, dict) or not {"r_m", "r_sigma_m"} <= set(own):
        return None
    return Length(float(own["r_m"]), float(own["r_sigma_m"]))


def mounted_on(recovery: Recovery, radius: Length | None = None) -> Mounted:
    """The sensor's orientation over time and its place against the core, from a solved recording.

    The lever arms say in which direction the core lies; how far is known better from a measured radius than
    from joints that the camera places beside the core, so both are put together by their variances.

    Parameters
    ----------
    radius : Length, optional
        Core to the sensor (r of `calibrate forearm`), or None for the usual one.

    Returns
    -------
    Mounted

    Raises
    ------
    CalibrationError
        The lever arms of elbow and wrist are not known.
    """
    arm: ArmCalibration = recovery.calibration or ArmCalibration()
    frame = forearm_frame(arm)
    if frame is None:
        raise CalibrationError(
            f"{recovery.name}: how the sensor sits on the forearm is not known; elbow and wrist must be"
            " tracked"
        )
    elbow = arm.lever_arms["elbow"].position_m
    foot = elbow - (elbow @ frame.direction) * frame.direction
    away = -foot / max(float(np.linalg.norm(foot)), 1e-9)
    own = radius or USUAL_RADIUS
    weight = own.sigma_m**-2, max(frame.distance_sigma_m, 1e-3) ** -2
    distance = (weight[0] * own.value_m + weight[1] * frame.distance_m) / sum(weight)
    roll = min(frame.roll_sigma_rad, 1.0)
    return Mounted(
        t_s=recovery.t_s - recovery.clock_offset_s,
        R_K_A=_matrices(recovery.quaternion),
        origin_ns=recovery.origin_ns,
        from_core=distance * away,
        sigma_m=float(np.hypot(sum(weight) ** -0.5, distance * roll) / np.sqrt(2)),
        along=frame.direction,
        radius_m=float(np.clip(distance, 0.02, 0.06)) if radius is None else radius.value_m,
    )


def _matrices(quaternion: FloatArray) -> FloatArray:
    """(N, 3, 3) of quaternions qw, qx, qy, qz; nan where there is none."""
    good = np.isfinite(quaternion).all(axis=1)
    R = np.full((len(quaternion), 3, 3), np.nan)
    if good.any():
        R[good] = Rotation.from_quat(quaternion[good], scalar_first=True).as_matrix()
    return R
