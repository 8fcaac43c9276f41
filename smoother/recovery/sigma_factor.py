"""Sigma as hidden gaps of the same camera ask for it: positions in gaps, wider by a measured factor."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..calibration import SigmaFactors
from ..recording import FOREARM_JOINTS
from ..result import Recovery

#: Gaps longer than the longest hidden one by this factor deserve a word.
BEYOND = 1.5


def with_sigma_factors(recovery: Recovery, factors: SigmaFactors | None) -> Recovery:
    """The recovery with the covariance of positions in every gap multiplied by the factor's square.

    What the camera saw, the shoulder and orientations stay: hidden gaps say nothing of them. Correlations
    stay too. The covariance columns, which may lie on disk, are changed where they are.

    Parameters
    ----------
    recovery : Recovery
        As the smoother states it.
    factors : SigmaFactors or None
        Of the calibration; without any nothing changes.

    Returns
    -------
    recovery : Recovery
        With a note, and the factors among its estimates.
    """
    if factors is None or not recovery.gaps:
        return recovery
    starts = np.searchsorted(recovery.t_s, [gap.start_s for gap in recovery.gaps], "left")
    stops = np.searchsorted(recovery.t_s, [gap.end_s for gap in recovery.gaps], "right")
    applied = tuple(round(factors.at(gap.length_s), 4) for gap in recovery.gaps)
    for start, stop, factor in zip(starts.tolist(), stops.tolist(), applied, strict=True):
        for batch in recovery.rows(slice(start, stop)).batches():  # slices: they share the columns' memory
            hidden = np.where(batch.occluded, factor, 1.0)
            batch.pose_covariance[:, :3] *= hidden[:, None, None]
            batch.pose_covariance[:, :, :3] *= hidden[:, None, None]
            for joint, covariance in batch.joint_covariance.items():
                if joint in FOREARM_JOINTS:
                    covariance *= hidden[:, None, None] ** 2
    notes = (*recovery.notes, _note(applied, factors, max(gap.length_s for gap in recovery.gaps)))
    return replace(recovery, notes=notes, estimates=replace(recovery.estimates, sigma_factors=applied))


def _note(applied: tuple[float, ...], factors: SigmaFactors, longest_s: float) -> str:
    least, most = min(applied), max(applied)
    by = f"{most:.2f}" if most - least < 0.005 else f"{least:.2f} to {most:.2f}"
    count = min(entry.gaps for entry in factors.by_length)
    note = (
        f"sigma of positions in gaps was multiplied by {by}, as the calibration's hidden gaps of up to"
        f" {factors.longest_s:g} s ask for ({count} or more behind each factor)"
    )
    if longest_s > BEYOND * factors.longest_s:
        note += f"; no gap as long as {longest_s:.1f} s was hidden"
    return note
