"""Steps of a stream's clock while it runs: found by when samples arrive, and taken out of the stamps."""

from __future__ import annotations

from collections import deque
from typing import Generic, TypeVar

import numpy as np

from ..array_types import FloatArray
from .arrivals import FrameRows, ImuRows

Rows = TypeVar("Rows", ImuRows, FrameRows)

#: A sample may come so much later than its neighbours, s: more than the 0.5 s that streams are allowed.
LATE_S = 0.6
#: A sample that comes so much sooner after its stamp than any before it is from another clock, s.
EARLY_S = 0.25
#: Where the first samples came later than this after their stamps, s, the stamps are of another clock.
OTHER_CLOCK_S = 5.0
#: So long must samples be odd, with no usual one between them, to count as a step of the clock, s.
PERSISTS_S = 0.3
#: The least delay is that of the last so many seconds: clocks drift apart.
_RECENT_S = 120


class StampSteps(Generic[Rows]):
    """Keeps the stamps of one stream on one clock.

    A stamp is odd where it lies `LATE_S` behind the newest one, or where it is ahead by more than the time
    that has passed while the sample came `EARLY_S` sooner after its stamp than any other did. Odd samples
    wait. If a usual one comes, they were wrong by themselves and are dropped; if none comes for `PERSISTS_S`,
    the clock has stepped, and from them on the step is taken out, so that the least delay is what it was.
    Bursts after a pause of the network are not odd: their stamps go on where they left off.

    Attributes
    ----------
    moved_s : float, s
        What is added to the stamps now.
    stepped_s : float, s
        What of that is for steps.
    dropped : int
        Samples whose stamps were wrong by themselves.
    """

    def __init__(self, name: str):
        self.moved_s = self.stepped_s = 0.0
        self.dropped = 0
        self._name = name
        self._newest = self._arrival = -np.inf
        self._least: deque[tuple[int, float]] = deque()
        self._odd: list[Rows] = []

    def mended(self, rows: Rows) -> tuple[Rows, tuple[str, ...]]:
        """Rows that can be used, stamped by the clock that the stream began with.

        Parameters
        ----------
        rows : ImuRows or FrameRows
            As they came.

        Returns
        -------
        rows : ImuRows or FrameRows
            Fewer, or more by those that waited.
        events : tuple of str
            A sentence for each step.
        """
        events = [] if self._least or not len(rows) else self._begin(rows.select(slice(0, 1)))
        if not self._odd and not self._is_odd(rows.t_s + self.moved_s, rows.arrival_s).any():
            rows = rows.stamped(rows.t_s + self.moved_s)
            self._learn(rows)
            return rows, tuple(events)
        usable = [rows.select(slice(0, 0))]
        for at in range(len(rows)):
            row = rows.select(slice(at, at + 1))
            moved = row.stamped(row.t_s + self.moved_s)
            if not self._is_odd(moved.t_s, moved.arrival_s).any():
                self.dropped += sum(map(len, self._odd))
                self._odd.clear()
                self._learn(moved)
                usable.append(moved)
                continue
            self._odd.append(row)
            if row.arrival_s[0] - self._odd[0].arrival_s[0] >= PERSISTS_S:
                stepped, sentence = self._step()
                usable.append(stepped)
                events.append(sentence)
        return type(rows).joined(usable), tuple(events)

    def _begin(self, row: Rows) -> list[str]:
        """The first row: a clock that is not this computer's is moved to it."""
        delay, events = float(row.arrival_s[0] - row.t_s[0]), []
        if not -EARLY_S <= delay <= OTHER_CLOCK_S:
            self.moved_s = delay
            events.append(
                f"the stamps of {self._name} are of a clock of its own: {delay:+.1f} s were added, so that"
                " the first one is when it came"
            )
        self._learn(row.stamped(row.t_s + self.moved_s))
        return events

    def _is_odd(self, t_s: FloatArray, arrival_s: FloatArray) -> np.ndarray:
        if not len(t_s):
            return np.zeros(0, bool)
        newest = np.maximum.accumulate(np.append(self._newest, t_s))[:-1]
        passed_s = arrival_s - np.append(self._arrival, arrival_s)[:-1]
        # a queue that empties after a pause has ever shorter delays, and stamps that go on one by one
        early = arrival_s - t_s < self._least_delay() - EARLY_S
        return np.asarray((t_s < newest - LATE_S) | (early & (t_s - newest > passed_s + EARLY_S)))

    def _least_delay(self) -> float:
        return min(delay for _, delay in self._least)

    def _learn(self, rows: Rows) -> None:
        """Remember the newest stamp, and each second's least delay."""
        if not len(rows):
            return
        self._newest = max(self._newest, float(rows.t_s.max()))
        self._arrival = float(rows.arrival_s[-1])
        second, delay = int(rows.arrival_s[-1]), float((rows.arrival_s - rows.t_s).min())
        if self._least and self._least[-1][0] == second:
            delay = min(delay, self._least.pop()[1])
        self._least.append((second, delay))
        while self._least[0][0] < second - _RECENT_S and len(self._least) > 1:
            self._least.popleft()

    def _step(self) -> tuple[Rows, str]:
        """Take the clock of the samples that wait as the stream's; those samples, and a sentence."""
        rows = type(self._odd[0]).joined(self._odd)
        self._odd.clear()
        usual = self._least_delay()
        before = self.moved_s
        self.moved_s = float((rows.arrival_s - rows.t_s).min()) - usual
        step = before - self.moved_s
        self.stepped_s -= step
        rows = rows.stamped(rows.t_s + self.moved_s)
        self._newest = float(rows.t_s[0])
        self._learn(rows)
        return rows, (
            f"the clock of {self._name} stepped by {step:+.3f} s at {rows.t_s[0]:.1f} s;"
            " its stamps after it were moved back"
        )
