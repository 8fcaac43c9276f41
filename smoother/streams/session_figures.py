"""How a session's streams are doing, for who watches it while it lasts and its summary afterwards."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..array_types import FloatArray
from ..live.answers import LiveOutput, LiveState
from ..measurements.visibility import Gap

#: Bins of 0.25 ms up to 2 s; what takes longer is in the last.
_BIN_S, _BINS = 0.00025, 8000


class DelayCounts:
    """Counts of delays."""

    def __init__(self) -> None:
        self.count = 0
        self.largest_s = float("nan")
        self._counts = np.zeros(_BINS, np.int64)

    def add(self, delay_s: float) -> None:
        """Count one."""
        self.count += 1
        self.largest_s = float(np.fmax(self.largest_s, delay_s))
        self._counts[min(max(int(delay_s / _BIN_S), 0), _BINS - 1)] += 1

    def percentile_s(self, percent: float) -> float:
        """The duration that a share (percent) did not exceed, s; nan without any."""
        if not self.count:
            return float("nan")
        at = int(np.searchsorted(np.cumsum(self._counts), percent / 100 * self.count))
        return min((at + 1) * _BIN_S, self.largest_s)

    def share_within(self, seconds: float) -> float:
        """Share of them that took at most this long; nan without any."""
        if not self.count:
            return float("nan")
        return float(self._counts[: round(seconds / _BIN_S)].sum()) / self.count

    def figures(self) -> dict[str, float | int]:
        """What a summary states of them, ms."""
        return {
            "count": self.count,
            "median_ms": 1e3 * self.percentile_s(50),
            "percentile_99_ms": 1e3 * self.percentile_s(99),
            "largest_ms": 1e3 * self.largest_s,
            "share_within_20_ms": self.share_within(0.020),
        }


#: Rates and delays are those of the last seconds.
_RECENT_S = 5.0
#: A stream is treated as lost after this long without a sample, s.
LOST_S = 1.0
#: Samples and frames are missing where two are farther apart than this many usual intervals.
_MISSING = 1.6
#: Intervals by which the usual one is known.
_INTERVALS = 200


class StreamHealth:
    """Counts one stream; memory does not grow with the session."""

    def __init__(self, name: str):
        self.name = name
        self.count = self.missing = self.late = self.lost_times = 0
        self.lost_s = 0.0
        self.is_lost = False
        self._arrivals: deque[tuple[float, int, float]] = deque()  # last arrival, how many, median delay
        self._intervals: deque[float] = deque(maxlen=_INTERVALS)
        self._newest = np.nan
        self._last_arrival = np.nan

    def take(self, t_s: FloatArray, arrival_s: FloatArray) -> tuple[str, ...]:  # t_s (n,) s; arrival_s (n,) s
        """Count what came; a sentence where the stream is back."""
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
        return (f"{self.name}: nothing for {now_s - self._last_arrival:.1f} s",)

    @property
    def delay_s(self) -> float:
        """Median delay of the last seconds."""
        return float(np.median([delay for *_, delay in self._arrivals])) if self._arrivals else float("nan")

    def rate_hz(self, now_s: float) -> float:
        """Samples or frames per second, of the last seconds."""
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
        return (f"{self.name}: back, after {away:.1f} s",)


#: Events that a summary states at most; more are counted.
_MOST_EVENTS = 200


@dataclass(frozen=True)
class StreamView:
    """A stream as it is shown."""

    name: str
    rate_hz: float  # Of the last seconds
    missing: int  # Samples that did not come, and that came after younger ones
    late: int  # Samples that did not come, and that came after younger ones
    delay_s: float  # From stamp to arrival
    is_lost: bool

    @classmethod
    def of(cls, health: StreamHealth, now_s: float) -> StreamView:
        """At a moment."""
        return cls(
            health.name, health.rate_hz(now_s), health.missing, health.late, health.delay_s, health.is_lost
        )


@dataclass(frozen=True)
class SessionView:
    """A session at one moment."""

    seconds: float  # s: since it began
    imu: StreamView  # The streams
    skeleton: StreamView  # The streams
    output: LiveOutput | None  # What the last step answered
    events: tuple[tuple[float, str], ...]  # The last of what happened: when, and a sentence
    event_count: int  # How many there were in all
    load: float  # Processor time of the whole program as a share of one core
    further: tuple[StreamView, ...] = ()  # Of IMUs beyond the forearm
    side: str = ""  # Which arm


class SessionFigures:
    """Counts while a session lasts; memory does not grow with it."""

    def __init__(
        self,
        imu: StreamHealth,
        skeleton: StreamHealth,
        further: Mapping[str, StreamHealth] | None = None,
        side: str = "",
    ):
        self.imu, self.skeleton, self.further, self.side = imu, skeleton, further or {}, side
        self.frame_delays = DelayCounts()
        self.steps = 0
        self.events: deque[tuple[float, str]] = deque(maxlen=_MOST_EVENTS)
        self.event_count = 0
        self.state_s = dict.fromkeys(LiveState, 0.0)
        self.gaps = 0
        self.longest_gap_s = 0.0
        self.largest_sigma_m = 0.0
        self._gap_start: float | None = None
        self._first_s = self._last_s = float("nan")
        self._output: LiveOutput | None = None
        self._wall, self._processor = time.monotonic(), time.process_time()

    def event(self, now_s: float, sentences: Iterable[str]) -> None:
        """Remember what happened, by the time since the session's beginning."""
        if np.isnan(self._first_s):
            self._first_s = self._last_s = now_s
        for sentence in sentences:
            self.events.append((now_s - self._first_s, sentence))
            self.event_count += 1

    def step(self, output: LiveOutput) -> Gap | None:
        """Count a step; the gap that it ended, if it did."""
        self.steps += 1
        if not self._first_s <= output.now_s:
            self._first_s = self._last_s = output.now_s
        self.state_s[output.state] += max(output.now_s - self._last_s, 0.0)
        self._last_s, self._output = output.now_s, output
        if output.now is not None:
            self.largest_sigma_m = max(self.largest_sigma_m, output.now.sigma_m)
        return self._gap(output)

    def view(self, now_s: float) -> SessionView:
        """What is shown."""
        return SessionView(
            0.0 if self._output is None else self._last_s - self._first_s,
            StreamView.of(self.imu, now_s),
            StreamView.of(self.skeleton, now_s),
            self._output,
            tuple(self.events)[-6:],
            self.event_count,
            self.load,
            tuple(StreamView.of(health, now_s) for health in self.further.values()),
            self.side,
        )

    @property
    def load(self) -> float:
        """Processor time of this program as a share of one core, since the session began."""
        return (time.process_time() - self._processor) / max(time.monotonic() - self._wall, 1e-3)

    def figures(self) -> dict[str, Any]:
        """What `--json` states."""
        output = self._output
        return {
            "seconds": 0.0 if output is None else self._last_s - self._first_s,
            "steps": self.steps,
            "imu": self.imu.figures(),
            "skeleton": self.skeleton.figures(),
            **(
                {"further": {segment: health.figures() for segment, health in self.further.items()}}
                if self.further
                else {}
            ),
            "state_s": {str(state): seconds for state, seconds in self.state_s.items()},
            "gaps": self.gaps,
            "longest_gap_s": self.longest_gap_s,
            "largest_sigma_cm": 100 * self.largest_sigma_m,
            "clock_offset_s": None if output is None else output.clock_offset_s,
            "clock_sigma_s": None if output is None else output.clock_sigma_s,
            "camera_latency_s": None if output is None else output.camera_latency_s,
            "dropped": None if output is None else vars(output.dropped),
            "calibration": None if output is None else output.calibration,
            "frame_done": self.frame_delays.figures(),
            "load": self.load,
            "events": [{"t_s": when, "event": sentence} for when, sentence in self.events],
            "event_count": self.event_count,
        }

    def _gap(self, output: LiveOutput) -> Gap | None:
        if output.state is LiveState.GAP and output.now is not None:
            if self._gap_start is None:
                self._gap_start = output.now.t_s if output.now.since_s is None else output.now.since_s
                self.gaps += 1
            self.longest_gap_s = max(self.longest_gap_s, output.now_s - self._gap_start)
            return None
        if self._gap_start is None:
            return None
        start, self._gap_start = self._gap_start, None
        return Gap(start, output.now_s)
