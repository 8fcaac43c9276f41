"""Lengths of an arm and places on its forearm, as a recovery has them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from ...array_types import FloatArray
from ...errors import UnoccludeError
from ...linalg import unit
from ...result import Recovery

#: As many samples say as much as all.
_SAMPLES = 4000


@dataclass(frozen=True)
class ArmMeasures:
    """What a model of an arm is scaled by.

    Attributes
    ----------
    side : str
        "left" or "right"; "" counts as right.
    upper_m, forearm_m : float, m
        Shoulder to elbow, elbow to wrist.
    places : dict of str to ndarray, shape (3,), m
        Of `hand` and `imu` from the elbow, as a right arm has them: y along the bone towards the elbow, z
        towards the thumb, x = y cross z. What a recovery does not have is left out.
    turns : bool
        The forearm's axes are known, so that its pronation is.
    """

    side: str
    upper_m: float
    forearm_m: float
    places: dict[str, FloatArray]
    turns: bool


def arm_measures(recovery: Recovery) -> ArmMeasures:
    """Measure the arm of a recovery: medians over its samples.

    Parameters
    ----------
    recovery : Recovery
        With shoulder, elbow and wrist.

    Returns
    -------
    ArmMeasures

    Raises
    ------
    UnoccludeError
        A joint is missing, or they are never all there.
    """
    missing = [joint for joint in ("shoulder", "elbow", "wrist") if joint not in recovery.joints]
    if missing:
        raise UnoccludeError(
            f"{recovery.name}: a model of the arm needs shoulder, elbow and wrist, and it has no"
            f" {', no '.join(missing)}; export to csv, trc, c3d or parquet"
        )
    rows = recovery.rows(slice(0, None, max(len(recovery) // _SAMPLES, 1)))
    shoulder, elbow, wrist = (rows.joints[joint] for joint in ("shoulder", "elbow", "wrist"))
    upper, fore = np.linalg.norm(elbow - shoulder, axis=1), np.linalg.norm(wrist - elbow, axis=1)
    if not np.isfinite(upper + fore).any():
        raise UnoccludeError(f"{recovery.name}: shoulder, elbow and wrist are never all there at once")
    places, turns = _forearm(rows)
    return ArmMeasures(recovery.side, float(np.nanmedian(upper)), float(np.nanmedian(fore)), places, turns)


def _forearm(rows: Recovery) -> tuple[dict[str, FloatArray], bool]:
    """Places from the elbow, and whether they say how the forearm is turned about its bone."""
    known = np.isfinite(rows.quaternion).all(axis=1) & np.isfinite(rows.position).all(axis=1)
    if not known.any():
        return {}, False
    R_A_K = Rotation.from_quat(rows.quaternion[known], scalar_first=True).inv()

    def in_imu(values: FloatArray) -> FloatArray:
        return np.asarray(np.nanmedian(R_A_K.apply(values[known] - rows.position[known]), axis=0))

    levers = {joint: in_imu(rows.joints[joint]) for joint in ("elbow", "wrist")}
    if "hand" in rows.joints and np.isfinite(rows.joints["hand"][known]).any():
        levers["hand"] = in_imu(rows.joints["hand"])
    mounting = None if rows.calibration is None else rows.calibration.R_F_A
    y = unit(levers["elbow"] - levers["wrist"])
    if mounting is None:  # the hand lies along the bone; how the IMU lies about it is not known
        along = {"hand": levers["hand"]} if "hand" in levers else {}
        return {name: np.array([0.0, (at - levers["elbow"]) @ y, 0.0]) for name, at in along.items()}, False
    hand_of = -1.0 if rows.side == "left" else 1.0
    thumb = hand_of * np.asarray(mounting)[2]
    x = hand_of * unit(np.cross(y, thumb))
    axes = np.stack([x, y, hand_of * np.cross(x, y)])
    levers["imu"] = np.zeros(3)
    return {name: axes @ (levers[name] - levers["elbow"]) for name in ("hand", "imu") if name in levers}, True
