"""What a session was like, for its dashboard while it lasts and its summary afterwards."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from ..live.estimate import LiveOutput, LiveState
from ..measurements.visibility import Gap
from .delay_counts import DelayCounts
from .stream_health import StreamHealth

#: Events that a summary states at most; more are counted.
_MOST_EVENTS = 200


@dataclass(frozen=True)
class StreamView:
    """A stream as the dashboard shows it.

    Attributes
    ----------
    name : str
    rate_hz : float, Hz
        Of the last seconds.
    missing, late : int
        Samples that did not come, and that came after younger ones.
    delay_s : float, s
        From stamp to arrival.
    is_lost : bool
    """

    name: str
    rate_hz: float
    missing: int
    late: int
    delay_s: float
    is_lost: bool

    @classmethod
    def of(cls, health: StreamHealth, now_s: float) -> StreamView:
        """At a moment."""
        return cls(
            health.name, health.rate_hz(now_s), health.missing, health.late, health.delay_s, health.is_lost
        )


@dataclass(frozen=True)
class SessionView:
    """A session at one moment.

    Attributes
    ----------
    seconds : float, s
        Since it began.
    imu, skeleton : StreamView
        The streams.
    output : LiveOutput or None
        What the last step answered.
    events : tuple of (float, str)
        The last of what happened: when, and a sentence.
    event_count : int
        How many there were in all.
    load : float
        Processor time of the whole program as a share of one core.
    """

    seconds: float
    imu: StreamView
    skeleton: StreamView
    output: LiveOutput | None
    events: tuple[tuple[float, str], ...]
    event_count: int
    load: float


class SessionFigures:
    """Counts while a session lasts; memory does not grow with it.

    Parameters
    ----------
    imu, skeleton : StreamHealth
        Of the streams.
    """

    def __init__(self, imu: StreamHealth, skeleton: StreamHealth):
        self.imu, self.skeleton = imu, skeleton
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
        """Remember what happened."""
        for sentence in sentences:
            self.events.append((now_s, sentence))
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
        """What the dashboard shows."""
        return SessionView(
            0.0 if self._output is None else self._last_s - self._first_s,
            StreamView.of(self.imu, now_s),
            StreamView.of(self.skeleton, now_s),
            self._output,
            tuple(self.events)[-6:],
            self.event_count,
            self.load,
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
