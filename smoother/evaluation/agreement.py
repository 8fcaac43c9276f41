"""How well two measurements of the same agree: bias, limits of agreement, ICC, detectable change, angles.

Sources: Bland and Altman, Lancet 327:307-310 (1986), limits of agreement; McGraw and Wong, Psychological
Methods 1:30-46 (1996), ICC(A,1) of their tables 4 and 7: two-way, absolute agreement, single measurement,
which is ICC(2,1) of Shrout and Fleiss, Psychological Bulletin 86:420-428 (1979); Weir, Journal of Strength
and Conditioning Research 19:231-240 (2005), SEM and minimal difference.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..array_types import BoolArray, FloatArray
from ..joint_angles import ANGLES, arm_angles, defined, forearm_axes, recovery_angles, wrapped_deg
from ..linalg import unit
from ..recording import Truth
from ..result import Recovery
from .metrics import position_at

#: Half width of the limits of agreement in standard deviations.
LIMITS = 1.96
#: The confidence of the interval of the ICC.
CONFIDENCE = 0.95
#: Samples are no longer alike where their autocorrelation has fallen to this.
FORGOTTEN = 0.05


#: Agreement of an answer with a reference, in the unit of both, by name; None where samples are too few.
#: `samples` or `pairs`; `rmse`; `bias`, mean of answer minus reference; `limits_low` and `limits_high`, bias
#: -+ 1.96 standard deviations; `icc`, ICC(A,1) with its 95 % interval; `independent`: samples as the interval
#: counts them, as neighbours in time are not independent.
Agreement = dict[str, Any]


def agreement(answer: FloatArray, reference: FloatArray, *, degrees: bool = False) -> Agreement:  # (n,)
    """Agreement of two series; a pair with nan is left out."""
    good = np.isfinite(answer) & np.isfinite(reference)
    answer, reference = answer[good], reference[good]
    if degrees:
        answer, reference = unwound_deg(answer, reference)
    count = len(answer)
    names = ("rmse", "bias", "limits_low", "limits_high", "icc", "icc_low", "icc_high")
    found: Agreement = {"samples": count, "independent": float(count), **dict.fromkeys(names)}
    if count < FEWEST_PAIRS:
        return found
    difference = answer - reference
    bias, half = float(difference.mean()), LIMITS * float(difference.std(ddof=1))
    independent = count / memory(reference)
    icc = icc_a1(np.column_stack([answer, reference]), independent)
    values = (float(np.sqrt(np.mean(difference**2))), bias, bias - half, bias + half, *icc)
    return found | {"independent": independent} | dict(zip(names, values, strict=True))


def interval(low: float | None, high: float | None, digits: int) -> str | None:
    """An interval for a cell; None where there is none."""
    return None if low is None or high is None else f"{low:.{digits}f} to {high:.{digits}f}"


def with_interval(row: Mapping[str, Any], name: str = "icc", digits: int = 3) -> str | None:
    """A coefficient with its interval, for a cell; None where there is none."""
    value = row[name]
    ends = interval(row[f"{name}_low"], row[f"{name}_high"], digits)
    return None if value is None else f"{value:.{digits}f} ({ends})"


def unwound_deg(answer: FloatArray, reference: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Angles without jumps of a full turn, from sample to sample, the answer beside the reference."""
    wound = np.unwrap(reference, period=360.0)
    if len(wound):
        wound = wound - 360.0 * np.round(np.median(wound) / 360.0)
    return wound + wrapped_deg(answer - reference), wound


def memory(values: FloatArray) -> float:
    """How many samples in a row are equivalent to one (integrated autocorrelation time), 1 or more."""
    x = values - values.mean()
    count = len(x)
    if not x.any():
        return float(count)
    spectrum = np.abs(np.fft.rfft(x, 2 * count)) ** 2
    correlation = np.fft.irfft(spectrum)[:count]
    correlation = correlation / correlation[0]
    below = np.flatnonzero(correlation < FORGOTTEN)
    last = below[0] if len(below) else count
    return float(min(count / 2.0, max(1.0, 1.0 + 2.0 * correlation[1:last].sum())))


def mean_squares(ratings: FloatArray) -> tuple[float, float, float]:  # ratings (n, k)
    """Between rows (persons), between columns (sessions, raters), and of the error."""
    n, k = ratings.shape
    rows, columns, grand = ratings.mean(axis=1), ratings.mean(axis=0), ratings.mean()
    residual = ratings - rows[:, None] - columns + grand
    error = (residual**2).sum() / ((n - 1) * (k - 1))
    return float(k * ((rows - grand) ** 2).sum() / (n - 1)), float(n * columns.var(ddof=1)), float(error)


def icc_a1(
    ratings: FloatArray,
    independent: float | None = None,  # ratings (n, k)
) -> tuple[float | None, float | None, float | None]:
    """ICC(A,1) and its 95 % interval."""
    from scipy.stats import f as f_distribution

    n, k = ratings.shape
    between_rows, between_columns, error = mean_squares(ratings)
    whole = between_rows + (k - 1) * error + k / n * (between_columns - error)
    if whole <= 0:
        return None, None, None
    icc = (between_rows - error) / whole
    m = max(float(n if independent is None else independent), 3.0)
    between_columns *= m / n
    if error <= 0 or icc >= 1:
        return icc, icc, icc
    a = k * icc / (m * (1 - icc))
    b = 1 + k * icc * (m - 1) / (m * (1 - icc))
    freedom = (a * between_columns + b * error) ** 2 / (
        (a * between_columns) ** 2 / (k - 1) + (b * error) ** 2 / ((m - 1) * (k - 1))
    )
    tail = 0.5 * (1 + CONFIDENCE)
    upper, lower = f_distribution.ppf(tail, m - 1, freedom), f_distribution.ppf(tail, freedom, m - 1)
    others = k * between_columns + (k * m - k - m) * error
    low = m * (between_rows - upper * error) / (upper * others + m * between_rows)
    high = m * (lower * between_rows - error) / (others + m * lower * between_rows)
    return icc, float(low), float(high)


#: Fewer pairs have a mean difference and nothing else.
FEWEST_PAIRS = 3


def limits_of_agreement(difference: FloatArray) -> dict[str, float]:  # difference (n,)
    """Mean difference and limits of agreement (-+ 1.96 standard deviations), each with its 95 % interval.

    Exact intervals: Carkeet, Optometry and Vision Science 92:e71-e80 (2015).
    """
    from scipy.stats import nct
    from scipy.stats import t as student

    count, bias, spread = len(difference), float(difference.mean()), float(difference.std(ddof=1))
    tail, of_mean = 0.5 * (1 + CONFIDENCE), spread / np.sqrt(count)
    half = float(student.ppf(tail, count - 1) * of_mean)
    near, far = (
        float(nct.ppf(p, count - 1, LIMITS * np.sqrt(count)) * of_mean) if spread > 0 else 0.0
        for p in (1 - tail, tail)
    )
    found = {"bias": bias, "bias_low": bias - half, "bias_high": bias + half}
    found |= {"limits_low": bias - LIMITS * spread, "limits_high": bias + LIMITS * spread}
    found |= {"limits_low_from": bias - far, "limits_low_to": bias - near}
    return found | {"limits_high_from": bias + near, "limits_high_to": bias + far}


_OF_PAIRS = (
    *("bias", "limits_low", "limits_high", "icc", "icc_low", "icc_high", "sem", "mdc95", "mdc95_low"),
    *("mdc95_high", "limits_low_from", "limits_low_to", "limits_high_from", "limits_high_to"),
)


def pair_agreement(answer: FloatArray, reference: FloatArray) -> Agreement:  # answer (n,); reference (n,)
    """Agreement of pairs; one with nan is left out.

    `sem`: standard error of measurement of the answer; `mdc95`: minimal detectable change, 1.96 sqrt(2) SEM,
    with its interval, as few pairs say little about a standard deviation.
    """
    good = np.isfinite(answer) & np.isfinite(reference)
    answer, reference = answer[good], reference[good]
    count, difference = len(answer), answer - reference
    found: Agreement = {"pairs": count, **dict.fromkeys(_OF_PAIRS)}
    if count < FEWEST_PAIRS:
        return found | {"bias": float(difference.mean()) if count else None}
    limits, sem = limits_of_agreement(difference), float(difference.std(ddof=1))
    found |= {name: limits[name] for name in _OF_PAIRS if name in limits}
    found |= dict(zip(_OF_PAIRS[3:6], icc_a1(np.column_stack([answer, reference])), strict=True))
    low, high = (detectable_change(end) for end in sigma_interval(sem, count - 1))
    return found | {"sem": sem, "mdc95": detectable_change(sem), "mdc95_low": low, "mdc95_high": high}


def detectable_change(sem: float) -> float:
    """The minimal detectable change of two values that each have this standard error, 95 % (Weir 2005)."""
    return LIMITS * float(np.sqrt(2.0)) * sem


def sigma_interval(sigma: float, freedom: float) -> tuple[float, float]:
    """95 % interval of a standard deviation of normal values with these degrees of freedom (chi-square)."""
    from scipy.stats import chi2

    tail = 0.5 * (1 - CONFIDENCE)
    low, high = (sigma * np.sqrt(freedom / chi2.ppf(p, freedom)) for p in (1 - tail, tail))
    return float(low), float(high)


#: Names for people.
WORDS = {
    "elbow_flexion": "elbow flexion",
    "carrying": "carrying angle",
    "pronation": "forearm pronation",
    "shoulder_plane": "shoulder plane of elevation",
    "shoulder_elevation": "shoulder elevation",
    "shoulder_rotation": "shoulder axial rotation",
}


@dataclass(frozen=True)
class AngleComparison:
    """Angles of answer and truth at the answer's times, degrees; nan where not known or not defined."""

    t_s: FloatArray  # (n,) s: times
    answer: dict[str, FloatArray]  # dict of (n,): by the names of `smoother.joint_angles.ANGLES`
    truth: dict[str, FloatArray]
    # Median of the truth's carrying angle, None without markers on the epicondyles
    carrying_truth_deg: float | None = None
    notes: tuple[str, ...] = ()  # Notes on the comparison, one sentence each

    @property
    def compared(self) -> tuple[str, ...]:
        """Angles that both have."""
        return tuple(
            name for name in ANGLES if (np.isfinite(self.answer[name]) & np.isfinite(self.truth[name])).any()
        )

    def figures(self, chosen: BoolArray) -> dict[str, Agreement]:
        """Agreement over the chosen samples (N,), by angle."""
        return {
            name: agreement(self.answer[name][chosen], self.truth[name][chosen], degrees=True)
            for name in self.compared
        }


def compare_angles(
    recovery: Recovery,
    reference: Truth,
    landmarks: dict[str, FloatArray] | None = None,  # dict of (m, 3) m
    landmark_t_s: FloatArray | None = None,  # (m,) s
) -> AngleComparison | None:
    """Angles of a recovery beside those of a truth; None where they share none."""
    joints = {
        name: np.where(reference.score[:, None], place, np.nan) for name, place in reference.joints.items()
    }
    if not {"shoulder", "elbow"} <= joints.keys() & recovery.joints.keys():
        return None
    at = {
        name: position_at(landmark_t_s, place, recovery.t_s)
        for name, place in (landmarks or {}).items()
        if landmark_t_s is not None
    }
    R_K_F, notes = _true_forearm(recovery, reference, joints, at)
    about = (recovery.side, recovery.gravity_direction)
    answer, truth = recovery_angles(recovery), arm_angles(joints, len(recovery), R_K_F, *about)
    good_answer, good_truth = defined(answer), defined(truth)
    masked = [
        {name: np.where(good_answer[name] & good_truth[name], angles[name], np.nan) for name in ANGLES}
        for angles in (answer, truth)
    ]
    carrying = None
    if {"medial_epicondyle", "lateral_epicondyle"} <= at.keys():
        axis = at["lateral_epicondyle"] - at["medial_epicondyle"]
        own = arm_angles(joints, len(recovery), None, *about, flexion_axis=axis)["carrying"]
        carrying = float(np.nanmedian(own)) if np.isfinite(own).any() else None
    found = AngleComparison(recovery.t_s, masked[0], masked[1], carrying, tuple(notes))
    return found if found.compared else None


def _true_forearm(
    recovery: Recovery, reference: Truth, joints: dict[str, FloatArray], at: dict[str, FloatArray]
) -> tuple[FloatArray | None, list[str]]:
    """The truth's `R_K_F` (N, 3, 3), and notes on it and on the other angles."""
    notes = [
        "Angles are in ISB order; the thorax is not seen, so shoulder angles are relative to gravity and to a"
        " person who faces the camera.",
        "The carrying angle needs the humerus' own axis (epicondyles), which a skeleton does not have: it is"
        " not compared.",
    ]
    if {"radial_styloid", "ulnar_styloid", "elbow", "wrist"} <= at.keys() | joints.keys():
        y = unit(joints["wrist"] - joints["elbow"])
        thumb = (at["radial_styloid"] - at["ulnar_styloid"]) * (-1.0 if recovery.side == "left" else 1.0)
        x = unit(np.cross(y, thumb))
        notes.append("The truth's pronation is that of the styloids' markers.")
        return np.stack([x, y, np.cross(x, y)], axis=2), notes
    mounting = None if recovery.calibration is None else recovery.calibration.R_F_A
    if mounting is None:
        notes.append("The forearm's axes in the IMU (R_F_A) are not known: pronation is not compared.")
        return None, notes
    notes.append(
        "Pronation of truth and answer share the forearm's axes in the IMU: its error is not in the figure."
    )
    return forearm_axes(reference.quaternion, mounting), notes
