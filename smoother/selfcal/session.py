"""Recordings of one session: what the strap shows over all of them, and which of them it does not fit.

A trial of some seconds hardly proves its clock alone: the forearm's direction in the sensor, the heading and
the offset all are free. Trials of one person and strap share that direction. For each direction on a grid
every trial has an offset that fits best; the direction that all trials together support is the strap's, and
with it a trial needs little motion (`agreement`). Trials that it does not fit are asked whether they share
another one, as after a strap was put on anew.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ..array_types import FloatArray
from ..linalg import around, sphere
from ..recording import Recording
from ..runtime.pool import Pool
from .agreement import CHANCE_SCALE, GRID_HZ, OFFSETS_PER_S, TurningSums, agreement, turning_sums
from .pairing import LIKELY, decided

#: Directions that are tried, and how far those beside the best one are from it at first, rad; how often that
#: is halved.
DIRECTIONS, BESIDE_RAD, HALVED = 400, 0.12, 3
#: What a trial's best offset reaches by chance is taken off its evidence; one trial counts for this at most.
MOST_OF_ONE = 15.0
#: So many recordings that a direction proves are a strap; one recording alone proves nothing of others.
FEWEST = 2
#: Two straps may be so much alike that a direction between them fits every trial. Directions so far apart are
#: tried, up to so far from it, rad. Two of them gain less than the third by chance (of 25 simulated sessions
#: none gained 4); no trial objects to a direction by more than the fourth.
STEP_RAD, REACH_RAD, PARTED, MOST_OBJECTION = 0.07, 0.42, 7.0, 3.5


@dataclass(frozen=True)
class Strap:
    """An IMU as it sat on a forearm, and the recordings that show it."""

    along: FloatArray  # (3,): the forearm's direction in the sensor
    members: tuple[int, ...]  # Numbers of the recordings that it fits


def find_straps(recordings: Sequence[Recording], workers: Pool | None = None) -> list[Strap]:
    """The straps of a session, that of most recordings first; recordings that none fits are in none."""
    sums = {number: list(turning_sums(recording, workers)) for number, recording in enumerate(recordings)}
    left = [number for number, own in sums.items() if own]
    straps: list[FloatArray] = []
    fitting: list[int] = []
    while len(left) >= FEWEST:
        along = _shared_direction([each for number in left for each in sums[number]])
        members = tuple(number for number in left if _fits(recordings[number], along, workers))
        if len(members) < FEWEST:
            break
        members = _alike(along, members, sums)
        if len(members) < len(left):
            along = _shared_direction([each for number in members for each in sums[number]])
        straps.append(along)
        fitting += members
        left = [number for number in left if number not in members]
    # a trial that several fit is of the one that fits it best
    own: dict[int, list[int]] = {kind: [] for kind in range(len(straps))}
    for number in sorted(fitting):
        support = sum(each.best_of(np.array(straps)) for each in sums[number])
        own[int(np.argmax(support))].append(number)
    found = [Strap(straps[kind], tuple(members)) for kind, members in own.items() if members]
    return sorted(found, key=lambda strap: -len(strap.members))


def _fits(recording: Recording, along: FloatArray, workers: Pool | None) -> bool:
    found = agreement(recording, None, workers, along)
    if found is None or not found.is_mounted:
        return False
    pairing, _ = decided(found, recording)
    return pairing is not None and pairing.chance < LIKELY


def _alike(
    along: FloatArray, members: tuple[int, ...], sums: Mapping[int, Sequence[TurningSums]]
) -> tuple[int, ...]:
    """The members; where two directions beside the shared one are clearly better, those of one of the two."""
    directions = around(along, np.arange(-REACH_RAD, REACH_RAD, STEP_RAD))
    directions = directions[directions @ along > np.cos(REACH_RAD)]
    support = np.array([sum(each.best_of(directions) for each in sums[number]) for number in members])
    support = np.maximum(support, support.max(axis=1, keepdims=True) - MOST_OBJECTION)
    of_two = np.array([np.maximum(support, own[:, None]).sum(axis=0) for own in support.T])
    one, other = np.unravel_index(of_two.argmax(), of_two.shape)
    is_first = support[:, one] >= support[:, other]
    fewest = min(is_first.sum(), (~is_first).sum())
    if of_two.max() - support.sum(axis=0).max() < PARTED or fewest < FEWEST:
        return members
    is_most = is_first.sum() > len(members) / 2
    return tuple(number for number, first in zip(members, is_first, strict=True) if first == is_most)


def _shared_direction(sums: Sequence[TurningSums]) -> FloatArray:
    """The direction of the forearm in the sensor that all together support most."""
    directions = sphere(DIRECTIONS)
    best = directions[int(_support(sums, directions).argmax())]
    for halved in range(HALVED):
        beside = around(best, BESIDE_RAD * 0.5**halved * np.linspace(-1.0, 1.0, 3))
        best = beside[int(_support(sums, beside).argmax())]
    return best


def _support(sums: Sequence[TurningSums], directions: FloatArray) -> FloatArray:
    """(d,) how much the recordings together speak for each direction."""
    total = np.zeros(len(directions))
    for each in sums:
        by_chance = CHANCE_SCALE * np.log(max(OFFSETS_PER_S * len(each.known) / GRID_HZ, 1.0))
        total += np.clip(each.best_of(directions) - by_chance, 0.0, MOST_OF_ONE)
    return total
