"""A person's measures over the sessions, and how each changed."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any

from .change import LESS, MORE, Change, SessionValue
from .main_measures import FIRST, is_main


@dataclass(frozen=True)
class Series:
    """A measure of one arm over a person's sessions.

    Attributes
    ----------
    person, side, task : str
        Whose, which arm, and of which recording of a session ("" where a session has one).
    key, name, unit : str
        As a `Measure` has them.
    values : tuple of SessionValue
        In the order of time.
    changes : tuple of Change
        Each session against the first.
    """

    person: str
    side: str
    task: str
    key: str
    name: str
    unit: str
    values: tuple[SessionValue, ...]
    changes: tuple[Change, ...] = ()

    @property
    def change(self) -> Change | None:
        """The last session against the first; None where there is one session."""
        return self.changes[-1] if self.changes else None

    def to_dict(self) -> dict[str, Any]:
        """Plain values by name, as `--json` writes them."""
        return {
            **{name: getattr(self, name) for name in ("person", "side", "task", "key", "name", "unit")},
            "sessions": [asdict(value) for value in self.values],
            "changes": [change.to_dict() for change in self.changes],
        }


@dataclass(frozen=True)
class PersonProgress:
    """All measures of a person over the sessions.

    Attributes
    ----------
    person : str
        What the study calls the person.
    sessions : tuple of str
        The sessions that have a measure, in the order of time.
    days : tuple of float, d
        Since the first of them; nan where that is not known.
    series : tuple of Series
        By arm, task and measure.
    left_out : tuple of str
        Recordings that take no part, and why; one sentence each.
    notes : tuple of str
        What a reader must know, one sentence each.
    """

    person: str
    sessions: tuple[str, ...]
    days: tuple[float, ...]
    series: tuple[Series, ...]
    left_out: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

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
        return tuple(
            each for each in self.main if each.change is not None and each.change.word in (MORE, LESS)
        )

    def to_dict(self) -> dict[str, Any]:
        """Plain values by name, as `--json` writes them."""
        return {
            "person": self.person,
            "sessions": list(self.sessions),
            "days": list(self.days),
            "compared": len(self.compared),
            "clear": len(self.clear),
            "measures": [each.to_dict() for each in self.series],
            "left_out": list(self.left_out),
            "notes": list(self.notes),
        }
