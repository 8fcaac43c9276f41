"""Camera samples that called themselves tracked and were set aside: how many, of what, why, when."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..recording import JOINTS, FloatArray
from ..result import Recovery


@dataclass(frozen=True)
class Rejected:
    """The samples of one joint that were set aside for one reason.

    Attributes
    ----------
    reason : the reason's name ("jump"), `why` in words.
    joint : the joint.
    count, share : samples, and their part of the joint's tracked ones.
    first_s, last_s : times of the first and the last, on the IMU's clock.
    """

    reason: str
    why: str
    joint: str
    count: int
    share: float
    first_s: float
    last_s: float

    def to_dict(self) -> dict[str, object]:
        """Plain values by name."""
        return {
            "reason": self.reason,
            "why": self.why,
            "joint": self.joint,
            "count": self.count,
            "share": self.share,
            "first_s": self.first_s,
            "last_s": self.last_s,
        }


def rejected(recovery: Recovery) -> list[Rejected]:
    """A row a reason and joint, the most frequent reason first, joints from the shoulder down."""
    kept = recovery.residuals
    if kept is None:
        return []
    at: dict[tuple[int, int], _Seen] = {}
    tracked = np.zeros(len(JOINTS), np.int64)
    for block in kept.blocks():
        tracked += np.count_nonzero(block.used | (block.reason != 0), axis=0)
        for code in np.unique(block.reason[block.reason != 0]).tolist():
            for column in np.flatnonzero((block.reason == code).any(axis=0)).tolist():
                seen = at.setdefault((code, column), _Seen())
                seen.add(block.t_s[block.reason[:, column] == code])
    totals = {code: sum(seen.count for (each, _), seen in at.items() if each == code) for code, _ in at}
    rows = []
    for code in sorted(totals, key=lambda code: (-totals[code], kept.reasons[code])):
        name, _, why = kept.reasons[code].partition(": ")
        for column, joint in enumerate(JOINTS):
            if (code, column) in at:
                seen = at[code, column]
                share = seen.count / int(tracked[column])
                rows.append(Rejected(name, why, joint, seen.count, share, seen.first_s, seen.last_s))
    return rows


@dataclass
class _Seen:
    """How often something was met, and when."""

    count: int = 0
    first_s: float = float("nan")
    last_s: float = float("nan")

    def add(self, t_s: FloatArray) -> None:
        """More of it, later."""
        self.first_s = self.first_s if self.count else float(t_s[0])
        self.last_s = float(t_s[-1])
        self.count += len(t_s)
