"""The persons of a file: numbers that the camera exchanged or gave anew are put right."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np

from ...array_types import BoolArray, FloatArray, IntArray
from ...linalg import runs
from ...recording import FOREARM_JOINTS, JOINTS, JointState
from ...runtime.store import by_rows
from .streams import ArmFrames, RecordingFile

#: A body that comes back within this time and distance is treated as the same one.
_AWAY_S = 30.0
_APART_M = 0.4
#: The shoulder moves least, so it is asked first; only the forearm's joints may have moved on while not seen.
_REACH_M = {
    JOINTS.index(joint): _APART_M + (0.4 if joint in FOREARM_JOINTS else 0.0)
    for joint in ("shoulder", "elbow", "wrist", "hand", "strap")
}


def join_bodies(arms: list[ArmFrames]) -> tuple[list[ArmFrames], list[str]]:
    """Join arms of one topic and side that are never seen together and take over where the other was lost."""
    joined: list[tuple[ArmFrames, set[int]]] = []  # with the numbers that each had so far
    notes = []
    for arm in sorted(arms, key=lambda arm: _first_and_last(arm)[0]):
        for place, (earlier, numbers) in enumerate(joined):
            if arm.body not in numbers and _goes_on(earlier, arm):
                merged = _merged(earlier, arm, arm.state != JointState.NOT_TRACKED)
                joined[place] = merged, numbers | {arm.body}
                why = "the camera lost the body and numbered it anew where it was; --body takes one alone."
                notes.append(f"{earlier.label} and body {arm.body} were joined: {why}")
                break
        else:
            joined.append((arm, {arm.body}))
    return [arm for arm, _ in joined], notes


def _merged(own: ArmFrames, other: ArmFrames, taken: BoolArray) -> ArmFrames:
    """An arm with another's joints where `taken` (F, 5)."""

    def either(here: BoolArray, its: FloatArray, mine: FloatArray) -> FloatArray:
        return np.asarray(np.where(here[:, :, None], its, mine))

    position = by_rows(either, taken, other.position, own.position)
    return replace(own, position=position, state=np.where(taken, other.state, own.state))


def _first_and_last(arm: ArmFrames) -> tuple[int, int]:
    """First and last frame in which anything of the arm is there; past the end for none."""
    there = np.flatnonzero((arm.state != JointState.NOT_TRACKED).any(axis=1))
    return (int(there[0]), int(there[-1])) if len(there) else (len(arm.stamp_ns), len(arm.stamp_ns))


def _goes_on(earlier: ArmFrames, later: ArmFrames) -> bool:
    """Whether it is the same arm of a body that is first seen when the other was lost, soon and near."""
    lost, back = _first_and_last(earlier)[1], _first_and_last(later)[0]
    if (earlier.topic, earlier.side) != (later.topic, later.side) or not lost < back < len(later.stamp_ns):
        return False
    if abs(int(later.stamp_ns[back]) - int(earlier.stamp_ns[lost])) / 1e9 > _AWAY_S:
        return False
    for joint, reach_m in _REACH_M.items():
        if earlier.state[lost, joint] and later.state[back, joint]:
            step = np.linalg.norm(later.position[back, joint] - earlier.position[lost, joint])
            return bool(step < reach_m)
    return False


#: Between two frames this close in time no person walks to where another stood.
_SOON_NS = 200_000_000
#: Both jump at least this far, m; what is left after exchanging is at most this share of the jumps.
_JUMP_M, _LEFT = 0.4, 0.35
_SHOULDER = JOINTS.index("shoulder")


def unswap_bodies(arms: list[ArmFrames]) -> tuple[list[ArmFrames], list[str]]:
    """Give bodies their numbers back where two of one topic exchanged them."""
    arms, notes = list(arms), []
    bodies: dict[tuple[str, int], dict[str, int]] = {}  # by side the arm's place in the list
    for place, arm in enumerate(arms):
        bodies.setdefault(arm.key[:2], {})[arm.side] = place
    for (first, own), (second, others) in combinations(sorted(bodies.items()), 2):
        if first[0] != second[0] or own.keys() != others.keys():
            continue
        swaps = _swaps([arms[k] for k in own.values()], [arms[k] for k in others.values()])
        if not len(swaps):
            continue
        stamp = arms[next(iter(own.values()))].stamp_ns
        exchanged = np.zeros(len(stamp), bool)
        for row in swaps:
            exchanged[row:] ^= True
        taken = np.repeat(exchanged[:, None], len(JOINTS), axis=1)
        for i, k in ((own[side], others[side]) for side in own):
            arms[i], arms[k] = _merged(arms[i], arms[k], taken), _merged(arms[k], arms[i], taken)
        seconds = [f"{(int(stamp[run.start]) - int(stamp[0])) / 1e9:.1f}" for run in runs(exchanged)]
        notes.append(
            f"Bodies {first[1]} and {second[1]} of {first[0]} exchange their numbers"
            f" {', '.join(seconds[:5])} s after the first frame (each jumps to where the other was); they"
            " were exchanged back."
        )
    return arms, notes


def _swaps(first: list[ArmFrames], second: list[ArmFrames]) -> IntArray:
    """Rows from which on the numbers are exchanged, or exchanged back: by the places of the shoulders."""
    if len({len(arm.stamp_ns) for arm in (*first, *second)}) != 1:
        return np.empty(0, np.int64)
    there = np.all([arm.state[:, _SHOULDER] != JointState.NOT_TRACKED for arm in (*first, *second)], axis=0)
    rows = np.flatnonzero(there)
    soon = np.diff(first[0].stamp_ns[rows]) <= _SOON_NS
    a, b = (np.mean([arm.position[rows, _SHOULDER] for arm in arms], axis=0) for arms in (first, second))

    def apart(now: FloatArray, before: FloatArray) -> FloatArray:
        return np.asarray(np.linalg.norm(now[1:] - before[:-1], axis=1))

    own_a, own_b = apart(a, a), apart(b, b)
    crossed = apart(a, b) + apart(b, a)
    jumps = soon & (np.minimum(own_a, own_b) > _JUMP_M) & (crossed < _LEFT * (own_a + own_b))
    # after one exchange the next one is seen in the numbers as they are then: every jump counts
    return np.asarray(rows[1:][jumps])


def people(file: RecordingFile) -> tuple[list[ArmFrames], list[str]]:
    """The arms of every person, each under one number."""
    arms, swapped = unswap_bodies(file.arms)
    arms, joined = join_bodies(arms)
    return arms, swapped + joined
