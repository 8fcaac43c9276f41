"""Sigma as hidden gaps of the same camera ask for it: positions in gaps, wider by a measured factor."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..calibration import SigmaFactors
from ..measurements.visibility import Gap
from ..recording import FOREARM_JOINTS
from ..result import Draws, Recovery
from ..runtime.store import batches
from ..window.trajectory import share_after
from .self_check import HiddenStretch, summary

#: Gaps longer than the longest hidden one by this factor deserve a word.
BEYOND = 1.5
#: Drawn motions take their factor on and off over this time before and after a gap, s.
RAMP_S = 0.3


def with_sigma_factors(recovery: Recovery, factors: SigmaFactors | None) -> Recovery:
    """The recovery with the covariance of positions in every gap multiplied by the factor's square.

    What the camera saw, the shoulder and orientations stay: hidden gaps say nothing of them. Correlations
    stay too. The covariance columns and the drawn motions, which may lie on disk, are changed where they are.

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
    applied = tuple(round(factors.at(gap.length_s), 4) for gap in recovery.gaps)
    _widen(recovery, applied)
    notes = (*recovery.notes, _note(applied, factors, max(gap.length_s for gap in recovery.gaps)))
    return replace(recovery, notes=notes, estimates=replace(recovery.estimates, sigma_factors=applied))


def with_self_check(recovery: Recovery, stretches: Sequence[HiddenStretch]) -> Recovery:
    """The recovery with its self-check, and sigma in gaps as wide as the hidden stretches ask for.

    Parameters
    ----------
    recovery : Recovery
    stretches : sequence of HiddenStretch
        That were hidden and recovered. Where a calibration has given factors already, they change nothing.
    """
    check = summary(stretches)
    if recovery.estimates.sigma_factors:
        check = replace(check, sigma_factor=1.0)
    if check.sigma_factor > 1.0 and recovery.gaps:
        _widen(recovery, [check.sigma_factor] * len(recovery.gaps))
    return replace(recovery, estimates=replace(recovery.estimates, self_check=check))


def _widen(recovery: Recovery, applied: Sequence[float]) -> None:
    """The covariance of positions in every gap times its factor's square, in place; drawn motions too."""
    starts = np.searchsorted(recovery.t_s, [gap.start_s for gap in recovery.gaps], "left")
    stops = np.searchsorted(recovery.t_s, [gap.end_s for gap in recovery.gaps], "right")
    for start, stop, factor in zip(starts.tolist(), stops.tolist(), applied, strict=True):
        for batch in recovery.rows(slice(start, stop)).batches():  # slices: they share the columns' memory
            hidden = np.where(batch.occluded, factor, 1.0)
            batch.pose_covariance[:, :3] *= hidden[:, None, None]
            batch.pose_covariance[:, :, :3] *= hidden[:, None, None]
            for joint, covariance in batch.joint_covariance.items():
                if joint in FOREARM_JOINTS:
                    covariance *= hidden[:, None, None] ** 2
    if recovery.draws is not None:
        _widen_draws(recovery.draws, recovery.gaps, applied)


def _widen_draws(draws: Draws, gaps: Sequence[Gap], factors: Sequence[float]) -> None:
    """Drawn positions (in place) as much further from the answer as their sigma is larger.

    A motion does not jump: outside a gap the factor comes and goes over `RAMP_S`.
    """
    moved = [draws.position, *(values for joint, values in draws.joints.items() if joint in FOREARM_JOINTS)]
    ends = np.array([(gap.start_s, gap.end_s) for gap in gaps])
    for rows in batches(len(draws.t_s)):
        t = draws.t_s[rows]
        factor = np.ones(len(t))
        for (start_s, end_s), of_gap in zip(ends, factors, strict=True):
            away_s = np.maximum(np.maximum(start_s - t, t - end_s), 0.0)
            near = np.flatnonzero(away_s < RAMP_S)
            fade = 1.0 - share_after(away_s[near], 0.5 * RAMP_S, 0.5 * RAMP_S)
            # of two gaps side by side the stronger one counts
            own = 1.0 + (of_gap - 1.0) * fade
            factor[near] = np.where(np.abs(own - 1.0) > np.abs(factor[near] - 1.0), own, factor[near])
        for column in moved:
            column[:, rows] *= factor[:, None].astype(column.dtype)


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
