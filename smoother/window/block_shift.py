"""What a window says of a block of its camera samples, as plain values."""

from __future__ import annotations

from dataclasses import dataclass

from ..array_types import FloatArray


@dataclass(frozen=True)
class BlockShift:
    """A block of camera samples against the rest of its window.

    Attributes
    ----------
    start_s, end_s : float, s
        On the IMU's clock.
    shift_m : ndarray, shape (3,)
        What the block would have to be moved by in {K}.
    score : float
        Squared shift in sigmas / 3, the camera's slow errors allowed for; about 1 where it is chance.
    """

    start_s: float
    end_s: float
    shift_m: FloatArray
    score: float
