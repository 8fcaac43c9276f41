"""What a file holds of one arm, and what that allows: `describe_arm(recording) -> ArmInfo`."""

from __future__ import annotations

import math
from dataclasses import dataclass

from ..measurements.allowance import allowance
from ..measurements.visibility import accepted_samples, find_gaps, visible_frames
from ..recording import Recording


@dataclass(frozen=True)
class ArmInfo:
    """An arm that would be recovered.

    Attributes
    ----------
    label : str
        As "left arm".
    imu, skeleton, side : str
        What would be taken.
    body : int, optional
        The camera's number of the person, where there are several.
    upper_imu, trunk_imu : str
        The IMUs on the same upper arm and on the trunk that would take part; empty without one.
    joints : list of str
        Of the skeleton.
    imu_rate_hz, camera_rate_hz : float, Hz, optional
        Median rates.
    duration_s : float, s
        Time that IMU and camera share.
    gaps : int
        Number of gaps.
    gap_total_s, gap_longest_s : float, s
        Their length together, and the longest.
    allows : str
        What the recording allows, in a line.
    ready : bool
        Nothing says that no answer could be trusted.
    """

    label: str
    imu: str
    skeleton: str
    side: str
    body: int | None
    upper_imu: str
    trunk_imu: str
    joints: list[str]
    imu_rate_hz: float | None
    camera_rate_hz: float | None
    duration_s: float
    gaps: int
    gap_total_s: float
    gap_longest_s: float
    allows: str
    ready: bool


def describe_arm(recording: Recording) -> ArmInfo:
    """Describe the arm of a recording."""
    arm, imu = recording.arm, recording.imu
    start, end = max(imu.t_s[0], arm.t_s[0]), min(imu.t_s[-1], arm.t_s[-1])
    gaps = find_gaps(arm.t_s, visible_frames(arm, accepted_samples(arm)), float(start), float(end))
    allowed = allowance(recording)
    return ArmInfo(
        label=recording.arm_label,
        imu=imu.name,
        skeleton=arm.name,
        side=recording.side,
        body=recording.body,
        upper_imu="" if recording.upper_imu is None else recording.upper_imu.name,
        trunk_imu="" if recording.trunk is None else recording.trunk.imu.name,
        joints=list(arm.present),
        imu_rate_hz=finite(imu.rate_hz),
        camera_rate_hz=finite(arm.rate_hz),
        duration_s=round(float(end - start), 3),
        gaps=len(gaps),
        gap_total_s=round(sum((gap.length_s for gap in gaps), 0.0), 3),
        gap_longest_s=round(max((gap.length_s for gap in gaps), default=0.0), 3),
        allows=allowed.sentence,
        ready=allowed.ready,
    )


def finite(value: float) -> float | None:
    """A value to three decimals; None where there is none."""
    return round(value, 3) if math.isfinite(value) else None
