"""Sentences, and measures as people read them: in their units, and which come first."""

from __future__ import annotations

import math
import re
import tomllib
from collections.abc import Collection, Iterable, Iterator, Mapping
from functools import cache
from importlib import resources
from typing import TYPE_CHECKING, Any

from ..table import Table, percent

if TYPE_CHECKING:
    from ..measures import Measure, Measures


def texts(document: str) -> dict[str, Any]:
    """The texts of a TOML document, each on one line."""

    def flat(value: Any) -> Any:
        if isinstance(value, dict):
            return {name: flat(each) for name, each in value.items()}
        return re.sub(r"\s*\n\s*", " ", value)

    found: dict[str, Any] = flat(tomllib.loads(document))
    return found


@cache
def _sentences() -> dict[str, dict[str, str]]:
    return texts(resources.files(__package__).joinpath("sentences.toml").read_text(encoding="utf-8"))


def said(about: str, name: str, **given: object) -> str:
    """A sentence of `sentences.toml`, filled in."""
    return _sentences()[about][name].format(**given)


def listed(names: Iterable[str]) -> str:
    """Names in a sentence, as "a, b and c"."""
    *first, last = list(names) or [""]
    return f"{', '.join(first)} and {last}" if first else last


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
_PURE = (1.0, "", 2)


def shown_unit(unit: str) -> str:
    """The unit for people: "cm" for lengths that are stored in m."""
    return _SHOWN.get(unit, _PURE)[1].strip()


def scaled(value: float, unit: str) -> float:
    """A value in its unit for people."""
    return value * _SHOWN.get(unit, _PURE)[0]


def number(value: float, unit: str, signed: bool = False) -> str:
    """A value in its unit for people, without the unit; a dash where there is none."""
    if not math.isfinite(value):
        return "–"
    decimals = 0 if not unit and value == round(value) else _SHOWN.get(unit, _PURE)[2]  # 0: a count
    return f"{scaled(value, unit):{'+' if signed else ''}.{decimals}f}".replace("-", "−")


def quantity(value: float, unit: str, signed: bool = False) -> str:
    """A value with its unit for people."""
    text = number(value, unit, signed)
    return text if text == "–" else text + _SHOWN.get(unit, _PURE)[1]


def worded(key: str, value: float, unit: str) -> str:
    """A measure's value for people: yes or no for what was reached, a sign for what is to one side."""
    if key.endswith("_reached") and math.isfinite(value):
        return "yes" if value >= 1 else "no"
    return quantity(value, unit, is_signed(key))


def is_signed(key: str) -> bool:
    """Whether a measure's sign names a side: more on the right, or more on the left."""
    return key.endswith("_symmetry_percent")


def interval(low: float | None, high: float | None, unit: str, signed: bool = False) -> str:
    """An interval with its unit for people; "" where there is none."""
    if low is None or high is None or not math.isfinite(low) or not math.isfinite(high):
        return ""
    return f"{number(low, unit, signed)} to {quantity(high, unit, signed)}"


def measure_words(row: Measure | None) -> str:
    """The value of a measure, its 95 % interval in brackets, and the unit."""
    if row is None:
        return "–"
    value, between = worded(row.key, row.value, row.unit), interval(row.low, row.high, row.unit)
    if row.key.endswith("_reached") and row.has_interval:
        return value if row.low == row.high else f"{value} (no to yes)"
    if not row.has_interval or row.unit.startswith("deg"):
        return f"{value} ({between})" if between else value
    value, low, high = (number(each, row.unit, is_signed(row.key)) for each in (row.value, row.low, row.high))
    return f"{value} ({low} to {high})\u00a0{shown_unit(row.unit)}".rstrip()


def measure_table(title: str, first: str, rows: Iterable[Measure]) -> Table:
    """Measures that are known, with their intervals and how much of each was recovered."""

    def recovered(row: Measure) -> str:
        share = percent(row.recovered_share) or "-"
        return f"{share} ({percent(row.untrusted_share)} not trusted)" if row.note else share

    cells = [(row.name, measure_words(row), recovered(row)) for row in rows if row.is_known]
    return Table(title, (first, "value (95 % interval)", "recovered"), cells)


def not_measured(arm: Measures) -> Iterator[str]:
    """What of a session is not known: each reason with its measures."""
    unknown = [row for row in arm.session if not row.is_known and row.note]
    for reason in dict.fromkeys(row.note for row in unknown):
        names = dict.fromkeys(row.name.partition(",")[0] for row in unknown if row.note == reason)
        yield f"not measured: {', '.join(names)}. {reason}"


def limits_words(row: Mapping[str, Any]) -> str:
    """Limits of agreement with their unit for people."""
    return interval(row["limits_low"], row["limits_high"], row["unit"], signed=True)


def with_interval(row: Mapping[str, Any], name: str = "icc", digits: int = 3) -> str | None:
    """A coefficient with its interval, for a cell; None where there is none."""
    value, low, high = (row[f"{name}{end}"] for end in ("", "_low", "_high"))
    return None if value is None else f"{value:.{digits}f} ({low:.{digits}f} to {high:.{digits}f})"


#: Those that a reader looks at first, in that order.
FIRST = (
    *("elbow_flexion_range_deg", "shoulder_elevation_max_deg", "hand_reach_hull_l"),
    *("hand_peak_speed_m_s", "sparc", "pronation_range_deg", "elbow_flexion_min_deg"),
    *("shoulder_elevation_range_deg", "movement_duration_s", "hand_path_ratio"),
)
#: Those that grow with the length of the recording, whatever the person does.
OF_LENGTH = ("duration_s", "hand_path_length_m", "movement_count", "repetition_count")
#: Details of an angle's distribution: in files, not on pages.
_DETAILS = ("_zone_", "_p5_", "_p25_", "_p50_", "_p75_", "_p95_")


def is_main(key: str) -> bool:
    """Whether a table for people shows this measure: no detail, and not one of the recording's length."""
    return key not in OF_LENGTH and not any(detail in key for detail in _DETAILS)


def first_of(keys: Collection[str], most: int | None = None) -> list[str]:
    """The keys to look at first, at most this many; in their order."""
    ordered = [key for key in FIRST if key in keys]
    return [*ordered, *(key for key in dict.fromkeys(keys) if is_main(key) and key not in ordered)][:most]
