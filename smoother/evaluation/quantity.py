"""Measures as people read them: values with their unit, and which of many come first."""

from __future__ import annotations

import math
from collections.abc import Collection

#: By the unit of a measure: factor, unit for people, decimals.
_SHOWN: dict[str, tuple[float, str, int]] = {
    "deg": (1.0, "°", 1),
    "deg/s": (1.0, "°/s", 0),
    "m": (100.0, "\u00a0cm", 1),
    "m/s": (1.0, "\u00a0m/s", 2),
    "l": (1.0, "\u00a0litres", 1),
    "s": (1.0, "\u00a0s", 2),
    "%": (1.0, "\u00a0%", 1),
}


def shown_unit(unit: str) -> str:
    """The unit for people: "cm" for lengths that are stored in m."""
    return _SHOWN.get(unit, (1.0, "", 2))[1].strip()


def scaled(value: float, unit: str) -> float:
    """A value in its unit for people."""
    return value * _SHOWN.get(unit, (1.0, "", 2))[0]


def number(value: float, unit: str, signed: bool = False) -> str:
    """A value in its unit for people, without the unit; a dash where there is none."""
    if not math.isfinite(value):
        return "–"
    factor, _, decimals = _SHOWN.get(unit, (1.0, "", 2))
    if not unit and value == round(value):  # a count
        decimals = 0
    text = f"{factor * value:{'+' if signed else ''}.{decimals}f}"
    return text.replace("-", "−")


def quantity(value: float, unit: str, signed: bool = False) -> str:
    """A value with its unit for people."""
    text = number(value, unit, signed)
    return text if text == "–" else text + _SHOWN.get(unit, (1.0, "", 2))[1]


def worded(key: str, value: float, unit: str) -> str:
    """A measure's value for people: yes or no for what was reached."""
    if key.endswith("_reached") and math.isfinite(value):
        return "yes" if value >= 1 else "no"
    return quantity(value, unit)


def interval(low: float, high: float, unit: str, signed: bool = False) -> str:
    """An interval with its unit for people; "" where there is none."""
    if not math.isfinite(low) or not math.isfinite(high):
        return ""
    return f"{number(low, unit, signed)} to {quantity(high, unit, signed)}"


#: Those that a reader looks at first, in that order.
FIRST = (
    *("elbow_flexion_range_deg", "shoulder_elevation_max_deg", "hand_reach_hull_l"),
    *("hand_peak_speed_m_s", "sparc", "pronation_range_deg", "elbow_flexion_min_deg"),
    *("shoulder_elevation_range_deg", "movement_duration_s", "hand_path_ratio"),
)
#: Those that grow with the length of the recording, whatever the person does.
OF_LENGTH = ("duration_s", "hand_path_length_m", "movement_count", "repetition_count")
#: Those that are means over the movements of a session, or of one of them.
BY_MOVEMENT = (
    *("sparc", "ldlj_v", "velocity_peaks", "hand_path_ratio", "movement_duration_s"),
    *("hand_time_to_peak_s", "hand_time_to_peak_percent"),
)
#: Details of an angle's distribution: in files, not on pages.
_DETAILS = ("_zone_", "_p5_", "_p25_", "_p50_", "_p75_", "_p95_")


def is_main(key: str) -> bool:
    """Whether a table for people shows this measure: no detail, and not one of the recording's length."""
    return key not in OF_LENGTH and not any(detail in key for detail in _DETAILS)


def first_of(keys: Collection[str], most: int) -> list[str]:
    """The keys to look at first, at most so many; in their order."""
    ordered = [key for key in FIRST if key in keys]
    ordered += [key for key in dict.fromkeys(keys) if is_main(key) and key not in ordered]
    return ordered[:most]
