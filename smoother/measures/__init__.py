"""What clinicians read of a motion: ranges, reach, speed, smoothness, each with its interval."""

from __future__ import annotations

from .measure import Measure, Measures, MeasureSettings, Movement, Scope
from .measuring import measure
from .symmetry import BothArms, measure_both

__all__ = [
    "BothArms",
    "Measure",
    "MeasureSettings",
    "Measures",
    "Movement",
    "Scope",
    "measure",
    "measure_both",
]
