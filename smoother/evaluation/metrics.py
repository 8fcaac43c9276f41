"""Errors of a recovered motion against a reference, and whether its stated covariance holds.

Position errors are metres, orientation errors degrees of rotation. A sample without an answer or
without a reference is nan in every function here and left out of the summaries.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

from ..array_types import FloatArray
from ..linalg import unit

#: 95 % quantile of chi-square with three degrees of freedom: the 95 % region of a position.
CHI2_95_3 = 7.814727903251179


def position_error(answer: FloatArray, reference: FloatArray) -> FloatArray:
    """Distance between answer and reference (N, 3), m; (N,)."""
    return np.linalg.norm(np.asarray(answer) - np.asarray(reference), axis=1)


def orientation_error_deg(answer: FloatArray, reference: FloatArray) -> FloatArray:
    """Degrees of rotation between two orientations, 0 to 180.

    The published measure: `deg' = arccos(Re(q_answer^-1 q_reference)) 360/pi`, then
    `min(deg', 360 - deg')`. The angle is taken from sine and cosine together, because arccos
    alone loses angles under 1e-6 degrees to rounding.

    Parameters
    ----------
    answer, reference : ndarray, shape (n, 4)
        Unit quaternions qw, qx, qy, qz of the same frames.
    """
    a, b = unit(answer), unit(reference)
    real = np.abs(np.einsum("ni,ni->n", a, b))  # the sign of a quaternion means nothing: eq 15
    # imaginary part of conj(a) * b
    imaginary = a[:, :1] * b[:, 1:] - b[:, :1] * a[:, 1:] - np.cross(a[:, 1:], b[:, 1:])
    return np.degrees(2.0 * np.arctan2(np.linalg.norm(imaginary, axis=1), real))


def rotation_error(answer: FloatArray, reference: FloatArray) -> FloatArray:
    """Rotation vectors (N, 3) rad in {K} that turn the reference into the answer; nan where one is missing.

    Parameters
    ----------
    answer, reference : ndarray, shape (n, 4)
        Quaternions qw, qx, qy, qz of `R_K_A`.
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


def squared_sigmas(error: FloatArray, covariance: FloatArray) -> FloatArray:
    """Squared error in sigmas, e' P^-1 e, (N,); nan where the covariance is missing or not positive.

    Parameters
    ----------
    error : ndarray, shape (n, 3), m
        Answer minus reference.
    covariance : ndarray, shape (n, 3, 3), m^2
        As stated with the answer.
    """
    result = np.full(len(error), np.nan)
    usable = np.isfinite(error).all(axis=1) & np.isfinite(covariance).all(axis=(1, 2))
    if usable.any():
        eigen, axes = np.linalg.eigh(covariance[usable])
        along = np.einsum("nji,nj->ni", axes, error[usable])
        with np.errstate(divide="ignore", invalid="ignore"):
            value = (along**2 / eigen).sum(axis=1)
        result[usable] = np.where(eigen.min(axis=1) > 0, value, np.nan)
    return result


def rms(values: FloatArray) -> float | None:
    """Root mean square of the finite values, or None without any."""
    finite = _finite(values)
    return float(np.sqrt(np.mean(finite**2))) if len(finite) else None


def maximum(values: FloatArray) -> float | None:
    """Largest finite value, or None without any."""
    finite = _finite(values)
    return float(finite.max()) if len(finite) else None


def percentile(values: FloatArray, percent: float) -> float | None:
    """Percentile of the finite values (linear between samples), or None without any."""
    finite = _finite(values)
    return float(np.percentile(finite, percent)) if len(finite) else None


def nees(squared: FloatArray) -> float | None:
    """Mean squared position error in sigmas / 3: 1 where the stated covariance is consistent.

    Above 1 the result is over-confident, below 1 under-confident.
    """
    finite = _finite(squared)
    return float(finite.mean() / 3.0) if len(finite) else None


def coverage_95(squared: FloatArray) -> float | None:
    """Part of the samples whose error lies inside the stated 95 % region (0.95 is consistent)."""
    finite = _finite(squared)
    return float((finite <= CHI2_95_3).mean()) if len(finite) else None


def _finite(values: FloatArray) -> FloatArray:
    values = np.asarray(values, dtype=float)
    return values[np.isfinite(values)]


@dataclass(frozen=True)
class Figures:
    """Errors of one set of samples; None where there is nothing to measure.

    Attributes
    ----------
    position_rms_m, position_median_m, position_p95_m, position_max_m : float, m, or None
        Of the position error.
    orientation_rms_deg, orientation_max_deg : float, degrees, or None
        Of the angle of rotation between answer and reference.
    nees : float or None
        Mean squared position error in sigmas / 3.
    coverage_95 : float or None
        Part of the samples inside the stated 95 % region.
    samples : int
        Samples with a reference and an answer.
    unanswered : int
        Samples with a reference where the method gave no position.
    joint_rms_m : dict[str, float | None], m
        Rms of the position error of each joint that the reference has.
    position_bias_m : list of float, shape (3,), m, or None
        Mean of answer minus reference, in {K}.
    orientation_p95_deg : float, degrees, or None
        95 % of the orientation errors are smaller.
    orientation_bias_deg : list of float, shape (3,), degrees, or None
        Mean rotation vector from reference to answer, in {K}.
    orientation_nees, orientation_coverage_95 : float or None
        As for the position, of the rotation vector.
    """

    position_rms_m: float | None
    position_max_m: float | None
    orientation_rms_deg: float | None
    orientation_max_deg: float | None
    nees: float | None
    samples: int
    position_median_m: float | None = None
    position_p95_m: float | None = None
    coverage_95: float | None = None
    unanswered: int = 0
    joint_rms_m: dict[str, float | None] = field(default_factory=dict)
    position_bias_m: list[float] | None = None
    orientation_p95_deg: float | None = None
    orientation_bias_deg: list[float] | None = None
    orientation_nees: float | None = None
    orientation_coverage_95: float | None = None

    def to_dict(self) -> dict[str, object]:
        """Plain values by name, as `--json` writes them."""
        return asdict(self)


def summarise(
    distance_m: FloatArray, angle_deg: FloatArray, squared: FloatArray, unanswered: int = 0
) -> Figures:
    """The figures of a set of samples.

    Parameters
    ----------
    distance_m : ndarray, shape (n,), m
        Position errors, nan where there is none.
    angle_deg : ndarray, shape (n,), degrees
        Orientation errors, nan where there is none.
    squared : ndarray, shape (n,)
        Squared position errors in sigmas, nan where there is none.
    """
    return Figures(
        position_rms_m=rms(distance_m),
        position_max_m=maximum(distance_m),
        orientation_rms_deg=rms(angle_deg),
        orientation_max_deg=maximum(angle_deg),
        nees=nees(squared),
        samples=int(np.isfinite(distance_m).sum()),
        position_median_m=percentile(distance_m, 50),
        position_p95_m=percentile(distance_m, 95),
        coverage_95=coverage_95(squared),
        unanswered=unanswered,
        orientation_p95_deg=percentile(angle_deg, 95),
    )
