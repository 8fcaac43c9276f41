"""Validation without mocap: hide visible frames, recover them, compare with what was hidden."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ..errors import RecordingError, UnoccludeError
from ..recording import Recording
from ..result import Recovery
from .gap_score import GapErrors, score_gap
from .gap_table import GapFigures, GapRow, GapTable, pooled, table_of
from .metrics import summarise
from .placement import HiddenGap, place_gaps

#: A method: recording in, recovery out.
Method = Callable[[Recording], Recovery]
#: Called with the part done (0 to 1) and what is being done.
Progress = Callable[[float, str], None]


@dataclass
class _Collected:
    """Rows and their samples while the runs go on."""

    rows: list[GapRow] = field(default_factory=list)
    hidden: list[GapErrors] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)


def evaluate_gaps(
    recording: Recording,
    lengths_s: Sequence[float],
    methods: Mapping[str, Method],
    *,
    seed: int = 0,
    repetitions: int = 1,
    gaps_per_run: int = 6,
    margin_s: float = 1.5,
    progress: Progress | None = None,
) -> GapTable:
    """Hide visible frames at random, recover them, and measure the error there.

    Each method gets a copy of the recording in which elbow, wrist, hand and strap are not tracked
    inside the gaps and which has no truth: no step of it, calibration included, can see what is
    scored. All methods get the same gaps. The answer in a gap is compared with the recording's truth
    at the IMU's times where there is one, else with the hidden camera samples (wrist, or the
    recording's only joint) at the frames' times plus the clock offset that the method estimated.

    Parameters
    ----------
    recording : Recording
        The recording, whole.
    lengths_s : sequence of float, s
        Gap lengths to try.
    methods : dict[str, Method]
        By name, a function from a recording to its recovery.
    seed : int
        Where the gaps fall.
    repetitions : int
        Copies with other gaps, a length.
    gaps_per_run : int
        Most gaps hidden in one copy.
    margin_s : float, s
        Visible time kept on both sides of a gap.
    progress : Progress, optional
        Called with (part done, what is being done).

    Raises
    ------
    RecordingError
        At none of the lengths can a gap be hidden.
    """
    collected = _Collected()
    trials = _place_all(recording, lengths_s, seed, repetitions, gaps_per_run, margin_s, collected)
    for number, (length, run, gaps) in enumerate(trials):
        copy = hide(recording, gaps)
        for place, (name, method) in enumerate(methods.items()):
            if progress is not None:
                share = (number + place / len(methods)) / len(trials)
                progress(share, f"gaps of {length:g} s, {name}")
            _run(recording, copy, length, run, gaps, name, method, collected)
    if progress is not None:
        progress(1.0, "done")
    return table_of(collected.rows, collected.hidden, collected.notes)


def hide(recording: Recording, gaps: Sequence[HiddenGap]) -> Recording:
    """A copy whose forearm is not seen inside the gaps, and which has no truth."""
    hidden = np.zeros(len(recording.arm), dtype=bool)
    for gap in gaps:
        hidden |= gap.contains(recording.arm.t_s)
    return replace(recording, arm=recording.arm.hide(hidden), truth=None)


def _place_all(
    recording: Recording,
    lengths_s: Sequence[float],
    seed: int,
    repetitions: int,
    gaps_per_run: int,
    margin_s: float,
    collected: _Collected,
) -> list[tuple[float, int, list[HiddenGap]]]:
    """The gaps of every run, as (length, run, gaps)."""
    trials = []
    for length in lengths_s:
        for run in range(repetitions):
            # a generator a length and run: adding a length to the list moves no other gap
            rng = np.random.default_rng([seed, round(1000 * length), run])
            gaps = place_gaps(recording, length, rng, count=gaps_per_run, margin_s=margin_s)
            if gaps:
                trials.append((length, run, gaps))
        if not any(entry[0] == length for entry in trials):
            collected.notes.append(
                f"The camera never sees the forearm for long enough to hide a gap of {length:g} s."
            )
    if not trials:
        shortest = min(lengths_s, default=0.0)
        raise RecordingError(
            f"{recording.name}: the camera never sees the forearm for long enough to hide a gap of"
            f" {shortest:g} s with 0.4 s visible on both sides"
        )
    return trials


def _run(
    recording: Recording,
    copy: Recording,
    length_s: float,
    run: int,
    gaps: Sequence[HiddenGap],
    name: str,
    method: Method,
    collected: _Collected,
) -> None:
    """One method on one copy; what it cannot do becomes a row without figures."""
    try:
        recovery = method(copy)
    except UnoccludeError as error:
        collected.notes.append(f"{name} could not recover gaps of {length_s:g} s: {error}")
        for gap in gaps:
            nothing = summarise(np.zeros(0), np.zeros(0), np.zeros(0))
            collected.rows.append(
                GapRow(length_s, name, run, gap, "", nothing, failure=str(error), recording=recording.name)
            )
            collected.hidden.append(GapErrors.empty())
        return
    for gap in gaps:
        hidden = score_gap(recording, recovery, gap)
        failure = "" if np.isfinite(hidden.distance_m).any() else "no answer inside the gap"
        collected.rows.append(
            GapRow(
                length_s,
                name,
                run,
                gap,
                hidden.reference,
                hidden.figures(),
                sigma_max_m=hidden.sigma_max_m,
                path_m=hidden.path_m,
                failure=failure,
                recording=recording.name,
            )
        )
        collected.hidden.append(hidden)


__all__ = ["GapFigures", "GapRow", "GapTable", "evaluate_gaps", "hide", "pooled"]
