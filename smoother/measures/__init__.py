"""What clinicians read of a motion: ranges, reach, speed, smoothness, each with its interval."""

from __future__ import annotations

from .measure import Measure, Scope
from .measures import Measures
from .movement import Movement

__all__ = ["Measure", "Measures", "Movement", "Scope"]
