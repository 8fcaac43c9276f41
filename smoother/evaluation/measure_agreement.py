"""The measures of a result beside those of its reference."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import asdict, dataclass, replace

import numpy as np

from ..recording import Truth
from ..result import Recovery
from ..runtime.pool import Progress
from ..table import Table, tabulated
from .words import first_of, interval, is_main, quantity


@dataclass(frozen=True)
class MeasurePair:
    """A measure of a session, of the answer and of the reference."""

    recording: str  # What it was measured on
    side: str  # The arm
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

    def to_dict(self) -> dict[str, object]:
        """Plain values by name, as `--json` writes them."""
        return asdict(self) | {"difference": self.difference, "inside": self.inside}


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
    known = {name: np.isfinite(place).all(axis=1, keepdims=True) for name, place in joints.items()}
    answer = replace(
        recovery,
        joints={name: np.where(known[name], recovery.joints[name], np.nan) for name in joints},
        joint_covariance={name: each for name, each in recovery.joint_covariance.items() if name in joints},
    )
    return answer, motion


def compare_measures(
    recovery: Recovery, reference: Truth, processes: int, progress: Progress | None
) -> list[MeasurePair] | None:
    """Measure the answer and the reference by the same functions over the same samples."""
    from ..measures import measure

    answer, motion = same_samples(recovery, reference)
    if not any(np.isfinite(place).all(axis=1).sum() > 1 for place in motion.joints.values()):
        return None
    mine, others = measure(answer, processes=processes, progress=progress), measure(motion).by_key
    return [
        MeasurePair(
            *(recovery.name, mine.side, key, row.name, row.unit),
            *(row.value, row.low, row.high, others[key].value, row.recovered_share),
        )
        for key, row in mine.by_key.items()
        if key in others and row.is_known and others[key].is_known
    ]


def pair_table(title: str, pairs: Iterable[MeasurePair], most: int | None = None) -> Table:
    """The session's main measures, or those of them to look at first."""
    by_key = {pair.key: pair for pair in pairs}
    shown = set(by_key) if most is None else set(first_of(list(by_key), most))
    return tabulated(
        title,
        [pair for key, pair in by_key.items() if key in shown and is_main(key)],
        {
            "measure": "name",
            "answer": lambda pair: quantity(pair.value, pair.unit),
            "95 % interval": lambda pair: interval(pair.low, pair.high, pair.unit) or "-",
            "truth": lambda pair: quantity(pair.reference, pair.unit),
            "difference": lambda pair: quantity(pair.difference, pair.unit, signed=True),
            "inside": lambda pair: {None: "-", True: "yes", False: "no"}[pair.inside],
            "recovered": "recovered_share",
        },
    )
