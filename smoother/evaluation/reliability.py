"""Reliability and measurement error of a measure over sessions without true change.

Sources: Mokkink et al., J Clin Epidemiol 63:737-745 (2010), the terms; Shrout and Fleiss, Psychological
Bulletin 86:420-428 (1979), and McGraw and Wong, Psychological Methods 1:30-46 (1996), ICC(2,1) = ICC(A,1)
with its interval; de Vet et al., J Clin Epidemiol 59:1033-1039 (2006), SEM_agreement
and smallest detectable change; Satterthwaite, Biometrics Bulletin 2:110-114 (1946).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np

from ..array_types import FloatArray
from .agreement import (
    detectable_change,
    icc_a1,
    limits_of_agreement,
    mean_squares,
    sigma_interval,
    with_interval,
)
from .progress import PersonProgress, interval, is_main, quantity

#: Fewer persons have no figures.
FEWEST_PERSONS = 3


@dataclass(frozen=True)
class Reliability:
    """How reliable a measure is over repeated sessions, in its unit."""

    side: str
    task: str
    key: str  # As a `Measure` has them
    name: str
    unit: str
    persons: int  # How many, each person with as many sessions
    sessions: int
    # ICC(2,1), two-way random effects, absolute agreement, single measurement, with its 95 % interval
    icc_21: float | None
    icc_21_low: float | None
    icc_21_high: float | None
    # Standard error of measurement, with systematic differences between sessions, and its 95 % interval
    sem_agreement: float
    sem_agreement_low: float
    sem_agreement_high: float
    sdc: float  # Smallest detectable change of one person, 1.96 sqrt(2) SEM_agreement (also called MDC95)
    bias: float  # Mean of the second session minus the first, with its interval
    bias_low: float
    bias_high: float
    limits_low: float  # Limits of agreement of these two sessions, each with its interval
    limits_low_from: float
    limits_low_to: float
    limits_high: float
    limits_high_from: float
    limits_high_to: float
    values: tuple[tuple[float, float], ...]  # First and second session of each person

    def to_dict(self) -> dict[str, object]:
        """Plain values by name, as `--json` writes them."""
        return asdict(self)


def reliability_of(persons: Sequence[PersonProgress]) -> list[Reliability]:
    """The main measures over the sessions of persons in whom nothing changed."""
    values: dict[tuple[str, str, str], list[list[float]]] = {}
    about: dict[str, tuple[str, str]] = {}
    for person in persons:
        for series in person.main:
            known = [each.value for each in series.values if np.isfinite(each.value)]
            if len(known) > 1:
                about[series.key] = series.name, series.unit
                values.setdefault((series.side, series.task, series.key), []).append(known)
    found = []
    for key, own in values.items():
        if len(own) >= FEWEST_PERSONS and is_main(key[2]):
            ratings = np.array([each[: min(map(len, own))] for each in own])
            sem = sem_agreement(ratings)
            limits = limits_of_agreement(ratings[:, 1] - ratings[:, 0])
            pairs = tuple((float(first), float(second)) for first, second in ratings[:, :2])
            what = (*key, *about[key[2]], len(ratings), ratings.shape[1])
            figures = (*icc_a1(ratings), *sem, detectable_change(sem[0]))
            found.append(Reliability(*what, *figures, *limits, pairs))
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


#: Heads of the table of `reliability_cells`.
COLUMNS = ("measure", "persons", "ICC(2,1), 95 %", "SEM agreement", "SDC", "limits")


def reliability_cells(found: Sequence[Reliability]) -> list[tuple[str, ...]]:
    """Rows of a table for people."""
    return [
        (
            ", ".join(filter(None, (one.name, one.side, one.task))),
            f"{one.persons} x {one.sessions}",
            with_interval(one.icc_21, one.icc_21_low, one.icc_21_high, 2) or "-",
            quantity(one.sem_agreement, one.unit),
            quantity(one.sdc, one.unit),
            interval(one.limits_low, one.limits_high, one.unit, signed=True),
        )
        for one in found
    ]
