"""A calibrated magnetometer, where it agrees with the rest.

The direction of the local field in {K} is not known. A first solution without the magnetometer turns
its samples into {K}; their middle over the whole recording is that direction, known far better than
the attitude at any one time. Iron and magnets show in the field's strength, which no attitude
changes: where it is off, and where the direction is farther off than everywhere else, the samples are
left out. How much the strength varies in what remains is how much the direction varies too, as a
disturbance has no preferred side: this is the sigma of the factors (`AttitudeFactorPose3`, one
for each mean over some seconds).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..array_types import BoolArray, FloatArray
from ..linalg import skew, unit
from ..recording import ImuStream
from ..result import Recovery
from ..window.problem import FieldMeasurements
from ..window.shared import axes_across
from ..window.solution import Solution

#: The field is averaged over this long: a place's disturbance lasts about as long as the arm stays.
MEAN_S = 2.0
#: A field this much stronger or weaker than the recording's own is disturbed, and one that is this much
#: stronger or weaker than where the magnetometer was calibrated is another one.
STRENGTH_OFF = 0.1
STRENGTH_ELSEWHERE = 0.35
#: Means whose strength is off by more than this many scaled median deviations, and by this much at least, are
#: left out, as those whose direction is; and their neighbours, which the same magnet may have reached.
FAR = 3.5
LEAST_FAR = 0.03
#: A mean is used when this much of it is undisturbed.
SHARE_NEEDED = 0.8
#: Where fewer of a mean's nodes have a sample there is no mean: samples that are missing are no iron.
SAMPLES_NEEDED = 0.5
#: Means that the field's direction needs, and the share of all that has to agree.
MEANS_NEEDED = 8
MEANS_SHARE = 0.5
#: No room's field is known better than this, rad.
LEAST_SIGMA_RAD = np.radians(0.7)
#: No factor is trusted more than this, rad: in gaps of some seconds, what the field is off in tilt costs
#: more than the heading gains (at 0.7 degrees 3 % of the position in a trial of BROAD, at 2 nothing).
FACTOR_SIGMA_RAD = np.radians(2.0)
#: The error of the attitude is another one after this time, s.
ATTITUDE_S = 12.0
#: How often the direction is solved anew without the means that contradict it.
ROUNDS = 4
#: A sample farther than this from a node is not used for it, s.
NEAR_S = 0.05


@dataclass(frozen=True)
class FieldMean:
    """The mean field over some seconds."""

    t_s: float
    in_K: FloatArray  # (3,)
    in_A: FloatArray  # (3,)
    share: float  # Of its samples with the field's usual strength
    attitude_covariance: FloatArray  # (3, 3) rad^2


@dataclass(frozen=True)
class Field:
    """Directions of the field that are used."""

    t_s: FloatArray  # (k,)
    in_A: FloatArray  # (k, 3): unit vectors in {A}
    in_K: FloatArray  # (3,): unit vector of the field in {K}
    sigma_rad: float  # Of each
    common_rad: float  # Of the field's direction in {K}

    def at_nodes(self, t: FloatArray) -> FieldMeasurements | None:
        """A window's directions; together they know the field's no better than the recording does."""
        own = np.flatnonzero((self.t_s >= t[0]) & (self.t_s <= t[-1]))
        if not len(own):
            return None
        node = np.abs(t - self.t_s[own, None]).argmin(axis=1)
        sigma_rad = float(np.hypot(self.sigma_rad, np.sqrt(len(own)) * self.common_rad))
        return FieldMeasurements(node, self.in_A[own], self.in_K, sigma_rad)


@dataclass(frozen=True)
class Magnetometer:
    """What became of the magnetometer."""

    note: str = ""  # A sentence for the reader, "" where there is no calibrated magnetometer
    field: Field | None = None  # What is used of it
    means: int = 0  # How many means of the field there are

    @property
    def used(self) -> int:
        """How many of them are used."""
        return 0 if self.field is None else len(self.field.t_s)

    def noted(self, recovery: Recovery) -> Recovery:
        """The recovery with a word on the magnetometer."""
        if not self.note:
            return recovery
        estimates = replace(
            recovery.estimates, magnetometer_blocks=self.means, magnetometer_blocks_used=self.used
        )
        if self.field is not None:
            estimates = replace(
                estimates,
                magnetometer_sigma_deg=float(np.degrees(self.field.sigma_rad)),
                magnetic_field_direction=tuple(self.field.in_K.tolist()),
            )
        return replace(recovery, notes=(*recovery.notes, self.note), estimates=estimates)


@dataclass(frozen=True)
class FieldObservation:
    """What the magnetometer read at the nodes of a section."""

    t_s: FloatArray  # (n,)
    in_K: FloatArray  # (n, 3); nan where it has no sample
    R_K_A: FloatArray  # (n, 3, 3)
    attitude_covariance: FloatArray  # (n, 3, 3) rad^2

    @property
    def strength(self) -> FloatArray:
        """(n,) of the field."""
        return np.linalg.norm(self.in_K, axis=1)


def takes_part(imu: ImuStream) -> bool:
    """Whether there is a calibrated magnetometer."""
    return imu.mag is not None and imu.mag_calibrated


def observe(imu: ImuStream, solution: Solution, start_s: float, end_s: float) -> FieldObservation:
    """What a solution with covariance makes of the magnetometer's samples between two times."""
    assert imu.mag is not None and solution.forearm.pose_covariance is not None
    nodes = np.flatnonzero((solution.t >= start_s) & (solution.t <= end_s))
    t, R = solution.t[nodes], solution.forearm.states.R[nodes]
    have = imu.select(np.asarray(np.isfinite(imu.mag).all(axis=1)))
    in_K = np.full((len(t), 3), np.nan) if len(have) < 2 else _in_camera(have, t, R)
    return FieldObservation(t, in_K, R, solution.forearm.pose_covariance[nodes, 3:, 3:])


def judged(observations: Iterable[FieldObservation]) -> Magnetometer:
    """Find the field's direction in {K}, and which means of it agree: they are used."""
    seen = list(observations)
    known = np.concatenate([np.zeros(0), *(each.strength[np.isfinite(each.strength)] for each in seen)])
    if not len(known):
        return _without("it has no samples while the arm was solved")
    strength = float(np.median(known))
    if not abs(strength - 1.0) < STRENGTH_ELSEWHERE:
        return _without(
            f"the field is {strength:.2f} times as strong as where it was calibrated; a magnet is near, or"
            " the calibration is not of this sensor"
        )
    means = [mean for each in seen for mean in field_means(each, strength)]
    calm = [mean for mean in means if mean.share >= SHARE_NEEDED]
    if len(means) < MEANS_NEEDED:
        return _without(
            "the recording is too short, or has too few of its samples, to estimate the field's direction"
        )
    if len(calm) < max(MEANS_SHARE * len(means), MEANS_NEEDED):
        return _without(_off(len(means) - len(calm), len(means), "strength"))
    direction, covariance, sigma, good = _agree(means, calm)
    used = int(good.sum())
    if used < max(MEANS_SHARE * len(means), MEANS_NEEDED):
        return _without(_off(len(means) - used, len(means), "direction"))
    sigma_rad = max(sigma, FACTOR_SIGMA_RAD)
    note = (
        f"the magnetometer is used, with a sigma of {np.degrees(sigma_rad):.1f} degrees for the field's"
        " direction"
    )
    if used < len(means):
        note += f"; it was left out in {len(means) - used} of {len(means)} places, as it disagrees there"
    in_A = unit(np.array([mean.in_A for mean in calm])[good])
    t_s = np.array([mean.t_s for mean in calm])[good]
    common_rad = float(np.sqrt(np.linalg.eigvalsh(covariance).max()))
    return Magnetometer(note, Field(t_s, in_A, direction, sigma_rad, common_rad), len(means))


def _without(reason: str) -> Magnetometer:
    return Magnetometer(f"the magnetometer was left out: {reason}")


def _agree(
    means: Sequence[FieldMean], calm: list[FieldMean]
) -> tuple[FloatArray, FloatArray, float, BoolArray]:
    """The field's direction that most means agree on, and which do."""
    in_K = np.array([mean.in_K for mean in calm])
    strength = np.linalg.norm(in_K, axis=1)
    pointing = in_K / strength[:, None]
    part = np.array([mean.t_s // ATTITUDE_S for mean in calm])
    attitude = np.array([mean.attitude_covariance for mean in calm])
    usual = float(np.median(strength))
    varies = 1.4826 * float(np.median(np.abs(strength - usual)))
    calm_enough = np.abs(strength - usual) < max(FAR * varies, LEAST_FAR * usual)
    good, direction, covariance, sigma = calm_enough, middle_direction(in_K), np.eye(2), LEAST_SIGMA_RAD
    for _ in range(ROUNDS):
        if not good.any():
            break
        sigma = max(float(np.std(strength[good])) / usual, LEAST_SIGMA_RAD)
        across = axes_across(direction)
        residual = pointing @ across.T
        tilt = across @ skew(direction[None])[0]  # a small turn moves the direction by turn x direction
        own = tilt @ attitude @ tilt.T
        information, sum_ = np.zeros((2, 2)), np.zeros(2)
        for k in np.unique(part[good]):
            rows = good & (part == k)
            weight = np.linalg.inv(own[rows].mean(axis=0) + np.eye(2) * sigma**2 / rows.sum())
            information += weight
            sum_ += weight @ residual[rows].mean(axis=0)
        covariance = np.asarray(np.linalg.inv(information), np.float64)
        direction = direction + (covariance @ sum_) @ across
        direction = direction / np.linalg.norm(direction)
        left = pointing @ axes_across(direction).T
        expected = own + covariance + np.eye(2) * sigma**2
        far = np.einsum("ni,nij,nj->n", left, np.linalg.inv(expected), left)
        good = calm_enough & (far < FAR**2)
        good &= _far_from_bad(means, calm, good)
    return direction, covariance, sigma, good


def _far_from_bad(means: Sequence[FieldMean], calm: list[FieldMean], good: BoolArray) -> BoolArray:
    """Which of the calm means have no mean beside them that was left out."""
    kept = {id(mean) for mean, is_good in zip(calm, good, strict=True) if is_good}
    bad = np.array([mean.t_s for mean in means if id(mean) not in kept])
    if not len(bad):
        return np.ones(len(calm), dtype=bool)
    t = np.array([mean.t_s for mean in calm])
    return np.asarray(np.abs(t[:, None] - bad).min(axis=1) > 1.5 * MEAN_S)


def _off(bad: int, means: int, what: str) -> str:
    return f"in {bad} of {means} places the field's {what} is off; magnets or iron are near"


def _in_camera(imu: ImuStream, t: FloatArray, R_K_A: FloatArray) -> FloatArray:
    """The field at nodes (n, 3) in {K}; nan where there is no sample."""
    assert imu.mag is not None
    after = np.clip(np.searchsorted(imu.t_s, t), 1, len(imu.t_s) - 1)
    apart = np.minimum(np.abs(t - imu.t_s[after - 1]), np.abs(t - imu.t_s[after]))
    sample = np.stack([np.interp(t, imu.t_s, axis) for axis in imu.mag.T], axis=1)
    sample[apart > NEAR_S] = np.nan
    return np.asarray(np.einsum("nij,nj->ni", R_K_A, sample))


def field_means(seen: FieldObservation, strength: float) -> Iterator[FieldMean]:
    """Means over some seconds each, of the samples with the field's usual strength."""
    t, known = seen.t_s, np.isfinite(seen.in_K).all(axis=1)
    with np.errstate(invalid="ignore"):
        good = np.abs(seen.strength / strength - 1.0) < STRENGTH_OFF
    count = max(round(float(t[-1] - t[0]) / MEAN_S), 1)
    of = np.clip(np.searchsorted(np.linspace(t[0], t[-1], count + 1), t, side="right") - 1, 0, count - 1)
    for k in range(count):
        nodes = of == k
        rows = np.flatnonzero(nodes & known)
        if not len(rows) or len(rows) < SAMPLES_NEEDED * nodes.sum():
            continue
        share = float(good[rows].mean())
        mean = seen.in_K[rows[good[rows]]].mean(axis=0) if share > 0 else np.full(3, np.nan)
        node = rows[len(rows) // 2]
        in_A = seen.R_K_A[node].T @ mean
        yield FieldMean(float(t[node]), mean, in_A, share, seen.attitude_covariance[node])


def middle_direction(vectors: FloatArray) -> FloatArray:
    """Unit vector (3,) in the middle of directions (N, 3), far ones pulling less (spatial median)."""
    pointing = unit(vectors)
    middle = np.median(pointing, axis=0)
    for _ in range(30):  # Weiszfeld's iteration
        weight = 1.0 / np.maximum(np.linalg.norm(pointing - middle, axis=1), 1e-3)
        middle = weight @ pointing / weight.sum()
    return np.asarray(middle / np.linalg.norm(middle))
