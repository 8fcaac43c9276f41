"""One person under several numbers: a camera that loses a body counts it anew."""

from __future__ import annotations

from dataclasses import replace
from typing import Protocol

import numpy as np

from ...recording import FOREARM_JOINTS, JOINTS, JointState
from ...runtime.store import Store, batches
from .streams import ArmFrames

#: A body that comes back within this time and distance counts as the same one.
_AWAY_S = 30.0
_APART_M = 0.4
#: The shoulder moves least, so it is asked first.
_ASKED = [JOINTS.index(joint) for joint in ("shoulder", "elbow", "wrist", "hand", "strap")]


class WornAgreement(Protocol):
    """What IMUs say of two bodies; see `WornImus.agree`."""

    def agree(self, earlier: list[int], later: int, topic: str) -> bool | None:
        """Whether a body wears what another wore; None where that is open."""
        ...


def join_bodies(
    arms: list[ArmFrames], store: Store | None = None, worn: WornAgreement | None = None
) -> tuple[list[ArmFrames], list[str]]:
    """Join arms of one topic and side that are never seen together and take over where the other was lost.

    Where IMUs tell people apart they decide: a body that wears what another wore is the same one, wherever
    it comes back, and one that does not is another, even in the same place.

    Parameters
    ----------
    arms : list of ArmFrames
        As the file has them; they stay as they are.
    store : Store, optional
        Where the positions of joined arms are to lie; None = in memory.
    worn : WornAgreement, optional
        Which IMUs the bodies wear; None = not asked.

    Returns
    -------
    arms : list of ArmFrames
        Joined ones under the first body's number.
    notes : list of str
        A sentence for each joining, and for each that the IMUs forbid.
    """
    joined: list[ArmFrames] = []
    numbers: list[list[int]] = []  # that each of them had so far
    notes = []
    for arm in sorted(arms, key=lambda arm: first_and_last(arm)[0]):
        follows = {
            place: _continues(earlier, arm)
            for place, earlier in enumerate(joined)
            if _comes_after(earlier, arm, numbers[place])
        }
        agreed = {
            place: None if worn is None else worn.agree(numbers[place], arm.body, arm.topic)
            for place in follows
        }
        by_imu = [place for place, agrees in agreed.items() if agrees]
        by_place = [place for place, agrees in agreed.items() if follows[place] and agrees is None]
        notes += [
            f"{joined[place].label} and body {arm.body} were not joined: one came where the other was lost,"
            " but they wear different IMUs."
            for place, agrees in agreed.items()
            if agrees is False and follows[place]
        ]
        if not by_imu and not by_place:
            joined.append(arm)
            numbers.append([arm.body])
            continue
        place = (by_imu or by_place)[0]
        earlier = joined[place]
        joined[place] = _joined(earlier, arm, store or Store())
        numbers[place].append(arm.body)
        how = (
            "numbered it anew where it was"
            if follows[place]
            else "numbered it anew elsewhere, which the IMU that both wear says"
        )
        notes.append(
            f"{earlier.label} and body {arm.body} were joined: the camera lost the body and {how};"
            " --body takes one alone."
        )
    return joined, notes


def _joined(earlier: ArmFrames, later: ArmFrames, store: Store) -> ArmFrames:
    position = store.array(earlier.position.shape, 0.0)
    for part in batches(len(position)):
        mine = (later.state[part] != JointState.NOT_TRACKED)[:, :, None]
        position[part] = np.where(mine, later.position[part], earlier.position[part])
    return replace(earlier, state=np.maximum(earlier.state, later.state), position=position)


def first_and_last(arm: ArmFrames) -> tuple[int, int]:
    """First and last frame in which anything of the arm is there; past the end for none."""
    there = np.flatnonzero((arm.state != JointState.NOT_TRACKED).any(axis=1))
    return (int(there[0]), int(there[-1])) if len(there) else (len(arm.stamp_ns), len(arm.stamp_ns))


def _comes_after(earlier: ArmFrames, later: ArmFrames, numbers: list[int]) -> bool:
    """Whether it is the same arm of a body that is first seen when the other was lost."""
    if (earlier.topic, earlier.side) != (later.topic, later.side) or later.body in numbers:
        return False
    return first_and_last(earlier)[1] < first_and_last(later)[0] < len(later.stamp_ns)


def _continues(earlier: ArmFrames, later: ArmFrames) -> bool:
    """Whether it comes back soon and near."""
    lost, back = first_and_last(earlier)[1], first_and_last(later)[0]
    away = abs(int(later.stamp_ns[back]) - int(earlier.stamp_ns[lost])) / 1e9
    if away > _AWAY_S:
        return False
    for joint in _ASKED:
        if earlier.state[lost, joint] and later.state[back, joint]:
            step = np.linalg.norm(later.position[back, joint] - earlier.position[lost, joint])
            # Only the forearm's joints may have moved on while nobody looked.
            reach = _APART_M + (0.4 if JOINTS[joint] in FOREARM_JOINTS else 0.0)
            return bool(step < reach)
    return False
