"""A session's source: streams of the Lab Streaming Layer."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from typing import Any, TypeAlias

import numpy as np

from ..body import SEGMENTS
from ..errors import UnoccludeError
from ..io.recording.names import named_side
from ..runtime.printable import printable
from .arrivals import Arrivals, FrameRows, ImuRows, SourceInfo
from .channels import ImuChannels, SkeletonChannels, StreamLabels
from .imu_halves import HalfChannels, ImuHalves, belongs, half_of
from .lsl import LslInlet, LslSamples, listed, lsl_module

#: Content types by which streams are found that were not named.
_IMU_TYPES, _SKELETON_TYPES = ("imu", "accelerometer", "acc"), ("mocap", "skeleton")
_GYRO_TYPES = ("gyroscope", "gyro", "gyr")


#: An IMU of one stream, or an accelerometer, a gyroscope and what joins them.
_Imu: TypeAlias = ImuChannels | tuple[HalfChannels, HalfChannels, ImuHalves]


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
        self._something = threading.Event()
        self._inlets: list[LslInlet] = [
            LslInlet(imu, _IMU_TYPES, self._something.set),
            LslInlet(skeleton, _SKELETON_TYPES, self._something.set) if beside is None else beside._inlets[1],
        ]
        self._beside, self._frame_batches = beside, list[LslSamples]()
        self._further = {
            segment: LslInlet(name, _IMU_TYPES, self._something.set)
            for segment, name in (further or {}).items()
        }
        self._further_channels: dict[str, ImuChannels] = {}
        if gyro is not None:
            self._inlets.append(LslInlet(gyro, _GYRO_TYPES, self._something.set))
        self._side, self._prefer_side, self._body = side, prefer_side, body
        self._start_s = float(np.floor(lsl.local_clock()))
        self._origin_ns = time.time_ns() - int((lsl.local_clock() - self._start_s) * 1e9)
        if beside is not None:
            self._start_s, self._origin_ns = beside._start_s, beside._origin_ns
        self._opened: tuple[_Imu, SkeletonChannels, SourceInfo] | None = None

    def open(
        self,
        seconds: float,  # s
        stopped: Callable[[], bool] = lambda: False,
        say: Callable[[str], None] = lambda _: None,
    ) -> bool:
        """Wait until both streams are there; what the first one sends meanwhile is not lost."""
        imu_inlet, skeleton_inlet = self._inlets[:2]
        for inlet in self._own_inlets:
            inlet.start()
        until = time.monotonic() + seconds
        imu = skeleton = None
        while imu is None or skeleton is None or len(self._further_channels) < len(self._further):
            for inlet in self._all_inlets:
                inlet.check()
            self._look_for_further(say)
            if imu is None and imu_inlet.stream is not None:
                imu = self._imu_there(say)
            if skeleton is None and skeleton_inlet.stream is not None:
                side = self._side or named_side("" if imu_inlet.stream is None else imu_inlet.stream.name())
                labels = StreamLabels.of(skeleton_inlet.stream)
                skeleton = SkeletonChannels.of(labels, side or None, self._prefer_side, self._body)
                if self._beside is None:
                    say(f"skeleton stream {skeleton_inlet.stream.name()} is there")
            if stopped():
                return False
            if time.monotonic() > until:
                raise UnoccludeError(self._missing(seconds))
            self._something.wait(0.1)
            self._something.clear()
        self._opened = imu, skeleton, self._described(skeleton)
        return True

    def _imu_there(self, say: Callable[[str], None]) -> _Imu | None:
        """What the IMU is made of; None while its second stream is not there."""
        stream = self._inlets[0].stream
        labels = StreamLabels.of(stream)
        if len(self._inlets) == 2 and half_of(labels) == "acc":
            self._look_for_gyro(stream)
        if len(self._inlets) == 2:
            say(f"IMU stream {stream.name()} is there")
            return ImuChannels.of(labels)
        gyro = self._inlets[2].stream
        if gyro is None:
            return None
        halves = HalfChannels.of(labels, "acc"), HalfChannels.of(StreamLabels.of(gyro), "gyro")
        say(f"accelerometer stream {stream.name()} and gyroscope stream {gyro.name()} are there")
        return (*halves, ImuHalves(stream.name(), gyro.name()))

    def _look_for_further(self, say: Callable[[str], None]) -> None:
        """Take down the IMUs beyond the forearm that are there."""
        for segment, inlet in self._further.items():
            if segment not in self._further_channels and inlet.stream is not None:
                self._further_channels[segment] = ImuChannels.of(StreamLabels.of(inlet.stream))
                say(f"IMU stream {inlet.stream.name()} of the {SEGMENTS[segment].label} is there")

    @property
    def _all_inlets(self) -> list[LslInlet]:
        return [*self._inlets, *self._further.values()]

    @property
    def _own_inlets(self) -> list[LslInlet]:
        """Without the skeleton's, where that is the other arm's as well."""
        shared = [] if self._beside is None else [self._inlets[1]]
        return [inlet for inlet in self._all_inlets if inlet not in shared]

    def _look_for_gyro(self, stream: Any) -> None:
        """Receive the one stream that is the gyroscope beside an accelerometer's, by name and type."""
        beside = [each for each in self._inlets[0].others if each.uid() != stream.uid()]
        found = [each for each in beside if belongs(each.name(), each.type(), stream.name())]
        if len(found) == 1:
            inlet = LslInlet(found[0].name(), (found[0].type().lower(),), self._something.set)
            self._inlets.append(inlet)
            inlet.start()

    @property
    def info(self) -> SourceInfo:
        """What the session is made of."""
        return self._open[2]

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
        imu_channels, skeleton_channels, _ = self._open
        imu_batches, *gyro_batches = [inlet.samples() for inlet in (self._inlets[0], *self._inlets[2:])]
        if self._beside is None:
            self._frame_batches = self._inlets[1].samples()
        frame_batches = (self._beside or self)._frame_batches
        events = tuple(text for inlet in self._own_inlets for text in inlet.events())
        further = {
            segment: ImuRows.joined(
                [self._imu(self._further_channels[segment], batch) for batch in inlet.samples()]
            )
            for segment, inlet in self._further.items()
        }
        frames = [self._frames(skeleton_channels, batch) for batch in frame_batches]
        if isinstance(imu_channels, ImuChannels):
            imu = ImuRows.joined([self._imu(imu_channels, batch) for batch in imu_batches])
        else:
            acc_channels, gyro_channels, halves = imu_channels
            acc = ImuRows.joined([self._half(acc_channels, batch) for batch in imu_batches])
            gyro = ImuRows.joined([self._half(gyro_channels, batch) for batch in gyro_batches[0]])
            imu, said = halves.joined(acc, gyro)
            events += said
        return Arrivals(imu, FrameRows.joined(frames), events, further)

    def close(self) -> None:
        """Let the streams go."""
        for inlet in self._own_inlets:
            inlet.close()

    @property
    def _open(self) -> tuple[_Imu, SkeletonChannels, SourceInfo]:
        assert self._opened is not None
        return self._opened

    def _imu(self, channels: ImuChannels, batch: LslSamples) -> ImuRows:
        acc, gyro, mag = channels.values(batch.values)
        return ImuRows(batch.t_s - self._start_s, acc, gyro, batch.arrival_s - self._start_s, mag)

    def _half(self, channels: HalfChannels, batch: LslSamples) -> ImuRows:
        """Samples of either half, as both: the joiner takes what counts."""
        values = channels.values(batch.values)
        return ImuRows(batch.t_s - self._start_s, values, values, batch.arrival_s - self._start_s)

    def _frames(self, channels: SkeletonChannels, batch: LslSamples) -> FrameRows:
        position, state = channels.values(batch.values)
        return FrameRows(batch.t_s - self._start_s, position, state, batch.arrival_s - self._start_s)

    def _described(self, skeleton: SkeletonChannels) -> SourceInfo:
        imu_name, skeleton_name, *gyro_names = [printable(inlet.stream.name()) for inlet in self._inlets]
        corrections = [
            f"{printable(inlet.stream.name())} {1e3 * inlet.correction_s:+.1f} ms"
            for inlet in self._all_inlets
        ]
        notes = [f"LSL's time correction: {', '.join(corrections)}."]
        if gyro_names:
            notes.append(
                f"Accelerometer {imu_name} and gyroscope {gyro_names[0]} are two streams: the accelerometer"
                " is interpolated to the gyroscope's stamps."
            )
        return SourceInfo(
            imu_name,
            skeleton_name,
            skeleton.side,
            skeleton.joints,
            self._origin_ns,
            skeleton.camera_frame,
            lsl_start_s=self._start_s,
            notes=tuple(notes),
            further={segment: printable(inlet.stream.name()) for segment, inlet in self._further.items()},
        )

    def _missing(self, seconds: float) -> str:
        types = ("imu", _IMU_TYPES), ("skeleton", _SKELETON_TYPES), ("gyro", _GYRO_TYPES)
        names = [
            f"--{option} {inlet.wanted}" if inlet.wanted is not None else f"{option} of type {known[0]}"
            for inlet, (option, known) in zip(self._inlets, types, strict=False)
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
