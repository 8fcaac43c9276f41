"""Where the curve of an angle over a repetition differs between sessions: statistical parametric mapping.

By relabelling, not by random field theory, since repetitions are few and their curves not normal: Nichols and
Holmes, Human Brain Mapping 15:1-25 (2002), with the largest statistic along the curve; for curves of motion
Pataky, Vanrenterghem and Robinson, J Biomech 48:1277-1285 (2015), whose spm1d has the same test. (spm1d is
under the GPL and imports matplotlib, so that it is what we are held against and no dependency.)
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np

from ..array_types import BoolArray, FloatArray
from ..linalg import runs

#: A difference along the curve is one where less than this is likely without any.
LEVEL = 0.05
#: Relabellings: all of them where there are no more.
MOST_RELABELLINGS = 4000
#: Repetitions of a session; with fewer no relabelling can be rarer than `LEVEL`.
FEWEST_CURVES = 4
_SEED = 20021


@dataclass(frozen=True)
class SessionCurves:
    """An angle over the repetitions of a session.

    Attributes
    ----------
    curves : ndarray, shape (n, points), deg
        One per repetition, from 0 to 100 %.
    errors : ndarray, shape (m, points), deg
        Errors that all repetitions share, by the drawn motions: each row times a standard normal number, all
        added up. Empty without draws.
    """

    curves: FloatArray
    errors: FloatArray

    @property
    def mean(self) -> FloatArray:
        """Over the repetitions (points,)."""
        return np.asarray(self.curves.mean(axis=0))

    @property
    def sd(self) -> FloatArray:
        """Between them (points,)."""
        return np.asarray(self.curves.std(axis=0, ddof=1))


@dataclass(frozen=True)
class Stretch:
    """A part of the curve that differs.

    Attributes
    ----------
    start_percent, end_percent : float
        Of the repetition.
    difference : float, deg
        The largest in it, last minus first.
    p : float
        How likely so large a statistic is anywhere along the curve without any difference.
    """

    start_percent: float
    end_percent: float
    difference: float
    p: float


@dataclass(frozen=True)
class CurveTest:
    """Two sets of curves compared point by point, with one error rate for all points.

    Attributes
    ----------
    statistic : ndarray, shape (points,)
        Student's t.
    threshold : float
        What its largest absolute value exceeds in 5 of 100 relabellings.
    p : float
        Of the largest absolute value.
    stretches : tuple of Stretch
        Where it exceeds the threshold.
    relabellings : int
        How many were tried.
    is_exact : bool
        They are all there are.
    """

    statistic: FloatArray
    threshold: float
    p: float
    stretches: tuple[Stretch, ...]
    relabellings: int
    is_exact: bool


@dataclass(frozen=True)
class WaveformChange:
    """An angle's curve in the first session of a person and in the last.

    Attributes
    ----------
    side, task, angle : str
    from_session, to_session : str
    first, last : SessionCurves
    test : CurveTest
    """

    side: str
    task: str
    angle: str
    from_session: str
    to_session: str
    first: SessionCurves
    last: SessionCurves
    test: CurveTest

    def to_dict(self) -> dict[str, Any]:
        """Plain values by name, as `--json` writes them."""
        test = self.test
        return {
            **{name: getattr(self, name) for name in ("side", "task", "angle")},
            "from": self.from_session,
            "to": self.to_session,
            "repetitions": [len(self.first.curves), len(self.last.curves)],
            "difference": [round(float(value), 3) for value in self.last.mean - self.first.mean],
            "t": [round(float(value), 4) for value in test.statistic],
            "threshold": test.threshold,
            "p": test.p,
            "relabellings": test.relabellings,
            "exact": test.is_exact,
            "stretches": [dict(vars(each)) for each in test.stretches],
        }


def two_sessions(first: SessionCurves, last: SessionCurves) -> CurveTest:
    """Whether the curves of two sessions differ, and where.

    Without a change the labels of the repetitions mean nothing, so each relabelling is as likely as what was
    measured. Errors that all repetitions of a session share are not scatter between them: they add to the
    variance of the difference, and each relabelling gets a draw of them.

    Parameters
    ----------
    first, last : SessionCurves
        Of the same number of points.
    """
    curves = np.concatenate([first.curves, last.curves])
    count, n = len(curves), len(last.curves)
    shared = np.concatenate([first.errors, last.errors])
    rng = np.random.default_rng([_SEED, count, n])
    # every relabelling where they are few, and no error is to be drawn; what was measured is the first
    is_exact = math.comb(count, n) <= MOST_RELABELLINGS and not shared.size
    own = np.arange(count) >= count - n
    chosen = _all_labels(count, n) if is_exact else _random_labels(own, MOST_RELABELLINGS, rng)
    added = rng.normal(size=(len(chosen), len(shared))) @ shared if shared.size else 0.0
    variance = (shared**2).sum(axis=0)
    observed = _student(curves, own[None], variance, 0.0)[0]
    largest = np.abs(_student(curves, chosen, variance, added)).max(axis=1)
    if not is_exact:
        largest = np.append(largest, np.abs(observed).max())
    return _tested(observed, largest, last.mean - first.mean, is_exact)


def one_sample(differences: FloatArray) -> CurveTest:
    """Whether the mean of curves is zero, by their signs: last minus first session of several persons.

    Parameters
    ----------
    differences : ndarray, shape (n, points), deg
        One per person. What the drawn motions state of their errors is part of the scatter between persons.
    """
    n = len(differences)
    is_exact = 2**n <= MOST_RELABELLINGS
    if is_exact:
        signs = 1.0 - 2.0 * ((np.arange(2**n)[:, None] >> np.arange(n)) & 1)
    else:
        signs = np.random.default_rng([_SEED, n]).choice([-1.0, 1.0], size=(MOST_RELABELLINGS, n))
        signs[0] = 1.0
    mean = signs @ differences / n
    variance = ((differences**2).sum(axis=0) - n * mean**2) / (n - 1)
    statistic = _ratio(mean, variance / n)
    return _tested(statistic[0], np.abs(statistic).max(axis=1), mean[0], is_exact)


def _all_labels(count: int, n: int) -> BoolArray:
    chosen = np.zeros((math.comb(count, n), count), bool)
    for row, members in enumerate(combinations(range(count), n)):
        chosen[row, members] = True
    return chosen


def _random_labels(own: BoolArray, most: int, rng: np.random.Generator) -> BoolArray:
    return np.stack([rng.permutation(own) for _ in range(most)])


def _student(
    curves: FloatArray, chosen: BoolArray, variance: FloatArray, added: FloatArray | float
) -> FloatArray:
    """Student's t (labels, points) of the chosen curves less the others, with what all of them share."""
    count, n = len(curves), int(chosen[0].sum())
    sums, squares = chosen @ curves, (curves**2).sum(axis=0)
    here, there = sums / n, (curves.sum(axis=0) - sums) / (count - n)
    within = (squares - n * here**2 - (count - n) * there**2) / (count - 2)
    return _ratio(here - there + added, within * (1 / n + 1 / (count - n)) + variance)


def _ratio(mean: FloatArray, variance: FloatArray) -> FloatArray:
    sigma = np.sqrt(np.maximum(variance, 0.0))
    return np.divide(mean, sigma, out=np.zeros_like(mean), where=sigma > 1e-12)


def _tested(observed: FloatArray, largest: FloatArray, difference: FloatArray, is_exact: bool) -> CurveTest:
    """Threshold, probability and stretches by the distribution of the largest statistic."""
    ordered = np.sort(largest)
    # at most 5 of 100
    threshold = float(ordered[min(math.ceil((1 - LEVEL) * len(ordered)) - 1, len(ordered) - 1)])

    def p_of(value: float) -> float:
        return float((largest >= value * (1 - 1e-9)).mean())

    last = len(observed) - 1
    beyond: BoolArray = np.asarray(np.abs(observed) > threshold * (1 + 1e-9))
    stretches = []
    for run in runs(beyond):
        at = run.start + int(np.abs(difference[run]).argmax())
        stretches.append(
            Stretch(
                100.0 * run.start / last,
                100.0 * (run.stop - 1) / last,
                float(difference[at]),
                p_of(float(np.abs(observed[run]).max())),
            )
        )
    p = p_of(float(np.abs(observed).max()))
    return CurveTest(observed, threshold, p, tuple(stretches), len(largest), is_exact)


def curves_of(row: Mapping[str, Any]) -> dict[tuple[str, str], SessionCurves]:
    """The curves of a study's row by side and angle; without what is not to be trusted, and too few."""
    found = {}
    for each in json.loads(row.get("waveforms") or "[]"):
        if each["trusted"] is not False and len(each.get("curves", ())) >= FEWEST_CURVES:
            errors = np.array(each.get("errors") or np.empty((0, len(each["mean"]))), dtype=float)
            found[each["side"] or "", each["angle"]] = SessionCurves(np.array(each["curves"]), errors)
    return found


def change_of(
    about: tuple[str, str, str], sessions: Sequence[tuple[str, SessionCurves]]
) -> WaveformChange | None:
    """The last session of a person against the first; None of a single one.

    Parameters
    ----------
    about : (str, str, str)
        Side, task, angle.
    sessions : sequence of (str, SessionCurves)
        In the order of time.
    """
    if len(sessions) < 2:
        return None
    (before, first), (after, last) = sessions[0], sessions[-1]
    return WaveformChange(*about, before, after, first, last, two_sessions(first, last))


#: Fewer persons have no test: with five, the rarest signs are no rarer than 6 of 100.
FEWEST_PERSONS = 6


def of_group(changes: Sequence[WaveformChange]) -> list[dict[str, Any]]:
    """The changes of several persons together, by side, task and angle, as `--json` writes them."""
    kinds: dict[tuple[str, str, str], list[FloatArray]] = {}
    for each in changes:
        kinds.setdefault((each.side, each.task, each.angle), []).append(each.last.mean - each.first.mean)
    found = []
    for (side, task, angle), curves in kinds.items():
        if len(curves) < FEWEST_PERSONS:
            continue
        test = one_sample(np.stack(curves))
        found.append(
            {"side": side, "task": task, "angle": angle, "persons": len(curves)}
            | {"threshold": test.threshold, "p": test.p, "exact": test.is_exact}
            | {"difference": [round(float(value), 3) for value in np.mean(curves, axis=0)]}
            | {"stretches": [dict(vars(each)) for each in test.stretches]}
        )
    return found


def sentence(change: WaveformChange, name: str) -> str:
    """What the curve shows, for people."""
    about = ", ".join(filter(None, (name, change.side, change.task)))
    test = change.test
    if not test.stretches:
        return f"{about}: no part of the repetition differs clearly (p = {test.p:.2g})."
    parts = [
        f"{each.start_percent:.0f} to {each.end_percent:.0f} % ({each.difference:+.1f}°, p = {each.p:.2g})"
        for each in test.stretches
    ]
    return f"{about}: differs at {', '.join(parts)} of the repetition.".replace("-", "−")
