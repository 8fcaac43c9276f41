"""Angles over the repetitions of an exercise, each brought to one length: their mean and their spread."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..angles import joint_angles
from ..array_types import FloatArray
from ..measures import Measures
from ..result import Recovery

#: Points from the beginning of a repetition to its end, and repetitions that a mean needs.
POINTS, FEWEST = 51, 2
#: Angles that have a waveform.
SHOWN = ("elbow_flexion", "shoulder_elevation")


def waveforms_of(recovery: Recovery, measured: Measures) -> list[dict[str, Any]]:
    """Mean and standard deviation of the angles over the repetitions of a session.

    Parameters
    ----------
    recovery : Recovery
    measured : Measures
        Of it; says when the repetitions were.

    Returns
    -------
    waveforms : list of dict
        Plain values of each angle: `side`, `angle`, `repetitions` (how many), `trusted`, `mean` and `sd` (51
        values each, degrees, from 0 to 100 % of a repetition). Empty without repetitions.
    """
    if len(measured.repetitions) < FEWEST:
        return []
    table = joint_angles(recovery)
    found = []
    for angle in SHOWN:
        curves = [
            curve
            for each in measured.repetitions
            if (curve := _resampled(recovery.t_s, table.values[angle], each.start_s, each.end_s)) is not None
        ]
        if len(curves) < FEWEST:
            continue
        values = np.stack(curves)
        found.append(
            {
                "side": recovery.side,
                "angle": angle,
                "repetitions": len(curves),
                "trusted": recovery.estimates.trusted,
                "mean": [round(float(value), 2) for value in values.mean(axis=0)],
                "sd": [round(float(value), 2) for value in values.std(axis=0, ddof=1)],
            }
        )
    return found


def _resampled(t_s: FloatArray, values: FloatArray, start_s: float, end_s: float) -> FloatArray | None:
    """A repetition on its own even grid; None where the angle is not known all through it."""
    rows = slice(*np.searchsorted(t_s, [start_s, end_s]).tolist())
    part = values[rows]
    if len(part) < 3 or not np.isfinite(part).all():
        return None
    return np.interp(np.linspace(start_s, end_s, POINTS), t_s[rows], part)
