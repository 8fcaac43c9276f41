"""What was found of each camera of a recording: where it stands, its clock, and when it saw the forearm."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ..array_types import BoolArray, FloatArray
from .plain import Matrix, Vector


@dataclass(frozen=True)
class CameraEstimate:
    """A camera {C} of a recording in the first one's frame {K}."""

    name: str
    R_K_C: Matrix | None = None  # (3, 3): Maps a vector from {C} to {K}; None if unknown
    p_K_C_m: Vector | None = None  # (3,), m: Its origin in {K}
    # m and degrees per axis: One standard deviation of both; 0 of the first camera, which defines {K}
    sigma_m: float | None = None
    sigma_deg: float | None = None
    offset_s: float | None = None  # s: t_first = t_own + offset, in the middle of the recording
    offset_sigma_s: float | None = None
    skew: float | None = None  # s/s: Steady drift of its clock against the first one's
    # m: Median distance of its joints from the first one's, what is constant taken off
    misfit_m: float | None = None
    together_s: float | None = None  # s: Time during which both saw the forearm
    joint_sigma_m: dict[str, float] = field(default_factory=dict)  # m per axis: Noise of its joints' samples
    reason: str = ""  # Why it was left out; "" where it is used
    seen_s: tuple[tuple[float, float], ...] = ()  # s: When it saw the forearm, on the IMU's clock

    @property
    def takes_part(self) -> bool:
        """Its samples are in the answer."""
        return not self.reason

    def saw_at(self, t_s: FloatArray) -> BoolArray:
        """Whether it saw the forearm at times (n,), s on the IMU's clock."""
        if not self.seen_s:
            return np.zeros(len(t_s), bool)
        start, end = np.array(self.seen_s).T
        row = np.clip(np.searchsorted(start, t_s, side="right") - 1, 0, None)
        return np.asarray((t_s >= start[row]) & (t_s <= end[row]))
