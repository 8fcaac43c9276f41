"""What the drawn motions of a recovery measure."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from ..array_types import FloatArray
from ..linalg import rotate_covariance
from ..result import Recovery
from .elbow_bend import ElbowBend
from .intervals import FEWEST_DRAWS
from .layout import SESSION, Layout, Place
from .motion import Motion, motion_of


class DrawnFigures:
    """Every measure of every drawn motion.

    Parameters
    ----------
    recovery : Recovery
        With or without draws.
    layout : Layout
        Where to measure.
    motion : Motion
        The answer's, whose grid they share.

    Attributes
    ----------
    answer : Motion
        The answer's without what its errors add to the elbow's flexion.
    bend : ElbowBend or None
        By how much; None where too few motions were drawn.
    """

    def __init__(self, recovery: Recovery, layout: Layout, motion: Motion) -> None:
        self.count = 0 if recovery.draws is None else len(recovery.draws)
        self._by_place: dict[Place, dict[str, FloatArray]] = {}
        cutoff_hz = layout.settings.smoothing.cutoff_hz

        def drawn_of(k: int) -> Motion:
            return motion_of(drawn_motion(recovery, k), motion.grid, cutoff_hz)

        self.bend = None
        if recovery.draws is not None and self.count >= FEWEST_DRAWS:
            self.bend = ElbowBend.of(motion, (drawn_of(k) for k in range(FEWEST_DRAWS)))
        self.answer = motion if self.bend is None else self.bend.corrected(motion)
        for k in range(self.count):
            drawn = drawn_of(k)
            if self.bend is not None and recovery.draws is not None:
                rng = np.random.default_rng([recovery.draws.seed, k, 1])
                drawn = self.bend.corrected_draw(drawn, float(rng.uniform()))
            for place, figures in layout.figures(drawn).items():
                of_place = self._by_place.setdefault(place, {})
                for key, figure in figures.items():
                    if key not in of_place:  # a zone in which no motion before ever was
                        of_place[key] = np.full(self.count, 0.0 if "_zone_" in key else np.nan)
                    of_place[key][k] = figure.value

    def values(self, place: Place, key: str) -> FloatArray:
        """(count,) of a measure; nan where a motion has none."""
        absent = 0.0 if "_zone_" in key else np.nan
        return self._by_place.get(place, {}).get(key, np.full(self.count, absent))

    def zones(self) -> Iterator[str]:
        """Keys of all zones of angles in which any motion ever is."""
        return (key for key in self._by_place.get(SESSION, {}) if "_zone_" in key)


def drawn_motion(recovery: Recovery, k: int) -> Recovery:
    """A drawn motion, with the errors that draws leave out: how the IMUs on upper arm and trunk sit.

    Those do not change over a recording: one turn a draw, of the stated sizes. The trunk's orientation, which
    is not drawn either, is turned with its mounting by as much as it is uncertain on average.

    Parameters
    ----------
    recovery : Recovery
        With draws.
    k : int
        Number of the motion.

    Returns
    -------
    drawn : Recovery
        Covariances are zero.
    """
    drawn = recovery.drawn(k)
    assert recovery.draws is not None
    rng = np.random.default_rng([recovery.draws.seed, k])
    calibration, upper, trunk = drawn.calibration, recovery.upper, recovery.trunk
    if upper is not None and calibration is not None and calibration.R_U_B is not None:
        off = Rotation.from_rotvec(rng.normal(0.0, upper.mount_sigma_rad)).as_matrix()
        drawn = replace(drawn, calibration=replace(calibration, R_U_B=off @ calibration.R_U_B))
    if trunk is not None:
        known = np.flatnonzero(np.isfinite(trunk.quaternion).all(axis=1))
        R_K_T = Rotation.from_quat(trunk.quaternion[known], scalar_first=True)
        own = rotate_covariance(R_K_T.inv().as_matrix(), trunk.covariance[known]) if len(known) else None
        mean = np.zeros(3) if own is None else np.nanmean(np.einsum("nii->ni", own), axis=0)
        turn = Rotation.from_rotvec(rng.normal(0.0, np.sqrt(mean + trunk.mount_sigma_rad**2)))
        quaternion = trunk.quaternion.copy()
        quaternion[known] = (R_K_T * turn).as_quat(scalar_first=True)
        drawn = replace(drawn, trunk=replace(trunk, quaternion=quaternion))
    return drawn
