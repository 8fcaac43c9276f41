"""Joint angles of answer and truth, in ISB order, and how well they agree."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..array_types import BoolArray, FloatArray
from ..joint_angles import ANGLES, arm_angles, defined, forearm_axes, recovery_angles
from ..linalg import unit
from ..recording import Truth
from ..result import Recovery
from .agreement import Agreement, agreement
from .align import position_at

#: Names for people.
WORDS = {
    "elbow_flexion": "elbow flexion",
    "carrying": "carrying angle",
    "pronation": "forearm pronation",
    "shoulder_plane": "shoulder plane of elevation",
    "shoulder_elevation": "shoulder elevation",
    "shoulder_rotation": "shoulder axial rotation",
}


@dataclass(frozen=True)
class AngleComparison:
    """Angles of answer and truth at the answer's times, degrees; nan where not known or not defined.

    Attributes
    ----------
    t_s : ndarray, shape (n,), s
        Times.
    answer, truth : dict[str, ndarray], shape (n,)
        By the names of `smoother.joint_angles.ANGLES`.
    carrying_truth_deg : float, degrees, or None
        Median of the truth's carrying angle, None without markers on the epicondyles.
    notes : tuple of str
        What to know of the comparison, one sentence each.
    """

    t_s: FloatArray
    answer: dict[str, FloatArray]
    truth: dict[str, FloatArray]
    carrying_truth_deg: float | None = None
    notes: tuple[str, ...] = ()

    @property
    def compared(self) -> tuple[str, ...]:
        """Angles that both have."""
        return tuple(
            name for name in ANGLES if (np.isfinite(self.answer[name]) & np.isfinite(self.truth[name])).any()
        )

    def figures(self, chosen: BoolArray) -> dict[str, Agreement]:
        """Agreement over the chosen samples (N,), by angle."""
        return {
            name: agreement(self.answer[name][chosen], self.truth[name][chosen], degrees=True)
            for name in self.compared
        }


def compare_angles(
    recovery: Recovery,
    reference: Truth,
    landmarks: dict[str, FloatArray] | None = None,
    landmark_t_s: FloatArray | None = None,
) -> AngleComparison | None:
    """Angles of a recovery beside those of a truth; None where they share none.

    Both have the humerus of ISB's second definition, the same direction of gravity (the answer's) and the
    same forearm axes in the IMU. Samples near a singular posture, in the truth or the answer, are left out.

    Parameters
    ----------
    reference : Truth
        The truth at the recovery's times, with joints.
    landmarks : dict[str, ndarray], shape (m, 3), m, optional
        Positions of markers on the bones, in {K}. The styloids give the truth's forearm its own axes, the
        epicondyles its carrying angle.
    landmark_t_s : ndarray, shape (m,), s, optional
        Their times.
    """
    count = len(recovery)
    joints = {
        name: np.where(reference.score[:, None], place, np.nan) for name, place in reference.joints.items()
    }
    if not {"shoulder", "elbow"} <= joints.keys() or not {"shoulder", "elbow"} <= recovery.joints.keys():
        return None
    landmarks = landmarks or {}
    at = {
        name: position_at(landmark_t_s, place, recovery.t_s)
        for name, place in landmarks.items()
        if landmark_t_s is not None
    }
    R_K_F, notes = _true_forearm(recovery, reference, joints, at)
    answer = recovery_angles(recovery)
    truth = arm_angles(joints, count, R_K_F, recovery.side, recovery.gravity_direction)
    good_answer, good_truth = defined(answer), defined(truth)
    masked = [
        {name: np.where(good_answer[name] & good_truth[name], angles[name], np.nan) for name in ANGLES}
        for angles in (answer, truth)
    ]
    carrying = None
    if {"medial_epicondyle", "lateral_epicondyle"} <= at.keys():
        axis = at["lateral_epicondyle"] - at["medial_epicondyle"]
        own = arm_angles(joints, count, None, recovery.side, recovery.gravity_direction, flexion_axis=axis)
        known = own["carrying"][np.isfinite(own["carrying"])]
        carrying = float(np.median(known)) if len(known) else None
    found = AngleComparison(recovery.t_s, masked[0], masked[1], carrying, tuple(notes))
    return found if found.compared else None


def _true_forearm(
    recovery: Recovery, reference: Truth, joints: dict[str, FloatArray], at: dict[str, FloatArray]
) -> tuple[FloatArray | None, list[str]]:
    """The truth's `R_K_F` (N, 3, 3), and what to say of it and of the other angles."""
    notes = [
        "Angles are in ISB order; the thorax is not seen, so shoulder angles are relative to gravity and to a"
        " person who faces the camera.",
        "The carrying angle needs the humerus' own axis (epicondyles), which a skeleton does not have: it is"
        " not compared.",
    ]
    if {"radial_styloid", "ulnar_styloid", "elbow", "wrist"} <= at.keys() | joints.keys():
        y = unit(joints["wrist"] - joints["elbow"])
        thumb = (at["radial_styloid"] - at["ulnar_styloid"]) * (-1.0 if recovery.side == "left" else 1.0)
        x = unit(np.cross(y, thumb))
        notes.append("The truth's pronation is that of the styloids' markers.")
        return np.stack([x, y, np.cross(x, y)], axis=2), notes
    mounting = None if recovery.calibration is None else recovery.calibration.R_F_A
    if mounting is None:
        notes.append("The forearm's axes in the IMU (R_F_A) are not known: pronation is not compared.")
        return None, notes
    notes.append(
        "Pronation of truth and answer share the forearm's axes in the IMU: its error is not in the figure."
    )
    return forearm_axes(reference.quaternion, mounting), notes
