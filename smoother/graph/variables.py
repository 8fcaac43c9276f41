"""The variables of the graphs: their keys by segment of the arm, and by their letter sizes and values."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache
from typing import Any, NamedTuple

import gtsam
import numpy as np
from numpy.typing import NDArray

from ..array_types import IntArray
from ..body import SEGMENTS
from ..recording import JOINTS


class SegmentKeys(NamedTuple):
    """The first key of each kind of a segment's variables; the n-th key is n more."""

    pose: int  # By node; the point is that of the joint that the segment shares with its parent
    velocity: int  # By node; the point is that of the joint that the segment shares with its parent
    bias: int  # By number of the bias
    lever: int  # By number of the joint in `JOINTS`
    point: int  # By node; the point is that of the joint that the segment shares with its parent

    def lever_of(self, joint: str) -> int:
        """Key of a joint's lever arm."""
        return self.lever + JOINTS.index(joint)


@cache
def keys_of(segment: str) -> SegmentKeys:
    """The keys of a segment of the arm."""
    letters = SEGMENTS[segment].letters.ljust(5, " ")
    return SegmentKeys(*(gtsam.Symbol(letter, 0).key() for letter in letters))


def node_keys(segment: str, node: int) -> list[int]:
    """Keys of a segment's pose and velocity at a node, and of the joint that it shares with its parent."""
    keys, has_point = keys_of(segment), bool(SEGMENTS[segment].shared_joint)
    return [keys.pose + node, keys.velocity + node, *([keys.point + node] if has_point else [])]


#: Dimension of a variable.
DIMENSION = {"g": 2, "u": 1, "s": 3}
_READ: dict[str, Callable[[gtsam.Values, int], Any]] = {
    "g": gtsam.Values.atUnit3,
    "u": gtsam.Values.atDouble,
    "s": gtsam.Values.atPoint3,
}
_KINDS = (
    (6, gtsam.Values.atPose3),
    (3, gtsam.Values.atVector),
    (6, gtsam.Values.atConstantBias),
    (3, gtsam.Values.atPoint3),
    (3, gtsam.Values.atPoint3),
)
for _segment in SEGMENTS.values():
    for _letter, (_dimension, _read) in zip(_segment.letters, _KINDS, strict=False):
        DIMENSION[_letter], _READ[_letter] = _dimension, _read
#: The dimension by the letter's number, and where a key has its letter (GTSAM's `Symbol`).
_SIZE = np.zeros(128, int)
_SIZE[[ord(letter) for letter in DIMENSION]] = list(DIMENSION.values())
LETTER_BITS = 56


def letter_of(key: int) -> str:
    """Of a variable's key: as `gtsam.Symbol` reads it, in a tenth of the time."""
    return chr(key >> LETTER_BITS)


def sizes_of(keys: NDArray[np.uint64]) -> IntArray:
    """Dimensions of many variables."""
    return np.asarray(_SIZE[(keys >> np.uint64(LETTER_BITS)).astype(int)])


def values_of(values: gtsam.Values, keys: Sequence[int]) -> gtsam.Values:
    """The present values of some variables."""
    some = gtsam.Values()
    for key in keys:
        some.insert(key, _READ[letter_of(key)](values, key))
    return some
