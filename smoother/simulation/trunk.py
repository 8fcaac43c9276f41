"""How the trunk turns and leans about the hips."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline
from scipy.spatial.transform import Rotation

from ..array_types import FloatArray
from .path import band_noise
from .protocol import Performance

#: What the trunk turns about, between the hips, m in {T}.
HIPS = np.array([0.0, -0.45, 0.0])
#: How the turning is shared by leaning forwards, turning about the vertical and leaning sideways.
SHARES = np.sqrt([0.25, 0.6, 0.15])


class TrunkTurn:
    """How the trunk turns about the hips over time.

    Parameters
    ----------
    performance : Performance
    rms_deg : float, degrees
        Of the whole rotation; 0 = the trunk stands upright and still.
    rng : numpy.random.Generator
    """

    def __init__(self, performance: Performance, rms_deg: float, rng: np.random.Generator) -> None:
        self._spline: BSpline | None = None
        if rms_deg > 0.0:
            turn = np.radians(rms_deg) * SHARES * band_noise(performance.t_s, 0.05, 0.3, 3, rng)
            self._spline = make_interp_spline(performance.t_s, turn, k=5)

    @property
    def is_still(self) -> bool:
        """The trunk never turns."""
        return self._spline is None

    def at(self, t_s: FloatArray) -> FloatArray:
        """The trunk as it is turned against the upright one, (N, 3, 3)."""
        if self._spline is None:
            return np.tile(np.eye(3), (len(t_s), 1, 1))
        return np.asarray(Rotation.from_rotvec(self._spline(t_s)).as_matrix())

    def moved(self, points_T: FloatArray, t_s: FloatArray) -> FloatArray:
        """Points (N, 3) of the upright trunk, m in {T}, where its turning takes them."""
        if self._spline is None:
            return points_T
        return HIPS + np.einsum("nij,nj->ni", self.at(t_s), points_T - HIPS)

    def back(self, points_T: FloatArray, t_s: FloatArray) -> FloatArray:
        """The other way round: points (N, 3) of the turned trunk as the upright one has them."""
        if self._spline is None:
            return points_T
        return HIPS + np.einsum("nji,nj->ni", self.at(t_s), points_T - HIPS)
