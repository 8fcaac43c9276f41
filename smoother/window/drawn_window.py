"""Motions drawn from the posterior at the nodes of a window, or of a section."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np

from ..array_types import FloatArray
from ..linalg import interpolate


@dataclass(frozen=True)
class WindowDraws:
    """Deviations of drawn motions from a window's answer, or a section's.

    Attributes
    ----------
    position : ndarray, shape (k, n, 3), m
        Of the IMU at the nodes, in {K}.
    rotation : ndarray, shape (k, n, 3), rad
        In {K}.
    velocity : ndarray, shape (k, n, 3), m/s
        In {K}.
    shoulder : ndarray, shape (k, s, 3), m, or None
        At the knots of a window, at the nodes of a section; None where the camera saw no shoulder.
    upper_rotation : ndarray, shape (k, n, 3), rad, or None
        Of an upper-arm IMU in {K}, nan where it has no samples; None without one.
    """

    position: FloatArray
    rotation: FloatArray
    velocity: FloatArray
    shoulder: FloatArray | None
    upper_rotation: FloatArray | None

    def at_nodes(self, knots: FloatArray, t: FloatArray) -> WindowDraws:
        """With the shoulder at all nodes (n,), by linear interpolation between its knots' times (s,)."""
        if self.shoulder is None:
            return self
        shoulder = np.moveaxis(interpolate(knots, np.moveaxis(self.shoulder, 1, 0), t), 0, 1)
        return replace(self, shoulder=shoulder)

    def columns(self) -> dict[str, FloatArray]:
        """What there is, by name."""
        named = {each.name: getattr(self, each.name) for each in fields(self)}
        return {name: values for name, values in named.items() if values is not None}
