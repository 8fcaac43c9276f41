"""Frames whose forearm points elsewhere than the inertial attitude says, before there is any graph."""

from __future__ import annotations

from ..calibration import ArmCalibration
from ..measurements.alignment import Alignment, align, pairs
from ..measurements.clock import Clock
from ..measurements.outliers import reject_by_attitude
from ..measurements.segment import Segment


def reject_by_direction(
    segment: Segment, calibration: ArmCalibration, clock: Clock
) -> tuple[Segment, Alignment | None]:
    """Reject the frames whose forearm does not point where the inertial attitude says.

    Parameters
    ----------
    segment : Segment
    calibration : ArmCalibration
        Of which the forearm's direction in the sensor is used; without one nothing is rejected.
    clock : Clock
        Of the camera.

    Returns
    -------
    segment : Segment
        The same object where nothing was rejected.
    alignment : Alignment or None
        Of the inertial frame to the camera's, where nothing was rejected and it can be used again.
    """
    along_A = calibration.forearm_direction
    if along_A is None:
        return segment, None
    frame_t = segment.frame_t_imu(clock)
    vectors = pairs(segment, frame_t, segment.accepted, calibration)
    if not vectors:
        return segment, None
    alignment = align(vectors, segment.start_s, segment.end_s, segment.down)
    inlier = reject_by_attitude(segment, frame_t, alignment, along_A)
    return inlier, alignment if inlier is segment else None
