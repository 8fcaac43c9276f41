"""Sigma correction factors from hidden gaps of the user's own recording.

Samples inside a gap hang together; what can be exchanged for another is the gap. So the quantile is that of
hierarchical conformal prediction (Lee, Barber and Willett 2023, "Distribution-free inference with
hierarchical data", eq 7; with groups of one sample: Vovk, Gammerman and Shafer 2005; Lei et al. 2018): every
gap weighs 1 / (K + 1), shared by its samples, and the gap to come weighs the rest. A sample of the next gap
then lies inside with at least the level's probability, whatever the errors look like, if the next gap is
like the hidden ones.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial

import numpy as np

from smoother.array_types import BoolArray, FloatArray
from smoother.calibration import ArmCalibration, SigmaFactor, SigmaFactors
from smoother.config import Config
from smoother.errors import UnoccludeError
from smoother.linalg import interpolate
from smoother.recording import Recording
from smoother.runtime.pool import Pool
from smoother.smoothing import smooth

#: Levels of the regions that are asked for.
LEVELS = (0.5, 0.95)
#: This many gaps are needed for the last level (K / (K + 1) must reach it).
ENOUGH_GAPS = 19
#: A factor below 1 needs this many gaps, and holds with this probability over gaps drawn again.
FIRM_GAPS, FIRM = 60, 0.95
DRAWS = 400
#: Beyond this factor it is not sigma that is wrong.
LARGEST_FACTOR = 10.0


@dataclass(frozen=True)
class LengthFactor:
    """What hidden gaps of one length ask of sigma."""

    length_s: float
    count: int  # Gaps behind it: of this length, or of all lengths together where `pooled`
    pooled: bool  # The gaps of this length alone are too few
    factor_50: float  # By which sigma has to be multiplied for the 50 % region to hold
    factor_95: float  # By which for the 95 % region
    level: float  # What `factor_95` holds: 0.95, or less where there are too few gaps even together
    factor: float  # What sigma is to be multiplied by: below 1 only on firm evidence

    def to_dict(self) -> dict[str, float | int | bool]:
        """Plain values by name."""
        return asdict(self)


def needed_factors(
    error_m: FloatArray,  # (n, 3) m
    stated: FloatArray,  # (n, 3, 3) m^2
    noise: FloatArray,  # (3, 3) m^2
) -> FloatArray:  # (n, 2)
    """The factor of sigma with which each error would lie just inside the region of each of `LEVELS`."""
    from scipy.stats import chi2  # slow to load

    factors = np.full((len(error_m), len(LEVELS)), np.nan)
    rows = np.flatnonzero(np.isfinite(error_m).all(axis=1) & np.isfinite(stated).all(axis=(1, 2)))
    if len(rows):
        eigen, axes = np.linalg.eigh(stated[rows])
        rows, eigen, axes = (part[eigen.min(axis=1) > 0.0] for part in (rows, eigen, axes))
    if not len(rows):
        return factors
    whiten = np.swapaxes(axes, 1, 2) / np.sqrt(eigen)[:, :, None]
    noises, turn = np.linalg.eigh(whiten @ noise @ np.swapaxes(whiten, 1, 2))
    noises = np.maximum(noises, 0.0)
    squared = np.einsum("nji,njk,nk->ni", turn, whiten, error_m[rows]) ** 2
    for column, level in enumerate(LEVELS):
        limit = float(chi2.isf(1.0 - level, 3))
        low, high = np.zeros(len(rows)), squared.sum(axis=1) / limit
        for _ in range(50):
            middle = 0.5 * (low + high)
            outside = (squared / np.maximum(middle[:, None] + noises, 1e-300)).sum(axis=1) > limit
            low, high = np.where(outside, middle, low), np.where(outside, high, middle)
        factors[rows, column] = np.sqrt(high)
    return factors


def hierarchical_quantile(groups: Sequence[FloatArray], level: float) -> float:  # groups (n_k,)
    """Conformal quantile over groups of values: infinite where there are fewer groups than it takes."""
    values = np.concatenate(groups)
    share = np.repeat([1.0 / (len(groups) + 1) / len(group) for group in groups], [len(g) for g in groups])
    order = np.argsort(values)
    reached = np.flatnonzero(np.cumsum(share[order]) >= level - 1e-12)
    return float(values[order[reached[0]]]) if len(reached) else float("inf")


def length_factors(gaps: Sequence[tuple[float, FloatArray]]) -> tuple[LengthFactor, ...]:
    """The factors by length of gap."""
    known = [(length, needed[np.isfinite(needed).all(axis=1)]) for length, needed in gaps]
    known = [(length, needed) for length, needed in known if len(needed)]
    together = [needed for _, needed in known]
    rows = []
    for length_s in sorted({length for length, _ in known}):
        own = [needed for length, needed in known if length == length_s]
        pooled = len(own) < ENOUGH_GAPS < len(together) + 1 and len(own) < len(together)
        groups = together if pooled else own
        half, most = LEVELS
        level = min(most, len(groups) / (len(groups) + 1))
        factor_50 = hierarchical_quantile([needed[:, 0] for needed in groups], half)
        columns = [needed[:, 1] for needed in groups]
        factor_95 = factor = hierarchical_quantile(columns, level)
        if factor_95 < 1.0:  # what it hardly exceeds when gaps are drawn again (bootstrap)
            factor = 1.0
            if len(groups) >= FIRM_GAPS:
                rng, count = np.random.default_rng(0), len(columns)
                again = ([columns[k] for k in rng.integers(count, size=count)] for _ in range(DRAWS))
                drawn = [hierarchical_quantile(each, most) for each in again]
                factor = min(float(np.quantile(drawn, FIRM)), 1.0)
        rows.append(LengthFactor(length_s, len(groups), pooled, factor_50, factor_95, level, factor))
    return tuple(rows)


def factor_sentences(factors: Sequence[LengthFactor]) -> list[str]:
    """What the factors mean, in words; empty without any."""
    if not factors:
        return []
    listed = "; ".join(
        f"{row.length_s:g} s by {row.factor:.2f}"
        f" ({row.count} {'gap' if row.count == 1 else 'gaps'}{', all lengths' if row.pooled else ''})"
        for row in factors
    )
    sentences = [f"for the 95 % region to hold in hidden gaps, multiply sigma: {listed}"]
    fewest = min(factors, key=lambda row: row.level)
    if fewest.level < LEVELS[1]:
        sentences.append(
            f"{fewest.count} {'gap is' if fewest.count == 1 else 'gaps are'} too few for 95 %: the largest"
            f" error is used, which covers {100 * fewest.level:.0f} of 100; {ENOUGH_GAPS} or more are"
            " needed (--repetitions, or several recordings)"
        )
    if max(row.factor for row in factors) > LARGEST_FACTOR:
        sentences.append(
            f"a factor above {LARGEST_FACTOR:g} is not about sigma: some gaps are recovered wrongly; check"
            " clock, axes and mounting"
        )
    return sentences


#: A recording up to this length, s, rarely checks itself.
SHORT_S = 12.0
#: Lengths of the gaps, s; as much is left visible on both sides.
LENGTHS_S = (0.5, 1.0)
BESIDE_S = 0.6
#: Joints to compare with, the best first.
REFERENCES = ("wrist", "strap", "hand")


def short_recordings(recordings: Sequence[Recording]) -> list[Recording]:
    """Those that are too short to check themselves, if they are enough to do so together; else none."""
    short = [one for one in recordings if len(one.arm) and one.arm.t_s[-1] - one.arm.t_s[0] <= SHORT_S]
    return short if len(short) >= ENOUGH_GAPS else []


def hidden_gap_factors(
    recordings: Sequence[Recording], calibration: ArmCalibration, config: Config
) -> SigmaFactors | None:
    """What sigma of positions in gaps has to be multiplied by, from gaps hidden in short recordings."""
    jobs = [(recording, length_s) for length_s in LENGTHS_S for recording in recordings]
    job = partial(_needed, calibration=calibration, config=config)
    with Pool(config.windows.processes, sum(len(recording.arm) for recording, _ in jobs)) as pool:
        needed = list(pool.map(job, jobs))
    rows = length_factors([(length_s, each) for (_, length_s), each in zip(jobs, needed, strict=True)])
    rows = tuple(row for row in rows if row.count >= ENOUGH_GAPS and row.factor <= LARGEST_FACTOR)
    if not any(row.factor > 1.0 for row in rows):
        return None
    return SigmaFactors(tuple(SigmaFactor(row.length_s, row.factor, row.count) for row in rows))


def _needed(job: tuple[Recording, float], calibration: ArmCalibration, config: Config) -> FloatArray:
    """The factors (n, 2) required by the samples of one hidden gap; none where it is not recovered."""
    recording, length_s = job
    nothing = np.zeros((0, 2))
    arm = recording.arm
    middle_s = 0.5 * (arm.t_s[0] + arm.t_s[-1])
    hidden: BoolArray = np.abs(arm.t_s - middle_s) <= 0.5 * length_s
    if arm.t_s[-1] - arm.t_s[0] < length_s + 2.0 * BESIDE_S:
        return nothing
    joint = next((name for name in REFERENCES if (arm.tracked(name) & hidden).any()), None)
    if joint is None:
        return nothing
    copy = replace(recording, arm=arm.hide(hidden), truth=None)
    try:
        recovery = smooth(copy, calibration, config, processes=1)
    except UnoccludeError:
        return nothing
    noise_m = (recovery.estimates.camera_sigma_m or {}).get(joint)
    if joint not in recovery.joints or noise_m is None:
        return nothing
    seen = arm.tracked(joint) & hidden
    t = np.asarray(recovery.arm.t_s)[seen]
    inside = slice(*np.searchsorted(recovery.t_s, [t[0], t[-1]]).tolist())
    if not np.asarray(recovery.trusted[inside]).all():
        return nothing
    error = interpolate(recovery.t_s, recovery.joints[joint], t) - arm.joint(joint)[seen]
    stated = interpolate(recovery.t_s, recovery.joint_covariance[joint], t)
    return needed_factors(error, stated, noise_m**2 * np.eye(3))
