"""A session's source: streams of the Lab Streaming Layer, each received by a thread, again after a loss."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from queue import SimpleQueue
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..array_types import FloatArray
from ..body import FOREARM, SEGMENTS
from ..errors import UnoccludeError
from ..io.recording.names import named_side
from ..runtime.printable import printable
from .arrivals import STEP_OF_IMU_S, Arrivals, FrameRows, ImuRows, SourceInfo, StampSteps, StreamRows
from .channels import ImuChannels, SkeletonChannels, StreamLabels, belongs, is_accelerometer
from .lsl import lsl_module


def listed(streams: Sequence[Any]) -> str:
    """Names and types of streams, for a sentence."""
    names = sorted({f"{stream.name()} (type {stream.type() or 'none'})" for stream in streams})
    shown = [printable(name[:80]) for name in names[:8]]
    more = [f"and {len(names) - 8} more"] if len(names) > 8 else []
    return ", ".join([*shown, *more]) or "none"


#: Samples that are received together at most, and for how long the library holds them, s.
_MOST, _BUFFER_S = 512, 120
#: Waits of the thread: for streams to answer, for samples, for the first estimate of the clocks, s.
_RESOLVE_S, _PULL_S, _CLOCK_S = 1.0, 0.2, 3.0


@dataclass(frozen=True)
class LslSamples(StreamRows):
    """Samples that came together; times are after the beginning on this computer's LSL clock."""

    # (n,) s: stamps: as sent, and the library's time correction
    t_s: FloatArray = field(default_factory=partial(np.empty, 0))
    values: NDArray = field(default_factory=partial(np.empty, (0, 0)))  # (n, channels)
    arrival_s: FloatArray = field(default_factory=partial(np.empty, 0))  # (n,) s: when they came


class LslInlet:
    """Receives a stream, also after it was lost."""

    def __init__(
        self,
        option: str,
        wanted: str | None,
        types: tuple[str, ...],
        wake: Callable[[], None],
        start_s: float = 0.0,
    ) -> None:
        self._option, self._start_s = option, start_s
        self.stream: Any = None
        self.others: list[Any] = []
        self.correction_s = float("nan")
        self._wanted, self._types, self._wake = wanted, types, wake
        self._samples: SimpleQueue[LslSamples] = SimpleQueue()
        self._events: SimpleQueue[str] = SimpleQueue()
        self._labels: StreamLabels | None = None
        self._failure: UnoccludeError | None = None
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._work, name="lsl-inlet", daemon=True)

    @property
    def name(self) -> str:
        """What the stream that was found is called."""
        return printable(self.stream.name())

    @property
    def described(self) -> str:
        """Which stream is looked for, by its option."""
        if self._wanted is not None:
            return f"{self._option}{self._wanted}"
        return f"{self._option.strip(' -')} of type {self._types[0]}"

    def start(self) -> None:
        """Look for the stream, and receive it."""
        self._thread.start()

    def samples(self) -> list[LslSamples]:
        """What came since the last call."""
        self.check()
        return [self._samples.get_nowait() for _ in range(self._samples.qsize())]

    def events(self) -> list[str]:
        """What happened to the stream since the last call, a sentence each."""
        return [self._events.get_nowait() for _ in range(self._events.qsize())]

    def check(self) -> None:
        """Raise what the thread failed by."""
        if self._failure is not None:
            raise self._failure

    def close(self) -> None:
        """Stop receiving."""
        self._closing.set()
        if self._thread.is_alive():
            self._thread.join(3 * _RESOLVE_S)

    def _work(self) -> None:
        while not self._closing.is_set():
            try:
                inlet = self._connected()
                while inlet is not None and not self._closing.is_set():
                    self._receive(inlet)
            except UnoccludeError as failure:
                self._failure = failure
                self._wake()
                return
            except RuntimeError:  # the library's: lost, or no answer in time
                continue  # look for it again

    def _connected(self) -> Any:
        """An inlet of the stream once it is there; None where this ends before."""
        lsl = lsl_module()
        while not self._closing.is_set():
            self.others = list(lsl.resolve_streams(_RESOLVE_S))
            found = self._matching()
            if found is None:
                continue
            # the library itself would wait for the same source_id for ever
            inlet = lsl.StreamInlet(found, max_buflen=_BUFFER_S, recover=False)
            stream = inlet.info(_CLOCK_S)
            labels = StreamLabels.of(stream)
            if self._labels is not None:
                self._compare(self._labels, labels, stream)
            self._labels = labels
            self.correction_s = inlet.time_correction(_CLOCK_S)
            inlet.open_stream(_CLOCK_S)  # last: what waits inside has no arrival of its own
            self.stream = stream
            self._wake()
            return inlet
        return None

    def _compare(self, before: StreamLabels, now: StreamLabels, stream: Any) -> None:
        """Refuse a stream that came back as another one."""
        if now != before:
            raise UnoccludeError(
                f"the stream {self.name} came back with other labels, units or channels; begin a new session"
            )
        if stream.source_id() != self.stream.source_id():
            self._events.put(f"{self.name}: found again by its name, its source_id is another")

    def _matching(self) -> Any:
        """The stream that is meant among those that answered; None where it is not there."""
        if self.stream is not None:
            return self._again()
        part = (self._wanted or "").lower()
        exact = [s for s in self.others if self._wanted in (s.name(), s.source_id())]
        fitting = exact or [s for s in self.others if part in s.name().lower()]
        # some devices give all of their streams one name
        of_type = [stream for stream in fitting if stream.type().lower() in self._types]
        fitting = of_type if self._wanted is None else of_type or fitting
        if len({stream.uid() for stream in fitting}) <= 1:
            return fitting[0] if fitting else None
        raise UnoccludeError(
            f"several streams are meant by {self.described}: {listed(fitting)}; give the whole name or the"
            " source_id"
        )

    def _again(self) -> Any:
        """The stream that was received before: the same source_id, or the only one of its name and type."""
        meant = (self.stream.name(), self.stream.type())
        named = [stream for stream in self.others if (stream.name(), stream.type()) == meant]
        same = [stream for stream in named if stream.source_id() == self.stream.source_id()]
        for fitting in (same, named):
            if len({stream.uid() for stream in fitting}) == 1:
                return fitting[0]
        return None

    def _receive(self, inlet: Any) -> None:
        values, stamps = inlet.pull_chunk(timeout=_PULL_S, max_samples=_MOST, min_samples=1, as_numpy=True)
        if not len(stamps):
            return
        arrival = lsl_module().local_clock()
        with suppress(lsl_module().util.TimeoutError):  # the one before holds until there is a new one
            self.correction_s = inlet.time_correction(0.0)
        t_s = np.asarray(stamps, float) + self.correction_s - self._start_s
        self._samples.put(LslSamples(t_s, np.asarray(values), np.full(len(t_s), arrival - self._start_s)))
        self._wake()


#: Between samples of the accelerometer farther apart than this nothing is interpolated, s.
_MOST_APART_S = 0.2
#: A sample waits for the other half no longer than this, s.
_LONGEST_WAIT_S = 2.0


class ImuHalves:
    """Joins an accelerometer's samples, interpolated, to those of a gyroscope with a stream of its own."""

    def __init__(self, *names: str) -> None:
        self._steps = [StampSteps[LslSamples](name, STEP_OF_IMU_S, STEP_OF_IMU_S) for name in names]
        self._waiting = [LslSamples(), LslSamples()]

    def joined(self, *came: Sequence[LslSamples]) -> tuple[list[LslSamples], list[str]]:
        """What both halves reach, the gyroscope's channels last; and what was done to stamps."""
        events: list[str] = []
        for at, batches in enumerate(came):
            for batch in batches:
                rows, said = self._steps[at].corrected(batch)
                rows = LslSamples.joined([each for each in (self._waiting[at], rows) if len(each)])
                self._waiting[at] = rows.select(np.unique(rows.t_s, return_index=True)[1])  # in order
                events += said
        acc, gyro = self._waiting
        stop = int(np.searchsorted(gyro.t_s, acc.t_s.max(initial=-np.inf), "right"))
        due, later = gyro.select(slice(0, stop)), gyro.select(slice(stop, None))
        self._waiting = [
            rows.select(np.flatnonzero(rows.t_s > rows.t_s.max(initial=-np.inf) - _LONGEST_WAIT_S))
            for rows in (acc, later)
        ]
        after = np.searchsorted(acc.t_s, due.t_s)
        before = np.searchsorted(acc.t_s, due.t_s, "right") - 1
        held = np.flatnonzero((before >= 0) & (acc.t_s[after] - acc.t_s[before] <= _MOST_APART_S))
        if not len(held):
            return [], events
        due = due.select(held)
        force = [np.interp(due.t_s, acc.t_s, channel) for channel in acc.values.T]
        # a sample is complete when the later half has come
        arrival_s = np.maximum(due.arrival_s, acc.arrival_s[after[held]])
        return [LslSamples(due.t_s, np.column_stack([*force, due.values]), arrival_s)], events


#: Content types by which streams are found that were not named.
_IMU_TYPES, _SKELETON_TYPES = ("imu", "accelerometer", "acc"), ("mocap", "skeleton")
_GYRO_TYPES = ("gyroscope", "gyro", "gyr")


class _Arm:
    """The streams of one arm: its IMUs by segment; the skeleton's is of all arms."""

    def __init__(self, side: str | None, imus: dict[str, LslInlet]) -> None:
        self.side, self.imus = side, imus
        self.gyros: dict[str, LslInlet] = {}  # Gyroscopes of IMUs that have one in a stream of its own
        self.halves: dict[str, ImuHalves] = {}
        self.channels: dict[str, ImuChannels] = {}
        self.skeleton: SkeletonChannels | None = None


class LslSource:
    """Streams of the lab's network as one source; times count from the session's beginning."""

    speed = 1.0
    ended = False  # streams that are lost may come back

    def __init__(
        self,
        arms: Mapping[str | None, Mapping[str, str]],  # Streams of IMUs by side and segment, as far as named
        skeleton: str | None = None,
        prefer_side: str | None = None,
        body: str | None = None,
        gyro: str | None = None,  # Stream of the first arm's gyroscope where it has one of its own
    ) -> None:
        lsl = lsl_module()
        self._something = threading.Event()
        self._start_s = float(np.floor(lsl.local_clock()))
        self._origin_ns = time.time_ns() - int((lsl.local_clock() - self._start_s) * 1e9)
        self._skeleton = self._inlet("--skeleton ", skeleton, _SKELETON_TYPES)
        self._arms = [self._of_arm(side, named) for side, named in arms.items()]
        self._inlets = [inlet for arm in self._arms for inlet in arm.imus.values()]
        self._inlets.insert(1, self._skeleton)
        if gyro is not None:
            self._add_gyro(self._arms[0], FOREARM.name, gyro, _GYRO_TYPES)
        self._prefer_side, self._body = prefer_side, body
        self.infos: list[SourceInfo] = []

    def _inlet(self, option: str, wanted: str | None, types: tuple[str, ...]) -> LslInlet:
        return LslInlet(option, wanted, types, self._something.set, self._start_s)

    def _add_gyro(self, arm: _Arm, segment: str, wanted: str, types: tuple[str, ...]) -> None:
        arm.gyros[segment] = self._inlet("--gyro ", wanted, types)
        self._inlets.append(arm.gyros[segment])

    def _of_arm(self, side: str | None, named: Mapping[str, str]) -> _Arm:
        streams: dict[str, str | None] = {FOREARM.name: None, **named}
        inlets = {}
        for segment, wanted in streams.items():
            option = "--imu " if segment == FOREARM.name else f"--imu {segment.replace('_', '-')}="
            inlets[segment] = self._inlet(option, wanted, _IMU_TYPES)
        return _Arm(side, inlets)

    def open(
        self,
        seconds: float,
        stopped: Callable[[], bool] = lambda: False,
        say: Callable[[str], None] = lambda _: None,
    ) -> bool:
        """Wait until all streams are there; what the first one sends meanwhile is not lost."""
        for inlet in self._inlets:
            inlet.start()
        until = time.monotonic() + seconds
        while not self._all_there(say):
            if stopped():
                return False
            if time.monotonic() > until:
                raise UnoccludeError(self._missing(seconds))
            self._something.wait(0.1)
            self._something.clear()
        self.infos = [self._described(arm) for arm in self._arms]
        return True

    def _all_there(self, say: Callable[[str], None]) -> bool:
        """Take down the streams that have come; whether none is missing."""
        for inlet in self._inlets:
            inlet.check()
        skeleton = self._skeleton.stream
        for arm in self._arms:
            for segment, inlet in arm.imus.items():
                if segment not in arm.channels and inlet.stream is not None:
                    self._take_imu(arm, segment, inlet, say)
            imu = arm.imus[FOREARM.name].stream
            if arm.skeleton is None and skeleton is not None:
                side = arm.side or named_side("" if imu is None else imu.name())
                labels = StreamLabels.of(skeleton)
                arm.skeleton = SkeletonChannels.of(labels, side or None, self._prefer_side, self._body)
                if arm is self._arms[0]:
                    say(f"skeleton stream {skeleton.name()} is there")
        return skeleton is not None and all(len(arm.channels) == len(arm.imus) for arm in self._arms)

    def _take_imu(self, arm: _Arm, segment: str, inlet: LslInlet, say: Callable[[str], None]) -> None:
        """Take down what an IMU sends, unless its gyroscope has a stream that is still to come."""
        stream, labels = inlet.stream, StreamLabels.of(inlet.stream)
        where = "" if segment == FOREARM.name else f" of the {SEGMENTS[segment].label}"
        if segment not in arm.gyros and is_accelerometer(labels):
            beside = [each for each in inlet.others if each.uid() != stream.uid()]
            found = [each for each in beside if belongs(each.name(), each.type(), stream.name())]
            if len(found) == 1:
                self._add_gyro(arm, segment, found[0].name(), (found[0].type().lower(),))
                arm.gyros[segment].start()
        if segment not in arm.gyros:
            arm.channels[segment] = ImuChannels.of(labels)
            say(f"IMU stream {stream.name()}{where} is there")
        elif (gyro := arm.gyros[segment]).stream is not None:
            turns = ImuChannels.of(StreamLabels.of(gyro.stream), "gyro")
            arm.channels[segment] = ImuChannels.of(labels, "acc").with_gyroscope(turns, len(labels.labels))
            arm.halves[segment] = ImuHalves(inlet.name, gyro.name)
            say(f"accelerometer stream {inlet.name} and gyroscope stream {gyro.name}{where} are there")

    def now_s(self) -> float:
        """The LSL clock of this computer, after the session's beginning."""
        return float(lsl_module().local_clock()) - self._start_s

    def wait(self, seconds: float) -> None:
        """Until something comes, at most this long."""
        self._something.wait(seconds)
        self._something.clear()

    def arrivals(self) -> list[Arrivals]:
        """What came since the last call; what happened to a stream is said with the first arm."""
        frames, events = self._skeleton.samples(), [text for inlet in self._inlets for text in inlet.events()]
        came: list[Arrivals] = []
        for arm in self._arms:
            imus = {}
            for segment, inlet in arm.imus.items():
                batches, channels = inlet.samples(), arm.channels[segment]
                if segment in arm.halves:
                    batches, said = arm.halves[segment].joined(batches, arm.gyros[segment].samples())
                    events += said
                rows = [
                    ImuRows(each.t_s, arrival_s=each.arrival_s, **channels.values(each.values))
                    for each in batches
                ]
                imus[segment] = ImuRows.joined(rows)
            assert arm.skeleton is not None  # since `open`
            arm_frames = [
                FrameRows(each.t_s, *arm.skeleton.values(each.values), each.arrival_s) for each in frames
            ]
            came.append(Arrivals(imus, FrameRows.joined(arm_frames), tuple(events)))
            events = []
        return came

    def close(self) -> None:
        """Let the streams go."""
        for inlet in self._inlets:
            inlet.close()

    def _described(self, arm: _Arm) -> SourceInfo:
        assert arm.skeleton is not None
        inlets = [*arm.imus.values(), self._skeleton, *arm.gyros.values()]
        corrections = [f"{each.name} {1e3 * each.correction_s:+.1f} ms" for each in inlets]
        notes = [f"LSL's time correction: {', '.join(corrections)}."]
        notes += [
            f"Accelerometer {arm.imus[segment].name} and gyroscope {gyro.name} are two streams: the"
            " accelerometer is interpolated to the gyroscope's stamps."
            for segment, gyro in arm.gyros.items()
        ]
        return SourceInfo(
            {segment: inlet.name for segment, inlet in arm.imus.items()},
            self._skeleton.name,
            arm.skeleton.side,
            arm.skeleton.joints,
            self._origin_ns,
            arm.skeleton.camera_frame,
            lsl_start_s=self._start_s,
            notes=tuple(notes),
        )

    def _missing(self, seconds: float) -> str:
        names = [inlet.described for inlet in self._inlets if inlet.stream is None]
        there = listed([stream for inlet in self._inlets for stream in inlet.others])
        return (
            f"no stream for {' and '.join(names)} arrived within {seconds:g} s; streams on the network:"
            f" {there}"
        )
