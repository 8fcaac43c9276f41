"""How well the measures of results agree with those of their references, pair by pair."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from ..measures import Measures, Movement, Scope
from ..recording import Truth
from ..result import Recovery
from ..runtime.pool import Progress
from ..table import Table
from .agreement import PairAgreement, pair_agreement
from .progress import interval, is_main, quantity

#: A movement of the answer and one of the reference are the same where they share more of their time.
SAME_SHARE = 0.5


@dataclass(frozen=True)
class MeasurePair:
    """A measure of the answer and of the reference."""

    recording: str  # What it was measured on
    side: str  # The arm
    scope: Scope
    movement: int | None  # Of the answer; None for the session
    key: str  # As a `Measure` has them
    name: str
    unit: str
    value: float  # Of the answer
    low: float  # nan without an interval
    high: float
    reference: float  # Value of the reference
    recovered_share: float  # How much of the answer's value comes from recovered samples

    @property
    def difference(self) -> float:
        """Answer minus reference."""
        return self.value - self.reference

    @property
    def inside(self) -> bool | None:
        """Whether the interval contains the reference; None without one."""
        if not math.isfinite(self.low) or not math.isfinite(self.high):
            return None
        return self.low <= self.reference <= self.high

    @property
    def identity(self) -> tuple[object, ...]:
        """The same for a pair that was written and read again."""
        numbers = (f"{self.value:.9g}", f"{self.reference:.9g}")
        return (self.recording, self.side, self.scope, self.movement, self.key, *numbers)

    def to_dict(self) -> dict[str, object]:
        """Plain values by name, as `--json` writes them."""
        return asdict(self) | {"difference": self.difference, "inside": self.inside}


def unique_pairs(pairs: Iterable[MeasurePair]) -> list[MeasurePair]:
    """The pairs without those that come again: files that were pooled hold what was pooled before."""
    return list({pair.identity: pair for pair in pairs}.values())


def same_samples(recovery: Recovery, reference: Truth) -> tuple[Recovery, Recovery]:
    """Answer and reference as recoveries, each without what the other does not have."""
    score = reference.score[:, None]
    position = np.where(score, reference.position, np.nan)
    place = position if np.isfinite(position).any() else recovery.position
    joints = {
        name: np.where(score, joint, np.nan)
        for name, joint in reference.joints.items()
        if name in recovery.joints and np.isfinite(joint).any()
    }
    known = {name: np.isfinite(place).all(axis=1, keepdims=True) for name, place in joints.items()}
    motion = replace(
        recovery,
        method="reference",
        position=place,
        quaternion=np.where(score, reference.quaternion, np.nan),
        velocity=np.gradient(place, recovery.t_s, axis=0) if len(recovery) > 1 else np.zeros_like(place),
        joints=joints,
        joint_covariance={name: np.zeros((len(recovery), 3, 3)) for name in joints},
        segments={},
        draws=None,
    )
    answer = replace(
        recovery,
        joints={name: np.where(known[name], recovery.joints[name], np.nan) for name in joints},
        joint_covariance={name: each for name, each in recovery.joint_covariance.items() if name in joints},
    )
    return answer, motion


def pairs_of(mine: Measures, theirs: Measures, recording: str) -> list[MeasurePair]:
    """The measures that answer and reference both have, by session, movement and repetition."""
    kinds: list[tuple[Scope, Sequence[Movement], Sequence[Movement]]] = [
        ("movement", mine.movements, theirs.movements),
        ("repetition", mine.repetitions, theirs.repetitions),
    ]
    places = [(mine.by_key, theirs.by_key)]
    for scope, ours, others in kinds:
        places += [
            (mine.of(scope, here), theirs.of(scope, there)) for here, there in same_movements(ours, others)
        ]
    return [
        MeasurePair(
            *(recording, mine.side, row.scope, row.movement, key, row.name, row.unit),
            *(row.value, row.low, row.high, others[key].value, row.recovered_share),
        )
        for rows, others in places
        for key, row in rows.items()
        if key in others and row.is_known and others[key].is_known
    ]


def same_movements(ours: Sequence[Movement], others: Sequence[Movement]) -> list[tuple[int, int]]:
    """Movements of two lists that share more than half of the time that either takes, by their numbers."""
    return [
        (here, there)
        for here, mine in enumerate(ours)
        for there, other in enumerate(others)
        if min(mine.end_s, other.end_s) - max(mine.start_s, other.start_s)
        > SAME_SHARE * (max(mine.end_s, other.end_s) - min(mine.start_s, other.start_s))
    ]


@dataclass(frozen=True)
class KeyAgreement:
    """How well a measure agrees over many pairs."""

    scope: str
    key: str
    name: str
    unit: str
    recordings: int  # Of how many recordings the pairs are
    inside: int  # Intervals that contain the reference
    intervals: int  # Pairs with an interval
    agreement: PairAgreement  # The figures

    def to_dict(self) -> dict[str, object]:
        """Plain values by name, as `--json` writes them."""
        about = {name: getattr(self, name) for name in ("name", "unit", "recordings", "inside", "intervals")}
        return about | asdict(self.agreement)


@dataclass(frozen=True)
class MeasureComparison:
    """The measures of a recording beside those of its reference."""

    pairs: tuple[MeasurePair, ...]  # Those that both have; the session's first
    pooled: tuple[MeasurePair, ...] = ()  # Of earlier validations
    notes: tuple[str, ...] = ()  # What a reader must know, one sentence each

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
        found = []
        for scope, key in sorted(groups, key=lambda each: order[each[0]]):
            pairs = groups[scope, key]
            inside = [pair.inside for pair in pairs if pair.inside is not None]
            values = np.array([(pair.value, pair.reference) for pair in pairs])
            recordings = len({(pair.recording, pair.side) for pair in pairs})
            about = (scope, key, pairs[0].name, pairs[0].unit, recordings, sum(inside), len(inside))
            found.append(KeyAgreement(*about, pair_agreement(*values.T)))
        return tuple(found)

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
    recovery: Recovery,
    reference: Truth,
    pooled: Sequence[MeasurePair] = (),
    processes: int = 1,
    progress: Progress | None = None,
) -> MeasureComparison | None:
    """Measure the answer and the reference by the same functions over the same samples."""
    from ..measures import measure

    answer, motion = same_samples(recovery, reference)
    if not any(np.isfinite(place).all(axis=1).sum() > 1 for place in motion.joints.values()):
        return None
    mine, theirs = measure(answer, processes=processes, progress=progress), measure(motion)
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


def pair_table(title: str, comparison: MeasureComparison, keys: Collection[str] | None = None) -> Table:
    """The session's main measures, or those with these keys."""
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
        if pair.scope == "session" and (is_main(pair.key) if keys is None else pair.key in keys)
    ]
    columns = ("measure", "answer", "95 % interval", "truth", "difference", "inside", "recovered")
    return Table(title, columns, rows)


def agreement_table(title: str, comparison: MeasureComparison, keys: Collection[str] | None = None) -> Table:
    """The agreement of the main measures with three pairs or more."""
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
        if (is_main(one.key) if keys is None else one.key in keys)
        and (found := one.agreement).limits_low is not None
    ]
    columns = (
        *("measure", "of", "pairs of arms", "bias", "limits of agreement"),
        *("ICC(2,1), 95 % interval", "MDC95", "inside"),
    )
    return Table(title, columns, rows)
