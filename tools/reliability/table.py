"""The table that a run prints: a row per trial, a line per case, and what must be nothing."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .judging import CHI2_95, TOO_SLOW, Outcome, Rated


@dataclass(frozen=True)
class Row:
    """A trial's name and its end.

    Attributes
    ----------
    case, about : str
        The case, and what the person did before which tracker.
    kind : str
        "sound", "unusual", "wrong" or "pair": an answer to a pair must not be trusted, however near it is.
    seed : int
    outcome : Outcome
    """

    case: str
    about: str
    kind: str
    seed: int
    outcome: Outcome

    @property
    def fails(self) -> str:
        """What is not as it must be; "" where all is well."""
        outcome = self.outcome
        if wrong := outcome.wrong_and_trusted:
            return f"WRONG AND TRUSTED x{len(wrong)}"
        if outcome.sentence.startswith("traceback"):
            return "TRACEBACK"
        if outcome.sentence.startswith(TOO_SLOW):
            return "TOO SLOW"
        if self.kind == "pair" and outcome.trusted:
            return "PAIR TRUSTED"
        if self.kind == "sound" and not outcome.trusted:
            return "SOUND, NOT TRUSTED"
        return "CONTRADICTION" if outcome.contradiction else ""

    def show(self) -> None:
        """Print the row."""
        outcome, worst = self.outcome, self.outcome.worst
        error, sigma = (worst.error_m, worst.sigma_m) if worst else (np.nan, np.nan)
        gap = "-" if worst is None else ("trusted" if worst.trusted else "not")
        said = outcome.sentence or "; ".join((*(worst.reasons if worst else ()), *outcome.reasons))
        text = " ".join(filter(None, [self.fails, outcome.contradiction, outcome.pairing, said]))
        print(
            f"{self.case:38} {self.about:32} {self.seed:10} {outcome.duration_s:5.1f} s"
            f" {_cm(error)} {_cm(sigma)}  {gap:8} {outcome.verdict:12} {textwrap.shorten(text, 170)}",
            flush=True,
        )


def head() -> None:
    """Print the heads of the columns."""
    print(
        f"{'case':38} {'exercise, tracker':32} {'seed':>10} {'length':>7} {'worst gap':>9} {'stated':>9}"
        f"  {'gap':8} {'recording':12} what it says"
    )


def summarise(rows: Sequence[Row]) -> None:
    """Print a line per case, then the figures that count."""
    print(f"\n{'case':38} runs refused not care trusted  intervals wrong and trusted")
    for case in dict.fromkeys(row.case for row in rows):
        own = [row.outcome for row in rows if row.case == case]
        ends = [
            sum(each.verdict == verdict for each in own)
            for verdict in ("refused", "not trusted", "with care", "trusted")
        ]
        wrong = [each for outcome in own for each in outcome.wrong_and_trusted]
        sizes = ", ".join(f"{_cm(each.error_m).strip()} at {_cm(each.sigma_m).strip()}" for each in wrong)
        print(
            f"{case:38} {len(own):4} {ends[0]:7} {ends[1]:3} {ends[2]:4} {ends[3]:7}"
            f"  {len(wrong) or '-'} {sizes}"
        )
    faults = [row for row in rows if row.kind in ("wrong", "unusual")]
    pairs, sound = ([row for row in rows if row.kind == kind] for kind in ("pair", "sound"))
    print()
    if faults:
        wrong_runs = sum(bool(row.outcome.wrong_and_trusted) for row in faults)
        print(f"wrong or unusual set-ups, an interval wrong and trusted: {wrong_runs} of {len(faults)}")
    if pairs:
        trusted, wrong_pairs = (
            sum(bool(of(row.outcome)) for row in pairs)
            for of in (lambda outcome: outcome.trusted, lambda outcome: outcome.wrong_and_trusted)
        )
        print(
            f"wrong pairs called trusted: {trusted} of {len(pairs)}; wrong in the gaps besides: {wrong_pairs}"
        )
    if sound:
        _show_sound([row.outcome for row in sound])
    _show_time([row.outcome for row in rows])


def _show_sound(outcomes: list[Outcome]) -> None:
    lost = [outcome for outcome in outcomes if not outcome.trusted]
    print(f"sound recordings not trusted or refused: {len(lost)} of {len(outcomes)}")
    wrong = sum(bool(outcome.wrong_and_trusted) for outcome in outcomes)
    print(f"sound recordings with an interval wrong and trusted: {wrong} of {len(outcomes)}")
    gaps: list[Rated] = [each for outcome in outcomes for each in outcome.rated if not each.interval.faulty]
    kept = [each for each in gaps if each.trusted]
    print(f"their gaps not trusted: {len(gaps) - len(kept)} of {len(gaps)}")
    if not kept:
        return
    squares = np.concatenate([each.squared_sigmas for each in kept])
    print(
        f"trusted gaps: rms {_cm(float(np.sqrt(np.mean([each.error_m**2 for each in kept])))).strip()},"
        f" {100 * np.mean(squares <= CHI2_95):.0f} % of the samples in the 95 % region,"
        f" squared error / variance {np.mean(squares) / 3:.2f} (median {np.median(squares) / 2.37:.2f})"
    )
    ratios = [each.error_m / each.line_m for each in kept if np.isfinite(each.line_m)]
    if ratios:
        print(
            f"error against a straight line's: median {np.median(ratios):.2f}, more than 1.1 times in"
            f" {sum(ratio > 1.1 for ratio in ratios)} of {len(ratios)} gaps"
        )


def _show_time(outcomes: list[Outcome]) -> None:
    share = [outcome.seconds / outcome.duration_s for outcome in outcomes if np.isfinite(outcome.seconds)]
    if share:
        print(f"time of smooth / time recorded: median {np.median(share):.2f}, most {max(share):.2f}")
    contradictions = sum(bool(outcome.contradiction) for outcome in outcomes)
    if contradictions:
        print(f"answers whose verdicts contradict each other: {contradictions}")


def _cm(metres: float) -> str:
    if not np.isfinite(metres):
        return f"{'-':>9}"
    return f"{100 * metres:6.1f} cm" if metres < 100 else f"{100 * metres:6.0e} cm"
