"""Camera samples that called themselves tracked and were rejected: how many, of what, why, when."""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np

from ..recording import JOINTS
from ..result import Recovery


@dataclass(frozen=True)
class Rejected:
    """The samples of one joint that were rejected for one reason.

    Attributes
    ----------
    reason : str
        The reason's name ("jump").
    why : str
        The same in words.
    joint : str
        The joint.
    count : int
        Samples.
    share : float
        Their part of the joint's tracked ones.
    first_s, last_s : float, s
        Times of the first and the last, on the IMU's clock.
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
        return asdict(self)


def rejected(recovery: Recovery) -> list[Rejected]:
    """A row a reason and joint, the most frequent reason first, joints from the shoulder down."""
    residuals = recovery.residuals
    if residuals is None:
        return []
    times: dict[tuple[int, int], tuple[int, float, float]] = {}  # count, first and last by reason and joint
    tracked = np.zeros(len(JOINTS), np.int64)
    for batch in residuals.batches():
        tracked += np.count_nonzero(batch.used | (batch.reason != 0), axis=0)
        for code in np.unique(batch.reason[batch.reason != 0]).tolist():
            for column in np.flatnonzero((batch.reason == code).any(axis=0)).tolist():
                t_s = batch.t_s[batch.reason[:, column] == code]
                count, first_s, _ = times.get((code, column), (0, float(t_s[0]), 0.0))
                times[code, column] = count + len(t_s), first_s, float(t_s[-1])
    totals = {code: sum(row[0] for (other, _), row in times.items() if other == code) for code, _ in times}
    rows = []
    for code in sorted(totals, key=lambda code: (-totals[code], residuals.reasons[code])):
        reason = residuals.reasons[code]
        for column, joint in enumerate(JOINTS):
            if (code, column) in times:
                count, first_s, last_s = times[code, column]
                rows.append(Rejected(*reason, joint, count, count / int(tracked[column]), first_s, last_s))
    return rows
