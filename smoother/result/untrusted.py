"""What of a result is not to be trusted: which samples, a line for a terminal, sentences for a list."""

from __future__ import annotations

import numpy as np

from ..array_types import BoolArray
from .recovery import Recovery
from .verdict import UntrustedInterval

#: More gaps than this are counted in a line, not named.
MOST_NAMED = 6


def usable(recovery: Recovery) -> BoolArray:
    """(N,) samples with an answer that is to be trusted and is certain enough.

    Of a result that was not judged every sample is treated as trusted.
    """
    return certain(recovery) & recovery.trusted


def certain(recovery: Recovery) -> BoolArray:
    """(N,) samples with an answer that is certain enough by what it states of itself.

    Without a limit every answer counts. With one, the standard deviation of the position has to be below
    it on every axis; an answer that states none is not known to be.
    """
    limit = recovery.estimates.max_sigma_m
    if limit is None:
        return recovery.answered
    with np.errstate(invalid="ignore"):
        below: BoolArray = recovery.worst_sigma_m <= limit  # nan where one axis is
    return recovery.answered & below


def partly_untrusted(recovery: Recovery) -> bool:
    """Whether some times are not to be trusted of a result that otherwise is."""
    return recovery.estimates.trusted is not False and bool(recovery.estimates.untrusted)


def untrusted_gaps(recovery: Recovery) -> list[int]:
    """Numbers of the gaps that are not to be trusted, from 1, in order of time."""
    return [number for number, gap in enumerate(recovery.gap_verdicts, start=1) if not gap.trusted]


def untrusted_times(recovery: Recovery) -> list[tuple[float, float]]:
    """Start and end of what is not to be trusted, s on the IMU's clock, in order; all of it may be."""
    if recovery.estimates.trusted is False:
        return [(float(recovery.t_s[0]), float(recovery.t_s[-1]))] if len(recovery) else []
    return sorted((each.start_s, each.end_s) for each in recovery.estimates.untrusted)


def in_view(recovery: Recovery) -> list[UntrustedInterval]:
    """The untrusted intervals that reach into no gap: the camera saw the arm in them, or something else."""
    return [
        each
        for each in recovery.estimates.untrusted
        if not any(each.overlaps(gap.start_s, gap.end_s) for gap in recovery.gaps)
    ]


def untrusted_sentences(recovery: Recovery) -> tuple[str, ...]:
    """Which times are not to be trusted, and why: gaps, then times in view; () if all is, or nothing."""
    if not partly_untrusted(recovery):
        return ()
    gaps = [
        f"gap {number} ({_times(gap.start_s, gap.end_s)}): {'; '.join(gap.reasons)}"
        for number, gap in enumerate(recovery.gap_verdicts, start=1)
        if not gap.trusted
    ]
    seen = [
        f"{_times(each.start_s, each.end_s)}, in view: {'; '.join(each.reasons)}"
        for each in in_view(recovery)
    ]
    return (*gaps, *seen)


def standing(recovery: Recovery) -> str:
    """The verdict and the gaps that are not to be trusted, on one line; "" where not judged."""
    parts = [recovery.estimates.verdict]
    if partly_untrusted(recovery):
        numbers = untrusted_gaps(recovery)
        named = [
            f"{number} ({_times(recovery.gaps[number - 1].start_s, recovery.gaps[number - 1].end_s)})"
            for number in numbers[:MOST_NAMED]
        ]
        if len(numbers) > MOST_NAMED:
            named.append(f"{len(numbers) - MOST_NAMED} more")
        if named:
            which = "gap" if len(numbers) == 1 else "gaps"
            parts.append(f"Not to be trusted: {which} {', '.join(named)} of {len(recovery.gaps)}.")
        if seen := in_view(recovery):
            times = [_times(each.start_s, each.end_s) for each in seen[:MOST_NAMED]]
            parts.append(f"Not to be trusted while in view: {', '.join(times)}.")
    return " ".join(part for part in parts if part)


def _times(start_s: float, end_s: float) -> str:
    return f"{start_s:.2f} to {end_s:.2f} s"
