"""Two bodies whose numbers the camera exchanged: each jumps to where the other was."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np

from ...array_types import BoolArray, FloatArray, IntArray
from ...linalg import runs
from ...recording import JOINTS, JointState
from ...runtime.store import Store, batches
from .streams import ArmFrames

#: Between two frames this close in time nobody walks to where another stood.
_SOON_NS = 200_000_000
#: Both jump at least this far, m; what is left after exchanging is at most this share of the jumps.
_JUMP_M, _LEFT = 0.4, 0.35
_SHOULDER = JOINTS.index("shoulder")


def unswap_bodies(arms: list[ArmFrames], store: Store | None = None) -> tuple[list[ArmFrames], list[str]]:
    """Give bodies their numbers back where two of one topic exchanged them.

    Two people who stand apart do not change places from one frame to the next: where both shoulders jump,
    each to where the other's was, the numbers were exchanged.

    Parameters
    ----------
    arms : list of ArmFrames
        As the file has them; they stay as they are.
    store : Store, optional
        Where the positions of such arms are to lie; None = in memory.

    Returns
    -------
    arms : list of ArmFrames
        In the same order.
    notes : list of str
        A sentence for each pair of bodies.
    """
    arms, notes = list(arms), []
    bodies = sorted({(arm.topic, arm.body) for arm in arms})
    for (topic, first), (other_topic, second) in combinations(bodies, 2):
        if topic != other_topic:
            continue
        swaps = _swaps(_of(arms, topic, first), _of(arms, topic, second))
        if not len(swaps):
            continue
        pairs = [
            (i, k)
            for i, one in enumerate(arms)
            for k, other in enumerate(arms)
            if (one.topic, one.body, other.topic, other.body) == (topic, first, topic, second)
            and one.side == other.side
        ]
        stamp = arms[pairs[0][0]].stamp_ns
        exchanged = np.zeros(len(stamp), bool)
        for row in swaps:
            exchanged[row:] ^= True
        for i, k in pairs:
            arms[i], arms[k] = (
                _exchanged(arms[i], arms[k], exchanged, store or Store()),
                _exchanged(arms[k], arms[i], exchanged, store or Store()),
            )
        seconds = [f"{(int(stamp[run.start]) - int(stamp[0])) / 1e9:.1f}" for run in runs(exchanged)]
        notes.append(
            f"Bodies {first} and {second} of {topic} exchange their numbers {', '.join(seconds[:5])} s after"
            " the first frame (each jumps to where the other was); they were exchanged back."
        )
    return arms, notes


def _of(arms: list[ArmFrames], topic: str, body: int) -> list[ArmFrames]:
    return [arm for arm in arms if (arm.topic, arm.body) == (topic, body)]


def _place(arms: list[ArmFrames]) -> tuple[FloatArray, BoolArray]:
    """Where a body is in each frame (n, 3), by its shoulders, and whether all of them are there (n,)."""
    there = np.all([arm.state[:, _SHOULDER] != JointState.NOT_TRACKED for arm in arms], axis=0)
    return np.mean([arm.position[:, _SHOULDER] for arm in arms], axis=0), there


def _swaps(first: list[ArmFrames], second: list[ArmFrames]) -> IntArray:
    """Rows from which on the numbers are exchanged, or exchanged back."""
    nothing = np.empty(0, np.int64)
    sides = {arm.side for arm in first}
    if sides != {arm.side for arm in second} or len({len(arm.stamp_ns) for arm in (*first, *second)}) != 1:
        return nothing
    a, a_there = _place(first)
    b, b_there = _place(second)
    rows = np.flatnonzero(a_there & b_there)
    if len(rows) < 2:
        return nothing
    soon = np.diff(first[0].stamp_ns[rows]) <= _SOON_NS
    a, b = a[rows], b[rows]

    def apart(now: FloatArray, before: FloatArray) -> FloatArray:
        return np.asarray(np.linalg.norm(now[1:] - before[:-1], axis=1))

    own_a, own_b = apart(a, a), apart(b, b)
    crossed = apart(a, b) + apart(b, a)
    jumps = soon & (np.minimum(own_a, own_b) > _JUMP_M) & (crossed < _LEFT * (own_a + own_b))
    # after one exchange the next one is seen in the numbers as they are then: every jump counts
    return np.asarray(rows[1:][jumps])


def _exchanged(own: ArmFrames, other: ArmFrames, rows: BoolArray, store: Store) -> ArmFrames:
    """An arm with the other body's joints in some frames."""
    position = store.array(own.position.shape, 0.0)
    for part in batches(len(position)):
        position[part] = np.where(rows[part, None, None], other.position[part], own.position[part])
    return replace(own, position=position, state=np.where(rows[:, None], other.state, own.state))
