"""Samples and frames as they arrive, and the last minutes of them in order."""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..array_types import BoolArray, FloatArray
from ..linalg import runs
from ..recording import JOINTS, ImuStream, JointTracks
from .imu_check import AGAIN_S, CONTEXT_S, DENSITIES, ImuCheck


@dataclass(frozen=True)
class SkeletonFrame:
    """One arm in one frame of the camera."""

    t_s: float  # Its stamp, on the camera's clock
    # When it arrived here, on the clock of the time given to `LiveSmoother.step` (the IMU's)
    arrival_s: float
    position: FloatArray  # (5, 3) m: in {K}, joints in the order of `JOINTS`; nan where there is none
    state: NDArray[np.int8]  # int (5,): `JointState` values


#: Samples older than this against the newest are not sorted in, s.
LATE_S = 0.5
#: Held for this many times the capacity at most; then the oldest go.
SLACK = 1.25


class ImuBuffer:
    """Samples of the last seconds."""

    def __init__(self, capacity_s: float) -> None:
        self._capacity_s = capacity_s
        self._rows = np.zeros((0, 9))  # t, acc, gyro as they came; doubt of the two
        self.version = self.late = self.duplicate = self.invalid = 0
        self._check, self._reasons = ImuCheck(), dict[str, float]()
        self._doubted_s = -np.inf, -np.inf

    def __len__(self) -> int:
        return len(self._rows)

    @property
    def t(self) -> FloatArray:
        """Times of the samples, s; a view."""
        return self._rows[:, 0]

    @property
    def end_s(self) -> float:
        """Time of the newest sample, s; -inf without any."""
        return float(self._rows[-1, 0]) if len(self) else -np.inf

    def add(self, batch: ImuStream) -> float | None:
        """Sort samples in; from when on those that were there are followed by others, None where none are."""
        rows = np.column_stack([batch.t_s, batch.acc, batch.gyro, np.zeros((len(batch), 2))]).astype(float)
        finite = np.isfinite(rows).all(axis=1)
        self.invalid += int((~finite).sum())
        rows = rows[finite]
        rows, before_s = rows[np.argsort(rows[:, 0], kind="stable")], self.end_s
        if len(self):  # a first batch may be as long as it likes
            late = rows[:, 0] < max(before_s, rows[-1:, 0].max(initial=-np.inf)) - LATE_S
            self.late += int(late.sum())
            rows = rows[~late]
        fresh = (np.diff(rows[:, 0], prepend=-np.inf) > 0) & ~np.isin(
            rows[:, 0], self._since(before_s - LATE_S)[:, 0]
        )
        self.duplicate += int((~fresh).sum())
        rows = rows[fresh]
        if not len(rows):
            return None
        self.version += 1
        first = int(np.searchsorted(self.t, rows[0, 0]))
        tail = np.concatenate([self._rows[first:], rows])
        self._rows = np.concatenate([self._rows[:first], tail[np.argsort(tail[:, 0], kind="stable")]])
        if self.end_s - self._rows[0, 0] > SLACK * self._capacity_s:
            self._rows = self._since(self.end_s - self._capacity_s)
        return float(rows[0, 0]) if rows[0, 0] <= before_s else None

    def _since(self, t_s: float) -> FloatArray:
        """The rows from a time on; a view."""
        return self._rows[int(np.searchsorted(self.t, t_s)) :]

    def since_pause_s(self, longest_s: float, looked_s: float) -> float:
        """Where the samples begin that have no longer pause, within the last `looked_s`; s."""
        t = self._since(self.end_s - looked_s)[:, 0]
        pauses = np.flatnonzero(np.diff(t) > longest_s)
        return float(t[pauses[-1] + 1]) if len(pauses) else float(t[0])

    def check(self) -> float | None:
        """Look for samples that cannot be right; from when on they are treated otherwise than before."""
        if not len(self):
            return None
        end_s = self.end_s
        rows, late = self._since(end_s - AGAIN_S - CONTEXT_S), self._since(end_s - AGAIN_S)
        found, reasons = self._check.doubt(rows[:, 0], rows[:, 1:4], rows[:, 4:7])
        if self._doubted_s[1] >= rows[0, 0]:
            found = np.maximum(found, self._contradicted(rows[:, 0]))
        for why, where in reasons.items():
            if where[-3:].any() and where.sum() >= 5:
                self._reasons[why] = end_s
        self._reasons = {why: at for why, at in self._reasons.items() if end_s - at < AGAIN_S}
        found = found[len(rows) - len(late) :]
        sound = ~found.any(axis=1)
        self._check.learn(late[sound, 1:4], late[sound, 4:7])
        changed = ((found > 0) != (late[:, 7:] > 0)).any(axis=1)
        late[:, 7:] = found
        if not changed.any():
            return None
        self.version += 1
        return float(late[int(np.argmax(changed)), 0])

    def contradicted(self, since_s: float, until_s: float) -> float | None:
        """Doubt all samples from one time to another, because the camera contradicts them."""
        since_s = min(since_s, self._doubted_s[0]) if since_s <= self._doubted_s[1] else since_s
        self._doubted_s = since_s, until_s
        rows = self._since(since_s)
        if not len(rows):
            return None
        rows[:, 7:] = np.maximum(rows[:, 7:], self._contradicted(rows[:, 0]))
        self.version += 1
        return float(rows[0, 0])

    def _contradicted(self, t: FloatArray) -> FloatArray:
        """What the camera's contradiction makes of samples at some times (n,): (n, 2) variances."""
        inside = (t >= self._doubted_s[0]) & (t <= self._doubted_s[1])
        each_s = float(np.median(np.diff(t))) if len(t) > 1 else 0.01
        return np.outer(inside, np.square(DENSITIES) * each_s)

    @property
    def is_doubted(self) -> bool:
        """The newest samples are doubtful, for more than a moment."""
        return bool(len(self)) and bool((self._rows[-5:, 7:] > 0).any(axis=1).all())

    @property
    def doubtful_because(self) -> tuple[str, ...]:
        """What is wrong with the samples of the last moments, in words."""
        return tuple(self._reasons)

    def doubt(self, start_s: float) -> FloatArray:
        """What replaced samples may cost velocity and turn, (n, 2) variances, from a time on."""
        return self._since(start_s)[:, 7:].copy()

    def stream(self, start_s: float, end_s: float = np.inf) -> ImuStream:
        """The samples from one time to another; doubtful ones are replaced."""
        rows = self._rows[slice(*np.searchsorted(self.t, [start_s, end_s]).tolist())].copy()
        if rows[:, 7:].any():
            for column, values, fades in ((7, slice(1, 4), False), (8, slice(4, 7), True)):
                _replace(rows[:, 0], rows[:, values], rows[:, column] > 0, fades)
        return ImuStream("live", rows[:, 0], rows[:, 1:4], rows[:, 4:7])

    def sound_stream(self) -> ImuStream:
        """All samples without stretches that are doubtful: there is a pause."""
        stream, wrong = self.stream(-np.inf), np.asarray((self._rows[:, 7:] > 0).any(axis=1))
        for run in runs(wrong):
            wrong[run] = run.stop - run.start >= 4  # a single one was replaced well
        return stream.select(~wrong) if wrong.any() else stream


def _replace(t: FloatArray, values: FloatArray, wrong: BoolArray, fades: bool) -> None:
    """Doubtful samples (n, 3) by their sound neighbours, in place; a long stretch of rates by none."""
    if not wrong.any() or wrong.all():
        return
    for axis in range(3):
        values[wrong, axis] = np.interp(t[wrong], t[~wrong], values[~wrong, axis])
    for run in runs(wrong):
        if run.stop - run.start >= 4:
            near = ~wrong & (np.abs(t - t[run.start]) < 0.3)
            values[run] = 0.0 if fades else values[near if near.any() else ~wrong].mean(axis=0)


class FrameBuffer:
    """Frames of the last seconds."""

    def __init__(self, capacity_s: float) -> None:
        self._capacity_s = capacity_s
        self._frames: list[SkeletonFrame] = []
        self._left_out: list[SkeletonFrame] = []
        self.late = self.duplicate = 0

    def __len__(self) -> int:
        return len(self._frames)

    def _at(self, t_s: float) -> int:
        """How many frames are before a stamp."""
        return bisect_left(self._frames, t_s, key=lambda frame: frame.t_s)

    def _has(self, index: int, t_s: float) -> bool:
        return index < len(self._frames) and self._frames[index].t_s == t_s

    def add(self, frame: SkeletonFrame) -> bool:
        """Sort a frame in; False where it is too late or was here already."""
        t_s, newest_s = frame.t_s, self._frames[-1].t_s if self._frames else -np.inf
        if not np.isfinite(t_s) or t_s < newest_s - LATE_S:
            self.late += 1
            return False
        if self._has(index := self._at(t_s), t_s):
            self.duplicate += 1
            return False
        self._frames.insert(index, frame)
        if t_s - self._frames[0].t_s > SLACK * self._capacity_s:
            del self._frames[: self._at(t_s - self._capacity_s)]
        return True

    def leave_out(self, since_s: float, until_s: float) -> None:
        """Take the joints of frames out, as long as they are not restored."""
        for index in range(self._at(since_s), self._at(until_s)):
            frame = self._frames[index]
            if frame.state.any():
                self._left_out.append(frame)
                self._frames[index] = replace(frame, state=np.zeros_like(frame.state))

    def restore(self) -> None:
        """Put those back that were left out: it was not the camera that was wrong."""
        for frame in self._left_out:
            if self._has(index := self._at(frame.t_s), frame.t_s):
                self._frames[index] = frame
        self.confirm()

    def confirm(self) -> None:
        """Those that were left out stay out."""
        self._left_out = []

    def since(self, t_s: float) -> list[SkeletonFrame]:
        """Frames from a stamp on, s on the camera's clock."""
        return self._frames[self._at(t_s) :]

    def tracks(self, start_s: float) -> JointTracks:
        """The frames from a stamp on as tracks of joints."""
        frames = self.since(start_s)
        return JointTracks(
            "live",
            np.array([frame.t_s for frame in frames]),
            np.array([frame.position for frame in frames], dtype=float).reshape(-1, len(JOINTS), 3),
            np.array([frame.state for frame in frames], dtype=np.int8).reshape(-1, len(JOINTS)),
        )
