"""Answers that are too uncertain to use."""

from __future__ import annotations

from dataclasses import replace

from ..result import Recovery


def limit_sigma(recovery: Recovery, max_sigma_m: float | None) -> Recovery:
    """Mark the samples whose position is less certain than asked for; they stay as they are.

    Parameters
    ----------
    max_sigma_m : largest standard deviation on the worst axis that is of use, m; None marks nothing.

    Returns
    -------
    The recovery with the limit among its figures, from which `io.usable` derives the marks, and a note
    that says how many samples it concerns.
    """
    if max_sigma_m is None:
        return recovery
    from ..io.result.usable import LIMIT, usable

    answered = int(usable(recovery).sum())
    marked = replace(recovery, figures={**recovery.figures, LIMIT: float(max_sigma_m)})
    kept = int(usable(marked).sum())
    note = (
        f"{answered - kept} of {answered} samples are less certain than {max_sigma_m:g} m (one standard"
        " deviation) and are marked as not to be used: `usable` is 0 in the CSV export."
    )
    return replace(marked, notes=(*recovery.notes, note))
