"""How the IMU is turned on the forearm: from a calibration, or from how far the forearm turned."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..array_types import FloatArray
from ..joint_angles import arm_angles, forearm_axes, wrapped_deg
from ..linalg import unit
from ..result import Recovery

#: Roll of a calibrated mounting, degrees: a palm that faces the camera does not determine it better.
CALIBRATED_DEG = 15.0
#: A healthy forearm turns between these, ISB's pronation in degrees, each of which differs by this much from
#: person to person: supination 82 +- 4, pronation 76 +- 5 from the thumb-up posture (Boone and Azen, J Bone
#: Joint Surg Am 61:756-759, 1979), with some degrees for how a skeleton places elbow and wrist.
LEAST_DEG, MOST_DEG, LIMIT_SIGMA_DEG = 8.0, 166.0, 7.0
#: The turn is read between these percentiles, where the elbow is bent by this much, degrees.
PERCENTILES, BENT_DEG = (1.0, 99.0), (30.0, 150.0)
#: A roll that is less certain is not stated, degrees; no fewer samples are asked.
WORST_SIGMA_DEG, FEWEST = 20.0, 200
#: Widest gap between neighbouring values in which the circle is cut, degrees.
_EMPTY_ARC_DEG = 20.0
_CALIBRATE = "`unocclude calibrate forearm` measures it, `smooth --calibration` takes it"


@dataclass(frozen=True)
class ForearmMounting:
    """The forearm's anatomical axes in the IMU's."""

    # (3, 3): Maps IMU axes to forearm axes (y elbow to wrist, x to the back of the hand)
    R_F_A: FloatArray | None
    roll_sigma_deg: float = float("nan")  # About the forearm, constant over the recording
    reason: str = ""  # Why it is not known, a sentence; "" where it is
    estimated: bool = False  # From the motion, not from a calibration


def forearm_mounting(arm: Recovery) -> ForearmMounting:
    """The mounting as it was calibrated, else from the motion where that shows it."""
    calibration = arm.calibration
    if calibration is not None and calibration.R_F_A is not None:
        return ForearmMounting(calibration.R_F_A, CALIBRATED_DEG)
    along = None if calibration is None else calibration.forearm_direction
    unknown = "How the IMU is turned on the forearm (R_F_A) is not known"
    if along is None:
        return ForearmMounting(None, reason=f"{unknown}: {_CALIBRATE}.")
    start = _axes_about(along)
    turns = _turns(arm, start)
    if len(turns) < FEWEST:
        return ForearmMounting(None, reason=f"{unknown}, and the elbow was hardly ever bent: {_CALIBRATE}.")
    low, high = _range(turns)
    turned = high - low
    space = max(MOST_DEG - LEAST_DEG - turned, 0.0)
    sigma = float(np.hypot(space / np.sqrt(12.0), LIMIT_SIGMA_DEG))
    if sigma > WORST_SIGMA_DEG or turned > MOST_DEG - LEAST_DEG + 4.0 * LIMIT_SIGMA_DEG:
        seen = (
            f"the forearm turned by {turned:.0f} degrees only, too little to find it by a forearm's limits"
            if space
            else f"the forearm seems to have turned by {turned:.0f} degrees, which no forearm does"
        )
        return ForearmMounting(
            None,
            reason=f"{unknown}, and {seen}: turn the palm fully up and fully down once, elbow bent, or"
            f" calibrate: {_CALIBRATE}.",
        )
    constant = 0.5 * (LEAST_DEG + MOST_DEG) - 0.5 * (low + high)
    return ForearmMounting(_rolled(start, constant, arm.side), sigma, estimated=True)


def _axes_about(along: FloatArray) -> FloatArray:
    """Axes `R_F_A` (3, 3) with y along the forearm (3,) in {A}, rolled anyhow."""
    across = unit(np.cross(along, np.eye(3)[int(np.argmin(np.abs(along)))]))
    return np.stack([np.cross(along, across), along, across])


def _rolled(R_F_A: FloatArray, more_deg: float, side: str) -> FloatArray:
    """The mounting whose pronation is larger by `more_deg`."""
    angle = np.radians(more_deg) * (-1.0 if side == "left" else 1.0)
    cos, sin = np.cos(angle), np.sin(angle)
    return np.array([[cos, 0.0, sin], [0.0, 1.0, 0.0], [-sin, 0.0, cos]]) @ R_F_A


def _turns(arm: Recovery, R_F_A: FloatArray) -> FloatArray:
    """Pronation (m,) by a mounting where the elbow is well bent, degrees."""
    parts = []
    for batch in arm.batches():
        R_K_F = forearm_axes(np.asarray(batch.quaternion), R_F_A)
        angles = arm_angles(batch.joints, len(batch), R_K_F, batch.side)
        with np.errstate(invalid="ignore"):
            bent = (angles["elbow_flexion"] > BENT_DEG[0]) & (angles["elbow_flexion"] < BENT_DEG[1])
        parts.append(angles["pronation"][bent & np.isfinite(angles["pronation"])].astype(np.float32))
    return np.concatenate(parts).astype(float) if parts else np.empty(0)


def _range(turns: FloatArray) -> tuple[float, float]:
    """Between which values angles (m,) lie that are cut in their widest empty arc, degrees."""
    kept = np.sort(wrapped_deg(turns))
    arcs = np.diff(kept, append=kept[0] + 360.0)
    # single samples may lie anywhere: the cut is opposite the mean where no arc is empty
    widest = int(np.argmax(arcs))
    middle = np.degrees(np.angle(np.exp(1j * np.radians(turns)).mean()))
    centre = kept[widest] + 0.5 * arcs[widest] + 180.0 if arcs[widest] > _EMPTY_ARC_DEG else middle
    low, high = np.percentile(wrapped_deg(turns - centre), PERCENTILES)
    return float(low + centre), float(high + centre)
