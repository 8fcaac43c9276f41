"""A depth image with the camera that took it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from smoother.array_types import FloatArray

from ..intrinsics import PlacedCamera


@dataclass(frozen=True)
class Depth:
    """A depth image.

    Attributes
    ----------
    z_m : ndarray, shape (height, width), m
        z of every pixel in the lens's own axes; nan where there is none.
    camera : PlacedCamera
        That took it.
    """

    z_m: NDArray[np.float64]
    camera: PlacedCamera

    def at(self, points_K: FloatArray) -> tuple[FloatArray, FloatArray]:
        """What the image has where points (n, 3) of {K} fall, and the points' own z, m (nan outside)."""
        pixels, z = self.camera.pixels(points_K)
        inside = np.isfinite(pixels).all(axis=1)
        column = np.where(inside, np.rint(np.nan_to_num(pixels[:, 0])), -1).astype(np.int64)
        row = np.where(inside, np.rint(np.nan_to_num(pixels[:, 1])), -1).astype(np.int64)
        inside &= (column >= 0) & (row >= 0) & (column < self.z_m.shape[1]) & (row < self.z_m.shape[0])
        seen = np.full(len(points_K), np.nan)
        seen[inside] = self.z_m[row[inside], column[inside]]
        return seen, z
