"""Answers that are too uncertain to use."""

from __future__ import annotations

from dataclasses import replace

from ..result import Recovery


def limit_sigma(recovery: Recovery, max_sigma_m: float | None) -> Recovery:
    """Mark the samples whose position is less certain than asked for; they stay as they are.

    Parameters
    ----------
    recovery : Recovery
    max_sigma_m : float or None, m
        Largest standard deviation on the worst axis that is of use; None marks nothing.

    Returns
    -------
    recovery : Recovery
        With the limit among its estimates, from which `io.usable` derives the marks, and a note that says how
        many samples it concerns.
    """
    if max_sigma_m is None:
        return recovery
    from ..io.result.usable import certain

    answered = int(certain(recovery).sum())
    marked = replace(recovery, estimates=replace(recovery.estimates, max_sigma_m=float(max_sigma_m)))
    below = int(certain(marked).sum())
    note = (
        f"{answered - below} of {answered} samples are less certain than {max_sigma_m:g} m (one standard"
        " deviation) and are marked as not to be used: `usable` is 0 in the CSV export."
    )
    return replace(marked, notes=(*recovery.notes, note))
