"""How much of the sphere of directions a set of measurements covers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from smoother.array_types import FloatArray

#: Directions that the sphere is looked at; neighbours are some 4 degrees apart.
_GRID = 2000
#: Cells that a sphere's coverage is counted in; each is some 20 degrees across.
_CELLS = 100


@dataclass(frozen=True)
class Coverage:
    """What was covered of the sphere.

    Attributes
    ----------
    hole_rad : float, rad
        Radius of the largest cap without a direction in it.
    towards : ndarray, shape (3,)
        Unit vector, the middle of that cap.
    share : float
        Part of the sphere's 100 cells that hold a direction, 0 to 1.
    """

    hole_rad: float
    towards: FloatArray
    share: float


def cover(direction: FloatArray) -> Coverage:
    """Coverage by unit vectors (N, 3)."""
    grid = sphere_points(_GRID)
    apart, _ = cKDTree(direction).query(grid)
    worst = int(np.argmax(apart))
    _, cell = cKDTree(sphere_points(_CELLS)).query(direction)
    return Coverage(
        hole_rad=2.0 * float(np.arcsin(min(apart[worst] / 2.0, 1.0))),
        towards=grid[worst],
        share=len(np.unique(cell)) / _CELLS,
    )


def sphere_points(count: int) -> FloatArray:
    """Unit vectors (count, 3) spread evenly over the sphere (Fibonacci's lattice)."""
    k = np.arange(count) + 0.5
    z = 1.0 - 2.0 * k / count
    angle = np.pi * (1.0 + np.sqrt(5.0)) * k
    radius = np.sqrt(1.0 - z**2)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), z], axis=1)


def axis_words(direction: FloatArray) -> str:
    """A direction in the sensor's axes in words: "+z", or "between +x and -z"."""
    order = np.argsort(-np.abs(direction))
    parts = [f"{'+' if direction[i] > 0 else '-'}{'xyz'[i]}" for i in order]
    if abs(direction[order[0]]) > np.cos(np.radians(25.0)):
        return parts[0]
    if abs(direction[order[2]]) < np.sin(np.radians(20.0)):
        return f"between {parts[0]} and {parts[1]}"
    return f"between {parts[0]}, {parts[1]} and {parts[2]}"
