"""What came in from sensor and camera since the last look, with the times at which it came.

Steps of a stream's clock while it runs: found by when samples arrive, and taken out of the stamps.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ..array_types import FloatArray
from ..live.answers import LiveOutput
from ..measurements.visibility import Gap
from ..recording import CameraFrame


@dataclass(frozen=True)
class Rows:
    """What a stream sent, in the order in which it came."""

    t_s: FloatArray = field(default_factory=lambda: np.empty(0))  # (n,) s: stamps
    # (n,) s: when they came, on the session's clock
    arrival_s: FloatArray = field(default_factory=lambda: np.empty(0))
    # Of an IMU `acc` (n, 3) m/s^2, `gyro` (n, 3) rad/s in {A}, maybe `mag` (n, 3) in the sensor's unit; of a
    # camera `position` (n, 5, 3) m in {K}, nan where there is none, and `state` (n, 5); else `values`
    columns: Mapping[str, NDArray] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.t_s)

    def __getitem__(self, name: str) -> NDArray:
        return self.columns[name]

    def select(self, rows: NDArray | slice) -> Rows:
        """Some of the rows."""
        columns = {name: column[rows] for name, column in self.columns.items()}
        return Rows(self.t_s[rows], self.arrival_s[rows], columns)

    @staticmethod
    def joined(parts: Sequence[Rows]) -> Rows:
        """One after the other, with the columns that all of them have."""
        parts = [part for part in parts if len(part)]
        if len(parts) < 2:
            return parts[0] if parts else Rows()
        names = [name for name in parts[0].columns if all(name in part.columns for part in parts)]
        columns = {name: np.concatenate([part[name] for part in parts]) for name in names}
        t_s, arrival_s = [part.t_s for part in parts], [part.arrival_s for part in parts]
        return Rows(np.concatenate(t_s), np.concatenate(arrival_s), columns)


@dataclass(frozen=True)
class Arrivals:
    """What came of an arm since the last look."""

    imus: Mapping[str, Rows] = field(default_factory=dict)  # By segment, the forearm's first
    frames: Rows = field(default_factory=Rows)
    events: tuple[str, ...] = ()  # What was done to their stamps, a sentence each

    def by_row(self, change: Callable[[Rows], Rows]) -> Arrivals:
        """The same with every stream's rows changed."""
        imus = {name: change(imu) for name, imu in self.imus.items()}
        return Arrivals(imus, change(self.frames), self.events)


@dataclass(frozen=True)
class SourceInfo:
    """What a session of an arm is made of."""

    imus: Mapping[str, str]  # Names of the IMUs' streams by segment, the forearm's first
    skeleton: str  # Name of the stream
    side: str  # "left", "right" or ""
    joints: tuple[str, ...]  # Joints that the skeleton has
    origin_ns: int  # What the session's times count from
    camera_frame: CameraFrame | None = None  # Convention of the camera's axes where it is known
    gravity_hint: FloatArray | None = None  # (3,): direction of down in {K} where it is known
    name: str = "session"  # Of the session
    lsl_start_s: float | None = None  # The same on this computer's LSL clock, where that is the session's
    notes: tuple[str, ...] = ()  # How it was decided, and what is assumed, one sentence each

    @property
    def down(self) -> FloatArray | None:
        """Direction of gravity in {K} as far as it is known beforehand."""
        if self.gravity_hint is not None:
            return self.gravity_hint
        return None if self.camera_frame is None else self.camera_frame.down


@dataclass(frozen=True)
class LiveStep:
    """A step of an arm, as everything that shows, sends or keeps it gets it."""

    arm: int  # Which of the session's
    arrivals: Arrivals  # What came before it, on the clocks that the streams began with
    frames: Rows  # The same frames on the clock that the camera has now, as the smoother got them
    output: LiveOutput  # What was answered
    gap: Gap | None  # That it ended
    events: Sequence[str]  # What happened


class Receiver(Protocol):
    """Is sent every step."""

    def send(self, step: LiveStep) -> None:
        """Take a step in; never waits for long."""

    def close(self) -> None:
        """Let all that listen go."""


#: A sample may come this much later than its neighbours, s: more than the 0.5 s that streams are allowed.
_STAMP_LATE_S = 0.6
#: A sample that comes this much sooner after its stamp than any before it is from another clock, s.
_EARLY_S = 0.25
#: An IMU's samples come without a pause: a step of its clock shows from this on, s.
STEP_OF_IMU_S = 0.06
#: This many samples in a row that lie behind, all by the same time but for this, s, are of a clock set back.
_BACK_IN_A_ROW, _SAME_DELAY_S = 3, 0.04
#: Where the first samples came later than this after their stamps, s, the stamps are of another clock.
_OTHER_CLOCK_S = 5.0
#: So long must samples be odd, with no usual one between them, to be treated as a step of the clock, s.
_PERSISTS_S = 0.3
#: The least delay is that of the last this many seconds: clocks drift apart.
_RECENT_S = 120


class StampSteps:
    """Keeps the stamps of one stream on one clock."""

    def __init__(self, name: str, shows_from_s: float | None = None) -> None:
        self._name = name
        self._early_s, self._back_s = shows_from_s or _EARLY_S, shows_from_s or _STAMP_LATE_S
        self.moved_s = self.stepped_s = 0.0
        self.dropped = 0
        self._newest_s = self._arrival_s = -np.inf
        self._least: deque[tuple[int, float]] = deque()  # each second's least delay
        self._odd = Rows()  # those that wait, as they came

    def corrected(self, rows: Rows) -> tuple[Rows, list[str]]:
        """Rows that can be used, stamped by the clock that the stream began with."""
        waited = len(self._odd)
        rows, odd = Rows.joined([self._odd, rows]), list(range(waited))
        usable, stamps, events = list[int](), list[float](), list[str]()
        for at in range(waited, len(rows)):
            sent_s, arrival_s = float(rows.t_s[at]), float(rows.arrival_s[at])
            if not self._least:
                events += self._begin(sent_s, arrival_s)
            is_odd = self._is_odd(sent_s + self.moved_s, arrival_s)
            odd.append(at)
            if not is_odd and not self._ran_back(rows.t_s[odd], rows.arrival_s[odd]):
                # of those that waited, some were only late; the others are wrong by themselves
                behind_s = self._newest_s - rows.t_s[odd[:-1]] - self.moved_s
                kept = [k for k, s in zip(odd, behind_s, strict=False) if 0.0 <= s <= _STAMP_LATE_S] + [at]
                self.dropped += len(odd) - len(kept)
                self._learn(sent_s + self.moved_s, arrival_s)
            elif not is_odd or arrival_s - rows.arrival_s[odd[0]] >= _PERSISTS_S:
                kept = odd
                events.append(self._step(rows.t_s[odd], rows.arrival_s[odd]))
            else:
                continue
            usable += kept
            stamps += (rows.t_s[kept] + self.moved_s).tolist()
            odd = []
        self._odd = rows.select(np.array(odd, int))
        return replace(rows.select(np.array(usable, int)), t_s=np.array(stamps, float)), events

    def _begin(self, sent_s: float, arrival_s: float) -> list[str]:
        """The first row: a clock that is not this computer's is moved to it."""
        delay_s = arrival_s - sent_s
        is_own = -_EARLY_S <= delay_s <= _OTHER_CLOCK_S
        self.moved_s = 0.0 if is_own else delay_s
        self._learn(sent_s + self.moved_s, arrival_s)
        said = f"the stamps of {self._name} come from another clock: {delay_s:+.1f} s were added, so that"
        return [] if is_own else [f"{said} the first one is its arrival time"]

    def _is_odd(self, t_s: float, arrival_s: float) -> bool:
        # a queue that empties after a pause has ever shorter delays, and stamps that go on one by one
        early = arrival_s - t_s < self._least_delay_s - self._early_s
        ahead_s = t_s - self._newest_s
        return ahead_s < -self._back_s or (early and ahead_s > arrival_s - self._arrival_s + self._early_s)

    def _ran_back(self, t_s: FloatArray, arrival_s: FloatArray) -> bool:
        """Whether those that wait and the row after them go on as one, later than ever by the same time."""
        if len(t_s) <= _BACK_IN_A_ROW or self._back_s >= _STAMP_LATE_S:
            return False
        delays = arrival_s - t_s - self.moved_s
        is_even = bool((np.diff(t_s) > 0).all()) and float(np.ptp(delays)) < _SAME_DELAY_S
        return is_even and float(delays.min()) > self._least_delay_s + 0.5 * self._back_s

    @property
    def _least_delay_s(self) -> float:
        return min(delay for _, delay in self._least)

    def _learn(self, t_s: float, arrival_s: float) -> None:
        """Remember the newest stamp, and each second's least delay."""
        self._newest_s, self._arrival_s = max(self._newest_s, t_s), arrival_s
        second, delay_s = int(arrival_s), arrival_s - t_s
        if self._least and self._least[-1][0] == second:
            delay_s = min(delay_s, self._least.pop()[1])
        self._least.append((second, delay_s))
        while self._least[0][0] < second - _RECENT_S and len(self._least) > 1:
            self._least.popleft()

    def _step(self, t_s: FloatArray, arrival_s: FloatArray) -> str:
        """Take the clock of the samples that wait as the stream's; a sentence."""
        by_s = float((arrival_s - t_s).min()) - self._least_delay_s - self.moved_s
        self.moved_s += by_s
        self.stepped_s += by_s
        self._newest_s = float(t_s[0]) + self.moved_s
        for sent_s, came_s in zip(t_s.tolist(), arrival_s.tolist(), strict=True):
            self._learn(sent_s + self.moved_s, came_s)
        return (
            f"the clock of {self._name} stepped by {-by_s:+.3f} s at {t_s[0] + self.moved_s:.1f} s;"
            " its stamps after it were moved back"
        )
