"""What grows with the recording of drawn motions: filled section by section."""

from __future__ import annotations

import numpy as np

from ..array_types import FloatArray
from ..result import Draws
from ..runtime.store import Store
from ..window.draw_plan import DrawPlan
from .blending import blend
from .drawn_samples import JOINT, SectionDraws


class DrawColumns:
    """The drawn motions of a recording, neighbouring sections blended over their border.

    Parameters
    ----------
    imu_t : ndarray, shape (n,), s
        The recording's samples.
    plan : DrawPlan or None
        None where no motions are drawn.
    store : Store
        Where the columns live.
    """

    def __init__(self, imu_t: FloatArray, plan: DrawPlan | None, store: Store) -> None:
        self._imu_t, self._plan, self._store = imu_t, plan, store
        self._columns: dict[str, FloatArray] = {}

    def add(self, answer: SectionDraws | None, rows: slice, share: FloatArray) -> None:
        """The next section's motions; its samples' rows, and its share against the one before at each."""
        if answer is None or self._plan is None or not len(answer.samples):
            return
        count = -(-len(self._imu_t) // self._plan.every)
        first = (rows.start + int(answer.samples[0])) // self._plan.every
        drawn = slice(first, first + len(answer.samples))
        for name, values in answer.columns.items():
            if name not in self._columns:
                self._columns[name] = self._store.array((count, *values.shape[1:]), np.nan, np.float32)
            blend(self._columns[name], drawn, values, share[answer.samples])

    def draws(self) -> Draws | None:
        """All of them; None where none were drawn."""
        if self._plan is None:
            return None
        # a draw at a time is how they are read; a time after the other is how they lie
        columns = {name: np.moveaxis(values, 0, 1) for name, values in self._columns.items()}
        return Draws(
            t_s=self._imu_t[:: self._plan.every],
            seed=self._plan.seed,
            position=columns["position"],
            rotation=columns["rotation"],
            joints={
                name.removeprefix(JOINT): values for name, values in columns.items() if name.startswith(JOINT)
            },
            upper_rotation=columns.get("upper_rotation"),
        )
