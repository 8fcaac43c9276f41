"""Reference motion."""

from __future__ import annotations

from dataclasses import dataclass, field

from ..array_types import BoolArray, FloatArray
from ..linalg import rows_of


@dataclass(frozen=True)
class Truth:
    """Reference motion of the forearm IMU, on the IMU's clock and in the camera frame.

    Attributes
    ----------
    t_s : ndarray, shape (M,), s
        After the recording's origin.
    position : ndarray, shape (M, 3), m
        In {K}; nan where the reference has none.
    quaternion : ndarray, shape (M, 4)
        qw, qx, qy, qz of `R_K_A`; nan where there is none.
    score : ndarray of bool, shape (M,)
        Samples to score on (BROAD scores while the sensor is in motion).
    joints : dict of str to ndarray, shape (M, 3), m
        Further reference positions by joint name, in {K}.
    """

    t_s: FloatArray
    position: FloatArray
    quaternion: FloatArray
    score: BoolArray
    joints: dict[str, FloatArray] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.t_s)

    def select(self, rows: BoolArray | slice) -> Truth:
        """The same reference with some of the samples only."""
        return rows_of(self, rows, "t_s", "position", "quaternion", "score", "joints")
