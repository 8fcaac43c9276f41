"""How a stream is doing: rate, delay, what is missing, whether it is there at all."""

from __future__ import annotations

from collections import deque

import numpy as np

from ..array_types import FloatArray

#: Rates and delays are those of the last seconds.
_RECENT_S = 5.0
#: A stream counts as lost after so long without anything, s.
LOST_S = 1.0
#: Samples and frames are missing where two are farther apart than so many usual intervals.
_MISSING = 1.6
#: Intervals by which the usual one is known.
_INTERVALS = 200


class StreamHealth:
    """Counts one stream; memory does not grow with the session.

    Parameters
    ----------
    name : str
        Of the stream, for sentences.

    Attributes
    ----------
    count : int
        What came.
    missing : int
        What did not come, by the stamps of its neighbours.
    late : int
        What came after younger ones.
    lost_times : int
        How often nothing came for `LOST_S`.
    lost_s : float, s
        How long altogether.
    is_lost : bool
        Nothing comes now.
    delay_s : float, s
        Median of arrival less stamp, of the last seconds; nan where nothing came.
    """

    def __init__(self, name: str):
        self.name = name
        self.count = self.missing = self.late = self.lost_times = 0
        self.lost_s = 0.0
        self.is_lost = False
        self._arrivals: deque[tuple[float, int, float]] = deque()  # last arrival, how many, median delay
        self._intervals: deque[float] = deque(maxlen=_INTERVALS)
        self._newest = np.nan
        self._last_arrival = np.nan

    def take(self, t_s: FloatArray, arrival_s: FloatArray) -> tuple[str, ...]:
        """Count what came; a sentence where the stream is back.

        Parameters
        ----------
        t_s, arrival_s : ndarray, shape (n,), s
            Stamps and arrivals, in the order in which they came.
        """
        if not len(t_s):
            return ()
        events = self._back(float(arrival_s[0]))
        self.count += len(t_s)
        order = np.append(self._newest, t_s)
        highest = np.fmax.accumulate(order)
        self.late += int((t_s < highest[:-1]).sum())
        steps = np.diff(np.unique(highest[np.isfinite(highest)]))
        if len(self._intervals):
            usual = float(np.median(self._intervals))
            self.missing += int((np.rint(steps[steps > _MISSING * usual] / usual) - 1).sum())
        self._intervals.extend(steps[steps > 0].tolist())
        self._newest = float(highest[-1])
        self._last_arrival = float(arrival_s[-1])
        self._arrivals.append((self._last_arrival, len(t_s), float(np.median(arrival_s - t_s))))
        return events

    def look(self, now_s: float) -> tuple[str, ...]:
        """Notice a stream that has gone; a sentence where it has."""
        while self._arrivals and self._arrivals[0][0] < now_s - _RECENT_S:
            self._arrivals.popleft()
        if np.isnan(self._last_arrival):
            self._last_arrival = now_s  # since it is looked at
        if self.is_lost or not now_s - self._last_arrival > LOST_S:
            return ()
        self.is_lost = True
        self.lost_times += 1
        return (f"{self.name}: nothing since {self._last_arrival:.1f} s",)

    @property
    def delay_s(self) -> float:
        """Median delay of the last seconds."""
        return float(np.median([delay for *_, delay in self._arrivals])) if self._arrivals else float("nan")

    def rate_hz(self, now_s: float) -> float:
        """Samples or frames a second, of the last seconds."""
        recent = [(arrival, count) for arrival, count, _ in self._arrivals if arrival > now_s - _RECENT_S]
        if not recent:
            return 0.0
        seconds = min(max(now_s - recent[0][0], 0.2), _RECENT_S)
        return sum(count for _, count in recent[1:]) / seconds if len(recent) > 1 else 0.0

    def figures(self) -> dict[str, float | int]:
        """What a summary states of the stream."""
        return {
            "count": self.count,
            "missing": self.missing,
            "late": self.late,
            "lost_times": self.lost_times,
            "lost_s": round(self.lost_s, 3),
            "delay_s": self.delay_s,
        }

    def _back(self, arrival_s: float) -> tuple[str, ...]:
        if not self.is_lost:
            return ()
        self.is_lost = False
        away = arrival_s - self._last_arrival
        self.lost_s += away
        return (f"{self.name}: back at {arrival_s:.1f} s, after {away:.1f} s",)
