"""Whether a calibration that was given can be of this recording: held against the closed form without it.

A calibration of another person, or of an earlier mounting, is a strong prior: everything bends to it. The
closed form (`mounting`) needs none, so the two can be compared before anything is solved.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from ..array_types import FloatArray
from ..calibration import ArmCalibration
from ..measurements.segment import Segment
from ..recording import JOINTS
from .excerpts import choose_excerpts
from .mounting import find_mounting

#: The closed form's direction of the forearm counts where no direction farther off is nearly as likely, rad.
SURE_RAD = np.radians(30.0)
#: Directions that differ by more than this besides what the closed form leaves open contradict, degrees: with
#: the calibration of the recording's own mounting simulated arms stay below 4.
OTHERWISE_DEG = 18.0
#: Lengths between joints that differ by more than this, and by three sigmas, contradict, m: cameras place
#: both ends some centimetres off.
LENGTH_M = 0.08
#: Fewer frames say nothing of a length.
FEWEST_FRAMES = 30


def contradictions(segments: Sequence[Segment], given: ArmCalibration) -> Iterator[str]:
    """What of a given calibration this recording contradicts, a sentence each.

    Parameters
    ----------
    segments : sequence of Segment
        Of one recording.
    given : ArmCalibration
        Without lever arms of elbow and wrist, or an upper arm, there is nothing to say of them.
    """
    excerpts = choose_excerpts(list(segments))
    yield from _direction(excerpts, given)
    if given.upper_arm is not None:
        seen = _length(excerpts, "shoulder", "elbow")
        yield from _other_length("upper arm", given.upper_arm.value_m, given.upper_arm.sigma_m, seen)
    if {"elbow", "wrist"} <= set(given.lever_arms):
        elbow, wrist = given.lever_arms["elbow"], given.lever_arms["wrist"]
        length_m = float(np.linalg.norm(wrist.position_m - elbow.position_m))
        sigma_m = float(np.hypot(elbow.sigma_m, wrist.sigma_m).max())
        yield from _other_length("forearm", length_m, sigma_m, _length(excerpts, "elbow", "wrist"))


def _direction(excerpts: list[Segment], given: ArmCalibration) -> Iterator[str]:
    """The forearm's direction in the sensor."""
    along = given.forearm_direction
    if along is None:
        return
    own = find_mounting(excerpts, ArmCalibration(given.side))
    found = own.calibration.forearm_direction
    if found is None or not own.direction_spread_rad < SURE_RAD:
        return
    angle_deg = float(np.degrees(np.arccos(np.clip(found @ along, -1.0, 1.0))))
    if angle_deg > OTHERWISE_DEG + np.degrees(own.direction_spread_rad):
        yield (
            "the calibration does not fit this recording: the IMU sits"
            f" {angle_deg:.0f} degrees off the calibration's mounting on the forearm"
        )


def _other_length(what: str, given_m: float, sigma_m: float, seen_m: float | None) -> Iterator[str]:
    if seen_m is not None and abs(seen_m - given_m) > max(LENGTH_M, 3.0 * sigma_m):
        yield (
            f"the calibration does not fit this recording: its {what} is {100 * given_m:.0f} cm long, and"
            f" the camera sees {100 * seen_m:.0f} cm"
        )


def _length(excerpts: Sequence[Segment], first: str, second: str) -> float | None:
    """Median distance between two joints that the camera sees, m; None in too few frames."""
    one, other = JOINTS.index(first), JOINTS.index(second)
    lengths: list[FloatArray] = []
    for segment in excerpts:
        both = segment.accepted[:, one] & segment.accepted[:, other]
        lengths.append(np.linalg.norm(segment.position[both, one] - segment.position[both, other], axis=1))
    known = np.concatenate(lengths) if lengths else np.zeros(0)
    return float(np.median(known)) if len(known) >= FEWEST_FRAMES else None
