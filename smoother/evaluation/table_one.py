"""The layout of table I of Jatesiktat and Ang (2017): the camera's skeleton, the answer, what it gains."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..array_types import BoolArray, FloatArray
from ..recording import JOINTS, Truth
from ..result import Recovery
from .align import position_at
from .metrics import maximum, rms


@dataclass(frozen=True)
class TableRow:
    """One line of the table.

    Attributes
    ----------
    errors : str
        "Orientation errors (degree)" ...
    figure : str
        "RMS" or "Maximum".
    camera, answer : float or None
        The errors, in the unit of the line; None where there is none.
    """

    errors: str
    figure: str
    camera: float | None
    answer: float | None

    @property
    def reduction(self) -> float | None:
        """By which part of the camera's error the answer is better, 0 to 1; negative where it is worse."""
        if self.camera is None or self.answer is None or self.camera <= 0:
            return None
        return 1.0 - self.answer / self.camera

    def to_dict(self) -> dict[str, object]:
        """Plain values by name."""
        return {
            "errors": self.errors,
            "figure": self.figure,
            "camera": self.camera,
            "answer": self.answer,
            "reduction": self.reduction,
        }


@dataclass(frozen=True)
class TableOne:
    """The table.

    Attributes
    ----------
    rows : tuple of TableRow
        Its lines.
    camera_share : float
        Part of the scored samples for which the camera states a position at all.
    note : str
        What a reader must know of it, in a sentence.
    """

    rows: tuple[TableRow, ...]
    camera_share: float
    note: str

    def to_dict(self) -> dict[str, object]:
        """Plain values by name."""
        return {
            "rows": [row.to_dict() for row in self.rows],
            "camera_share": self.camera_share,
            "note": self.note,
        }


def table_one(
    recovery: Recovery, reference: Truth, scored: BoolArray, distance_m: FloatArray, angle_deg: FloatArray
) -> TableOne:
    """The table of a recovery, its figures over all scored samples.

    The camera's estimate of the IMU's position is their eq 16, D = L + d_se / (d_sw + d_se) (T - L), between
    the camera's elbow L and wrist T, inferred samples included, read at the IMU's times between samples
    0.1 s apart at most. A skeleton states no orientation; the direction elbow to wrist stands below instead.

    Parameters
    ----------
    reference : Truth
        The truth at the recovery's times.
    scored : ndarray of bool, shape (n,)
        Samples to score.
    distance_m, angle_deg : ndarray, shape (n,), m and degrees
        Errors of the answer.
    """
    position, direction = camera_estimate(recovery)
    own = np.where(scored, np.linalg.norm(position - reference.position, axis=1), np.nan)
    rows = [
        TableRow("Orientation errors (degree)", "RMS", None, rms(angle_deg)),
        TableRow("Orientation errors (degree)", "Maximum", None, maximum(angle_deg)),
    ]
    both = ("elbow", "wrist")
    if all(name in reference.joints and name in recovery.joints for name in both):
        true = reference.joints["wrist"] - reference.joints["elbow"]
        answer = _between_deg(recovery.joints["wrist"] - recovery.joints["elbow"], true)
        camera = _between_deg(direction, true)
        keep = reference.score
        errors = "Forearm direction errors (degree)"
        for name, figure in (("RMS", rms), ("Maximum", maximum)):
            rows.append(
                TableRow(
                    errors,
                    name,
                    figure(np.where(keep, camera, np.nan)),
                    figure(np.where(keep, answer, np.nan)),
                )
            )
    rows.append(TableRow("Position errors (meter)", "RMS", rms(own), rms(distance_m)))
    rows.append(TableRow("Position errors (meter)", "Maximum", maximum(own), maximum(distance_m)))
    known = np.isfinite(reference.position).all(axis=1) & scored
    share = float(np.isfinite(own[known]).mean()) if known.any() else 0.0
    return TableOne(
        tuple(rows),
        share,
        f"The camera states a position, guesses included, for {100 * share:.0f} % of the samples; its errors"
        " are over those, the answer's over all. A skeleton holds no orientation.",
    )


def camera_estimate(recovery: Recovery) -> tuple[FloatArray, FloatArray]:
    """The camera's own IMU position (N, 3) m and way from elbow to wrist (N, 3) m, at the IMU's times."""
    arm = recovery.arm
    elbow, wrist, strap = (arm.position[:, JOINTS.index(name)] for name in ("elbow", "wrist", "strap"))
    calibration = recovery.calibration
    along = None if calibration is None else calibration.forearm_direction
    if calibration is None or along is None:
        place = strap if np.isfinite(strap).any() else np.full_like(wrist, np.nan)
    else:
        levers = calibration.lever_arms
        from_elbow = -(levers["elbow"].position_m @ along)
        length = (levers["wrist"].position_m - levers["elbow"].position_m) @ along
        place = elbow + from_elbow / length * (wrist - elbow)
    return position_at(arm.t_s, place, recovery.t_s), position_at(arm.t_s, wrist - elbow, recovery.t_s)


def _between_deg(a: FloatArray, b: FloatArray) -> FloatArray:
    return np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), (a * b).sum(axis=1)))
