"""Where a camera stands and how its clock runs, from the joints that it and the first camera both see.

A start in closed form (Kabsch, Acta Crystallographica A32, 1976), then a few robust Gauss-Newton steps on
pose, clock and a constant offset of each joint. Skeletons err by centimetres for a second at a time, so what
the samples scatter by says too little: the covariance is that of blocks of seconds (Liang and Zeger,
Biometrika 73, 1986).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..array_types import BoolArray, FloatArray
from ..linalg import nearest_rotation, skew
from ..recording import JOINTS, CameraPose, JointTracks
from ..rotation import Rotation
from .rig import Overlap, RelativeClock, overlap

#: A joint's constant error against the other camera's, m per axis, before the recording speaks.
OFFSET_M = 0.013
#: How far clocks drift before it speaks, s/s.
SKEW = 50e-6
#: Samples of one block share their error, s.
BLOCK_S = 3.0
#: No more samples than this are treated as one.
MOST_ALIKE = 100.0
#: Length of a residual, in sigmas, where its weight is halved.
CAUCHY = 2.5
#: At most this many steps; a step that moves the clock, s, and the joints, m, by less is the last.
STEPS = 20
SETTLED_S, SETTLED_M = 1e-4, 2e-4

#: Columns of what is solved: turn about the arm's centre (3), shift (3), clock's offset and skew, offsets of
#: the joints (5 x 3).
POSE, CLOCK, OFFSETS = slice(0, 6), slice(6, 8), slice(8, 8 + 3 * len(JOINTS))
SIZE = OFFSETS.stop


@dataclass(frozen=True)
class Placement:
    """A camera's pose and clock as the joints tell them."""

    R: FloatArray  # (3, 3): `R_K_C`
    p: FloatArray  # (3,) m: the origin of {C} in {K}
    clock: RelativeClock
    offset_m: FloatArray  # (5, 3) m: the first camera's joints less this one's in {K}: their constant errors
    centre_m: FloatArray  # (3,) m: mean place of the joints in {K}, that the turn is about
    covariance: FloatArray  # (SIZE, SIZE): of the columns
    misfit_m: float  # Median distance of the joints, each joint's own taken in the middle
    spread_m: float  # How far the joints move about their means, as a median over them

    @property
    def pose(self) -> CameraPose:
        """The pose with its sigmas."""
        variance = np.diag(self.covariance)
        return CameraPose(
            self.R, self.p, float(np.sqrt(variance[:3].mean())), float(np.sqrt(variance[3:6].mean()))
        )


def place(
    first: JointTracks, other: JointTracks, clock: RelativeClock, known: CameraPose | None = None
) -> tuple[Placement, Overlap] | None:
    """Pose and clock of a camera, from a clock that is right to some hundredths of a second."""
    together = overlap(first, other, clock)
    if len(together) < 10:
        return None
    middle = 0.5 * float(together.t[0] + together.t[-1])
    clock = replace(clock, middle_s=float(clock.from_first(np.array([middle]))[0]))
    placement = start(together, clock, known)
    for _ in range(STEPS):
        before, placement = placement, step(placement, together, known)
        again = overlap(first, other, placement.clock)
        if len(again) < 10:
            return None
        together = again
        moved_s = abs(placement.clock.offset_s - before.clock.offset_s)
        if moved_s < SETTLED_S and np.abs(placement.offset_m - before.offset_m).max() < SETTLED_M:
            break
    return placement, together


def start(together: Overlap, clock: RelativeClock, known: CameraPose | None = None) -> Placement:
    """The closed form: all joints of both as two clouds of points, twice, the second time without the far."""
    both = together.both
    use = both
    for _ in range(3):
        a, b = together.first[use], together.other[use]
        R = nearest_rotation((a - a.mean(axis=0)).T @ (b - b.mean(axis=0)))
        p = a.mean(axis=0) - R @ b.mean(axis=0)
        distance = np.linalg.norm(together.first - (together.other @ R.T + p), axis=2)
        use = both & (np.nan_to_num(distance, nan=np.inf) < 3.0 * float(np.median(distance[both])) + 1e-9)
    if known is not None:
        R, p = known.R_K_C, known.p_K_C_m
    centre = (together.other @ R.T + p)[both].mean(axis=0)
    zero = np.zeros((len(JOINTS), 3))
    return Placement(R, p, clock, zero, centre, np.eye(SIZE), *_misfit(together, R, p, zero))


def step(placement: Placement, together: Overlap, known: CameraPose | None = None) -> Placement:
    """A robust Gauss-Newton step on everything."""
    pose_sigma = [1e3] * 6 if known is None else np.repeat([known.sigma_rad, known.sigma_m], 3)
    sigma = np.concatenate([pose_sigma, [1e3, SKEW], np.full(3 * len(JOINTS), OFFSET_M)])
    at = np.zeros(SIZE)  # where the state is, from the prior's mean
    at[CLOCK.stop - 1] = placement.clock.skew
    at[OFFSETS] = placement.offset_m.ravel()
    if known is not None:
        turned = Rotation.from_matrix(placement.R @ known.R_K_C.T).as_rotvec()
        centre = known.R_K_C @ placement.R.T @ (placement.centre_m - placement.p) + known.p_K_C_m
        at[POSE] = np.concatenate([turned, placement.centre_m - centre])
    change, covariance = solved(*_normal_equations(placement, together), np.diag(sigma**-2.0), at)
    turn = Rotation.from_rotvec(change[:3]).as_matrix()
    R = turn @ placement.R
    p = turn @ (placement.p - placement.centre_m) + placement.centre_m + change[3:6]
    clock = replace(
        placement.clock,
        offset_s=placement.clock.offset_s + float(change[6]),
        skew=placement.clock.skew + float(change[7]),
        sigma_s=float(np.sqrt(covariance[6, 6])),
    )
    offset = placement.offset_m + change[OFFSETS].reshape(-1, 3)
    misfit_m = _misfit(together, R, p, offset)[0]
    there = replace(placement, R=R, p=p, clock=clock, offset_m=offset)
    return replace(there, covariance=covariance, misfit_m=misfit_m)


def solved(
    information: FloatArray,
    vector: FloatArray,
    meat: FloatArray,
    curvature: float,
    prior: FloatArray,
    at: FloatArray,  # from the prior's mean
) -> tuple[FloatArray, FloatArray]:
    """The step and its covariance by the scatter of blocks; pose first in the columns."""
    # neighbours share their errors: this many of them are treated as one, which the prior is weighed against
    alike = float(np.mean(np.diag(meat)[POSE] / np.maximum(np.diag(information)[POSE], 1e-9)))
    alike = min(max(alike, 1.0), MOST_ALIKE)
    information, vector, meat = information / alike, vector / alike, meat / alike**2
    inverse = np.linalg.inv(curvature * information + prior)
    step = np.asarray(np.linalg.solve(information + prior, vector - prior @ at), float)
    covariance: FloatArray = inverse @ (meat + prior) @ inverse
    return step, covariance


def residuals(placement: Placement, together: Overlap) -> FloatArray:
    """The first camera's joints less this one's, (n, 5, 3) m in {K}, constant offsets taken off."""
    placed = together.other @ placement.R.T + placement.p + placement.offset_m
    return np.asarray(np.where(together.both[:, :, None], together.first - placed, np.nan))


def weights(residual: FloatArray, both: BoolArray) -> FloatArray:
    """1 / variance of each joint's samples (n, 5), m^-2, those that are far off with less."""
    length = np.linalg.norm(residual, axis=2)
    weight = np.zeros(both.shape)
    for column in range(both.shape[1]):
        own = length[both[:, column], column]
        if len(own):
            sigma = max(float(np.median(own)) / 1.538, 1e-4)  # of three normal numbers the median length
            weight[both[:, column], column] = 1.0 / (1.0 + (own / (CAUCHY * sigma)) ** 2) / sigma**2
    return weight


def _normal_equations(
    placement: Placement, together: Overlap
) -> tuple[FloatArray, FloatArray, FloatArray, float]:
    """Information, vector, the scatter of the vector by blocks, and how much less the loss is curved."""
    residual = residuals(placement, together)
    weight = weights(residual, together.both)
    block = np.floor((together.t - together.t[0]) / BLOCK_S).astype(int)
    count = int(block[-1]) + 1
    middle = float(placement.clock.to_first(np.array([placement.clock.middle_s]))[0])
    vectors = np.zeros((count, SIZE))
    information = np.zeros((SIZE, SIZE))
    for column in range(len(JOINTS)):
        rows = np.flatnonzero(together.both[:, column])
        if not len(rows):
            continue
        turned = together.other[rows, column] @ placement.R.T + placement.p - placement.centre_m
        # a later clock shows an earlier joint
        late = -together.velocity[rows, column]
        columns = np.zeros((len(rows), 3, SIZE))
        columns[:, :, :3] = -skew(turned)
        columns[:, :, 3:6] = np.eye(3)
        columns[:, :, 6] = late
        columns[:, :, 7] = late * (together.t[rows] - middle)[:, None]
        first = OFFSETS.start + 3 * column
        columns[:, :, first : first + 3] = np.eye(3)
        w = weight[rows, column]
        weighted = columns * w[:, None, None]
        information += np.einsum("nij,nik->jk", weighted, columns)
        np.add.at(vectors, block[rows], np.einsum("nij,ni->nj", weighted, residual[rows, column]))
    centred = vectors - vectors.mean(axis=0)
    # a robust loss is flatter than its weights say: w + r w' / 3 on the average of three axes
    used = weight[together.both]
    largest = weight.max(axis=0, initial=0.0)  # of each joint: where the residual is none
    share = (weight / np.maximum(largest, 1e-12))[together.both]
    curvature = float(np.sum(used * (1.0 - 2.0 / 3.0 * (1.0 - share))) / max(float(used.sum()), 1e-12))
    return information, vectors.sum(axis=0), centred.T @ centred * count / max(count - 1, 1), curvature


def _misfit(together: Overlap, R: FloatArray, p: FloatArray, offset: FloatArray) -> tuple[float, float]:
    """Median distance of the joints, and how far they move, m."""
    placed = together.other @ R.T + p + offset
    distances, spreads = [], []
    for column in range(len(JOINTS)):
        both = together.both[:, column]
        if both.sum() < 10:
            continue
        first = together.first[both, column]
        distances.append(float(np.median(np.linalg.norm(first - placed[both, column], axis=1))))
        spreads.append(float(np.sqrt(np.mean(np.sum((first - first.mean(axis=0)) ** 2, axis=1)))))
    if not distances:
        return float("inf"), 0.0
    return float(np.median(distances)), float(np.median(spreads))
