"""One Gauss-Newton iteration of a lag window, with the covariance of the variables that are read (GTSAM)."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import gtsam
import numpy as np

from ..array_types import FloatArray
from ..body import SEGMENTS
from .variables import DIMENSION, values_of

#: Elimination goes along time; the variables of few nodes follow, and last come those of all.
_RANK = {ord("s"): 1}
for _segment in SEGMENTS.values():
    _letters = [ord(letter) for letter in _segment.letters]
    _RANK |= dict.fromkeys(_letters[:2] + _letters[4:], 0) | {_letters[2]: 2}
_LAST = 3
#: Above these bits of a key stands its letter, in them its number.
_LETTER_BIT = 56
_NUMBER = (1 << _LETTER_BIT) - 1


@dataclass(frozen=True)
class LagIteration:
    """What an iteration answers."""

    before: gtsam.Values  # Where it was linearised, and after the step
    values: gtsam.Values  # Where it was linearised, and after the step
    step: FloatArray  # (c,): of the variables that are read, in GTSAM's own coordinates
    covariance: FloatArray  # (c, c): joint, of the same
    columns: dict[int, slice]  # Where each of them is in both

    def moved_m(self, pose: int) -> float:
        """How far the step moved a pose that is read."""
        return float(np.linalg.norm(self.step[self.columns[pose]][3:]))


def iterate(
    graph: gtsam.NonlinearFactorGraph,
    values: gtsam.Values,
    query_keys: Sequence[int],
) -> LagIteration:
    """One Gauss-Newton step: eliminate all but what is read, invert what is left, and substitute back."""
    others = gtsam.Ordering()
    for key in in_order(set(values.keys()) - set(query_keys)):
        others.push_back(key)
    net, rest = graph.linearize(values).eliminatePartialSequential(others)
    ordering, columns, start = gtsam.Ordering(), {}, 0
    for key in query_keys:
        ordering.push_back(key)
        columns[key] = slice(start, start + DIMENSION[letter_of(key)])
        start = columns[key].stop
    information, vector = rest.hessian(ordering)
    covariance = _inverse(information)
    step = covariance @ np.ravel(vector)
    asked_steps = gtsam.VectorValues()
    for key, rows in columns.items():
        asked_steps.insert(key, step[rows])
    delta = net.optimize(asked_steps)
    for key, rows in columns.items():
        if not delta.exists(key):
            delta.insert(key, step[rows])
    return LagIteration(values, values.retract(delta), step, covariance, columns)


def in_order(keys: Iterable[int]) -> list[int]:
    """Variables in the order of time, as their numbers have it; those that last at the end."""

    def rank(key: int) -> tuple[int, int, int]:
        return _RANK.get(key >> _LETTER_BIT, _LAST), key & _NUMBER, key

    return sorted(keys, key=rank)


def letter_of(key: int) -> str:
    """Of a variable's key: as `gtsam.Symbol` reads it, in a tenth of the time."""
    return chr(key >> _LETTER_BIT)


def _inverse(information: FloatArray) -> FloatArray:
    """Inverse of a positive definite matrix, scaled to unit diagonal first."""
    diagonal = np.diag(information)
    if not (diagonal > 0).all():
        raise np.linalg.LinAlgError("a direction is left free")
    scale = 1.0 / np.sqrt(diagonal)
    factor = np.linalg.cholesky(information * scale[:, None] * scale)
    half = np.linalg.solve(factor, np.diag(scale))
    return np.asarray(half.T @ half)


def marginalise(
    factors: Sequence[gtsam.NonlinearFactor], values: gtsam.Values, leaving: Sequence[int]
) -> list[gtsam.NonlinearFactor]:
    """Eliminate variables."""
    touching, rest = split(factors, set(leaving))
    graph, order = gtsam.NonlinearFactorGraph(), gtsam.Ordering()
    for factor in touching:
        graph.add(factor)
    for key in leaving:
        order.push_back(key)
    _, gaussians = graph.linearize(values).eliminatePartialSequential(order)
    for i in range(gaussians.size()):
        gaussian = gaussians.at(i)
        if gaussian is not None:
            rest.append(gtsam.LinearContainerFactor(gaussian, values_of(values, gaussian.keys())))
    for key in leaving:
        values.erase(key)
    return rest


def split(
    factors: Sequence[gtsam.NonlinearFactor], keys: set[int]
) -> tuple[list[gtsam.NonlinearFactor], list[gtsam.NonlinearFactor]]:
    """The factors that touch some variables, and those that do not."""
    touching: list[gtsam.NonlinearFactor] = []
    others: list[gtsam.NonlinearFactor] = []
    for factor in factors:
        (others if keys.isdisjoint(factor.keys()) else touching).append(factor)
    return touching, others
