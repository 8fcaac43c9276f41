"""What two cameras saw of an arm at the same moments."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..array_types import BoolArray, FloatArray
from ..measurements.visibility import accepted_samples
from ..recording import JOINTS, JointTracks
from .rig import RelativeClock

#: Frames of the other camera before and after a moment are no farther apart than this, s.
APART_S = 0.12
#: Velocities are differences over this many frames on both sides.
BESIDE = 2
#: More moments than this do not improve a pose.
MOST_MOMENTS = 12_000


@dataclass(frozen=True)
class Overlap:
    """Joints that both cameras track, at the first one's frames."""

    t: FloatArray  # (n,) s: on the first camera's clock
    first: FloatArray  # (n, 5, 3) m: in {K}
    other: FloatArray  # (n, 5, 3) m: in {C}, between its frames
    # (n, 5, 3) m/s: Of the first camera's joints, by frames on both sides of each moment
    velocity: FloatArray
    both: BoolArray  # bool (n, 5): tracked by both
    step_s: float  # Time that a moment represents

    def __len__(self) -> int:
        return len(self.t)

    @property
    def length_s(self) -> float:
        """Time during which both saw elbow, wrist or another joint of the forearm, s."""
        return float(self.both[:, 1:].any(axis=1).sum()) * self.step_s

    def rows(self, rows: slice | BoolArray) -> Overlap:
        """Some of the moments."""
        points = self.first[rows], self.other[rows], self.velocity[rows]
        return Overlap(self.t[rows], *points, self.both[rows], self.step_s)

    def mirrored(self) -> Overlap:
        """As if the other camera's x axis pointed the other way."""
        flip = np.array([-1.0, 1.0, 1.0])
        return replace(self, other=self.other * flip)


def overlap(
    first: JointTracks, other: JointTracks, clock: RelativeClock, most: int = MOST_MOMENTS
) -> Overlap:
    """The moments at which both cameras track a joint."""
    t = np.asarray(first.t_s)
    other_t = np.asarray(other.t_s)
    empty = np.zeros((0, len(JOINTS), 3))
    none = Overlap(np.zeros(0), empty, empty, empty, np.zeros((0, len(JOINTS)), bool), 0.0)
    if len(t) < 2 or len(other_t) < 2:
        return none
    at = clock.from_first(t)
    rows = np.flatnonzero((at >= other_t[0]) & (at <= other_t[-1]))
    every = -(-len(rows) // most) if len(rows) else 1
    rows = rows[::every]
    after = np.clip(np.searchsorted(other_t, at[rows], side="right"), 1, len(other_t) - 1)
    before = after - 1
    dt = other_t[after] - other_t[before]
    near = (dt > 0.0) & (dt <= APART_S)
    rows, after, before, dt = rows[near], after[near], before[near], dt[near]
    tracked, other_tracked = accepted_samples(first), accepted_samples(other)
    both = tracked[rows] & other_tracked[before] & other_tracked[after]
    some = both.any(axis=1)
    rows, after, before, dt, both = rows[some], after[some], before[some], dt[some], both[some]
    if not len(rows):
        return none
    share = ((at[rows] - other_t[before]) / dt)[:, None, None]
    a, b = np.asarray(other.position[before]), np.asarray(other.position[after])
    # velocities by central differences
    early, late = np.maximum(rows - BESIDE, 0), np.minimum(rows + BESIDE, len(t) - 1)
    span_s = t[late] - t[early]
    is_short = (span_s > 0.0) & (span_s < 2 * BESIDE * APART_S)
    change = np.asarray(first.position[late]) - np.asarray(first.position[early])
    velocity = change / np.maximum(span_s, 1e-6)[:, None, None]
    known = tracked[early] & tracked[late] & is_short[:, None]
    return Overlap(
        t[rows],
        np.asarray(first.position[rows]),
        a + share * (b - a),
        np.where(known[:, :, None], velocity, 0.0),
        both,
        float(np.median(np.diff(t))) * every,
    )
