"""Which IMU is on which body and limb: `match_imus`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ..array_types import BoolArray, FloatArray, IntArray
from ..errors import UnoccludeError
from ..recording import ImuStream
from .excerpt_motion import GRID_HZ, SHORTEST_S, Limb, MatchExcerpt, read_excerpts
from .joint_likelihood import joint_likelihood
from .rigid_fit import rigid_evidence

#: A limb that an IMU cannot be on costs this.
_NEVER = 1e6


def assign(weight: FloatArray, none: FloatArray) -> IntArray:  # weight (k, m); none (k,) -> int (k,)
    """The assignment of largest total weight: each IMU to one limb or none, each limb to one IMU at most.

    Rectangular assignment (Crouse, IEEE Trans. Aerosp. Electron. Syst. 2016) by
    `scipy.optimize.linear_sum_assignment`; every IMU has a column `none` of its own.
    """
    from scipy.optimize import linear_sum_assignment  # slow to load

    k, m = weight.shape
    columns = _with_none(weight, none)
    rows, chosen = linear_sum_assignment(-columns)
    limb = np.full(k, -1)
    limb[rows] = np.where(chosen < m, chosen, -1)
    return limb


def probabilities(weight: FloatArray, none: FloatArray) -> FloatArray:  # -> (k, m + 1)
    """How probable each pair is, over all assignments."""
    from scipy.optimize import linear_sum_assignment

    k, m = weight.shape
    columns = _with_none(weight, none)
    total = np.full((k, m + 1), -np.inf)
    for i in range(k):
        others = np.delete(columns, i, axis=0)
        for j in range(m + 1):
            # `none` takes no limb; another IMU keeps its own `none`
            free = np.delete(others, j if j < m else m + i, axis=1)
            rows, chosen = linear_sum_assignment(-free)
            total[i, j] = (weight[i, j] if j < m else none[i]) + free[rows, chosen].sum()
    total -= total.max(axis=1, keepdims=True)
    share = np.exp(total)
    return np.asarray(share / share.sum(axis=1, keepdims=True))


def _with_none(weight: FloatArray, none: FloatArray) -> FloatArray:
    k = len(weight)
    own = np.full((k, k), -_NEVER)
    own[np.diag_indices(k)] = none
    return np.hstack([np.maximum(weight, -_NEVER), own])


#: An IMU is `unknown` where nothing is more probable than this.
NAMED_FROM = 0.6
#: Above this a pair is sure.
SURE_FROM = 0.95
#: Clocks: most are within the first of each other, s; this many are anywhere within reach.
CLOCKS_NEAR_S, CLOCKS_FAR = 0.1, 0.2
#: Before anything is seen: an IMU is on no limb in view; worn on a forearm rather than an upper arm.
PRIOR_NONE, PRIOR_WRIST = 0.2, 0.75
#: Below this rate, rad/s, a sensor is not on a living limb; how long a limb keeps so still by chance, s.
STILL_RATE, STILL_CHANCE_S, MOST_STILL = 0.005, 2.0, 8.0

#: Evidence (m,) that an IMU is on each limb, and its clock's shift there (m,), s.
Measure = Callable[[list[MatchExcerpt], int, "FloatArray | None", FloatArray], tuple[FloatArray, FloatArray]]
#: All methods by name; ours first.
METHODS: dict[str, Measure] = {
    "motion": rigid_evidence,
    "joint-likelihood": joint_likelihood,
}


@dataclass(frozen=True)
class ImuMatch:
    """What was decided of one IMU."""

    imu: str  # Its name in the recording
    limb: Limb | None  # What it is on; None for none of the limbs, and where nothing is probable enough
    is_known: bool  # False = `unknown`: neither a limb nor `none` is probable enough
    probability: float  # Of the limb, or of `none`; of the most probable where it is unknown
    clock_offset_s: float  # t_imu - t_camera to some 0.1 s, at the limb; nan without
    # Further candidates with a probability of 1 % and more, the best first
    others: tuple[tuple[str, float], ...] = ()

    @property
    def is_sure(self) -> bool:
        """The pair can be relied upon."""
        return self.limb is not None and self.probability > SURE_FROM

    @property
    def joint(self) -> str:
        """What a match says: "wrist_right", ..; "none" on no limb in view; "unknown"."""
        if self.limb is not None:
            return self.limb.joint
        return "none" if self.is_known else "unknown"

    def to_dict(self) -> dict[str, object]:
        """For JSON."""
        return {
            "imu": self.imu,
            "body": None if self.limb is None else self.limb.body,
            "joint": self.joint,
            "probability": self.probability,
            "sure": self.is_sure,
            "clock_offset_s": self.clock_offset_s,
            "others": [{"where": where, "probability": p} for where, p in self.others],
        }


@dataclass(frozen=True)
class PairEvidence:
    """Evidence from the motion on k IMUs and m limbs."""

    limb: FloatArray  # (k, m): log-likelihood ratio of an IMU on a limb against on none
    none: FloatArray  # (k,): further evidence for `none`: a sensor that does not move at all
    shift_s: FloatArray  # (k, m) s: t_imu - t_camera of each pair


def match_imus(
    imus: Sequence[ImuStream],
    limbs: Sequence[Limb],
    down: FloatArray | None = None,  # (3,)
    method: str = "motion",
    reach_s: float = 5.0,
    allowed: BoolArray | None = None,  # bool (k, m)
) -> list[ImuMatch]:
    """Settle for all IMUs together which limb each is on, by motion alone."""
    if not imus or not limbs:
        return [ImuMatch(imu.name, None, False, float("nan"), float("nan")) for imu in imus]
    return decide(imus, limbs, pair_evidence(imus, limbs, down, method, reach_s), allowed)


def pair_evidence(
    imus: Sequence[ImuStream],
    limbs: Sequence[Limb],
    down: FloatArray | None = None,
    method: str = "motion",
    reach_s: float = 5.0,
) -> PairEvidence:
    """Evidence from the motion on every pair, before anything is assigned; parameters as `match_imus`."""
    if method not in METHODS:
        raise UnoccludeError(f"there is no method '{method}' to match with; methods: {', '.join(METHODS)}")
    excerpts = read_excerpts(imus, limbs, reach_s)
    cost = shift_cost(excerpts[0].reach)
    rows = [METHODS[method](excerpts, i, down, cost) for i in range(len(imus))]
    still = np.array([stillness(excerpts, i) for i in range(len(imus))])
    return PairEvidence(np.array([row[0] for row in rows]), still, np.array([row[1] for row in rows]))


def decide(
    imus: Sequence[ImuStream],
    limbs: Sequence[Limb],
    pairs: PairEvidence,
    allowed: BoolArray | None = None,
) -> list[ImuMatch]:
    """One assignment of all IMUs by evidence and priors; parameters and returns as `match_imus`."""
    weight = pairs.limb + _limb_prior(limbs)
    if allowed is not None:
        weight[~allowed] = -np.inf
    none = np.log(PRIOR_NONE) + pairs.none
    chosen, share = assign(weight, none), probabilities(weight, none)
    return [_decided(imu, limbs, chosen[i], share[i], pairs.shift_s[i]) for i, imu in enumerate(imus)]


def shift_cost(reach: int) -> FloatArray:
    """Minus the log-prior of each shift from -reach to reach, 0 for the likeliest."""
    shift = np.arange(-reach, reach + 1) / GRID_HZ
    near = np.exp(-0.5 * (shift / CLOCKS_NEAR_S) ** 2)
    prior = (1 - CLOCKS_FAR) * near / near.sum() + CLOCKS_FAR / len(shift)
    return np.asarray(-np.log(prior / prior.max()))


def stillness(excerpts: list[MatchExcerpt], imu: int) -> float:
    """Evidence that a sensor is on nothing that lives: the time in which it does not turn at all."""
    still_s, step = 0.0, int(SHORTEST_S * GRID_HZ)
    for excerpt in excerpts:
        motion, count = excerpt.imus[imu], len(excerpt.t) // step
        rows = slice(excerpt.reach, excerpt.reach + count * step)
        rate, there = (x[rows].reshape(count, step) for x in (motion.rate, motion.there))
        still_s += SHORTEST_S * int((there.all(axis=1) & (np.ptp(rate, axis=1) < STILL_RATE)).sum())
    return min(still_s / STILL_CHANCE_S, MOST_STILL)


def _limb_prior(limbs: Sequence[Limb]) -> FloatArray:
    share = np.array([PRIOR_WRIST if limb.segment == "wrist" else 1 - PRIOR_WRIST for limb in limbs])
    return np.asarray(np.log((1 - PRIOR_NONE) * share / share.sum()))


def _decided(
    imu: ImuStream, limbs: Sequence[Limb], chosen: int, share: FloatArray, shift: FloatArray
) -> ImuMatch:
    best = float(share[chosen])  # -1 is the last column, `none`
    names = [*(limb.label for limb in limbs), "none"]
    known = best >= NAMED_FROM
    order = [k for k in np.argsort(-share) if share[k] >= 0.01 and not (known and k == chosen % len(names))]
    others = tuple((names[k], float(share[k])) for k in order)
    if not known:
        return ImuMatch(imu.name, None, False, float(share.max()), float("nan"), others)
    limb = limbs[chosen] if chosen >= 0 else None
    offset = float(shift[chosen]) if limb is not None else float("nan")
    return ImuMatch(imu.name, limb, True, best, offset, others)
