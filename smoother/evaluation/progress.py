"""Changes of a person's measures over sessions, and their reliability."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import Any, Literal

import numpy as np

from calib.file import toml_document

from ..errors import UnoccludeError
from ..measures.definitions import FEWEST_DRAWS, definitions, is_measure
from ..table import Table, percent, tabulated
from .statistics import detectable_change, icc_a1, limits_of_agreement, sem_agreement
from .words import FIRST, interval, is_main, limits_words, quantity, said, with_interval, worded

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
        return max((width for width in widths if math.isfinite(width)), default=math.nan)


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
        limits = tuple(dict.fromkeys(filter(None, map(_lacks, (first, last)))))
        return Change(first, last, difference, mdc95=mdc95, limits=limits)
    half, p = _half_and_p(first, last, difference, spread)
    clear = p < LEVEL and not abs(difference) <= mdc95
    word: Word = (MORE if difference > 0 else LESS) if clear else UNCLEAR
    found: list[str] = []
    if not clear and half > mdc95:  # a change that matters may hide in so wide an interval
        word = UNKNOWN
        found = ["the interval is wider than the minimal detectable change"]
    if p < LEVEL and not clear:
        found.append("the change is larger than its interval but not than the minimal detectable change")
    for value in (first, last):
        if value.recovered_share > MOSTLY_RECOVERED:
            found.append(f"more than half of session {value.session} comes from recovered samples")
        if value.value < value.low or value.value > value.high:
            found.append(f"session {value.session}: the value lies outside its own interval")
    ends = (difference - half, difference + half)
    return Change(first, last, difference, *ends, p, mdc95, word, tuple(found))


def _lacks(value: SessionValue) -> str:
    """What is missing from a session's value, in words."""
    if not math.isfinite(value.value):
        why = f" ({value.note.rstrip('.')})" if value.note else ""
        return f"session {value.session} has no value{why}"
    if math.isfinite(value.spread):
        return ""
    return said("progress", "no_interval", session=value.session, draws=FEWEST_DRAWS)


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
    sessions, numbers, ends, words = (change.first, change.last), [], [], []
    first, last = (of.session for of in sessions)
    for of, count in zip(sessions, counts, strict=True):
        if count is None or not math.isfinite(count.value):
            return f"the number of movements of session {of.session} is not known"
        low, high = np.nan_to_num([count.low, count.high], nan=count.value)
        numbers.append(count.value)
        ends += [low, high]
        words.append(f"{count.value:.0f}" + (f" ({low:.0f} to {high:.0f})" if low < high else ""))
    if min(numbers) < LIKE_NUMBERS * max(numbers) or min(ends) < LIKE_ENDS * max(ends):
        return said("progress", "unlike_numbers", first=first, last=last, one=words[0], other=words[1])
    shares = [of.recovered_share for of in sessions]
    if abs(shares[1] - shares[0]) > MOSTLY_RECOVERED:
        one, other = (100 * share for share in shares)
        return said("progress", "unlike_shares", first=first, last=last, one=one, other=other)
    return ""


def together(changes: Sequence[Change]) -> list[float]:
    """Probabilities of many comparisons together, by step-down (Holm, Scand J Statistics 6:65-70, 1979)."""
    known = sorted((change.p, place) for place, change in enumerate(changes) if math.isfinite(change.p))
    adjusted, largest = [math.nan] * len(changes), 0.0
    for rank, (p, place) in enumerate(known):
        largest = max(largest, min(1.0, (len(known) - rank) * p))
        adjusted[place] = largest
    return adjusted


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


SESSIONS_VARY = (
    "A clear change is one that errors of the measurement do not explain. A person also varies from day"
    " to day, with effort, pain and how the task was given: two sessions alone do not show a trend"
)
NO_SESSION = "No session can be used; the reasons are below"


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
    def changed(self) -> list[tuple[Series, Change]]:
        """The main measures of two sessions or more, each with its last change."""
        return [(each, each.change) for each in self.main if each.change is not None]

    @property
    def compared(self) -> tuple[Series, ...]:
        """Those that have intervals."""
        return tuple(each for each, change in self.changed if math.isfinite(change.p))

    @property
    def clear(self) -> tuple[Series, ...]:
        """Those that changed clearly."""
        return tuple(each for each, change in self.changed if change.word in (MORE, LESS))

    def label(self, series: Series) -> str:
        """A measure's name, with arm and task where there are several."""
        several = len({each.side for each in self.series}) > 1
        side = f"{series.side} arm" if several and series.side else ""
        return ", ".join(filter(None, (series.name, side, series.task)))

    @property
    def limits(self) -> list[str]:
        """What limits the statements: a sentence each, the most frequent first, and of which measures."""
        about: dict[str, list[str]] = {}
        for series, change in self.changed:
            for sentence in change.limits:
                about.setdefault(sentence, []).append(self.label(series))
        return [
            f"{sentence} ({', '.join(names) if len(names) <= 2 else f'{len(names)} measures'})"
            for sentence, names in sorted(about.items(), key=lambda item: -len(item[1]))
        ]

    def sentences(self) -> Iterator[str]:
        """What changed, and how much of that chance explains."""
        words = [change.word for _, change in self.changed]
        if not words:
            yield "There is one session only: nothing can be compared" if self.sessions else NO_SESSION
            return
        clear, compared = len(self.clear), len(self.compared)
        unclear, unknown = (words.count(word) or "none" for word in (UNCLEAR, UNKNOWN))
        yield (
            f"From session {self.sessions[0]} to session {self.sessions[-1]} {clear or 'none'} of"
            f" {len(words)} measures changed clearly; {unclear} did not, {unknown} cannot be assessed"
        )
        for word in (MORE, LESS):
            names = [self.label(each) for each, change in self.changed if change.word == word]
            if names:
                more = f" and {len(names) - 4} more" if len(names) > 4 else ""
                yield f"{word.capitalize()}: {'; '.join(names[:4])}{more}"
        if compared >= 5 and clear:
            stand = [
                self.label(each) for each in self.clear if each.change and each.change.p_together < LEVEL
            ]
            remain = f"{'; '.join(stand[:3])}{' and others' if len(stand) > 3 else ''}" or "nothing"
            yield (
                f"Of {compared} measures about {LEVEL * compared:.1f} would be called clear by chance alone;"
                f" clear after correction for that (Holm): {remain}"
            )

    def table(self, title: str, most: int | None = None) -> Table:
        """The last session against the first, what changed clearly in front."""
        rows = sorted(self.changed, key=lambda row: row[1].word not in (MORE, LESS))[:most]
        shares = ([value.recovered_share for value in (each.first, each.last)] for _, each in rows)
        known = [max(filter(math.isfinite, both), default=None) for both in shares]
        cells = [
            (
                self.label(series),
                worded(series.key, change.first.value, series.unit),
                worded(series.key, change.last.value, series.unit),
                quantity(change.difference, series.unit, signed=True),
                interval(change.low, change.high, series.unit, signed=True) or None,
                change.word,
                percent(share),
            )
            for (series, change), share in zip(rows, known, strict=True)
        ]
        columns = ("measure", "first", "last", "change", "95 % interval", "in words", "recovered")
        return Table(title, columns, cells)

    def to_dict(self) -> dict[str, Any]:
        """Plain values by name, as `--json` writes them."""
        about = {name: getattr(self, name) for name in ("person", "sessions", "days", "left_out", "notes")}
        counts = {"compared": len(self.compared), "clear": len(self.clear)}
        return about | counts | {"measures": [each.to_dict() for each in self.series]}

    def csv_rows(self) -> Iterator[list[object]]:
        """One row per measure and session, under `CSV_COLUMNS`, with the change since the first."""
        for series in self.series:
            for value, change in zip(series.values, (None, *series.changes), strict=True):
                cells = [getattr(series, name) for name in _OF_SERIES]
                cells += [getattr(value, name) for name in _OF_VALUE]
                cells += [getattr(change, name, None) for name in _OF_CHANGE]
                yield [*cells, None if change is None else "; ".join(change.limits)]


_OF_SERIES = ("person", "side", "task", "key", "name", "unit")
_OF_VALUE = ("session", "day", "value", "low", "high", "sigma", "recovered_share", "n_draws")
_OF_CHANGE = ("difference", "low", "high", "p", "p_together", "mdc95", "word")
CSV_COLUMNS = (
    *(*_OF_SERIES, *_OF_VALUE[:-1], "draws", "change", "change_low", "change_high"),
    *(*_OF_CHANGE[3:], "limits"),
)

#: Fewer persons have no figures of reliability.
FEWEST_PERSONS = 3


def reliability_of(persons: Sequence[PersonProgress]) -> list[dict[str, Any]]:
    """How reliable the main measures are over sessions without true change, as `--json` has it.

    ICC(2,1) (two-way random effects, absolute agreement, single measurement); SEM_agreement, with systematic
    differences between sessions; `sdc`, the smallest detectable change of one person, 1.96 sqrt(2) SEM; bias
    and limits of agreement of the second session minus the first, whose `values` they are. Terms are those of
    Mokkink et al., J Clin Epidemiol 63:737-745 (2010).
    """
    values: dict[tuple[str, ...], list[list[float]]] = {}
    for series in (each for person in persons for each in person.main):
        known = [each.value for each in series.values if np.isfinite(each.value)]
        if len(known) > 1:
            about = (series.side, series.task, series.key, series.name, series.unit)
            values.setdefault(about, []).append(known)
    found = []
    for names, own in values.items():
        if len(own) < FEWEST_PERSONS:
            continue
        ratings = np.array([each[: min(map(len, own))] for each in own])
        row: dict[str, Any] = dict(zip(("side", "task", "key", "name", "unit"), names, strict=True))
        row |= {"persons": len(ratings), "sessions": ratings.shape[1]}
        row |= zip(("icc_21", "icc_21_low", "icc_21_high"), icc_a1(ratings), strict=True)
        sem = sem_agreement(ratings)
        row |= {"sem_agreement": sem, "sdc": detectable_change(sem)}
        row |= limits_of_agreement(ratings[:, 1] - ratings[:, 0])
        found.append(row | {"values": ratings[:, :2].tolist()})
    return found


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


def read_detectable(path: Path) -> dict[str, float]:
    """Minimal detectable changes by the measures' keys: of a user, or of repeated sessions."""
    if path.suffix.lower() != ".toml":
        return _read_reliability(path)
    table = toml_document(path, str(path)).get("mdc95")
    if not isinstance(table, dict) or not table:
        raise UnoccludeError(
            f"{path} has no table [mdc95]; write one with a line per measure: elbow_flexion_range_deg = 5.0"
        )
    for key, value in table.items():
        if not is_measure(key):
            near = get_close_matches(key, definitions(), n=1, cutoff=0.0)
            raise UnoccludeError(
                f"{path}: there is no measure {key}, so its mdc95 has no effect; the nearest is {near[0]}"
            )
        if not _is_change(value):
            raise UnoccludeError(f"{path}: mdc95 of {key} is {value!r}; it must be a number above 0")
    return {key: float(value) for key, value in table.items()}


def _read_reliability(path: Path) -> dict[str, float]:
    """The smallest detectable changes that `--reliability --json` wrote, the largest of several arms."""
    found: dict[str, float] = {}
    try:
        for row in json.loads(path.read_text(encoding="utf-8"))["reliability"]:
            if _is_change(row["sdc"]):
                found[row["key"]] = max(float(row["sdc"]), found.get(row["key"], 0.0))
    except OSError as error:
        raise UnoccludeError(f"{path}: {error.strerror or error}") from error
    except (ValueError, TypeError, KeyError, RecursionError) as error:
        raise UnoccludeError(
            f"{path} has no detectable changes; name what `progress --reliability --json` wrote, or a .toml"
            " with [mdc95]"
        ) from error
    if not found:
        raise UnoccludeError(
            f"{path} has no smallest detectable change; `progress --reliability` needs three persons with"
            " two sessions each"
        )
    return found


def _is_change(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and 0 < value < math.inf
