"""Constants with units."""

from __future__ import annotations

#: Gravity that a recovery reckons with, m/s^2: between the equator's 9.78 and the poles' 9.83.
GRAVITY = 9.81
#: The unit "g" in which sensors state specific force, m/s^2 (CGPM 1901).
STANDARD_GRAVITY = 9.80665
