"""Marker trajectories of a motion capture, whatever file they come from."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...array_types import FloatArray
from ...errors import RecordingError
from ..tables.file_head import shown
from ..tables.units import METRES


@dataclass(frozen=True)
class Markers:
    """Trajectories of markers in the mocap's frame {E} and on its own clock.

    Attributes
    ----------
    names : tuple of str
        As the file has them, without spaces around.
    t_s : ndarray, shape (N,), s
        Frame times.
    position : ndarray, shape (N, M, 3), m
        nan where a marker was not seen.
    rate_hz : float
        As the file states it; nan where it does not.
    unit : str
        Of the file.
    residual_m : ndarray, shape (N, M), m, optional
        The capture's own residual (0 = measured or filled without one, nan where the marker was not
        seen), or None where the format has none.
    source : str
        What to call the file in messages.
    notes : tuple of str
        What was dropped or decided on reading, one sentence each.
    """

    names: tuple[str, ...]
    t_s: FloatArray
    position: FloatArray
    rate_hz: float
    unit: str
    residual_m: FloatArray | None = None
    source: str = "the motion capture"
    notes: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.t_s)

    @property
    def seen(self) -> FloatArray:
        """(M,) share of the frames in which each marker was seen."""
        return np.asarray(np.isfinite(self.position).all(axis=2).mean(axis=0))


def metres_in(unit: str, path: Path) -> float:
    """Metres in a unit of length as a file names it.

    Raises
    ------
    RecordingError
        The unit is not known.
    """
    try:
        return METRES[unit.strip().strip('"').lower()]
    except KeyError:
        raise RecordingError(
            f"{path}: the unit of length is '{shown(unit, 40)}', and only m, cm, mm, dm and inches are known;"
            " export the file in mm or m"
        ) from None


def without_origin(position: FloatArray) -> FloatArray:
    """Positions (..., 3) in which all of (0, 0, 0), as many programs write a lost marker, is nan."""
    return np.where((position == 0).all(axis=-1, keepdims=True), np.nan, position)


def told_apart(names: list[str]) -> tuple[tuple[str, ...], list[str]]:
    """Names without spaces around and none twice (`name_2` ..), and the names that were."""
    result: list[str] = []
    twice: list[str] = []
    originals = {name.strip() for name in names}
    used: set[str] = set()
    for number, name in enumerate((name.strip() for name in names), 1):
        name = name or f"unnamed_{number}"
        if name in used:
            twice.append(name)
            count = 2
            while f"{name}_{count}" in originals | used:
                count += 1
            name = f"{name}_{count}"
        used.add(name)
        result.append(name)
    return tuple(result), twice
