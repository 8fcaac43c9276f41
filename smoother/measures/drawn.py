"""What the drawn motions of a recovery measure."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ..recording import FloatArray
from ..result import Recovery
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
    """

    def __init__(self, recovery: Recovery, layout: Layout, motion: Motion) -> None:
        self.count = 0 if recovery.draws is None else len(recovery.draws)
        self._by_place: dict[Place, dict[str, FloatArray]] = {}
        for k in range(self.count):
            drawn = motion_of(recovery.drawn(k), motion.grid, layout.settings.smoothing.cutoff_hz)
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
