"""A session's source: streams of the Lab Streaming Layer."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from ..body import SEGMENTS
from ..errors import UnoccludeError
from ..io.recording.names import named_side
from ..runtime.printable import printable
from .arrivals import STEP_OF_IMU_S, Arrivals, FrameRows, ImuRows, SourceInfo, StampSteps
from .channels import ImuChannels, SkeletonChannels, StreamLabels, belongs, half_of
from .lsl import LslInlet, LslSamples, listed, lsl_module

#: Content types by which streams are found that were not named.
_IMU_TYPES, _SKELETON_TYPES = ("imu", "accelerometer", "acc"), ("mocap", "skeleton")
_GYRO_TYPES = ("gyroscope", "gyro", "gyr")

#: Between samples of the accelerometer farther apart than this nothing is interpolated, s.
MOST_APART_S = 0.2
#: A sample waits for the other half no longer than this, s.
LONGEST_WAIT_S = 2.0


class ImuHalves:
    """Joins samples of both halves at the gyroscope's stamps, the accelerometer interpolated to them."""

    def __init__(self, acc_name: str, gyro_name: str) -> None:
        self._steps = {
            kind: StampSteps[ImuRows](name, STEP_OF_IMU_S, STEP_OF_IMU_S)
            for kind, name in (("acc", acc_name), ("gyro", gyro_name))
        }
        self._acc, self._gyro = ImuRows(), ImuRows()

    def joined(self, acc: ImuRows, gyro: ImuRows) -> tuple[ImuRows, tuple[str, ...]]:
        """What both halves reach, and what was done to stamps."""
        acc, said_acc = self._steps["acc"].corrected(acc)
        gyro, said_gyro = self._steps["gyro"].corrected(gyro)
        self._acc = _in_order(ImuRows.joined([self._acc, acc]))
        self._gyro = _in_order(ImuRows.joined([self._gyro, gyro]))
        events = (*said_acc, *said_gyro)
        if not len(self._acc) or not len(self._gyro):
            self._forget()
            return ImuRows(), events
        t = self._acc.t_s
        stop = int(np.searchsorted(self._gyro.t_s, t[-1], "right"))
        due, self._gyro = self._gyro.select(slice(0, stop)), self._gyro.select(slice(stop, None))
        after = np.clip(np.searchsorted(t, due.t_s), 0, len(t) - 1)
        before = np.maximum(np.where(t[after] > due.t_s, after - 1, after), 0)
        held = (t[before] <= due.t_s) & (due.t_s <= t[after]) & (t[after] - t[before] <= MOST_APART_S)
        force = np.stack([np.interp(due.t_s, t, self._acc.acc[:, axis]) for axis in range(3)], axis=1)
        # the sample is complete when the later half has come
        arrival_s = np.maximum(due.arrival_s, self._acc.arrival_s[after])
        rows = ImuRows(due.t_s, force, due.gyro, arrival_s).select(np.flatnonzero(held))
        self._forget()
        return rows, events

    def _forget(self) -> None:
        """Drop what nothing can be joined with any more."""
        self._acc, self._gyro = (
            rows.select(np.flatnonzero(rows.t_s > rows.t_s.max(initial=-np.inf) - LONGEST_WAIT_S))
            for rows in (self._acc, self._gyro)
        )


def _in_order(rows: ImuRows) -> ImuRows:
    """Rows in order of their stamps, each stamp once."""
    if (np.diff(rows.t_s) > 0.0).all():
        return rows
    _, first = np.unique(rows.t_s, return_index=True)
    return rows.select(first)


class LslSource:
    """Streams of the lab's network as one source; times count from the session's beginning."""

    speed = 1.0

    def __init__(
        self,
        imu: str | None,
        skeleton: str | None,
        side: str | None = None,
        prefer_side: str | None = None,
        body: str | None = None,
        gyro: str | None = None,
        further: Mapping[str, str] | None = None,
        beside: LslSource | None = None,
    ):
        lsl = lsl_module()
        self._something, self._beside = threading.Event(), beside
        self._skeleton: LslInlet = (
            self._inlet(skeleton, _SKELETON_TYPES) if beside is None else beside._skeleton
        )
        self._imus = [self._inlet(imu, _IMU_TYPES)]  # the forearm's, and its gyroscope where that is apart
        if gyro is not None:
            self._imus.append(self._inlet(gyro, _GYRO_TYPES))
        self._further = {name: self._inlet(stream, _IMU_TYPES) for name, stream in (further or {}).items()}
        self._imu_channels: list[ImuChannels] = []
        self._further_channels: dict[str, ImuChannels] = {}
        self._skeleton_channels: SkeletonChannels | None = None
        self._halves: ImuHalves | None = None
        self._frame_batches: list[LslSamples] = []
        self._side, self._prefer_side, self._body = side, prefer_side, body
        self._start_s = float(np.floor(lsl.local_clock()))
        self._origin_ns = time.time_ns() - int((lsl.local_clock() - self._start_s) * 1e9)
        if beside is not None:
            self._start_s, self._origin_ns = beside._start_s, beside._origin_ns
        self._info: SourceInfo | None = None

    def _inlet(self, wanted: str | None, types: tuple[str, ...]) -> LslInlet:
        return LslInlet(wanted, types, self._something.set)

    def open(
        self,
        seconds: float,  # s
        stopped: Callable[[], bool] = lambda: False,
        say: Callable[[str], None] = lambda _: None,
    ) -> bool:
        """Wait until both streams are there; what the first one sends meanwhile is not lost."""
        for inlet in self._own_inlets:
            inlet.start()
        until = time.monotonic() + seconds
        while not self._all_there(say):
            if stopped():
                return False
            if time.monotonic() > until:
                raise UnoccludeError(self._missing(seconds))
            self._something.wait(0.1)
            self._something.clear()
        assert self._skeleton_channels is not None
        self._info = self._described(self._skeleton_channels)
        return True

    def _all_there(self, say: Callable[[str], None]) -> bool:
        """Take down the streams that have come; whether none is missing."""
        for inlet in self._all_inlets:
            inlet.check()
        for segment, inlet in self._further.items():
            if segment not in self._further_channels and inlet.stream is not None:
                self._further_channels[segment] = ImuChannels.of(StreamLabels.of(inlet.stream))
                say(f"IMU stream {inlet.stream.name()} of the {SEGMENTS[segment].label} is there")
        imu, skeleton = self._imus[0].stream, self._skeleton.stream
        if not self._imu_channels and imu is not None:
            self._imu_channels = self._imu_there(imu, say)
        if self._skeleton_channels is None and skeleton is not None:
            side = self._side or named_side("" if imu is None else imu.name())
            labels = StreamLabels.of(skeleton)
            self._skeleton_channels = SkeletonChannels.of(labels, side or None, self._prefer_side, self._body)
            if self._beside is None:
                say(f"skeleton stream {skeleton.name()} is there")
        is_there = bool(self._imu_channels) and self._skeleton_channels is not None
        return is_there and len(self._further_channels) == len(self._further)

    def _imu_there(self, stream: Any, say: Callable[[str], None]) -> list[ImuChannels]:
        """What the forearm's IMU is made of; nothing while its second stream is not there."""
        labels = StreamLabels.of(stream)
        if len(self._imus) == 1 and half_of(labels) == "acc":
            self._look_for_gyro(stream)
        if len(self._imus) == 1:
            say(f"IMU stream {stream.name()} is there")
            return [ImuChannels.of(labels)]
        gyro = self._imus[1].stream
        if gyro is None:
            return []
        channels = [ImuChannels.of(labels, "acc"), ImuChannels.of(StreamLabels.of(gyro), "gyro")]
        say(f"accelerometer stream {stream.name()} and gyroscope stream {gyro.name()} are there")
        self._halves = ImuHalves(stream.name(), gyro.name())
        return channels

    def _look_for_gyro(self, stream: Any) -> None:
        """Receive the one stream that is the gyroscope beside an accelerometer's, by name and type."""
        beside = [each for each in self._imus[0].others if each.uid() != stream.uid()]
        found = [each for each in beside if belongs(each.name(), each.type(), stream.name())]
        if len(found) == 1:
            self._imus.append(self._inlet(found[0].name(), (found[0].type().lower(),)))
            self._imus[1].start()

    @property
    def _all_inlets(self) -> list[LslInlet]:
        return [self._imus[0], self._skeleton, *self._imus[1:], *self._further.values()]

    @property
    def _own_inlets(self) -> list[LslInlet]:
        """Without the skeleton's, where that is the other arm's as well."""
        return [each for each in self._all_inlets if self._beside is None or each is not self._skeleton]

    @property
    def info(self) -> SourceInfo:
        """What the session is made of."""
        assert self._info is not None
        return self._info

    @property
    def ended(self) -> bool:
        """Streams that are lost may come back: never."""
        return False

    def now_s(self) -> float:
        """The LSL clock of this computer, after the session's beginning."""
        return float(lsl_module().local_clock()) - self._start_s

    def wait(self, seconds: float) -> None:
        """Until something comes, at most this long."""
        self._something.wait(seconds)
        self._something.clear()

    def arrivals(self) -> Arrivals:
        """What came since the last call."""
        assert self._skeleton_channels is not None
        halves = zip(self._imu_channels, self._imus, strict=True)
        rows = [self._imu_rows(channels, inlet) for channels, inlet in halves]
        if self._beside is None:
            self._frame_batches = self._skeleton.samples()
        frames = []
        for batch in (self._beside or self)._frame_batches:
            position, state = self._skeleton_channels.values(batch.values)
            arrival_s = batch.arrival_s - self._start_s
            frames.append(FrameRows(batch.t_s - self._start_s, position, state, arrival_s))
        further = {
            segment: self._imu_rows(self._further_channels[segment], inlet)
            for segment, inlet in self._further.items()
        }
        events = tuple(text for inlet in self._own_inlets for text in inlet.events())
        imu, said = (rows[0], ()) if self._halves is None else self._halves.joined(*rows)
        return Arrivals(imu, FrameRows.joined(frames), (*events, *said), further)

    def _imu_rows(self, channels: ImuChannels, inlet: LslInlet) -> ImuRows:
        """Samples of an IMU; those of a half stand in both places: the joiner takes what counts."""
        rows = []
        for batch in inlet.samples():
            values = channels.values(batch.values)
            half = next(iter(values.values()))
            acc, gyro = values.get("acc", half), values.get("gyro", half)
            t_s, arrival_s = batch.t_s - self._start_s, batch.arrival_s - self._start_s
            rows.append(ImuRows(t_s, acc, gyro, arrival_s, values.get("mag")))
        return ImuRows.joined(rows)

    def close(self) -> None:
        """Let the streams go."""
        for inlet in self._own_inlets:
            inlet.close()

    def _described(self, skeleton: SkeletonChannels) -> SourceInfo:
        names = [printable(inlet.stream.name()) for inlet in self._all_inlets]
        corrections = [
            f"{name} {1e3 * inlet.correction_s:+.1f} ms"
            for name, inlet in zip(names, self._all_inlets, strict=True)
        ]
        notes = [f"LSL's time correction: {', '.join(corrections)}."]
        if self._halves is not None:
            notes.append(
                f"Accelerometer {names[0]} and gyroscope {names[2]} are two streams: the accelerometer"
                " is interpolated to the gyroscope's stamps."
            )
        return SourceInfo(
            names[0],
            names[1],
            skeleton.side,
            skeleton.joints,
            self._origin_ns,
            skeleton.camera_frame,
            lsl_start_s=self._start_s,
            notes=tuple(notes),
            further={segment: printable(inlet.stream.name()) for segment, inlet in self._further.items()},
        )

    def _missing(self, seconds: float) -> str:
        known = (("imu", _IMU_TYPES), ("skeleton", _SKELETON_TYPES), ("gyro", _GYRO_TYPES))
        names = [
            f"--{option} {inlet.wanted}" if inlet.wanted is not None else f"{option} of type {types[0]}"
            for inlet, (option, types) in zip(self._all_inlets[: 1 + len(self._imus)], known, strict=False)
            if inlet.stream is None
        ]
        names += [
            f"{segment.replace('_', '-')}={inlet.wanted}"
            for segment, inlet in self._further.items()
            if inlet.stream is None
        ]
        there = listed([stream for inlet in self._all_inlets for stream in inlet.others])
        return (
            f"no stream for {' and '.join(names)} arrived within {seconds:g} s; streams on the network:"
            f" {there}"
        )
