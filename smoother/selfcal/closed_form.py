"""How well camera and IMU fit together, in closed form: a tenth of a second, and no start value.

The mounting's closed form gives the forearm's direction in the sensor and the lever arms. What it leaves over
tells set-ups apart: the direction that the camera sees against the one that the gyroscope turns, a joint's
acceleration by camera against the IMU's, gravity against the frame's down. Nothing is assumed of gravity.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..array_types import FloatArray
from ..calibration import ArmCalibration
from ..measurements.alignment import Alignment, VectorPairs, align, pairs
from ..measurements.clock import constant_clock
from ..measurements.outliers import reject_by_camera
from ..measurements.segment import Segment
from ..measurements.timeline import Timeline
from ..recording import Recording
from .excerpts import informative_excerpts
from .mounting import find_mounting

#: What fits: simulated arms leave at most 11 degrees and 0.1 of the acceleration, wrong set-ups
#: 17 degrees or 0.7 at least.
DIRECTION_DEG, ACCELERATION_SHARE = 15.0, 0.45


@dataclass(frozen=True)
class ClosedForm:
    """What the closed form leaves over.

    Attributes
    ----------
    direction_deg : float, degrees
        Median angle of the forearm by the camera to that by the IMU; nan without elbow and wrist.
    acceleration_share : float
        Share of a joint's acceleration (its square) that the IMU does not explain; nan where none was seen.
    down : ndarray, shape (3,)
        Direction of gravity in {K}; nan where it is open.
    calibration : ArmCalibration
        Lever arms.
    """

    direction_deg: float
    acceleration_share: float
    down: FloatArray
    calibration: ArmCalibration

    @property
    def fits(self) -> bool:
        """Directions and accelerations are those of one motion; never where one of them is open."""
        return self.direction_deg < DIRECTION_DEG and self.acceleration_share < ACCELERATION_SHARE

    @property
    def misfit(self) -> float:
        """One number to compare set-ups by; infinite where there is nothing to compare."""
        parts = self.direction_deg / DIRECTION_DEG, self.acceleration_share / ACCELERATION_SHARE
        misfit = float(np.hypot(*parts))
        return misfit if np.isfinite(misfit) else np.inf

    def down_deg(self, down: FloatArray) -> float:
        """Angle of gravity to where a frame has down, degrees; nan where it is open."""
        cosine = float(self.down @ down / np.linalg.norm(down))
        return float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))


def closed_form(
    recording: Recording, given: ArmCalibration | None = None, timeline: Timeline | None = None
) -> ClosedForm | None:
    """The closed form on a recording's excerpts.

    Parameters
    ----------
    recording : Recording
        Its clocks within the fine search's reach of each other.
    given : ArmCalibration, optional
        What is known of the arm.
    timeline : Timeline, optional
        Of the recording, where it is there already.

    Returns
    -------
    ClosedForm or None
        None where no forearm is visible while the IMU measures.
    """
    timeline = timeline or Timeline.of(recording)
    excerpts = [
        replace(reject_by_camera(excerpt), down=np.zeros(3))
        for excerpt in informative_excerpts(recording, timeline)
    ]
    if not any(excerpt.accepted.any() for excerpt in excerpts):
        return None
    mounting = find_mounting(excerpts, given or ArmCalibration(side=recording.side))
    angles, unexplained, whole = [np.zeros(0)], 0.0, 0.0
    down = np.zeros(3)
    for excerpt in excerpts:
        vectors, alignment = _aligned(excerpt, float(mounting.offset_s[0]), mounting.calibration)
        if alignment is None:
            continue
        middle = alignment.at(np.array([0.5 * (excerpt.start_s + excerpt.end_s)]))
        down += middle.apply([0.0, 0.0, -1.0])[0]
        for each in vectors:
            residual = each.in_K - alignment.at(each.t).apply(each.in_E)
            size = np.linalg.norm(each.in_K, axis=1)
            if np.allclose(size, 1.0, atol=1e-6):
                angles.append(2.0 * np.arcsin(np.clip(0.5 * np.linalg.norm(residual, axis=1), 0.0, 1.0)))
            else:
                unexplained += float(each.weight @ (residual**2).sum(axis=1))
                whole += float(each.weight @ size**2)
    angle = np.concatenate(angles)
    length = float(np.linalg.norm(down))
    return ClosedForm(
        float(np.degrees(np.median(angle))) if len(angle) else float("nan"),
        unexplained / whole if whole > 0.0 else float("nan"),
        down / length if length > 0.0 else np.full(3, np.nan),
        mounting.calibration,
    )


def _aligned(
    excerpt: Segment, offset_s: float, calibration: ArmCalibration
) -> tuple[list[VectorPairs], Alignment | None]:
    """Vectors that both measured, and the alignment that they give; none where there are none."""
    frame_t = excerpt.frame_t_imu(constant_clock(offset_s))
    vectors = [each for each in pairs(excerpt, frame_t, excerpt.accepted, calibration) if len(each.t)]
    if not vectors:
        return [], None
    return vectors, align(vectors, excerpt.start_s, excerpt.end_s, np.zeros(3))
