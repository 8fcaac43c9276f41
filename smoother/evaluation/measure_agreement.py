"""How well the measures of results agree with those of their references, over recordings and movements."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..measures import Measures
from ..recording import Truth
from ..result import Recovery
from .detectable import PairAgreement, pair_agreement
from .main_measures import is_main
from .measure_pairs import MeasurePair, is_measurable, pairs_of, same_movements, same_samples, unique_pairs
from .quantity import interval, quantity


@dataclass(frozen=True)
class KeyAgreement:
    """How well a measure agrees over many pairs.

    Attributes
    ----------
    scope, key, name, unit : str
        What is compared.
    recordings : int
        Of how many recordings the pairs are.
    inside : int
        Intervals that hold the reference.
    intervals : int
        Pairs with an interval.
    agreement : PairAgreement
        The figures.
    """

    scope: str
    key: str
    name: str
    unit: str
    recordings: int
    inside: int
    intervals: int
    agreement: PairAgreement

    def to_dict(self) -> dict[str, object]:
        """Plain values by name, as `--json` writes them."""
        about = {name: getattr(self, name) for name in ("name", "unit", "recordings", "inside", "intervals")}
        return about | self.agreement.to_dict()


@dataclass(frozen=True)
class MeasureComparison:
    """The measures of a recording beside those of its reference.

    Attributes
    ----------
    pairs : tuple of MeasurePair
        Those that both have; the session's first.
    pooled : tuple of MeasurePair
        Of earlier validations.
    notes : tuple of str
        What a reader must know, one sentence each.
    """

    pairs: tuple[MeasurePair, ...]
    pooled: tuple[MeasurePair, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def together(self) -> list[MeasurePair]:
        """All pairs, the pooled ones first."""
        return unique_pairs((*self.pooled, *self.pairs))

    @property
    def agreements(self) -> tuple[KeyAgreement, ...]:
        """Figures by scope and measure, over these pairs and the pooled ones."""
        groups: dict[tuple[str, str], list[MeasurePair]] = {}
        for pair in self.together:
            groups.setdefault((pair.scope, pair.key), []).append(pair)
        order = {"session": 0, "movement": 1, "repetition": 2}
        return tuple(_agreement(groups[each]) for each in sorted(groups, key=lambda each: order[each[0]]))

    def to_dict(self) -> dict[str, Any]:
        """Plain values by name, as `--json` writes them; another `validate` may pool them."""
        agreements: dict[str, dict[str, object]] = {}
        for each in self.agreements:
            agreements.setdefault(each.scope, {})[each.key] = each.to_dict()
        return {
            "agreement": agreements,
            "pairs": [pair.to_dict() for pair in self.together],
            "notes": list(self.notes),
        }


def compare_measures(
    recovery: Recovery, reference: Truth, pooled: Sequence[MeasurePair] = ()
) -> MeasureComparison | None:
    """Measure the answer and the reference by the same functions over the same samples.

    Parameters
    ----------
    recovery : Recovery
        The result; its draws, if there are any, give the intervals.
    reference : Truth
        At the recovery's times, in the camera's frame.
    pooled : sequence of MeasurePair
        Of earlier validations (`measure_files.read_pairs`).

    Returns
    -------
    MeasureComparison or None
        None where the reference has no motion to measure.
    """
    from ..measures import measure

    answer, motion = same_samples(recovery, reference)
    if not is_measurable(motion):
        return None
    mine, theirs = measure(answer), measure(motion)
    pairs = tuple(pairs_of(mine, theirs, recovery.name))
    return MeasureComparison(pairs, tuple(pooled), tuple(_notes(mine, theirs, pairs, pooled)))


def _notes(
    mine: Measures, theirs: Measures, pairs: Sequence[MeasurePair], pooled: Sequence[MeasurePair]
) -> list[str]:
    notes = []
    for what in ("movements", "repetitions"):
        ours, others = getattr(mine, what), getattr(theirs, what)
        same = len(same_movements(ours, others))
        if same < max(len(ours), len(others)):
            notes.append(
                f"{what.capitalize()}: the answer has {len(ours)}, the reference {len(others)}; the {same}"
                " that share more than half of their time are compared."
            )
    if not mine.n_draws:
        notes.append("The result has no draws: the measures have no intervals (smooth with --draws 64).")
    recordings = {pair.recording for pair in (*pairs, *pooled)}
    if len(recordings) < 3 and any(pair.scope != "session" for pair in pairs):
        notes.append(
            "Movements of one person are alike: over few recordings the intervals of ICC and of the minimal"
            " detectable change are too narrow."
        )
    return notes


def _agreement(pairs: Sequence[MeasurePair]) -> KeyAgreement:
    first = pairs[0]
    inside = [pair.inside for pair in pairs if pair.inside is not None]
    return KeyAgreement(
        scope=first.scope,
        key=first.key,
        name=first.name,
        unit=first.unit,
        recordings=len({(pair.recording, pair.side) for pair in pairs}),
        inside=sum(inside),
        intervals=len(inside),
        agreement=pair_agreement(
            np.array([pair.value for pair in pairs]), np.array([pair.reference for pair in pairs])
        ),
    )


def pair_cells(comparison: MeasureComparison) -> tuple[Sequence[str], Sequence[Sequence[str]]]:
    """Columns and rows of a table of the session's main measures."""
    rows = [
        (
            pair.name,
            quantity(pair.value, pair.unit),
            interval(pair.low, pair.high, pair.unit) or "-",
            quantity(pair.reference, pair.unit),
            quantity(pair.difference, pair.unit, signed=True),
            {None: "-", True: "yes", False: "no"}[pair.inside],
            f"{100 * pair.recovered_share:.0f} %" if np.isfinite(pair.recovered_share) else "-",
        )
        for pair in comparison.pairs
        if pair.scope == "session" and is_main(pair.key)
    ]
    return (
        "measure",
        "answer",
        "95 % interval",
        "truth",
        "difference",
        "inside",
        "recovered",
    ), rows


def agreement_cells(comparison: MeasureComparison) -> tuple[Sequence[str], Sequence[Sequence[str]]]:
    """Columns and rows of a table of agreement: the main measures with three pairs or more."""
    rows = [
        (
            one.name,
            one.scope,
            f"{found.pairs} of {one.recordings}",
            quantity(found.bias or 0.0, one.unit, signed=True),
            interval(found.limits_low, found.limits_high or 0.0, one.unit, signed=True),
            "-" if found.icc is None else f"{found.icc:.3f} ({found.icc_low:.3f} to {found.icc_high:.3f})",
            quantity(found.mdc95 or 0.0, one.unit),
            f"{one.inside} of {one.intervals}" if one.intervals else "-",
        )
        for one in comparison.agreements
        if is_main(one.key) and (found := one.agreement).limits_low is not None
    ]
    return (
        "measure",
        "of",
        "pairs of arms",
        "bias",
        "limits of agreement",
        "ICC(2,1), 95 % interval",
        "MDC95",
        "inside",
    ), rows
