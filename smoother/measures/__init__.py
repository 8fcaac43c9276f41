"""What clinicians read of a motion: ranges, reach, speed, smoothness, each with its interval."""

from __future__ import annotations

from .measure import Measure, Scope
from .measures import Measures
from .measuring import measure
from .movement import Movement
from .settings import MeasureSettings
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
