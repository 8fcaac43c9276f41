"""Camera samples that called themselves tracked and were set aside: how many, of what, why, when."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..recording import JOINTS
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
    totals = np.bincount(kept.reason.reshape(-1), minlength=len(kept.reasons))
    codes = [code for code in range(1, len(totals)) if totals[code]]
    tracked = np.count_nonzero(kept.used | (kept.reason != 0), axis=0)
    rows = []
    for code in sorted(codes, key=lambda code: (-totals[code], kept.reasons[code])):
        name, _, why = kept.reasons[code].partition(": ")
        for column, joint in enumerate(JOINTS):
            at = kept.t_s[kept.reason[:, column] == code]
            if not len(at):
                continue
            share = len(at) / int(tracked[column])
            rows.append(Rejected(name, why, joint, len(at), share, float(at[0]), float(at[-1])))
    return rows
