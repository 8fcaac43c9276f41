"""Units as files write them, and what one of them is in SI."""

from __future__ import annotations

import math
import re

from ...units import STANDARD_GRAVITY

#: m/s^2 in one unit, by the unit in its plain form (see `plain_unit`).
ACCELERATION = {
    **dict.fromkeys(
        ("m/s^2", "m/s2", "m/(s^2)", "m/(sec^2)", "m/s/s", "ms^-2", "m.s^-2", "m*s^-2", "m/s**2"), 1.0
    ),
    **dict.fromkeys(("mps2", "ms2", "m_s2", "ms-2", "mps^2"), 1.0),
    **dict.fromkeys(("g", "gs", "gn", "gravity"), STANDARD_GRAVITY),
    **dict.fromkeys(("mg", "milli-g"), STANDARD_GRAVITY / 1000),
}
#: rad/s in one unit.
ANGULAR_VELOCITY = {
    **dict.fromkeys(("rad/s", "rads/s", "radian/s", "radians/s", "rad*s^-1", "rad.s^-1", "rads^-1"), 1.0),
    **dict.fromkeys(("rads", "rad_s", "radps", "r/s"), 1.0),
    **dict.fromkeys(
        ("deg/s", "degs/s", "degree/s", "degrees/s", "dps", "deg*s^-1", "deg.s^-1"), math.pi / 180
    ),
    **dict.fromkeys(("deg_s", "degs", "d/s", "degps"), math.pi / 180),
    **dict.fromkeys(("mdps", "mdeg/s"), math.pi / 180_000),
}
#: s in one unit.
TIME = {
    **dict.fromkeys(("s", "seconds", "second"), 1.0),
    **dict.fromkeys(("ms", "milliseconds", "msec", "msecs", "millis"), 1e-3),
    **dict.fromkeys(("us", "usec", "microseconds", "micros"), 1e-6),
    **dict.fromkeys(("ns", "nsec", "nanoseconds", "nanos"), 1e-9),
}
_OTHERS = (
    *("ut", "t", "nt", "mt", "gauss", "ga", "mgauss", "au", "a.u.", "arbitrary", "local_flux", "flux"),
    *("mv", "v", "kpa", "pa", "hpa", "mbar", "bar", "degc", "c", "celsius", "degreecelsius"),
    *("k", "%", "lux", "m", "mm", "cm", "deg", "degree", "degrees", "rad", "radians", "hz", "no_units"),
    *("nounits", "counts", "count", "lsb", "raw", "adc", "quaternion", "unitless", "none", "n/a", "-"),
    *("degreescelsius", "yyyy-mm-dd", "hh:mm:ss"),
)
_UNITS = frozenset((*ACCELERATION, *ANGULAR_VELOCITY, *TIME, *_OTHERS))
_BRACKETED = re.compile(r"\s*[\(\[]([^()\[\]]*(?:\([^()]*\))?[^()\[\]]*)[\)\]]\s*$")
#: Units that are spelled behind a name: acc_x_mps2, gyro_x_dps, time_ms.
_SPELLED = re.compile(
    r"(.*[xyz])_(mps2|ms2|m_s2|ms-2|g|mg|dps|rads|rad_s|radps|deg_s|degs)"
    r"|(timestamp|time|t|elapsed|epoch)_(s|ms|us|ns)",
    re.IGNORECASE,
)
#: What stands in brackets behind a name and belongs to it: dv[1], Acc (x).
_INDEX = re.compile(r"\d+|[xyzw]", re.IGNORECASE)


def plain_unit(text: str) -> str:
    """A unit in the form that the tables above have it: `[m/s²]` is "m/s^2", `°/s` is "deg/s"."""
    unit = text.strip().strip('"').strip().lower()
    while len(unit) > 1 and (unit[0], unit[-1]) in (("(", ")"), ("[", "]")):
        unit = unit[1:-1].strip()
    for sign, plain in (("²", "^2"), ("µ", "u"), ("μ", "u"), ("°", "deg"), ("⁻¹", "^-1"), (" ", "")):
        unit = unit.replace(sign, plain)
    return re.sub(r"/sec(onds?)?\b", "/s", unit)


def is_unit(text: str) -> bool:
    """Whether a cell holds nothing but a unit."""
    return plain_unit(text) in _UNITS


def split_unit(name: str) -> tuple[str, str]:
    """A column's name without the unit behind it, and that unit ("" where there is none)."""
    bracketed = _BRACKETED.search(name)
    if bracketed and bracketed.start() and not _INDEX.fullmatch(bracketed.group(1).strip()):
        return name[: bracketed.start()].strip(), bracketed.group(1).strip()
    spelled = _SPELLED.fullmatch(name.strip())
    if spelled:
        stem, unit = (part for part in spelled.groups() if part is not None)
        return stem, unit
    return name.strip(), ""
