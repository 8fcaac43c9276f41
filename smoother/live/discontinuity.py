"""The discontinuity of what is shown, spread over a moment."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..array_types import FloatArray
from ..rotation import Rotation
from ..window.lag_solution import NodeState

#: A discontinuity is spread over so long, s.
SPREAD_S = 0.2


@dataclass(frozen=True)
class Discontinuity:
    """What was shown less what is known now, at the moment of the change.

    Attributes
    ----------
    at_s : float, s
        When it happened.
    offset : ndarray, shape (3,), m
        Of the position in {K}.
    turn : ndarray, shape (3,), rad
        Of the orientation in {K}.
    """

    at_s: float
    offset: FloatArray
    turn: FloatArray

    @classmethod
    def between(cls, shown: NodeState, known: NodeState) -> Discontinuity:
        """From what was shown to what is known now, at the same moment."""
        turn = Rotation.from_matrix(shown.R @ known.R.T).as_rotvec()
        return cls(known.t, shown.p - known.p, turn)

    def share(self, t_s: float) -> float:
        """How much of it is left at a time: 1 at first, 0 after `SPREAD_S`, smooth between."""
        u = float(np.clip((t_s - self.at_s) / SPREAD_S, 0.0, 1.0))
        return 1.0 - u * u * (3.0 - 2.0 * u)
