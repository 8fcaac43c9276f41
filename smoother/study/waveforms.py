"""Angles over the repetitions of an exercise, each brought to one length: their mean and their spread."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..angles import joint_angles
from ..array_types import FloatArray
from ..joint_angles import recovery_angles, wrapped_deg
from ..measures import Measures
from ..measures.definitions import FEWEST_DRAWS
from ..measures.measuring import drawn_motion
from ..result import Recovery

#: Points from the beginning of a repetition to its end, and repetitions that a mean needs.
POINTS, FEWEST = 51, 2
#: Angles that have a waveform.
SHOWN = ("elbow_flexion", "shoulder_elevation")
#: Curves of single repetitions that a row keeps, and components of what all of them share of the errors.
MOST_CURVES, COMPONENTS = 100, 4


def waveforms_of(recovery: Recovery, measured: Measures) -> list[dict[str, Any]]:
    """Mean and standard deviation of the angles over the repetitions of a session.

    Parameters
    ----------
    recovery : Recovery
    measured : Measures
        Of it; gives the times of the repetitions.

    Returns
    -------
    waveforms : list of dict
        Plain values of each angle: `side`, `angle`, `repetitions` (how many), `trusted`, `mean` and `sd` (51
        values each, degrees, from 0 to 100 % of a repetition), `curves` (of the first repetitions) and
        `errors` (what all repetitions share of the drawn motions' deviations, see `shared_errors`; empty
        without draws). Empty without repetitions.
    """
    if len(measured.repetitions) < FEWEST:
        return []
    table = joint_angles(recovery)
    drawn = _drawn_deviations(recovery)
    found = []
    for angle in SHOWN:
        known = [
            (curve, each)
            for each in measured.repetitions
            if (curve := _resampled(recovery.t_s, table.values[angle], each.start_s, each.end_s)) is not None
        ]
        if len(known) < FEWEST:
            continue
        values = np.stack([curve for curve, _ in known])
        deviations = [
            [_resampled(recovery.t_s, each[angle], one.start_s, one.end_s) for _, one in known]
            for each in drawn
        ]
        whole = [each for each in deviations if all(curve is not None for curve in each)]
        errors = np.empty((0, POINTS))
        if len(whole) >= FEWEST_DRAWS:
            errors = shared_errors(np.array(whole, dtype=float))
        found.append(
            {
                "side": recovery.side,
                "angle": angle,
                "repetitions": len(values),
                "trusted": recovery.estimates.trusted,
                "mean": [round(float(value), 2) for value in values.mean(axis=0)],
                "sd": [round(float(value), 2) for value in values.std(axis=0, ddof=1)],
                "curves": [[round(float(value), 2) for value in curve] for curve in values[:MOST_CURVES]],
                "errors": [[round(float(value), 3) for value in each] for each in errors],
            }
        )
    return found


def _drawn_deviations(recovery: Recovery) -> list[dict[str, FloatArray]]:
    """By angle how far each drawn motion is from the answer, degrees."""
    if recovery.draws is None or len(recovery.draws) < FEWEST_DRAWS:
        return []
    answer = recovery_angles(recovery)
    drawn = (recovery_angles(drawn_motion(recovery, k)) for k in range(len(recovery.draws)))
    return [{angle: wrapped_deg(each[angle] - answer[angle]) for angle in SHOWN} for each in drawn]


def shared_errors(deviations: FloatArray) -> FloatArray:
    """What the errors of all repetitions have in common: components of its covariance.

    A deviation's mean over n repetitions has the variance c + e / n, a single one's c + e: c is shared (joint
    centres, calibration), and e is part of the scatter between repetitions, where it is not counted again.

    Parameters
    ----------
    deviations : ndarray, shape (draws, n, points), deg
        Of n repetitions, two or more.

    Returns
    -------
    components : ndarray, shape (m, points), deg
        Each row times a standard normal number, added up, is a draw of the shared error.
    """
    draws, n, points = deviations.shape
    mean = deviations.mean(axis=1)
    of_mean = mean.var(axis=0, ddof=1)
    single = deviations.var(axis=0, ddof=1).mean(axis=0)
    shared = np.clip((n * of_mean - single) / (n - 1), 0.0, None)
    if not shared.any():
        return np.empty((0, points))
    share = np.sqrt(np.divide(shared, of_mean, out=np.zeros(points), where=of_mean > 0))
    _, size, rows = np.linalg.svd((mean - mean.mean(axis=0)) * share, full_matrices=False)
    found = (size[:COMPONENTS, None] * rows[:COMPONENTS]) / np.sqrt(draws - 1)
    # what the left-out components hold goes to those that are kept
    kept = (found**2).sum(axis=0)
    scale = np.sqrt(np.divide(shared, kept, out=np.zeros(points), where=kept > 0))
    return np.asarray(found * scale)


def _resampled(t_s: FloatArray, values: FloatArray, start_s: float, end_s: float) -> FloatArray | None:
    """A repetition on its own even grid; None where the angle is not known all through it."""
    rows = slice(*np.searchsorted(t_s, [start_s, end_s]).tolist())
    part = values[rows]
    if len(part) < 3 or not np.isfinite(part).all():
        return None
    return np.interp(np.linspace(start_s, end_s, POINTS), t_s[rows], part)
