"""Units as files write them, and those that a file does not state, by the size of its values."""

from __future__ import annotations

import math
import re

import numpy as np

from ...array_types import FloatArray
from ...units import STANDARD_GRAVITY


def _factors(**units: tuple[float, str]) -> dict[str, float]:
    return {name: factor for factor, names in units.values() for name in names.split()}


#: m/s^2 in one unit, by the unit in its plain form (see `plain_unit`); the first name is recording.toml's.
ACCELERATION = _factors(
    si=(1.0, "m/s^2 m/s2 m/(s^2) m/(sec^2) m/s/s ms^-2 m.s^-2 m*s^-2 m/s**2 mps2 ms2 m_s2 ms-2 mps^2"),
    g=(STANDARD_GRAVITY, "g gs gn gravity"),
    mg=(STANDARD_GRAVITY / 1000, "mg milli-g"),
    cm=(0.01, "cm/s^2 cm/s2 gal"),
    mm=(0.001, "mm/s^2 mm/s2"),
)
#: rad/s in one unit.
ANGULAR_VELOCITY = _factors(
    si=(1.0, "rad/s rads/s radian/s radians/s rad*s^-1 rad.s^-1 rads^-1 rads rad_s radps r/s"),
    degrees=(
        math.pi / 180,
        "deg/s degs/s degree/s degrees/s dps deg*s^-1 deg.s^-1 deg_s degs d/s degps",
    ),
    milli=(math.pi / 180_000, "mdps mdeg/s"),
)
TICKS, DAYS = "ticks of 100 ns", "days"
#: Words for units of time, by the unit in sentences.
_TIME_WORDS = {
    "s": "s sec secs second seconds",
    "ms": "ms msec msecs milli millis millisecond milliseconds",
    "us": "us usec usecs micro micros microsecond microseconds",
    "ns": "ns nsec nsecs nano nanos nanosecond nanoseconds",
    TICKS: "100ns ticks ticksof100ns",
    DAYS: "days datenum",
}
#: Unit of time by the words that files use for it.
TIME = {word: unit for unit, words in _TIME_WORDS.items() for word in words.split()}
#: s in one unit, by the unit in sentences, in the order in which they are tried.
SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, TICKS: 1e-7, DAYS: 86_400.0}
#: Metres in a unit, by the names that files use.
METRES = _factors(
    m=(1.0, "m meter meters metre metres"),
    dm=(0.1, "dm decimeters decimetres"),
    cm=(0.01, "cm centimeter centimeters centimetres"),
    mm=(0.001, "mm millimeter millimeters millimetres"),
    inch=(0.0254, "in inch inches"),
)
_OTHERS = _factors(
    field=(1.0, "ut t nt mt gauss ga mgauss au a.u. arbitrary local_flux flux"),
    others=(1.0, "mv v kpa pa hpa mbar bar degc c celsius degreecelsius degreescelsius k % lux hz"),
    place=(1.0, "m mm cm deg degree degrees rad radians quaternion"),
    none=(1.0, "no_units nounits counts count lsb raw adc unitless none n/a - yyyy-mm-dd hh:mm:ss"),
)
#: Every unit that a cell may hold, in its plain form.
UNITS = frozenset((*ACCELERATION, *ANGULAR_VELOCITY, *TIME, *_OTHERS))
_BRACKETED = re.compile(r"\s*[\(\[]([^()\[\]]*(?:\([^()]*\))?[^()\[\]]*)[\)\]]\s*$")
#: Units that are spelled behind a name: acc_x_mps2, gyro_x_dps, time_ms.
_SPELLED = re.compile(
    r"(.*[xyz])_(mps2|ms2|m_s2|ms-2|g|mg|dps|rads|rad_s|radps|deg_s|degs)"
    r"|(timestamp|(?:\w+_)?time(?:_in)?|t|elapsed|epoch|unix)_(s|ms|us|ns|100ns|ticks|days)",
    re.IGNORECASE,
)
#: What is in brackets behind a name and belongs to it: dv[1], Acc (x).
_INDEX = re.compile(r"\d+|[xyzw]", re.IGNORECASE)


def plain_unit(text: str) -> str:
    """A unit in the form that the tables above have it: `[m/s²]` is "m/s^2", `°/s` is "deg/s"."""
    unit = text.strip().strip('"').strip().lower()
    while len(unit) > 1 and (unit[0], unit[-1]) in (("(", ")"), ("[", "]")):
        unit = unit[1:-1].strip()
    for sign, plain in (("²", "^2"), ("µ", "u"), ("μ", "u"), ("°", "deg"), ("⁻¹", "^-1"), (" ", "")):
        unit = unit.replace(sign, plain)
    return re.sub(r"/sec(onds?)?\b", "/s", unit)


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


#: Rates that a sensor may have, Hz: times are of the unit that gives one of these.
SENSOR_RATES = (3.0, 2500.0)
#: Frame rates of cameras, Hz.
CAMERA_RATES = (4.0, 260.0)
#: The years 1990 and 2100 since 1970, s.
DATED_S = (631_152_000.0, 4_102_444_800.0)
#: 1970 as ticks (.NET, FILETIME) and days (spreadsheets, MATLAB) count it, s.
_SINCE_S = {TICKS: (62_135_596_800.0, 11_644_473_600.0), DAYS: (2_209_161_600.0, 62_167_305_600.0)}
#: Where two units fit and no date decides, the first is believed at such rates of a sensor, of a camera, Hz.
_USUAL, _USUAL_CAMERA = (20.0, 1250.0), (7.0, 130.0)


def time_unit(stated: str, times: FloatArray, rates_hz: tuple[float, float] = SENSOR_RATES) -> str | None:
    """Unit in which times (n,) give a rate within bounds, the stated one first; None if it is not clear."""
    dt = np.diff(times[np.isfinite(times)])
    rises = dt[dt > 0]
    if not len(rises):
        return None
    # samples of a packet that share its stamp count; rows of a skeleton may be joints of one frame
    dt = rises if rates_hz == CAMERA_RATES else dt[dt >= 0]
    step, at = float(np.minimum(dt, 20 * np.median(rises)).mean()), float(np.nanmedian(times))
    rates = {unit: 1 / (step * seconds) for unit, seconds in SECONDS.items()}
    fitting = [
        unit
        for unit in (TICKS, *rates)  # a date in ticks of .NET would be one of 1990 in ns
        if rates_hz[0] <= rates[unit] <= rates_hz[1] and (_epoch(at, unit) or at * SECONDS[unit] < DATED_S[1])
    ]
    if stated in fitting:
        return stated
    dated = [unit for unit in fitting if _epoch(at, unit) is not None]
    fitting = dated or [unit for unit in rates if unit in fitting]
    low, high = _USUAL_CAMERA if rates_hz == CAMERA_RATES else _USUAL
    # Ticks and us are a factor of 10 apart: without a date 8 Hz in one are 80 Hz in the other.
    unclear = len(fitting) > 1 and not dated and not low <= rates[fitting[0]] <= high
    return fitting[0] if fitting and not unclear else None


def _epoch(at: float, unit: str) -> float | None:
    """Where times count from, s before 1970, if they are dates of 1990 to 2100 then; None where not."""
    # Ticks since 1970 are rare, and look like the ns that a phone counts since it was started.
    starts = _SINCE_S.get(unit, (0.0,))
    fitting = (start for start in starts if DATED_S[0] <= at * SECONDS[unit] - start <= DATED_S[1])
    return next(fitting, None)


def from_1970(times: FloatArray, unit: str) -> FloatArray:
    """Times (n,) in a unit; ticks that count from the year 1 or 1601 count from 1970 then."""
    start = _epoch(float(np.nanmedian(times)), unit) if np.isfinite(times).any() else None
    return times - start / SECONDS[unit] if start else times


def in_seconds(times: FloatArray, unit: str) -> FloatArray:
    """Times (n,) in a unit, or of dates ("iso", which are in s), in s."""
    return times if unit == "iso" else from_1970(times, unit) * SECONDS[unit]


#: What gravity reads at rest, by the unit; raw counts of a range of 4 g (8192 a g) are no mm/s^2.
_GRAVITY = {"m/s^2": STANDARD_GRAVITY, "g": 1.0, "mg": 1000.0}


def gravity_unit(size: float, low: float = 0.7, high: float = 1.4) -> str:
    """The unit in which a size is about gravity; "" where in none."""
    return next((unit for unit, one in _GRAVITY.items() if low < size / one < high), "")


def unit_of_rest(size: float) -> str:
    """Unit in which a specific force of that size at rest is gravity, if it is another one than m/s^2."""
    unit = gravity_unit(size).removeprefix("m/s^2")
    return unit or ("mm/s^2" if 0.7 < size / (1000 * STANDARD_GRAVITY) < 1.4 else "")
