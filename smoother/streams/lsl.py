"""Streams of the Lab Streaming Layer: the library `pylsl`, an extra; received by threads, and sent."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from functools import cache
from pathlib import Path
from queue import Empty, SimpleQueue
from types import ModuleType
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from ..array_types import FloatArray
from ..errors import UnoccludeError
from ..live.answers import LiveEstimate, LiveOutput, LiveState
from ..live.arm_angles import ANGLES, live_angles
from ..measurements.visibility import Gap
from ..recording import JOINTS
from ..runtime.packages import extra_module
from ..runtime.printable import printable
from .arrivals import FrameRows, SourceInfo
from .channels import StreamLabels

Item = TypeVar("Item")

#: Where liblsl looks for settings of the user's own.
_SETTINGS = (
    *("lsl_api.cfg", "~/lsl_api/lsl_api.cfg", "/etc/lsl_api/lsl_api.cfg"),
)  # fmt: skip
#: The library writes lines of its log to the terminal; -3 is the least.
_NO_LOG = "[log]\nlevel = -3\n"


def user_settings() -> Path | None:
    """The file with the user's own settings of liblsl; None without one."""
    named = os.environ.get("LSLAPICFG")
    if named:
        return Path(named)
    return next((path for path in (Path(file).expanduser() for file in _SETTINGS) if path.exists()), None)


@cache
def lsl_module() -> ModuleType:
    """The package `pylsl`, which keeps silent on the terminal unless the user has settings for it."""
    try:
        pylsl = extra_module("pylsl", "pylsl", "live")
    except (RuntimeError, OSError) as error:
        raise UnoccludeError(
            "pylsl is installed without the library liblsl; install a wheel of pylsl that brings it"
            " (`pip install -U pylsl`), or liblsl itself, and name its file in PYLSL_LIB"
        ) from error
    if user_settings() is None and hasattr(pylsl, "set_config_content"):
        pylsl.set_config_content(_NO_LOG)
    return pylsl


def listed(streams: Sequence[Any]) -> str:
    """Names and types of streams, for a sentence."""
    names = sorted({f"{stream.name()} (type {stream.type() or 'none'})" for stream in streams})
    shown = [printable(name[:80]) for name in names[:8]]
    more = [f"and {len(names) - 8} more"] if len(names) > 8 else []
    return ", ".join([*shown, *more]) or "none"


def is_wanted(stream: Any, wanted: str) -> bool:
    """Whether a stream is meant: by its name or source_id, or by a part of the name."""
    name = stream.name()
    return wanted in (name, stream.source_id()) or wanted.lower() in name.lower()


#: Samples that are received together at most, and for how long the library holds them, s.
_MOST, _BUFFER_S = 512, 120
#: Waits of the thread: for streams to answer, for samples, for the first estimate of the clocks, s.
_RESOLVE_S, _PULL_S, _CLOCK_S = 1.0, 0.2, 3.0


class LslSamples(NamedTuple):
    """Samples that came together."""

    t_s: FloatArray  # (n,) s: stamps on this computer's LSL clock: as sent, and the library's time correction
    values: NDArray  # (n, channels)
    arrival_s: FloatArray  # (n,) s: when they came, on the same clock


class LslInlet:
    """Receives a stream, also after it was lost."""

    def __init__(self, wanted: str | None, types: tuple[str, ...], wake: Callable[[], None]):
        self.stream: Any = None
        self.others: list[Any] = []
        self.correction_s = float("nan")
        self.wanted, self._types, self._wake = wanted, types, wake
        self._samples: SimpleQueue[LslSamples] = SimpleQueue()
        self._events: SimpleQueue[str] = SimpleQueue()
        self._labels: StreamLabels | None = None
        self._failure: UnoccludeError | None = None
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._work, name="lsl-inlet", daemon=True)

    def start(self) -> None:
        """Look for the stream, and receive it."""
        self._thread.start()

    def samples(self) -> list[LslSamples]:
        """What came since the last call."""
        self.check()
        return _emptied(self._samples)

    def events(self) -> list[str]:
        """What happened to the stream since the last call, a sentence each."""
        return _emptied(self._events)

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
        """Refuse a stream that came back as another one; warn of other changes."""
        difference = before.difference(now)
        if difference:
            raise UnoccludeError(
                f"the stream {printable(now.name)} came back with {printable(difference)};"
                " begin a new session"
            )
        if stream.source_id() != self.stream.source_id():
            self._events.put(f"{printable(now.name)}: found again by its name, its source_id is another")
        rates = [float(each.nominal_srate()) for each in (self.stream, stream)]
        if rates[0] != rates[1]:
            self._events.put(f"{printable(now.name)}: states {rates[1]:g} /s instead of {rates[0]:g} /s")

    def _matching(self) -> Any:
        """The stream that is meant among those that answered; None where it is not there."""
        if self.stream is not None:
            return self._again()
        if self.wanted is not None:
            exact = [s for s in self.others if self.wanted in (s.name(), s.source_id())]
            fitting = exact or [stream for stream in self.others if is_wanted(stream, self.wanted)]
            # some devices give all of their streams one name
            fitting = [stream for stream in fitting if stream.type().lower() in self._types] or fitting
        else:
            fitting = [stream for stream in self.others if stream.type().lower() in self._types]
        if len({stream.uid() for stream in fitting}) <= 1:
            return fitting[0] if fitting else None
        option = self.wanted if self.wanted is not None else "/".join(self._types)
        raise UnoccludeError(
            f"several streams are meant by {option}: {listed(fitting)}; give the whole name or the source_id"
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
        t_s = np.asarray(stamps, float) + self.correction_s
        self._samples.put(LslSamples(t_s, np.asarray(values), np.full(len(t_s), arrival)))
        self._wake()


def _emptied(queue: SimpleQueue[Item]) -> list[Item]:
    """What is in a queue."""
    items: list[Item] = []
    try:
        while True:
            items.append(queue.get_nowait())
    except Empty:
        return items


#: What the channel `state` says.
STATES = {LiveState.CALIBRATING: 0, LiveState.VISIBLE: 1, LiveState.GAP: 2, LiveState.LOST: 3}


class LslOutlet:
    """Sends `now` as a stream NAME and `settled` as NAME_settled, of type MoCap, a sample a step."""

    def __init__(self, name: str, info: SourceInfo):
        self._start_s = info.lsl_start_s
        self._side = f"_{info.side}" if info.side else ""
        self._down = info.down
        self._outlets = {
            "now": self._outlet(name, info),
            "settled": self._outlet(f"{name}_settled", info),
        }

    def send(self, output: LiveOutput, frames: FrameRows, gap: Gap | None, events: Sequence[str]) -> None:
        """Send what a step answered; frames, gaps and events have no place in a stream of numbers."""
        start_s = self._start_s
        if start_s is None:  # a recording is played: the step's present is now
            start_s = lsl_module().local_clock() - output.now_s
        for kind, estimate in (("now", output.now), ("settled", output.settled)):
            t_s = output.now_s if estimate is None else estimate.t_s
            values = [float(value) for *_, value in self._columns(output, estimate)]
            self._outlets[kind].push_sample(values, start_s + t_s)

    def close(self) -> None:
        """Let all receivers go."""
        self._outlets.clear()

    def _outlet(self, name: str, info: SourceInfo):  # type: ignore[no-untyped-def]
        lsl = lsl_module()
        columns = list(self._columns(LiveOutput(0.0, LiveState.CALIBRATING), None))
        stream = lsl.StreamInfo(
            name, "MoCap", len(columns), lsl.IRREGULAR_RATE, lsl.cf_double64, f"unocclude-{name}"
        )
        described = stream.desc().append_child("channels")
        for *texts, _ in columns:
            channel = described.append_child("channel")
            for key, text in zip(("label", "marker", "type", "unit"), texts, strict=True):
                if text:
                    channel.append_child_value(key, text)
        acquisition = stream.desc().append_child("acquisition")
        for key, text in (("manufacturer", "unocclude"), ("imu", info.imu), ("skeleton", info.skeleton)):
            acquisition.append_child_value(key, text)
        return lsl.StreamOutlet(stream)

    def _columns(
        self, output: LiveOutput, estimate: LiveEstimate | None
    ) -> Iterator[tuple[str, str, str, str, float]]:
        """Label, marker, type, unit and value of every channel; nan without an estimate."""
        side, nothing = self._side, np.full(4, np.nan)
        places: dict[str, tuple[FloatArray, FloatArray]] = {}
        turn, sigma_deg, since_s, lag_s = nothing, np.nan, 0.0, 0.0
        angles: dict[str, tuple[float, float]] = {}
        if estimate is not None:
            places = {joint: (at, estimate.joint_covariance[joint]) for joint, at in estimate.joints.items()}
            places["imu"] = estimate.position, estimate.pose_covariance[:3, :3]
            turn, sigma_deg, lag_s = estimate.quaternion, estimate.sigma_deg, output.now_s - estimate.t_s
            since_s = 0.0 if estimate.since_s is None else estimate.t_s - estimate.since_s
            angles = live_angles(estimate, self._down)
        for marker in ("imu", *JOINTS):
            place, covariance = places.get(marker, (nothing, np.full((3, 3), np.nan)))
            for axis, value in zip("XYZ", place, strict=False):
                yield f"{marker}{side}_{axis.lower()}", marker + side, f"Position{axis}", "meters", value
            # on the worst axis
            yield f"{marker}{side}_sigma", "", "Sigma", "meters", float(np.sqrt(np.diag(covariance).max()))
        for axis, letter, value in zip("wxyz", "ABCD", turn, strict=True):
            yield f"imu{side}_q{axis}", "imu" + side, f"Orientation{letter}", "quaternion", value
        yield f"imu{side}_sigma_deg", "", "Sigma", "degrees", sigma_deg
        state = STATES[output.state if estimate is None else estimate.state]
        yield "state", "", "State", "0 calibrating, 1 visible, 2 gap, 3 lost", float(state)
        yield "gap", "", "Time", "seconds", since_s
        yield "lag", "", "Time", "seconds", lag_s
        for name in ANGLES:
            for suffix, kind, value in zip(
                ("", "_sigma"), ("Angle", "Sigma"), angles.get(name, nothing[:2]), strict=True
            ):
                yield f"{name}{side}{suffix}", "", kind, "degrees", value
        is_trusted = estimate is not None and output.trusted
        yield "trusted", "", "State", "1 trusted, 0 with care or no answer", float(is_trusted)
