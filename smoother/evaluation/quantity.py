"""Values with their unit as people read them: degrees, centimetres, litres."""

from __future__ import annotations

import math

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
