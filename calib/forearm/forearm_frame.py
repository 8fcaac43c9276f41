"""The forearm's axes in the IMU: `R_F_A` from the lever arms of elbow and wrist.

The forearm frame {F}: y from elbow to wrist, x towards the back of the hand, z = x cross y, origin in the
arm's core under the strap. The lever arms give y. The IMU sits on the back of the wrist, so that x points
from the elbow-wrist line to the IMU.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from smoother.array_types import FloatArray
from smoother.calibration import ArmCalibration, LeverArm

#: Nearer to the elbow-wrist line than this the IMU does not show which way the back of the hand is, m.
NEAREST_M = 0.015
#: Axes that are known no better than this are not written down, rad: roll, and the forearm's direction.
WORST_ROLL_RAD = np.radians(15.0)
WORST_DIRECTION_RAD = np.radians(6.0)


@dataclass(frozen=True)
class ForearmFrame:
    """The forearm's axes as far as the lever arms give them."""

    direction: FloatArray  # (3,): unit vector elbow to wrist in {A}
    direction_sigma_rad: float  # Its standard deviation
    length_m: float  # Elbow to wrist
    length_sigma_m: float  # Elbow to wrist
    distance_m: float  # Of the IMU from the elbow-wrist line
    distance_sigma_m: float  # Of the IMU from the elbow-wrist line
    roll_sigma_rad: float  # Of the angle about the forearm's axis; inf where the IMU is too near to the line
    R_F_A: FloatArray | None  # (3, 3): none where the roll or the direction is not known well enough


def forearm_frame(calibration: ArmCalibration) -> ForearmFrame | None:
    """The forearm's axes from the lever arms of elbow and wrist; None without both."""
    along = calibration.forearm_direction
    if along is None:
        return None
    elbow, wrist = calibration.lever_arms["elbow"], calibration.lever_arms["wrist"]
    length = float(np.linalg.norm(wrist.position_m - elbow.position_m))
    # the point of the line that is nearest to the IMU, the origin of {A}
    part = float(-elbow.position_m @ along) / length
    foot = elbow.position_m + part * length * along
    distance = float(np.linalg.norm(foot))
    sideways = np.linalg.norm([_sigma_across(lever, along) for lever in (elbow, wrist)])
    ends = np.linalg.norm([_sigma_along(lever, along) for lever in (elbow, wrist)])
    tilt = float(sideways) / length
    roll, R_F_A = np.inf, None
    away = -foot / max(distance, 1e-12)
    if distance > NEAREST_M:
        across = np.cross(away, along)
        roll = _sigma_at(elbow, wrist, part, across) / distance
        if roll < WORST_ROLL_RAD and tilt < WORST_DIRECTION_RAD:
            R_F_A = np.stack([away, along, across])
    return ForearmFrame(
        direction=along,
        direction_sigma_rad=tilt,
        length_m=length,
        length_sigma_m=float(ends),
        distance_m=distance,
        distance_sigma_m=_sigma_at(elbow, wrist, part, away),
        roll_sigma_rad=float(roll),
        R_F_A=R_F_A,
    )


def _sigma_along(lever: LeverArm, direction: FloatArray) -> float:
    """Standard deviation of a lever arm along a direction, m."""
    return float(np.linalg.norm(lever.sigma_m * direction))


def _sigma_across(lever: LeverArm, direction: FloatArray) -> float:
    """Standard deviation of a lever arm in the worst direction across the given one, m."""
    across = np.linalg.svd(direction[None])[2][1:]
    spread = across * lever.sigma_m
    return float(np.sqrt(np.linalg.eigvalsh(spread @ spread.T)[-1]))


def _sigma_at(elbow: LeverArm, wrist: LeverArm, part: float, direction: FloatArray) -> float:
    """Of a point of the elbow-wrist line, along a direction, m: both ends' errors go together."""
    ends = abs(1.0 - part) * _sigma_along(elbow, direction), abs(part) * _sigma_along(wrist, direction)
    return float(sum(ends))
