"""What is measured of a recovery, as arrays: hand, shoulder, angles, the trunk's axes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from ..array_types import BoolArray, FloatArray
from ..joint_angles import defined, elbow_bend, recovery_angles, torso_axes
from ..result import Recovery
from ..shoulder_angles import shoulder_angles, trunk_angles
from .low_pass import TimeGrid, on_grid, slope

#: The angles that are measured, in the order of the tables.
MEASURED_ANGLES = (
    "elbow_flexion",
    "pronation",
    "shoulder_elevation",
    "shoulder_plane",
    "shoulder_rotation",
    "shoulder_elevation_trunk",
    "shoulder_plane_trunk",
    "shoulder_rotation_trunk",
)
#: What stands for the hand, the best first; the IMU's own place where there is none of them.
HAND_JOINTS = ("hand", "wrist", "strap")


@dataclass(frozen=True)
class Motion:
    """An arm's motion on an even grid, low-passed: answer, drawn motion or truth.

    Attributes
    ----------
    grid : TimeGrid
        Of n times.
    occluded : ndarray of bool, shape (n,)
        The camera did not see the forearm.
    hand : ndarray, shape (n, 3), m
        In {K}.
    hand_joint : str
        Which joint stands for it: one of `HAND_JOINTS`, or "imu".
    velocity : ndarray, shape (n, 3), m/s
        Of the hand.
    joints : dict of str to ndarray, shape (n, 3), m
        In {K}.
    angles : dict of str to ndarray, shape (n,), deg
        By the names in `MEASURED_ANGLES`; nan where not known or near a singular posture.
    missing : dict of str to str
        Why an angle is not known at all, by its name.
    R_K_T : ndarray, shape (n, 3, 3) or (3, 3), optional
        Axes of the thorax (x forward, y up, z to its right): of an IMU on it, else upright and facing the
        camera; None where the direction of gravity is not known.
    side : str
        "left", "right" or "".
    bend : ndarray, shape (n, 3), rad, or None
        Rotation vector from the upper arm's direction to the forearm's, in the IMU's axes.
    """

    grid: TimeGrid
    occluded: BoolArray
    hand: FloatArray
    hand_joint: str
    velocity: FloatArray
    joints: dict[str, FloatArray]
    angles: dict[str, FloatArray]
    missing: dict[str, str]
    R_K_T: FloatArray | None
    side: str
    bend: FloatArray | None = None

    @property
    def speed(self) -> FloatArray:
        """(n,) of the hand, m/s."""
        return np.asarray(np.linalg.norm(self.velocity, axis=1))

    def in_trunk(self, vectors: FloatArray) -> FloatArray | None:
        """Vectors (n, 3) of {K} in the thorax's axes, mirrored to a right arm's; None without them."""
        if self.R_K_T is None:
            return None
        axes = self.R_K_T if self.R_K_T.ndim == 3 else np.broadcast_to(self.R_K_T, (len(vectors), 3, 3))
        turned = np.einsum("nji,nj->ni", axes, vectors)
        return turned * np.array([1.0, 1.0, -1.0]) if self.side == "left" else turned


def motion_of(recovery: Recovery, grid: TimeGrid, cutoff_hz: float) -> Motion:
    """The arrays of a recovery that measures are made of.

    Parameters
    ----------
    recovery : Recovery
        An answer, a drawn motion, or a truth in a recovery's place.
    grid : TimeGrid
        Where to measure.
    cutoff_hz : float, Hz
        Of the low-pass filter.

    Returns
    -------
    motion : Motion
        Of the grid's n times.
    """
    even = on_grid(recovery, grid, cutoff_hz)
    hand_joint = next((joint for joint in HAND_JOINTS if _is_there(even, joint)), "imu")
    hand = even.position if hand_joint == "imu" else even.joints[hand_joint]
    angles, missing = _angles(even)
    return Motion(
        grid,
        even.occluded,
        hand,
        hand_joint,
        slope(hand, grid),
        {joint: place for joint, place in even.joints.items() if _is_there(even, joint)},
        angles,
        missing,
        _thorax(even),
        even.side,
        elbow_bend(even),
    )


def _is_there(recovery: Recovery, joint: str) -> bool:
    return joint in recovery.joints and bool(np.isfinite(recovery.joints[joint]).any())


def _angles(recovery: Recovery) -> tuple[dict[str, FloatArray], dict[str, str]]:
    """The angles (n,) where they are defined, and why the others are not known."""
    angles = recovery_angles(recovery)
    good = defined(angles)
    measured = {name: np.where(good[name], angles[name], np.nan) for name in angles}
    if recovery.upper is not None:  # the upper arm's own IMU shows its turning for a straight elbow, too
        own, _ = shoulder_angles(recovery)
        to_trunk, _ = trunk_angles(recovery)
        own = {name: values for name, values in (own | to_trunk).items() if np.isfinite(values).any()}
        for name, values in own.items():
            elevation = own[f"shoulder_elevation{'_trunk' if name.endswith('_trunk') else ''}"]
            with np.errstate(invalid="ignore"):
                raised = (elevation >= 15.0) & (elevation <= 165.0)
            measured[name] = (
                values if name.startswith("shoulder_elevation") else np.where(raised, values, np.nan)
            )
    known = {name: values for name, values in measured.items() if name in MEASURED_ANGLES}
    known = {name: values for name, values in known.items() if np.isfinite(values).any()}
    missing = {name: _why(recovery, name) for name in MEASURED_ANGLES[:5] if name not in known}
    return known, missing


def _why(recovery: Recovery, angle: str) -> str:
    """Why an angle is not known, in a sentence."""
    for joint in ("shoulder", "elbow", *(() if angle == "shoulder_elevation" else ("wrist",))):
        if not _is_there(recovery, joint):
            return f"The recording has no {joint}."
    if angle == "pronation" and (recovery.calibration is None or recovery.calibration.R_F_A is None):
        return (
            "How the IMU is turned on the forearm (R_F_A) is not known: `unocclude calibrate forearm`"
            " measures it, `smooth --calibration` takes it."
        )
    if angle.startswith("shoulder") and not np.isfinite(recovery.gravity_direction).all():
        return f"The method {recovery.method} does not solve the direction of gravity."
    return "The arm was never 15 degrees or more from the posture in which this angle is not determined."


def _thorax(recovery: Recovery) -> FloatArray | None:
    if recovery.trunk is not None and np.isfinite(recovery.trunk.quaternion).any():
        axes = np.full((len(recovery), 3, 3), np.nan)
        known = np.isfinite(recovery.trunk.quaternion).all(axis=1)
        turns = Rotation.from_quat(recovery.trunk.quaternion[known], scalar_first=True)
        axes[known] = turns.as_matrix()
        return axes
    if not np.isfinite(recovery.gravity_direction).all():
        return None
    return torso_axes(recovery.gravity_direction)
