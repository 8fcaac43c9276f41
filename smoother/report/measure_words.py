"""One measure in words, for a page: value and interval, reached or not, right against left."""

from __future__ import annotations

import math
from collections.abc import Sequence
from html import escape

from ..evaluation.progress import SessionValue, change_between
from ..evaluation.quantity import interval, number, quantity, shown_unit
from ..measures import Measure, Measures
from .chart import Mark, badge


def with_interval(row: Measure) -> str:
    """The value, its 95 % interval in brackets, and the unit."""
    if not row.has_interval:
        return quantity(row.value, row.unit)
    if row.unit.startswith("deg"):
        return f"{quantity(row.value, row.unit)} ({interval(row.low, row.high, row.unit)})"
    between = f"{number(row.low, row.unit)} to {number(row.high, row.unit)}"
    return f"{number(row.value, row.unit)} ({between})\u00a0{shown_unit(row.unit)}".rstrip()


def share(row: Measure | None) -> str:
    """How much rests on recovered samples, in percent."""
    if row is None or not math.isfinite(row.recovered_share):
        return "–"
    return f"{100 * row.recovered_share:.0f}\u00a0%"


def mark_of(row: Measure, name: str = "") -> Mark:
    """The value as it is drawn."""
    return Mark(name, row.value, row.low, row.high, number(row.value, row.unit))


def reached(arm: Measures, key: str) -> str:
    """In words where the draws agree, and how near the hand came, as HTML."""
    row = arm.by_key.get(key)
    if row is None or not row.has_interval or row.low != row.high:
        word = "cannot be said"
    else:
        word = "reached" if row.value >= 1 else "not reached"
    return f"{badge(word)} {escape(_distance(arm, key))}"


def _distance(arm: Measures, key: str) -> str:
    """How near the hand came, where it was not there."""
    row = arm.by_key.get(key.replace("_reached", "_distance_m"))
    if row is None or not row.is_known or row.value <= 0:
        return ""
    return f"{with_interval(row)} away"


def listed(names: Sequence[str]) -> str:
    """Two names, or the first and how many more."""
    return ", ".join(names) if len(names) <= 2 else f"{names[0]} and {len(names) - 1} measures more"


def of_arm(arm: Measures, arms: Sequence[Measures]) -> str:
    """Which arm, where there are several."""
    return f", {arm.arm_label.replace(' arm', '')}" if len(arms) > 1 else ""


def capitalised(text: str) -> str:
    """With a capital at the start."""
    return text[:1].upper() + text[1:]


def both_arms(arms: Sequence[Measures]) -> tuple[Measures, Measures] | None:
    """Left and right arm of one person, both to be trusted."""
    by_side = {arm.side: arm for arm in arms}
    if len(arms) != 2 or by_side.keys() != {"left", "right"} or arms[0].body != arms[1].body:
        return None
    if any(arm.trusted is False for arm in arms):
        return None
    return by_side["left"], by_side["right"]


def compared(left: Measures, right: Measures, key: str) -> str:
    """Whether the right arm clearly has more, in words."""
    one, other = left.by_key.get(key), right.by_key.get(key)
    if one is None or other is None:
        return "cannot be said"
    word = change_between(_value(one, "left"), _value(other, "right")).word
    return "no clear difference" if word == "no clear change" else word


def symmetry(index: Measure | None) -> str:
    """A symmetry index and its interval in whole percent, behind a word; "" where there is none."""
    if index is None or not index.is_known:
        return ""
    between = f" ({index.low:.0f} to {index.high:.0f})" if index.has_interval else ""
    return f" {index.value:+.0f}\u00a0%{between}".replace("-", "−")


def _value(row: Measure, side: str) -> SessionValue:
    return SessionValue(
        side, 0.0, row.value, row.low, row.high, row.sigma, row.recovered_share, row.n_draws, row.note
    )
