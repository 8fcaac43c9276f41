"""How a session's streams are doing, for who watches it while it lasts and its summary afterwards."""

from __future__ import annotations

import time
from array import array
from collections import deque
from collections.abc import Iterable
from typing import Any

import numpy as np

from ..array_types import FloatArray
from ..body import FOREARM
from ..live.answers import LiveOutput, LiveState
from ..measurements.visibility import Gap
from .arrivals import SourceInfo

#: Rates and delays are those of the last seconds.
_RECENT_S = 5.0
#: A stream is treated as lost after this long without a sample, s.
_SILENT_S = 1.0
#: Samples and frames are missing where two are farther apart than this many usual intervals.
_MISSING = 1.6
#: Intervals by which the usual one is known.
_INTERVALS = 200


class StreamHealth:
    """Counts one stream; memory does not grow with the session."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.count = self.missing = self.late = self.lost_times = 0
        self.lost_s = 0.0
        self.is_lost = False
        self._arrivals: deque[tuple[float, int, float]] = deque()  # last arrival, how many, median delay
        self._intervals: deque[float] = deque(maxlen=_INTERVALS)
        self._newest = self._last_arrival = np.nan

    def take(self, t_s: FloatArray, arrival_s: FloatArray) -> list[str]:
        """Count what came; a sentence where the stream is back."""
        if not len(t_s):
            return []
        events: list[str] = []
        if self.is_lost:
            self.is_lost, away_s = False, float(arrival_s[0]) - self._last_arrival
            self.lost_s += away_s
            events = [f"{self.name}: back, after {away_s:.1f} s"]
        self.count += len(t_s)
        order = np.append(self._newest, t_s)
        highest = np.fmax.accumulate(order)
        self.late += int((t_s < highest[:-1]).sum())
        steps = np.diff(np.unique(highest[np.isfinite(highest)]))
        if len(self._intervals):
            usual = float(np.median(self._intervals))
            self.missing += int((np.rint(steps[steps > _MISSING * usual] / usual) - 1).sum())
        self._intervals.extend(steps[steps > 0].tolist())
        self._newest, self._last_arrival = float(highest[-1]), float(arrival_s[-1])
        self._arrivals.append((self._last_arrival, len(t_s), float(np.median(arrival_s - t_s))))
        return events

    def look(self, now_s: float) -> list[str]:
        """Notice a stream that has gone; a sentence where it has."""
        while self._arrivals and self._arrivals[0][0] < now_s - _RECENT_S:
            self._arrivals.popleft()
        if np.isnan(self._last_arrival):
            self._last_arrival = now_s  # since it is looked at
        if self.is_lost or not now_s - self._last_arrival > _SILENT_S:
            return []
        self.is_lost = True
        self.lost_times += 1
        return [f"{self.name}: nothing for {now_s - self._last_arrival:.1f} s"]

    @property
    def delay_s(self) -> float:
        """Median delay of the last seconds."""
        return float(np.median([delay for *_, delay in self._arrivals])) if self._arrivals else float("nan")

    def rate_hz(self, now_s: float) -> float:
        """Samples or frames per second, of the last seconds."""
        recent = [(arrival, count) for arrival, count, _ in self._arrivals if arrival > now_s - _RECENT_S]
        if len(recent) < 2:
            return 0.0
        return sum(count for _, count in recent[1:]) / min(max(now_s - recent[0][0], 0.2), _RECENT_S)

    def figures(self) -> dict[str, float | int]:
        """What a summary states of the stream."""
        counts = {name: getattr(self, name) for name in ("count", "missing", "late", "lost_times")}
        return counts | {"lost_s": round(self.lost_s, 3), "delay_s": self.delay_s}


#: Events that a summary states at most; more are counted.
_MOST_EVENTS = 200


class SessionFigures:
    """Counts while a session of an arm lasts."""

    def __init__(self, info: SourceInfo) -> None:
        self.side, self.skeleton = info.side, StreamHealth(info.skeleton)
        self.imus = {segment: StreamHealth(name) for segment, name in info.imus.items()}
        self.imu = self.imus[FOREARM.name]
        self.frame_delays_s = array("f")
        self.events: deque[tuple[float, str]] = deque(maxlen=_MOST_EVENTS)
        self.output: LiveOutput | None = None
        self.steps = self.event_count = self.gaps = 0
        self.state_s = dict.fromkeys(LiveState, 0.0)
        self.longest_gap_s = self.largest_sigma_m = 0.0
        self._gap_start: float | None = None
        self._first_s = self.now_s = float("nan")  # s: the session's beginning and its last step
        self._wall, self._processor = time.monotonic(), time.process_time()

    def event(self, now_s: float, sentences: Iterable[str]) -> None:
        """Remember what happened, by the time since the session's beginning."""
        if np.isnan(self._first_s):
            self._first_s = self.now_s = now_s
        for sentence in sentences:
            self.events.append((now_s - self._first_s, sentence))
            self.event_count += 1

    def step(self, output: LiveOutput) -> Gap | None:
        """Count a step; the gap that it ended, if it did."""
        self.event(output.now_s, ())
        self.steps += 1
        self.state_s[output.state] += max(output.now_s - self.now_s, 0.0)
        self.now_s, self.output, now = output.now_s, output, output.now
        if now is not None:
            self.largest_sigma_m = max(self.largest_sigma_m, now.sigma_m)
        if output.state is LiveState.GAP and now is not None:
            if self._gap_start is None:
                self._gap_start = now.t_s if now.since_s is None else now.since_s
                self.gaps += 1
            self.longest_gap_s = max(self.longest_gap_s, output.now_s - self._gap_start)
            return None
        start, self._gap_start = self._gap_start, None
        return None if start is None else Gap(start, output.now_s)

    @property
    def seconds(self) -> float:
        """Since the session began, s."""
        return 0.0 if self.output is None else self.now_s - self._first_s

    @property
    def load(self) -> float:
        """Processor time of this program as a share of one core, since the session began."""
        return (time.process_time() - self._processor) / max(time.monotonic() - self._wall, 1e-3)

    def figures(self) -> dict[str, Any]:
        """What `--json` states."""
        further = {name: own.figures() for name, own in self.imus.items() if own is not self.imu}
        of_output = ("clock_offset_s", "clock_sigma_s", "camera_latency_s", "dropped", "calibration")
        delays = np.asarray(self.frame_delays_s if self.frame_delays_s else [np.nan], float)
        median, percentile_99, largest = (1e3 * np.percentile(delays, (50, 99, 100))).tolist()
        return {
            "seconds": self.seconds,
            "steps": self.steps,
            "imu": self.imu.figures(),
            "skeleton": self.skeleton.figures(),
            **({"further": further} if further else {}),
            "state_s": {str(state): seconds for state, seconds in self.state_s.items()},
            "gaps": self.gaps,
            "longest_gap_s": self.longest_gap_s,
            "largest_sigma_cm": 100 * self.largest_sigma_m,
            **{name: getattr(self.output, name, None) for name in of_output},
            "frame_done": {
                "count": len(self.frame_delays_s),
                "median_ms": median,
                "percentile_99_ms": percentile_99,
                "largest_ms": largest,
                "share_within_20_ms": float(np.mean(np.where(np.isnan(delays), delays, delays <= 0.020))),
            },
            "load": self.load,
            "events": [{"t_s": when, "event": sentence} for when, sentence in self.events],
            "event_count": self.event_count,
        }
