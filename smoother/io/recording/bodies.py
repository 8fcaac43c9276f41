"""One person under several numbers: a camera that loses a body counts it anew."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...recording import FOREARM_JOINTS, JOINTS, JointState
from ...runtime.column import batches
from ...runtime.store import Store
from .streams import ArmFrames

#: A body that comes back within this time and distance counts as the same one.
_AWAY_S = 30.0
_APART_M = 0.4
#: The shoulder moves least, so it is asked first.
_ASKED = [JOINTS.index(joint) for joint in ("shoulder", "elbow", "wrist", "hand", "strap")]


def join_bodies(arms: list[ArmFrames], store: Store | None = None) -> tuple[list[ArmFrames], list[str]]:
    """Join arms of one topic and side that are never seen together and take over where the other was lost.

    Parameters
    ----------
    arms : list of ArmFrames
        As the file has them; they stay as they are.
    store : Store, optional
        Where the positions of joined arms are to lie; None = in memory.

    Returns
    -------
    arms : list of ArmFrames
        Joined ones under the first body's number.
    notes : list of str
        A sentence for each joining.
    """
    joined: list[ArmFrames] = []
    notes = []
    for arm in sorted(arms, key=lambda arm: _first_and_last(arm)[0]):
        for i, earlier in enumerate(joined):
            if _follows(earlier, arm):
                joined[i] = _joined(earlier, arm, store or Store())
                notes.append(
                    f"{earlier.label} and body {arm.body} were joined: the camera lost the body and numbered "
                    "it anew where it was; --body takes one alone."
                )
                break
        else:
            joined.append(arm)
    return joined, notes


def _joined(earlier: ArmFrames, later: ArmFrames, store: Store) -> ArmFrames:
    position = store.array(earlier.position.shape, 0.0)
    for part in batches(len(position)):
        mine = (later.state[part] != JointState.NOT_TRACKED)[:, :, None]
        position[part] = np.where(mine, later.position[part], earlier.position[part])
    return replace(earlier, state=np.maximum(earlier.state, later.state), position=position)


def _first_and_last(arm: ArmFrames) -> tuple[int, int]:
    """First and last frame in which anything of the arm is there; past the end for none."""
    there = np.flatnonzero((arm.state != JointState.NOT_TRACKED).any(axis=1))
    return (int(there[0]), int(there[-1])) if len(there) else (len(arm.stamp_ns), len(arm.stamp_ns))


def _follows(earlier: ArmFrames, later: ArmFrames) -> bool:
    if (earlier.topic, earlier.side) != (later.topic, later.side) or earlier.body == later.body:
        return False
    lost, back = _first_and_last(earlier)[1], _first_and_last(later)[0]
    if not lost < back < len(later.stamp_ns):
        return False
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
