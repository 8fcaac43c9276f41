"""An IMU over a session: its last samples in order, which are doubtful, and since when it is left out.

Samples cannot be right by themselves that are held, too large, spikes, clipped or without gravity. What is
doubtful is replaced in the signal, and its place in the window gets the uncertainty of an arm that may have
moved meanwhile: the camera leads until sound samples come again.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from ..array_types import BoolArray, FloatArray
from ..body import FOREARM, BodySegment
from ..linalg import middle, runs
from ..recording import ImuStream
from ..units import GRAVITY
from .buffers import LATE_S, SLACK


class _Sensor(NamedTuple):
    """What a worn sensor measures, m/s^2 or rad/s."""

    name: str
    largest: float  # No sensor that is worn measures more (32 g; 4,300 deg/s)
    spike: float  # Samples farther than this from the median of five are spikes, at 100 Hz and above
    share: float  # A spike may have been a knock: this share of it may be missing from velocity or turn
    clipped: float  # An axis that repeats a value is clipped, from this value on
    small: tuple[float, float]  # It is never so small for so long, s
    large: tuple[float, float]  # .. nor so large
    density: float  # What an arm may do meanwhile: change by this much per square root of a second
    units: str = ""


_ACCELEROMETER = _Sensor(
    "accelerometer", 320.0, 15.0, 0.4, 10.5, (0.3 * GRAVITY, 0.15), (3.0 * GRAVITY, 0.3), 2.0
)
_GYROSCOPE = _Sensor(
    "gyroscope", 75.0, 10.0, 0.05, 1.5, (0.0, 0.15), (20.0, 0.15), 2.5, ": are its units rad/s?"
)
#: Of the velocity, m/s, and of the direction, rad.
DENSITIES = _ACCELEROMETER.density, _GYROSCOPE.density
#: A value is held where it repeats this often on all axes, while the other sensor, or its own value, shows
#: that the arm moves: rad/s, m/s^2.
REPEATS = 4
MOVING_RATE, MOVING_FORCE = 0.15, 0.6
#: .. or where repeats were no more than this share of the samples before, and this many come in a row.
USUAL_REPEATS, UNUSUAL = 0.02, 8
#: With every sample this much is looked at again, s, and this much before it is its context, s.
LOOKED_AGAIN_S, CONTEXT_S = 0.5, 0.5


class ImuCheck:
    """Judges samples one after the other; what it has seen decides what is usual."""

    def __init__(self) -> None:
        self._repeats = np.array([0.5, 0.5])

    def learn(self, acc: FloatArray, gyro: FloatArray) -> None:
        """Take in sound samples (n, 3) each, as what is usual."""
        if len(acc) < 2:
            return
        weight = min(len(acc) / 500.0, 1.0)
        share = [float(_same(each).mean()) for each in (acc, gyro)]
        self._repeats = (1.0 - weight) * self._repeats + weight * np.array(share)

    def doubt(
        self,
        t_s: FloatArray,  # (n,) s
        acc: FloatArray,  # (n, 3) m/s^2
        gyro: FloatArray,  # (n, 3) rad/s
    ) -> tuple[FloatArray, dict[str, BoolArray]]:  # (n, 2) (m/s)^2 and rad^2
        """What is doubtful of a second's samples: variances of velocity and turn, 0 where sound, and why."""
        found, reasons = np.zeros((len(t_s), 2)), dict[str, BoolArray]()
        if len(t_s) < 8:
            return found, reasons
        apart = t_s[1:] - t_s[:-1]
        each_s = np.clip(np.concatenate([[middle(apart)], apart]), 1e-4, 0.1)
        usual_s = middle(each_s)
        sizes = [np.sqrt((each * each).sum(axis=1)) for each in (acc, gyro)]
        held = self._held(acc, gyro, *sizes)
        for column, sensor in enumerate((_ACCELEROMETER, _GYROSCOPE)):
            values, size, variance = (acc, gyro)[column], sizes[column], found[:, column]
            spike, off = _spikes(values, sensor.spike * max(usual_s / 0.01, 1.0))
            variance[spike] = (sensor.share * np.minimum(off, sensor.largest) * each_s)[spike] ** 2
            (small, small_s), (large, large_s) = sensor.small, sensor.large
            too_large = (np.abs(values) > sensor.largest).any(axis=1)
            for why, rows in (
                ("repeats a value", held[column]),
                (f"is out of range{sensor.units}", too_large | _on_average(size > large, usual_s, large_s)),
                ("does not show gravity: are its units m/s^2?", _on_average(size < small, usual_s, small_s)),
                ("is clipped", _clipped(values, sensor.clipped)),
            ):
                if rows.any():
                    variance[rows] = (sensor.density**2 * each_s)[rows]
                    reasons[f"the {sensor.name} {why}"] = rows
        return found, reasons

    def _held(
        self, acc: FloatArray, gyro: FloatArray, force: FloatArray, rate: FloatArray
    ) -> tuple[BoolArray, BoolArray]:
        """Samples of each sensor (n,) that repeat a value while the arm moves, or unlike before."""
        held = [_held(acc), _held(gyro)]
        if not (held[0].any() or held[1].any()):
            return held[0], held[1]
        unusual = _long(held[0] & held[1], UNUSUAL) & (self._repeats < USUAL_REPEATS).all()
        is_moving = (np.abs(force - GRAVITY) > MOVING_FORCE) | (rate > MOVING_RATE)
        turned = _over_runs(held[0], rate) > MOVING_RATE
        shaken = _over_runs(held[1], np.abs(force - middle(force))) > MOVING_FORCE
        force_held = held[0] & (is_moving | turned | unusual)
        return force_held, held[1] & ((rate > MOVING_RATE) | shaken | unusual)


def _same(values: FloatArray) -> BoolArray:
    """Samples (n, 3) that repeat the one before on all axes, (n - 1,)."""
    return np.asarray((values[1:] == values[:-1]).all(axis=1))


def _held(values: FloatArray) -> BoolArray:
    """Samples of a long run of repeats, without its first."""
    return np.append(False, _long(_same(values), REPEATS))


def _long(rows: BoolArray, least: int) -> BoolArray:
    """The rows whose run is at least this long."""
    long = np.zeros(len(rows), bool)
    for run in runs(rows) if rows.any() else ():
        long[run] = run.stop - run.start >= least
    return long


def _over_runs(rows: BoolArray, values: FloatArray) -> FloatArray:
    """Mean of values (n,) over each run of rows; 0 outside."""
    mean = np.zeros(len(rows))
    for run in runs(rows):
        mean[run] = float(np.mean(values[run]))
    return mean


def _clipped(values: FloatArray, floor: float) -> BoolArray:
    """Samples (n,) of which one axis repeats a large value twice, as only a limit of the sensor explains."""
    again = np.zeros(values.shape, bool)
    again[1:] = (values[1:] == values[:-1]) & (np.abs(values[1:]) > floor)
    again[1:] &= again[:-1]
    again[:-1] |= again[1:]
    return np.asarray(again.any(axis=1))


def _spikes(values: FloatArray, limit: float) -> tuple[BoolArray, FloatArray]:
    """Samples far from the median of five around them, and how far (n,); twice as far for the newest two."""
    padded = np.concatenate([values[1::-1], values, values[-3:-2], values[-3:-2]])
    around = np.stack([padded[k : len(padded) - 4 + k] for k in range(5)])
    around.sort(axis=0)
    off = values - around[2]
    size = np.sqrt((off * off).sum(axis=1))
    limits = np.full(len(values), limit)
    limits[-2:] = 2.0 * limit
    return np.asarray(size > limits), size


def _on_average(rows: BoolArray, usual_s: float, seconds: float) -> BoolArray:
    """Rows of stretches of this length in which nearly all are true, without a pause for single ones."""
    width = max(round(seconds / usual_s), 3)
    if len(rows) < width or rows.sum() < 0.8 * width:
        return np.zeros(len(rows), bool)
    share = sliding_window_view(rows, width).mean(axis=1)
    stretch = np.zeros(len(rows), bool)
    for first in np.flatnonzero(share >= 0.8):
        stretch[first : first + width] = True
    return stretch


#: No sample of an IMU beyond the forearm for this long: it is left out and said, s.
STOPPED_S = 0.5
#: A pause that is longer interrupts what an IMU says, s.
LONGEST_PAUSE_S = 0.3
#: One that contradicts the rest of the arm is left out for this long, s, and twice as long where it had just
#: been, up to this; it is called sound when it has fitted for this long, s.
DOUBT_S, LONGEST_DOUBT_S, SOUND_S = 1.0, 8.0, 2.0
#: So many doubtful samples in a row are a stretch; fewer are replaced well by their neighbours.
STRETCH = 4


class Suspicion:
    """How long something is doubted: twice as long where it had just been."""

    def __init__(self, first_s: float, longest_s: float, soon_s: float) -> None:
        self._first_s, self._longest_s, self._soon_s = first_s, longest_s, soon_s
        self._length_s, self.until_s = first_s, -np.inf

    def renew(self, since_s: float, now_s: float) -> bool:
        """Doubt it from now on; whether it had just been doubted."""
        again = since_s < self.until_s + self._soon_s
        self._length_s = min(2.0 * self._length_s, self._longest_s) if again else self._first_s
        self.until_s = now_s + self._length_s
        return again


class LiveImu:
    """The forearm's IMU, whose doubtful samples the camera makes up for, or one beyond it, left out then."""

    def __init__(self, segment: BodySegment, capacity_s: float) -> None:
        self.segment, self._capacity_s = segment, capacity_s
        self._name = f"the IMU on the {segment.label}"
        self._rows = np.zeros((0, 9))  # t, acc, gyro as they came; doubt of the two
        self.version = self.late = self.duplicate = self.invalid = 0
        self.changed_s: float | None = None  # From when on its samples are others than before
        self.because: tuple[str, ...] = ()  # What is wrong with its samples
        self._check, self._reasons, self._has_stopped = ImuCheck(), dict[str, float](), False
        self._contradicted_s = -np.inf, -np.inf  # the forearm's by the camera
        # one beyond the forearm is left out between these stamps
        self.doubted_s = self.usable_s = -np.inf
        self._suspicion = Suspicion(DOUBT_S, LONGEST_DOUBT_S, SOUND_S + 1.0)

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

    def _since(self, t_s: float) -> FloatArray:
        """The rows from a time on; a view."""
        return self._rows[int(np.searchsorted(self.t, t_s)) :]

    def _changed(self, since_s: float) -> None:
        self.version += 1
        self.changed_s = since_s if self.changed_s is None else min(self.changed_s, since_s)

    # What comes

    def add(self, batch: ImuStream) -> None:
        """Sort samples in; those that are much older than the newest are dropped."""
        rows = np.column_stack([batch.t_s, batch.acc, batch.gyro, np.zeros((len(batch), 2))]).astype(float)
        finite = np.isfinite(rows).all(axis=1)
        self.invalid += int((~finite).sum())
        rows = rows[finite]
        rows, before_s = rows[np.argsort(rows[:, 0], kind="stable")], self.end_s
        if len(self):  # a first batch may be as long as it likes
            late = rows[:, 0] < max(before_s, rows[-1:, 0].max(initial=-np.inf)) - LATE_S
            self.late += int(late.sum())
            rows = rows[~late]
        there = np.isin(rows[:, 0], self._since(before_s - LATE_S)[:, 0])
        fresh = (np.diff(rows[:, 0], prepend=-np.inf) > 0) & ~there
        self.duplicate += int((~fresh).sum())
        rows = rows[fresh]
        if not len(rows):
            return
        self.version += 1
        if rows[0, 0] <= before_s:
            self._changed(float(rows[0, 0]))
        first = int(np.searchsorted(self.t, rows[0, 0]))
        tail = np.concatenate([self._rows[first:], rows])
        self._rows = np.concatenate([self._rows[:first], tail[np.argsort(tail[:, 0], kind="stable")]])
        if self.end_s - self._rows[0, 0] > SLACK * self._capacity_s:
            self._rows = self._since(self.end_s - self._capacity_s)

    # What is wrong with it

    def check(self, now_s: float) -> list[str]:
        """Look at what came; a sentence where something is wrong with it, or is right again."""
        if not len(self):
            return []
        self._look()
        end_s, before, self.because = self.end_s, self.because, tuple(self._reasons)
        if self.segment is FOREARM:
            new = [f"{why}; the camera is followed meanwhile" for why in self.because if why not in before]
            return new + (["the IMU is plausible again"] if before and not self.because else [])
        if self.because:
            self._leave_out(end_s - LOOKED_AGAIN_S, end_s)
        if end_s < self._suspicion.until_s + SOUND_S:
            self.because = (*self.because, "it contradicts the rest of the arm")
        notes = []
        if bool(self.because) != bool(before):
            why = f"left out: {'; '.join(self.because)}" if self.because else "plausible again"
            notes.append(f"{self._name} is {why}")
        has_stopped = now_s - end_s > STOPPED_S
        if has_stopped != self._has_stopped:
            notes.append(f"{self._name} is {'left out: it has stopped' if has_stopped else 'back'}")
        self._has_stopped = has_stopped
        return notes

    def _look(self) -> None:
        """Look for samples that cannot be right, among those of the last moments."""
        end_s = self.end_s
        rows, late = self._since(end_s - LOOKED_AGAIN_S - CONTEXT_S), self._since(end_s - LOOKED_AGAIN_S)
        found, reasons = self._check.doubt(rows[:, 0], rows[:, 1:4], rows[:, 4:7])
        if self._contradicted_s[1] >= rows[0, 0]:
            found = np.maximum(found, self._blamed(rows[:, 0]))
        for why, where in reasons.items():
            if where[-3:].any() and where.sum() >= 5:
                self._reasons[why] = end_s
        self._reasons = {why: at for why, at in self._reasons.items() if end_s - at < LOOKED_AGAIN_S}
        found = found[len(rows) - len(late) :]
        sound = ~found.any(axis=1)
        self._check.learn(late[sound, 1:4], late[sound, 4:7])
        changed = ((found > 0) != (late[:, 7:] > 0)).any(axis=1)
        late[:, 7:] = found
        if changed.any():
            self._changed(float(late[int(np.argmax(changed)), 0]))

    def contradicted(self, since_s: float, until_s: float) -> None:
        """Doubt the samples of the forearm's from one time to another: the camera contradicts them."""
        since_s = min(since_s, self._contradicted_s[0]) if since_s <= self._contradicted_s[1] else since_s
        self._contradicted_s = since_s, until_s
        rows = self._since(since_s)
        if len(rows):
            rows[:, 7:] = np.maximum(rows[:, 7:], self._blamed(rows[:, 0]))
            self._changed(float(rows[0, 0]))

    def _blamed(self, t: FloatArray) -> FloatArray:
        """What the camera's contradiction makes of samples at some times (n,): (n, 2) variances."""
        inside = (t >= self._contradicted_s[0]) & (t <= self._contradicted_s[1])
        each_s = float(np.median(np.diff(t))) if len(t) > 1 else 0.01
        return np.outer(inside, np.square(DENSITIES) * each_s)

    def contradicted_by_arm(self, since_s: float) -> None:
        """Leave it out, because the rest of the arm contradicts its samples from a stamp on."""
        self._suspicion.renew(self.end_s, self.end_s)
        self._leave_out(since_s, self._suspicion.until_s)

    def _leave_out(self, since_s: float, until_s: float) -> None:
        """Samples between two stamps do not take part."""
        if since_s > self.usable_s:
            self.doubted_s = since_s
        self.usable_s = max(self.usable_s, until_s)

    @property
    def is_doubted(self) -> bool:
        """The newest samples are doubtful, for more than a moment."""
        return bool(len(self)) and bool((self._rows[-5:, 7:] > 0).any(axis=1).all())

    # What it says

    def since_pause_s(self, looked_s: float) -> float:
        """Where the samples begin that have no long pause, within the last `looked_s`; s."""
        t = self._since(self.end_s - looked_s)[:, 0]
        pauses = np.flatnonzero(np.diff(t) > LONGEST_PAUSE_S)
        return float(t[pauses[-1] + 1]) if len(pauses) else float(t[0])

    def doubt(self, start_s: float) -> FloatArray:
        """What replaced samples may cost velocity and turn, (n, 2) variances, from a time on."""
        return self._since(start_s)[:, 7:].copy()

    def stream(self, start_s: float, end_s: float = np.inf) -> ImuStream:
        """The samples from one time to another; doubtful ones are replaced."""
        rows = self._rows[slice(*np.searchsorted(self.t, [start_s, end_s]).tolist())].copy()
        if rows[:, 7:].any():
            for column, values, fades in ((7, slice(1, 4), False), (8, slice(4, 7), True)):
                _replace(rows[:, 0], rows[:, values], rows[:, column] > 0, fades)
        return ImuStream(self._name, rows[:, 0], rows[:, 1:4], rows[:, 4:7])

    def sound_stream(self) -> ImuStream:
        """All samples without stretches that are doubtful: there is a pause."""
        stream, wrong = self.stream(-np.inf), np.asarray((self._rows[:, 7:] > 0).any(axis=1))
        for run in runs(wrong):
            wrong[run] = run.stop - run.start >= STRETCH
        return stream.select(~wrong) if wrong.any() else stream


def _replace(t: FloatArray, values: FloatArray, wrong: BoolArray, fades: bool) -> None:
    """Doubtful samples (n, 3) by their sound neighbours, in place; a long stretch of rates by none."""
    if not wrong.any() or wrong.all():
        return
    for axis in range(3):
        values[wrong, axis] = np.interp(t[wrong], t[~wrong], values[~wrong, axis])
    for run in runs(wrong):
        if run.stop - run.start >= STRETCH:
            near = ~wrong & (np.abs(t - t[run.start]) < 0.3)
            values[run] = 0.0 if fades else values[near if near.any() else ~wrong].mean(axis=0)
