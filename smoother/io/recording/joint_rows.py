"""Joints as messages bring them, and the arms that they make up."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...array_types import FloatArray, IntArray
from ...recording import JOINTS, CameraFrame, JointState
from ...runtime.store import Column, Store, batches
from .streams import ArmFrames

SIDES = ("", "left", "right")
#: State of a joint of which a row says nothing.
UNREPORTED = -128


class JointRows:
    """What messages say of arms, gathered over a recording: a row is what one message says of one arm.

    Parameters
    ----------
    store : Store, optional
        Where the rows lie; None = in memory.
    """

    def __init__(self, store: Store | None = None):
        self._store = store or Store()
        self._message = Column(self._store, (), np.int64)
        self._arm = Column(self._store, (), np.int64)
        self._arms: set[int] = set()
        self._position = Column(self._store, (len(JOINTS), 3))
        self._state = Column(self._store, (len(JOINTS),), np.int8)

    def add(
        self, message: IntArray, body: IntArray, side: IntArray, state: NDArray[np.int8], position: FloatArray
    ) -> None:
        """Take rows.

        Parameters
        ----------
        message : ndarray of int, shape (n,)
            Number of the message that each is of.
        body, side : ndarray of int, shape (n,)
            The arm; sides as positions in `SIDES`.
        state : ndarray of int8, shape (n, 5)
            Of the joints; `UNREPORTED` where the message does not name one.
        position : ndarray, shape (n, 5, 3), m
        """
        position[(state == JointState.NOT_TRACKED) | (state == UNREPORTED)] = np.nan
        arm = body * len(SIDES) + side
        self._arms.update(np.unique(arm).tolist())
        self._arm.append(arm)
        self._message.append(message)
        self._state.append(state)
        self._position.append(position)

    def add_joints(
        self,
        message: IntArray,
        body: IntArray,
        side: IntArray,
        joint: IntArray,
        state: IntArray,
        position: FloatArray,
    ) -> None:
        """Take joints (n,) one by one, with positions (n, 3); of a joint said twice the last counts."""
        if not len(message):
            return
        arms, arm = np.unique(body * len(SIDES) + side, return_inverse=True)
        code, row = np.unique(message * len(arms) + arm, return_inverse=True)
        states = np.full((len(code), len(JOINTS)), UNREPORTED, np.int8)
        positions = np.full((len(code), len(JOINTS), 3), np.nan)
        states[row, joint], positions[row, joint] = state, position
        which, side_of = np.divmod(arms[code % len(arms)], len(SIDES))
        self.add(code // len(arms), which, side_of, states, positions)

    def arms(
        self, stamp_ns: IntArray, topic: str, frame_id: str, camera_frame: CameraFrame | None
    ) -> list[ArmFrames]:
        """Every arm of every body; all frames belong to all of them, so that absence is seen.

        Parameters
        ----------
        stamp_ns : ndarray of int, shape (messages,)
            Stamps; messages of one stamp are one frame.
        """
        if not len(self._message):
            return []
        frames, number = frames_of(stamp_ns)
        message, arm = self._message.done(), self._arm.done()
        position, state = self._position.done(), self._state.done()
        frame = message if number is None else number[message]
        alone = len(self._arms) == 1 and len(frame) == len(frames) and self._is_count(frame)
        arms = []
        for which in sorted(self._arms):
            body, side = divmod(which, len(SIDES))
            if alone:
                positions, states = (
                    position,
                    np.maximum(state, np.int8(0), out=state, where=state == UNREPORTED),
                )
            else:
                positions, states = self._scattered(frame, arm == which, position, state, len(frames))
            arms.append(
                ArmFrames(topic, frame_id, body, SIDES[side], frames, positions, states, camera_frame)
            )
        return arms

    def _scattered(
        self,
        frame: IntArray,
        mine: NDArray[np.bool_],
        position: FloatArray,
        state: NDArray[np.int8],
        count: int,
    ) -> tuple[FloatArray, NDArray[np.int8]]:
        """Rows to the frames that they are of."""
        positions = self._store.array((count, len(JOINTS), 3))
        states = np.zeros((count, len(JOINTS)), np.int8)
        for part in batches(len(frame)):
            at, said, there = frame[part][mine[part]], state[part][mine[part]], position[part][mine[part]]
            row, joint = np.nonzero(said != UNREPORTED)
            states[at[row], joint] = said[row, joint]
            positions[at[row], joint] = there[row, joint]
        return positions, states

    def _is_count(self, number: IntArray) -> bool:
        """Whether numbers (n,) are 0, 1, 2, .."""
        parts = batches(len(number))
        return all((number[part] == np.arange(part.start, part.stop)).all() for part in parts)


def frames_of(stamp_ns: IntArray) -> tuple[IntArray, IntArray | None]:
    """Different stamps in the order in which they came first, and which of them each is (None: its own)."""
    if (stamp_ns[1:] > stamp_ns[:-1]).all():
        return stamp_ns, None
    if (stamp_ns[1:] >= stamp_ns[:-1]).all():
        is_new = np.append(True, stamp_ns[1:] != stamp_ns[:-1])
        return stamp_ns[is_new], np.cumsum(is_new) - 1
    unique, first, which = np.unique(stamp_ns, return_index=True, return_inverse=True)
    order = np.argsort(first)
    rank = np.empty(len(unique), np.int64)
    rank[order] = np.arange(len(unique))
    return unique[order], rank[which]
