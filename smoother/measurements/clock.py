"""The camera's clock against the IMU's, as a value: an offset that may drift."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..array_types import FloatArray

#: Clock offsets are looked for up to this; before the data speak they are within the sigma, s.
LARGEST_OFFSET_S = 0.4
OFFSET_SIGMA_S = 0.15

#: Times of a batch, so that a long recording's need no memory of their own.
BATCH_TIMES = 1 << 16


@dataclass(frozen=True)
class Clock:
    """t_imu = t_camera + offset, linear between knots and held beyond them."""

    t: FloatArray  # (k,) s: knots on the camera's clock
    offset: FloatArray  # (k,) s: at the knots
    sigma_s: float  # Standard deviation of the mean offset
    walk: float = 0.0  # How fast the offset wanders
    local_sigma_s: float = 0.0  # Standard deviation of the offset at any one time
    skew: float = 0.0  # Steady drift; zero where none shows
    prior_sigma_s: float = OFFSET_SIGMA_S  # Standard deviation of the offset before the data spoke

    def at(self, t: FloatArray) -> FloatArray:  # t (n,) s -> (n,) s
        """Offsets at camera times; beyond the knots they go on with the skew."""
        offset = np.empty(len(t))
        for start in range(0, len(t), BATCH_TIMES):
            batch = np.asarray(t[start : start + BATCH_TIMES])
            outside = np.minimum(batch - self.t[0], 0.0) + np.maximum(batch - self.t[-1], 0.0)
            offset[start : start + BATCH_TIMES] = np.interp(batch, self.t, self.offset) + self.skew * outside
        return offset

    def to_imu(self, t_camera: FloatArray) -> FloatArray:
        """Camera times on the IMU's clock, s."""
        return t_camera + self.at(t_camera)

    def after(self, coarse: Clock | None) -> Clock:
        """The clock of the stamps themselves, where this one was estimated after `coarse` had moved them."""
        if coarse is None:
            return self
        t = self.t - coarse.mean_s
        for _ in range(3):  # coarse is nearly constant: this settles at once
            t = self.t - coarse.at(t)
        return replace(self, t=t, offset=self.offset + coarse.at(t), skew=self.skew + coarse.skew)

    @property
    def mean_s(self) -> float:
        """Mean offset, s."""
        return float(self.offset.mean())

    @property
    def drift_s(self) -> float:
        """Largest change of the offset over the recording, s."""
        return float(np.ptp(self.offset))


def constant_clock(offset_s: float, sigma_s: float = OFFSET_SIGMA_S) -> Clock:
    """A clock that does not drift; nothing was measured of it beyond its sigma."""
    return Clock(np.zeros(1), np.full(1, offset_s), sigma_s, prior_sigma_s=sigma_s)
