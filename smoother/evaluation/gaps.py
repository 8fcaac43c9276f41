"""Validation without mocap: hide visible frames, recover them, compare with what was hidden."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import numpy as np

from ..cameras import join_cameras
from ..errors import RecordingError, UnoccludeError
from ..recording import Recording
from ..result import Recovery
from ..runtime.pool import Pool, Progress
from .gap_table import GapRow, GapTable, pooled
from .hidden_gaps import GapErrors, HiddenGap, place_gaps, score_gap

#: A method: recording in, recovery out.
Method = Callable[[Recording], Recovery]


class GapCopy(NamedTuple):
    """A copy of the recording with these gaps; `run` counts the copies of one length."""

    length_s: float
    run: int
    gaps: list[HiddenGap]


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
    processes: int = 1,
) -> GapTable:
    """Hide visible frames at random, recover them, and measure the error there."""
    recording, _ = join_cameras(recording)  # what is hidden is hidden from all cameras
    report = progress or (lambda part, text: None)
    copies, notes = [], []
    for length in lengths_s:
        for run in range(repetitions):
            # a generator a length and run: adding a length to the list moves no other gap
            rng = np.random.default_rng([seed, round(1000 * length), run])
            gaps = place_gaps(recording, length, rng, count=gaps_per_run, margin_s=margin_s)
            if gaps:
                copies.append(GapCopy(length, run, gaps))
        if not any(copy.length_s == length for copy in copies):
            notes.append(f"The camera never sees the forearm for long enough to hide a gap of {length:g} s.")
    if not copies:
        raise RecordingError(
            f"{recording.name}: the camera never sees the forearm for long enough to hide a gap of"
            f" {min(lengths_s, default=0.0):g} s with 0.4 s visible on both sides"
        )
    tables = [GapTable((), tuple(notes))]
    job = partial(try_methods, recording=recording, methods=methods)
    with Pool(min(processes, len(copies)), len(copies) * len(recording.arm)) as workers:
        answers = workers.map(job, copies)
        for number, copy in enumerate(copies):
            report(number / len(copies), f"gaps of {copy.length_s:g} s")
            tables.append(next(answers))
    report(1.0, "done")
    return pooled(tables)


def hide(recording: Recording, gaps: Sequence[HiddenGap]) -> Recording:
    """A copy whose forearm is not seen inside the gaps, and which has no truth."""
    hidden = np.zeros(len(recording.arm), dtype=bool)
    for gap in gaps:
        hidden |= gap.contains(recording.arm.t_s)
    return replace(recording, arm=recording.arm.hide(hidden), truth=None)


def try_methods(
    trial: GapCopy, recording: Recording, methods: Mapping[str, Method], one_noise: bool = False
) -> GapTable:
    """All methods on one copy; what one of them cannot do becomes rows without figures."""
    rows, notes = [], []
    copy = hide(recording, trial.gaps)
    noise_of: Recovery | None = None
    for name, method in methods.items():
        row = partial(GapRow, trial.length_s, name, trial.run, recording=recording.name)
        try:
            recovery = method(copy)
        except UnoccludeError as error:
            notes.append(f"{name} could not recover gaps of {trial.length_s:g} s: {error}")
            rows += [row(gap, GapErrors.empty(), str(error)) for gap in trial.gaps]
            continue
        noise_of = (noise_of or recovery) if one_noise else None
        for gap in trial.gaps:
            errors = score_gap(recording, recovery, gap, noise_of)
            answered = np.isfinite(errors.distance_m).any()
            rows.append(row(gap, errors, "" if answered else "no answer inside the gap"))
    return GapTable(tuple(rows), tuple(notes))


#: Gaps of these lengths are hidden, s; values between are read off the line through them.
LENGTHS_S = (1.0, 3.0, 10.0)
GAPS = 3
#: What a gap is to stay within, m.
WITHIN_M = 0.02


@dataclass(frozen=True)
class TriedGaps:
    """How uncertain hidden gaps are."""

    sigma_m: dict[float, float]  # By length, s, of the gaps that could be hidden
    not_determined: tuple[str, ...] = ()  # What the motion left open

    @property
    def longest_s(self) -> float | None:
        """Gaps up to about this are within `WITHIN_M`; 0 where none is, None where none could be hidden."""
        if not self.sigma_m:
            return None
        lengths, sigma = list(self.sigma_m), np.maximum.accumulate(list(self.sigma_m.values()))
        if sigma[0] > WITHIN_M:
            return 0.0
        if sigma[-1] <= WITHIN_M:
            return lengths[-1]
        return float(np.exp(np.interp(np.log(WITHIN_M), np.log(sigma), np.log(lengths))))

    @property
    def sentences(self) -> tuple[str, ...]:
        """What is allowed, then what is not determined, one each."""
        within, longest_s = f"within {100 * WITHIN_M:.0f} cm", self.longest_s
        if longest_s is None:
            return "the forearm was never visible for long enough to try a gap", *self.not_determined
        if longest_s == 0.0:
            length_s, sigma_m = next(iter(self.sigma_m.items()))
            allowed = (
                f"no gap is recovered {within}; gaps of {length_s:g} s are known to {100 * sigma_m:.0f} cm"
            )
        else:
            up_to = "at least" if longest_s == max(self.sigma_m) else "about"
            allowed = f"gaps up to {up_to} {longest_s:.2g} s are recovered {within}"
        return (allowed, *self.not_determined)

    def to_dict(self) -> dict[str, object]:
        """Plain values by name."""
        return {
            "sentence": "; ".join(self.sentences),
            "longest_gap_s": self.longest_s,
            "within_m": WITHIN_M,
            "gaps": [
                {"length_s": length_s, "sigma_m": sigma_m} for length_s, sigma_m in self.sigma_m.items()
            ],
            "not_determined": list(self.not_determined),
        }


def try_gaps(
    recording: Recording,
    recover: Callable[[Recording], Recovery],
    not_determined: Sequence[str] = (),
    progress: Progress | None = None,
    processes: int = 1,
) -> TriedGaps:
    """Hide visible seconds and see how uncertain they become."""
    try:
        table = evaluate_gaps(
            *(recording, LENGTHS_S, {"graph": recover}),
            gaps_per_run=GAPS,
            progress=progress,
            processes=processes,
        )
    except RecordingError:  # never visible for long enough
        table = GapTable(())
    sigmas = {}
    for length_s, methods in table.lengths.items():
        own = [row.errors.sigma_max_m for row in table.rows if row.length_s == length_s]
        stated = [sigma_m for sigma_m in own if sigma_m is not None]
        if stated:  # widened where errors exceed what is stated
            nees = methods["graph"].figures.nees
            sigmas[length_s] = float(np.median(stated) * np.sqrt(np.fmax(nees or 1.0, 1.0)))
    return TriedGaps(sigmas, tuple(not_determined))
