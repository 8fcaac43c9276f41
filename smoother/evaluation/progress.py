"""Measures as people read them, over a person's sessions and over persons.

What changed as the intervals support; how reliable measures are without true change; a group's means.
Sources of reliability: Mokkink et al., J Clin Epidemiol 63:737-745 (2010), the terms; Shrout and Fleiss,
Psychological Bulletin 86:420-428 (1979), ICC(2,1); de Vet et al., J Clin Epidemiol 59:1033-1039 (2006),
SEM_agreement and smallest detectable change; Satterthwaite, Biometrics Bulletin 2:110-114 (1946).
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np

from ..array_types import FloatArray
from ..measures.definitions import FEWEST_DRAWS
from ..table import Table, tabulated
from .agreement import (
    detectable_change,
    icc_a1,
    limits_of_agreement,
    mean_squares,
    sigma_interval,
    with_interval,
)

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


def _shown(unit: str) -> tuple[float, str, int]:
    return _SHOWN.get(unit, (1.0, "", 2))


def shown_unit(unit: str) -> str:
    """The unit for people: "cm" for lengths that are stored in m."""
    return _shown(unit)[1].strip()


def scaled(value: float, unit: str) -> float:
    """A value in its unit for people."""
    return value * _shown(unit)[0]


def number(value: float, unit: str, signed: bool = False) -> str:
    """A value in its unit for people, without the unit; a dash where there is none."""
    if not math.isfinite(value):
        return "–"
    factor, _, decimals = _shown(unit)
    if not unit and value == round(value):  # a count
        decimals = 0
    text = f"{factor * value:{'+' if signed else ''}.{decimals}f}"
    return text.replace("-", "−")


def quantity(value: float, unit: str, signed: bool = False) -> str:
    """A value with its unit for people."""
    text = number(value, unit, signed)
    return text if text == "–" else text + _shown(unit)[1]


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


def limits_words(row: Mapping[str, Any]) -> str:
    """Limits of agreement with their unit for people."""
    return interval(row["limits_low"], row["limits_high"], row["unit"], signed=True)


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


def first_of(keys: Collection[str], most: int) -> list[str]:
    """The keys to look at first, at most this many; in their order."""
    ordered = [key for key in FIRST if key in keys]
    ordered += [key for key in dict.fromkeys(keys) if is_main(key) and key not in ordered]
    return ordered[:most]


#: What may be said of a change.
Word = Literal["clearly more", "clearly less", "no clear change", "cannot be assessed"]
MORE: Word = "clearly more"
LESS: Word = "clearly less"
UNCLEAR: Word = "no clear change"
UNKNOWN: Word = "cannot be assessed"
#: An error of a session's value is called one where less than this is likely without any change.
LEVEL = 0.05
#: A value from more recovered samples than this gets a note.
MOSTLY_RECOVERED = 0.5
#: Sessions whose numbers of movements differ more, or the ends of these numbers' intervals, have other
#: movements. Among 540 pairs of simulated sessions the ends alone let one change in the wrong direction pass,
#: both none (`python -m tools.accuracy movements`).
LIKE_NUMBERS, LIKE_ENDS = 0.9, 0.75
#: What none of n draws shows is rarer than this over n, with 95 % (Hanley and Lippman-Hand, JAMA 249, 1983).
RULE_OF_THREE = 3.0
#: Half of a normal interval of 95 %, in standard deviations.
HALF_95 = 1.959964


@dataclass(frozen=True)
class SessionValue:
    """A measure of one session."""

    session: str  # What the session is called
    day: float  # Days since the person's first session; nan where that is not known
    value: float  # The value and its 95 % interval; nan without one
    low: float = math.nan
    high: float = math.nan
    sigma: float = math.nan  # Standard deviation by the draws; nan without them
    recovered_share: float = math.nan  # How much of it comes from samples that the camera did not see
    n_draws: int = 0  # How many draws the interval is of
    note: str = ""  # A note on it; where the value is nan, the reason
    recording: str = ""  # What it was measured on

    @property
    def spread(self) -> float:
        """Its standard deviation: of the draws, or of the interval's wider side; nan without both."""
        widths = [self.sigma, (self.high - self.value) / HALF_95, (self.value - self.low) / HALF_95]
        finite = [width for width in widths if math.isfinite(width)]
        return max(finite) if finite else math.nan


@dataclass(frozen=True)
class Change:
    """A measure in two sessions."""

    first: SessionValue
    last: SessionValue
    difference: float  # Last minus first
    low: float = math.nan  # Its 95 % interval by the draws of both; nan without draws
    high: float = math.nan
    p: float = math.nan  # How likely so large a difference is without any change; nan without draws
    mdc95: float = math.nan  # The minimal detectable change that was given; nan without one
    word: Word = UNKNOWN  # "clearly more", "clearly less", "no clear change" or "cannot be assessed"
    limits: tuple[str, ...] = ()  # What limits the statement, one sentence each
    p_together: float = math.nan  # The same where all measures that were compared count together (Holm 1979)

    @property
    def detectable(self) -> float:
        """The least difference that these two sessions would have shown; nan without draws."""
        half = 0.5 * (self.high - self.low)
        return float(np.fmax(half, self.mdc95)) if math.isfinite(half) else math.nan

    def to_dict(self) -> dict[str, Any]:
        """Plain values by name, as `--json` writes them."""
        names = ("difference", "low", "high", "p", "p_together", "mdc95", "detectable", "word", "limits")
        sessions = {"from": self.first.session, "to": self.last.session}
        return sessions | {name: getattr(self, name) for name in names}


def change_between(first: SessionValue, last: SessionValue, mdc95: float = math.nan) -> Change:
    """Compare a measure of two sessions: clear where beyond its 95 % interval and the detectable change."""
    # errors of both are independent; of a limited number of draws each, so that the difference in sigmas has
    # Student's t with the freedom of Welch and Satterthwaite (Welch, Biometrika 34:28-35, 1947)
    difference = last.value - first.value
    spread = math.hypot(first.spread, last.spread)
    if not math.isfinite(difference) or not math.isfinite(spread):
        return Change(first, last, difference, mdc95=mdc95, limits=_unknown(first, last))
    half, p = _half_and_p(first, last, difference, spread)
    clear = p < LEVEL and not abs(difference) <= mdc95
    word: Word = (MORE if difference > 0 else LESS) if clear else UNCLEAR
    limits = _limits(first, last, p, difference, mdc95)
    if word == UNCLEAR and half > mdc95:  # a change that matters may hide in so wide an interval
        word = UNKNOWN
        limits = ("the interval is wider than the minimal detectable change", *limits)
    return Change(first, last, difference, difference - half, difference + half, p, mdc95, word, limits)


def without_like_movements(
    change: Change, first_count: SessionValue | None, last_count: SessionValue | None
) -> Change:
    """A mean over movements as it is where both sessions have like movements, else not assessed."""
    reason = _unlike(change, first_count, last_count)
    if not reason:
        return change
    limits = (reason, *change.limits)
    return Change(change.first, change.last, math.nan, mdc95=change.mdc95, limits=limits)


def _unlike(change: Change, *counts: SessionValue | None) -> str:
    """Why two sessions' means are over different movements; "" where they are not."""
    numbers, ends, words = [], [], []
    for of, count in zip((change.first, change.last), counts, strict=True):
        if count is None or not math.isfinite(count.value):
            return f"the number of movements of session {of.session} is not known"
        low, high = np.nan_to_num([count.low, count.high], nan=count.value)
        numbers.append(count.value)
        ends += [low, high]
        words.append(f"{count.value:.0f}" + (f" ({low:.0f} to {high:.0f})" if low < high else ""))
    names = f"sessions {change.first.session} and {change.last.session}"
    if min(numbers) < LIKE_NUMBERS * max(numbers) or min(ends) < LIKE_ENDS * max(ends):
        return f"{names} have {words[0]} and {words[1]} movements: their means are not comparable"
    shares = change.first.recovered_share, change.last.recovered_share
    if abs(shares[1] - shares[0]) > MOSTLY_RECOVERED:
        return (
            f"{100 * shares[0]:.0f} % of the movements of session {change.first.session} and"
            f" {100 * shares[1]:.0f} % of session {change.last.session} are recovered: their means are not"
            " comparable"
        )
    return ""


def together(changes: Sequence[Change]) -> list[float]:
    """Probabilities of many comparisons together, by step-down (Holm, Scand J Statistics 6:65-70, 1979)."""
    known = sorted((change.p, place) for place, change in enumerate(changes) if math.isfinite(change.p))
    adjusted, largest = [math.nan] * len(changes), 0.0
    for rank, (p, place) in enumerate(known):
        largest = max(largest, min(1.0, (len(known) - rank) * p))
        adjusted[place] = largest
    return adjusted


def _half_and_p(
    first: SessionValue, last: SessionValue, difference: float, spread: float
) -> tuple[float, float]:
    """Half of the difference's 95 % interval, and how likely so large a one is without any change."""
    if spread == 0:  # counts and answers by yes or no, on which all draws agree
        draws = min(first.n_draws, last.n_draws)
        return 0.0, min(1.0, RULE_OF_THREE / max(draws, 1)) if difference else 1.0
    from scipy.stats import t as student

    parts = [(value.spread**2, max(value.n_draws - 1, 1)) for value in (first, last)]
    total = sum(variance for variance, _ in parts)
    freedom = total**2 / sum(variance**2 / count for variance, count in parts)
    half = float(student.ppf(1 - LEVEL / 2, freedom)) * spread
    return half, float(2 * student.sf(abs(difference) / spread, freedom))


def _unknown(first: SessionValue, last: SessionValue) -> tuple[str, ...]:
    sentences = []
    for value in (first, last):
        note = value.note.rstrip(".")
        if not math.isfinite(value.value):
            sentences.append(f"session {value.session} has no value{f' ({note})' if note else ''}")
        elif not math.isfinite(value.spread):
            sentences.append(
                f"session {value.session} has no interval: it was recovered without drawn motions, or they"
                f" are too few ({FEWEST_DRAWS} are needed, --draws 64)"
            )
    return tuple(dict.fromkeys(sentences))


def _limits(
    first: SessionValue, last: SessionValue, p: float, difference: float, mdc95: float
) -> tuple[str, ...]:
    sentences = []
    if p < LEVEL and abs(difference) <= mdc95:
        sentences.append("the change is larger than its interval but not than the minimal detectable change")
    for value in (first, last):
        if value.recovered_share > MOSTLY_RECOVERED:
            sentences.append(f"more than half of session {value.session} comes from recovered samples")
        if value.value < value.low or value.value > value.high:
            sentences.append(f"session {value.session}: the value lies outside its own interval")
    return tuple(sentences)


@dataclass(frozen=True)
class Series:
    """A measure of one arm over a person's sessions."""

    person: str  # Whose, which arm, and of which recording of a session ("" where a session has one)
    side: str
    task: str
    key: str  # As a `Measure` has them
    name: str
    unit: str
    values: tuple[SessionValue, ...]  # In the order of time
    changes: tuple[Change, ...] = ()  # Each session against the first

    @property
    def change(self) -> Change | None:
        """The last session against the first; None where there is one session."""
        return self.changes[-1] if self.changes else None

    def to_dict(self) -> dict[str, Any]:
        """Plain values by name, as `--json` writes them."""
        about = {name: getattr(self, name) for name in ("person", "side", "task", "key", "name", "unit")}
        changes = [change.to_dict() for change in self.changes]
        return about | {"sessions": [asdict(value) for value in self.values], "changes": changes}


@dataclass(frozen=True)
class PersonProgress:
    """All measures of a person over the sessions."""

    person: str  # What the study calls the person
    sessions: tuple[str, ...]  # The sessions that have a measure, in the order of time
    days: tuple[float, ...]  # Since the first of them; nan where that is not known
    series: tuple[Series, ...]  # By arm, task and measure
    left_out: tuple[str, ...] = ()  # Recordings that take no part, and why; one sentence each
    notes: tuple[str, ...] = ()  # What a reader must know, one sentence each

    @property
    def main(self) -> tuple[Series, ...]:
        """The main measures, those to look at first in front."""
        order = {key: place for place, key in enumerate(FIRST)}
        main = [each for each in self.series if is_main(each.key)]
        return tuple(sorted(main, key=lambda each: order.get(each.key, len(order))))

    @property
    def compared(self) -> tuple[Series, ...]:
        """The main measures of two sessions or more that have intervals."""
        return tuple(each for each in self.main if each.change is not None and math.isfinite(each.change.p))

    @property
    def clear(self) -> tuple[Series, ...]:
        """The main measures that changed clearly."""
        return tuple(each for each in self.main if each.change and each.change.word in (MORE, LESS))

    def to_dict(self) -> dict[str, Any]:
        """Plain values by name, as `--json` writes them."""
        about = {name: getattr(self, name) for name in ("person", "sessions", "days", "left_out", "notes")}
        counts = {"compared": len(self.compared), "clear": len(self.clear)}
        return about | counts | {"measures": [each.to_dict() for each in self.series]}


#: Fewer persons have no figures of reliability.
FEWEST_PERSONS = 3


def reliability_of(persons: Sequence[PersonProgress]) -> list[dict[str, Any]]:
    """How reliable the main measures are over sessions without true change, as `--json` has it.

    ICC(2,1) (two-way random effects, absolute agreement, single measurement); SEM_agreement, with systematic
    differences between sessions; `sdc`, the smallest detectable change of one person, 1.96 sqrt(2) SEM; bias
    and limits of agreement of the second session minus the first, whose `values` they are.
    """
    values: dict[tuple[str, str, str], list[list[float]]] = {}
    about: dict[str, tuple[str, str]] = {}
    for person in persons:
        for series in person.main:
            known = [each.value for each in series.values if np.isfinite(each.value)]
            if len(known) > 1:
                about[series.key] = series.name, series.unit
                values.setdefault((series.side, series.task, series.key), []).append(known)
    found = []
    for (side, task, key), own in values.items():
        if len(own) < FEWEST_PERSONS:
            continue
        ratings = np.array([each[: min(map(len, own))] for each in own])
        row: dict[str, Any] = {
            "side": side,
            "task": task,
            "key": key,
            "name": about[key][0],
            "unit": about[key][1],
        }
        row |= {"persons": len(ratings), "sessions": ratings.shape[1]}
        row |= dict(zip(("icc_21", "icc_21_low", "icc_21_high"), icc_a1(ratings), strict=True))
        sem = sem_agreement(ratings)
        names = ("sem_agreement", "sem_agreement_low", "sem_agreement_high")
        row |= dict(zip(names, sem, strict=True)) | {"sdc": detectable_change(sem[0])}
        row |= limits_of_agreement(ratings[:, 1] - ratings[:, 0])
        found.append(row | {"values": ratings[:, :2].tolist()})
    return found


def sem_agreement(ratings: FloatArray) -> tuple[float, float, float]:  # ratings (n, k)
    """SEM_agreement, sqrt(variance between sessions + error), and its 95 % interval (Satterthwaite)."""
    n, k = ratings.shape
    _, sessions, error = mean_squares(ratings)
    parts = [(sessions / n, k - 1), ((n - 1) / n * error, (n - 1) * (k - 1))]
    if sessions <= error * (1 + 1e-12):  # the sessions do not differ: a variance is not negative
        parts = [(error, (n - 1) * (k - 1))]
    variance = sum(part for part, _ in parts)
    if variance <= 0:
        return 0.0, 0.0, 0.0
    freedom = variance**2 / sum(part**2 / count for part, count in parts)
    return float(np.sqrt(variance)), *sigma_interval(float(np.sqrt(variance)), freedom)


def reliability_table(found: Sequence[Mapping[str, Any]]) -> Table:
    """The same for people."""
    return tabulated(
        "Reliability, for sessions without true change",
        found,
        {
            "measure": lambda one: ", ".join(filter(None, (one["name"], one["side"], one["task"]))),
            "persons": lambda one: f"{one['persons']} x {one['sessions']}",
            "ICC(2,1), 95 %": lambda one: with_interval(one, "icc_21", 2) or "-",
            "SEM agreement": lambda one: quantity(one["sem_agreement"], one["unit"]),
            "SDC": lambda one: quantity(one["sdc"], one["unit"]),
            "limits": limits_words,
        },
    )


#: Measures of a group's table.
MOST_MEASURES = 12


def group_measures(rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """The main measures over the persons of a study's long rows, without what is not to be trusted.

    Count, mean and standard deviation of the persons' `first` sessions and of the `last` of those who have
    several; mean change between them with its interval by Student's t over the persons.
    """
    from scipy.stats import t

    values: dict[tuple[str, str, str], dict[str, dict[int, float]]] = {}
    about: dict[str, tuple[str, str]] = {}
    for row in rows:
        if not row["trusted"] or row["value"] is None:
            continue
        about[row["measure"]] = row["name"], row["unit"] or ""
        persons = values.setdefault((row["side"], row["task"], row["measure"]), {})
        persons.setdefault(row["person"], {})[row["session_number"]] = float(row["value"])
    keys = first_of(list(about), MOST_MEASURES)
    chosen = sorted((key for key in values if key[2] in keys), key=lambda key: (*key[:2], keys.index(key[2])))
    found = []
    for key in chosen:
        sessions = [[each[number] for number in sorted(each)] for each in values[key].values()]
        several = [each for each in sessions if len(each) > 1]
        count, mean, sd = _spread([each[-1] - each[0] for each in several])
        half = float(t.ppf(0.975, count - 1)) * sd / math.sqrt(count) if count > 1 else math.nan
        row = dict(zip(("side", "task", "key", "name", "unit"), (*key, *about[key[2]]), strict=True))
        row |= {"first": _spread([each[0] for each in sessions])}
        row |= {"last": _spread([each[-1] for each in several])}
        found.append(row | {"change": mean, "low": mean - half, "high": mean + half})
    return found


def _spread(values: Sequence[float]) -> tuple[int, float, float]:
    """Count, mean (nan without any) and standard deviation (nan without two)."""
    count = len(values)
    mean = float(np.mean(values)) if count else math.nan
    return count, mean, float(np.std(values, ddof=1)) if count > 1 else math.nan
