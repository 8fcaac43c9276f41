"""Errors of a recovered motion against a reference, and whether its stated covariance holds.

Position errors are metres, orientation errors degrees of rotation. A sample without an answer or
without a reference is nan in every function here and left out of the summaries.

A reference motion at other times, never beyond its ends or gaps; how late an answer is against it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from typing import Any, Self

import numpy as np

from ..array_types import BoolArray, FloatArray
from ..linalg import parabola_vertex, unit
from ..recording import Truth
from ..rotation import Rotation, Slerp

#: 95 % quantile of chi-square with three degrees of freedom: the 95 % region of a position.
CHI2_95_3 = 7.814727903251179


def rotation_error(
    answer: FloatArray,  # (n, 4)
    reference: FloatArray,  # (n, 4)
) -> FloatArray:
    """Rotation vectors (N, 3) rad in {K} that turn the reference into the answer; nan where one is
    missing.
    """
    result = np.full((len(answer), 3), np.nan)
    a, b = unit(answer), unit(reference)
    good = np.isfinite(a).all(axis=1) & np.isfinite(b).all(axis=1)
    turned, true = (Rotation.from_quat(q[good], scalar_first=True) for q in (a, b))
    result[good] = (turned * true.inv()).as_rotvec()
    return result


def mean_vector(vectors: FloatArray) -> list[float] | None:
    """Mean (3,) of the finite rows, or None without any."""
    finite = vectors[np.isfinite(vectors).all(axis=1)]
    return [float(x) for x in finite.mean(axis=0)] if len(finite) else None


def squared_sigmas(
    error: FloatArray,  # (n, 3) m
    covariance: FloatArray,  # (n, 3, 3) m^2
) -> FloatArray:
    """Squared error in sigmas, e' P^-1 e, (N,); nan where the covariance is missing or not positive."""
    result = np.full(len(error), np.nan)
    usable = np.isfinite(error).all(axis=1) & np.isfinite(covariance).all(axis=(1, 2))
    if usable.any():
        eigen, axes = np.linalg.eigh(covariance[usable])
        along = np.einsum("nji,nj->ni", axes, error[usable])
        with np.errstate(divide="ignore", invalid="ignore"):
            value = (along**2 / eigen).sum(axis=1)
        result[usable] = np.where(eigen.min(axis=1) > 0, value, np.nan)
    return result


def _of_finite(values: FloatArray, figure: Callable[[FloatArray], Any]) -> float | None:
    """A figure of the finite values, or None without any."""
    finite = np.asarray(values, dtype=float)
    finite = finite[np.isfinite(finite)]
    return float(figure(finite)) if len(finite) else None


def rms(values: FloatArray) -> float | None:
    """Root mean square of the finite values, or None without any."""
    return _of_finite(values, lambda finite: np.sqrt(np.mean(finite**2)))


def percentile(values: FloatArray, percent: float) -> float | None:
    """Percentile of the finite values (linear between samples), or None without any."""
    return _of_finite(values, lambda finite: np.percentile(finite, percent))


def nees(squared: FloatArray) -> float | None:
    """Mean squared position error in sigmas / 3: 1 where the stated covariance is consistent."""
    return _of_finite(squared, lambda finite: finite.mean() / 3.0)


def coverage_95(squared: FloatArray) -> float | None:
    """Part of the samples whose error lies inside the stated 95 % region (0.95 is consistent)."""
    return _of_finite(squared, lambda finite: (finite <= CHI2_95_3).mean())


@dataclass(frozen=True)
class Figures:
    """Errors of one set of samples; None where there is nothing to measure."""

    position_rms_m: float | None  # Of the position error, as the next ones
    position_max_m: float | None
    orientation_rms_deg: float | None  # Of the angle of rotation between answer and reference
    orientation_max_deg: float | None
    nees: float | None  # Mean squared position error in sigmas / 3
    samples: int  # Samples with a reference and an answer
    position_median_m: float | None
    position_p95_m: float | None
    coverage_95: float | None  # Part of the samples inside the stated 95 % region
    unanswered: int  # Samples with a reference where the method gave no position
    joint_rms_m: dict[str, float | None]  # Rms of the position error of each joint that the reference has
    position_bias_m: list[float] | None  # (3,) m: mean of answer minus reference, in {K}
    orientation_p95_deg: float | None
    orientation_bias_deg: list[float] | None  # (3,): mean rotation vector from reference to answer, in {K}
    orientation_nees: float | None  # As for the position, of the rotation vector
    orientation_coverage_95: float | None


@dataclass(frozen=True)
class Errors:
    """Answer minus reference of one point, sample by sample; nan where there is nothing to compare."""

    difference_m: FloatArray  # (n, 3) m, in {K}
    squared_sigmas: FloatArray  # (n,): squared position error in sigmas
    scored: BoolArray  # (n,): the reference has a position that is to be scored
    turn_rad: FloatArray  # (n, 3) rad: rotation vector from reference to answer, in {K}
    turn_squared_sigmas: FloatArray  # (n,): squared orientation error in sigmas

    @classmethod
    def of_positions(cls, difference_m: FloatArray, squared: FloatArray, **more: Any) -> Self:
        """Errors of a point that has no orientation."""
        nothing = np.full((len(squared), 3), np.nan)
        usual = {"scored": np.zeros(len(squared), bool), "turn_rad": nothing}
        return cls(difference_m, squared, **{**usual, "turn_squared_sigmas": nothing[:, 0], **more})

    @staticmethod
    def pooled(parts: Sequence[Errors]) -> Errors:
        """The samples of several together."""
        if not parts:
            return Errors.of_positions(np.zeros((0, 3)), np.zeros(0))
        names = [each.name for each in fields(Errors)]
        return Errors(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))

    @property
    def distance_m(self) -> FloatArray:
        """(n,) m: position error."""
        return np.asarray(np.linalg.norm(self.difference_m, axis=1))

    @property
    def angle_deg(self) -> FloatArray:
        """(n,): orientation error, as an angle of rotation."""
        return np.degrees(np.linalg.norm(self.turn_rad, axis=1))

    def figures(self, chosen: BoolArray | slice = slice(None)) -> Figures:
        """The figures of these samples, or of some."""
        distance, angle = self.distance_m[chosen], self.angle_deg[chosen]
        squared, turned = self.squared_sigmas[chosen], self.turn_squared_sigmas[chosen]
        answered = np.isfinite(distance)
        return Figures(
            position_rms_m=rms(distance),
            position_max_m=percentile(distance, 100),
            orientation_rms_deg=rms(angle),
            orientation_max_deg=percentile(angle, 100),
            nees=nees(squared),
            samples=int(answered.sum()),
            position_median_m=percentile(distance, 50),
            position_p95_m=percentile(distance, 95),
            coverage_95=coverage_95(squared),
            unanswered=int((self.scored[chosen] & ~answered).sum()),
            joint_rms_m={},
            position_bias_m=mean_vector(self.difference_m[chosen]),
            orientation_p95_deg=percentile(angle, 95),
            orientation_bias_deg=mean_vector(np.degrees(self.turn_rad[chosen])),
            orientation_nees=nees(turned),
            orientation_coverage_95=coverage_95(turned),
        )


#: Samples of a reference farther apart than this are not bridged, s.
BRIDGED_S = 0.1
#: Stamps that went through a text file are equal to this, s.
STAMP_S = 1e-6


def truth_at(truth: Truth, t_s: FloatArray) -> Truth:
    """The truth at the given times (its own clock), nan where it has none."""
    t_s = np.asarray(t_s, dtype=float)
    return Truth(
        t_s=t_s,
        position=position_at(truth.t_s, truth.position, t_s),
        quaternion=orientation_at(truth.t_s, truth.quaternion, t_s),
        score=_scored(truth, t_s),
        joints={name: position_at(truth.t_s, value, t_s) for name, value in truth.joints.items()},
    )


def position_at(t_known: FloatArray, position: FloatArray, t_s: FloatArray) -> FloatArray:
    """Positions (M, 3) read at other times (N, 3): cubic, nan where none is near."""
    return _read(_pieces(t_known, position), t_s, _cubic, 3)


def orientation_at(t_known: FloatArray, quaternion: FloatArray, t_s: FloatArray) -> FloatArray:
    """Orientations (M, 4) read at other times (N, 4): slerp, nan where none is near."""
    return _read(_pieces(t_known, quaternion), t_s, _slerp, 4)


def linear_at(t_known: FloatArray, values: FloatArray, t_s: FloatArray) -> FloatArray:
    """Values (M, D) read at other times (N, D): linear, so that variances stay positive."""
    return _read(_pieces(t_known, values), t_s, _linear, values.shape[1])


def _pieces(t_known: FloatArray, values: FloatArray) -> list[tuple[FloatArray, FloatArray]]:
    """Times and values of known samples in order of time, apart where they may not be bridged."""
    finite = np.isfinite(values).all(axis=1) & np.isfinite(t_known)
    t, v = t_known[finite], values[finite]
    order = np.argsort(t, kind="stable")
    t, v = t[order], v[order]
    fresh = np.append(True, np.diff(t) > 0) if len(t) else np.zeros(0, bool)
    t, v = t[fresh], v[fresh]
    starts = np.flatnonzero(np.diff(t) > BRIDGED_S + STAMP_S) + 1
    return [
        (part, own) for part, own in zip(np.split(t, starts), np.split(v, starts), strict=True) if len(part)
    ]


def _read(
    pieces: list[tuple[FloatArray, FloatArray]],
    t_s: FloatArray,
    reader: Callable[[FloatArray, FloatArray, FloatArray], FloatArray],
    width: int,
) -> FloatArray:
    """What pieces are at other times (n, width); nan outside of them."""
    result = np.full((len(t_s), width), np.nan)
    for t, v in pieces:
        inside = (t_s >= t[0] - STAMP_S) & (t_s <= t[-1] + STAMP_S)
        if inside.any():
            result[inside] = reader(t, v, np.clip(t_s[inside], t[0], t[-1]))
    return result


def _cubic(t: FloatArray, v: FloatArray, at: FloatArray) -> FloatArray:
    if len(t) >= 4:
        from scipy.interpolate import CubicSpline  # slow to load, and few need it

        return np.asarray(CubicSpline(t, v)(at))
    return _linear(t, v, at)


def _linear(t: FloatArray, v: FloatArray, at: FloatArray) -> FloatArray:
    return np.column_stack([np.interp(at, t, column) for column in v.T])


def _slerp(t: FloatArray, quaternion: FloatArray, at: FloatArray) -> FloatArray:
    if len(t) == 1:
        return np.repeat(quaternion, len(at), axis=0)
    rotation = Rotation.from_quat(quaternion, scalar_first=True)
    return np.asarray(Slerp(t, rotation)(at).as_quat(scalar_first=True))


def _scored(truth: Truth, t_s: FloatArray) -> BoolArray:
    after = np.searchsorted(truth.t_s, t_s - STAMP_S)  # first sample at or after
    before = np.searchsorted(truth.t_s, t_s + STAMP_S, side="right") - 1  # last at or before
    inside = (after < len(truth)) & (before >= 0)
    inside[inside] = truth.score[after[inside]] & truth.score[before[inside]]
    return inside


#: Lags looked at, s: up to this in coarse steps, then about the best one in finer steps.
LONGEST_S, COARSE_S, FINE_S = 0.5, 0.02, 0.002
_COARSE = np.arange(-LONGEST_S, LONGEST_S + 0.5 * COARSE_S, COARSE_S)
#: From fewer samples no lag is read; more than the second make it no surer.
FEWEST, MOST = 20, 20_000


# Sliding two whole signals over each other cuts every gap short at every lag. Here the samples stay as they
# are and the reference, which is known everywhere, is read earlier or later: the same samples are used at
# every lag, so that short gaps do not bias the peak (Feng 2014, 4.5.3, unbiased).
def lag_s(
    t_s: FloatArray,  # (n,) s
    samples: FloatArray,  # (n, d)
    reference: FloatArray,  # (m, d)
    reference_t_s: FloatArray | None = None,  # (m,) s
) -> float | None:  # s
    """Lag of samples behind a reference."""
    given = (t_s, samples, reference, t_s if reference_t_s is None else reference_t_s)
    roughly = _peak(_COARSE, _correlations(*given, _COARSE))
    if roughly is None:
        return None
    fine = np.linspace(roughly - 10 * FINE_S, roughly + 10 * FINE_S, 21)
    exactly = _peak(fine, _correlations(*given, fine))
    return roughly if exactly is None else exactly


def _correlations(
    t_s: FloatArray, samples: FloatArray, reference: FloatArray, t_reference: FloatArray, lags: FloatArray
) -> FloatArray:
    """Correlation at each lag (k,); nan where too little is known."""
    r = np.full(len(lags), np.nan)
    known = np.flatnonzero(np.isfinite(samples).all(axis=1))
    known = known[:: max(1, len(known) // MOST)]
    if len(known) < FEWEST:
        return r
    t, a, pieces = t_s[known], samples[known], _pieces(t_reference, reference)
    for k, lag in enumerate(lags):
        b = _read(pieces, t - lag, _linear, reference.shape[1])
        both = np.isfinite(b).all(axis=1)
        if both.sum() < FEWEST:
            continue
        # over all columns together, each about its own mean; nothing where one stands still
        x, y = (each[both] - each[both].mean(axis=0) for each in (a, b))
        scale = float(np.sqrt((x * x).sum() * (y * y).sum()))
        if scale > 1e-9 * len(x):
            r[k] = float((x * y).sum()) / scale
    return r


def _peak(lags: FloatArray, r: FloatArray) -> float | None:
    """The vertex of the parabola through the three highest; None at the ends."""
    best = int(np.nanargmax(r)) if np.isfinite(r).any() else 0
    around = slice(best - 1, best + 2)
    if not 0 < best < len(r) - 1 or not np.isfinite(r[around]).all():
        return None
    return parabola_vertex(lags[around], -r[around])
