"""The measures of a result beside those of its reference, pair by pair."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np

from ..array_types import FloatArray
from ..measures import Measure, Measures, Movement
from ..recording import Truth
from ..result import Recovery

#: A movement of the answer and one of the reference are the same where they share more of their time.
SAME_SHARE = 0.5


@dataclass(frozen=True)
class MeasurePair:
    """A measure of the answer and of the reference.

    Attributes
    ----------
    recording : str
        What it was measured on.
    side : str
        The arm.
    scope : str
        "session", "movement" or "repetition".
    movement : int or None
        Of the answer; None for the session.
    key, name, unit : str
        As a `Measure` has them.
    value, low, high : float
        Of the answer; nan without an interval.
    reference : float
        Of the reference.
    recovered_share : float, 0 to 1
        How much of the answer's value rests on recovered samples.
    """

    recording: str
    side: str
    scope: str
    movement: int | None
    key: str
    name: str
    unit: str
    value: float
    low: float
    high: float
    reference: float
    recovered_share: float

    @property
    def difference(self) -> float:
        """Answer minus reference."""
        return self.value - self.reference

    @property
    def inside(self) -> bool | None:
        """Whether the interval holds the reference; None without one."""
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
    """Answer and reference as recoveries, each without what the other does not have.

    Parameters
    ----------
    recovery : Recovery
        The answer.
    reference : Truth
        At its times.

    Returns
    -------
    answer, motion : Recovery
        Joints are nan where the reference has none; the reference has neither draws nor covariance.
    """
    score = reference.score[:, None]
    position = np.where(score, reference.position, np.nan)
    has_pose = bool(np.isfinite(position).any())
    joints = {
        name: np.where(score, place, np.nan)
        for name, place in reference.joints.items()
        if name in recovery.joints and np.isfinite(place).any()
    }
    known = {name: np.isfinite(place).all(axis=1, keepdims=True) for name, place in joints.items()}
    quaternion = np.where(score, reference.quaternion, np.nan)
    motion = replace(
        recovery,
        method="reference",
        position=position if has_pose else recovery.position,
        quaternion=quaternion,
        velocity=_speed(recovery.t_s, position if has_pose else recovery.position),
        joints=joints,
        joint_covariance={name: np.zeros((len(recovery), 3, 3)) for name in joints},
        upper=None,
        draws=None,
    )
    answer = replace(
        recovery,
        joints={name: np.where(known[name], recovery.joints[name], np.nan) for name in joints},
        joint_covariance={name: each for name, each in recovery.joint_covariance.items() if name in joints},
    )
    return answer, motion


def _speed(t_s: FloatArray, position: FloatArray) -> FloatArray:
    return np.gradient(position, t_s, axis=0) if len(t_s) > 1 else np.zeros_like(position)


def is_measurable(motion: Recovery) -> bool:
    """Whether any joint is known for longer than a sample."""
    return any(np.isfinite(place).all(axis=1).sum() > 1 for place in motion.joints.values())


def pairs_of(mine: Measures, theirs: Measures, recording: str) -> list[MeasurePair]:
    """The measures that answer and reference both have, by session, movement and repetition."""
    places: list[tuple[Mapping[str, Measure], Mapping[str, Measure]]] = [(mine.by_key, theirs.by_key)]
    for scope, ours, others in (
        ("movement", mine.movements, theirs.movements),
        ("repetition", mine.repetitions, theirs.repetitions),
    ):
        for here, there in same_movements(ours, others):
            places.append((mine.of(scope, here), theirs.of(scope, there)))  # type: ignore[arg-type]
    return [
        MeasurePair(
            recording=recording,
            side=mine.side,
            scope=row.scope,
            movement=row.movement,
            key=key,
            name=row.name,
            unit=row.unit,
            value=row.value,
            low=row.low,
            high=row.high,
            reference=others[key].value,
            recovered_share=row.recovered_share,
        )
        for rows, others in places
        for key, row in rows.items()
        if key in others and row.is_known and others[key].is_known
    ]


def same_movements(ours: Sequence[Movement], others: Sequence[Movement]) -> list[tuple[int, int]]:
    """Movements of two lists that share more than half of the time that either takes, by their numbers."""
    matches = []
    for here, mine in enumerate(ours):
        for there, other in enumerate(others):
            shared = min(mine.end_s, other.end_s) - max(mine.start_s, other.start_s)
            either = max(mine.end_s, other.end_s) - min(mine.start_s, other.start_s)
            if shared > SAME_SHARE * either:  # more than half: at most one matches
                matches.append((here, there))
    return matches
