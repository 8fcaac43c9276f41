"""What a session shows while it lasts: a line now and then, and one for whatever happens."""

from __future__ import annotations

import math
import threading
import time
from types import TracebackType
from typing import TYPE_CHECKING

from ..runtime.printable import printable
from .output import say

if TYPE_CHECKING:
    from ..streams.session_figures import SessionView, StreamView

#: How often a line is printed, s.
_LINE_S = 2.0
#: How often there may be something new to show, and how long a terminal is waited for in the end, s.
_LOOKED_S, _PATIENCE_S = 0.05, 2.0


class Lines:
    """A line every two seconds for each arm, and one for whatever happens."""

    def __init__(self) -> None:
        self._last = -math.inf
        self._events: dict[str, int] = {}

    def show(self, *views: SessionView) -> None:
        """Print what happened since, and the line if it is time."""
        is_time = time.monotonic() - self._last > _LINE_S
        for view in views:
            arm = f"{view.side} arm: " if len(views) > 1 else ""
            new = view.event_count - self._events.get(view.side, 0)
            for when, sentence in view.events[-new:] if new else ():
                say(f"{when:8.1f} s  {arm}{sentence}")
            self._events[view.side] = view.event_count
            if is_time:
                self._last = time.monotonic()
                print(f"{view.seconds:8.1f} s  {arm}{'; '.join(words(view))}", flush=True)


class Aside:
    """Shows a session from a thread of its own: a slow terminal delays no answer."""

    def __init__(self, lines: Lines) -> None:
        self._lines = lines
        self._views: tuple[SessionView, ...] = ()
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._work, name="lines", daemon=True)

    def __enter__(self) -> Aside:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._closing.set()
        self._thread.join(_PATIENCE_S)

    def show(self, *views: SessionView) -> None:
        """Show the session of each arm as it is now; only the newest is looked at."""
        self._views = views

    def _work(self) -> None:
        while not self._closing.wait(_LOOKED_S):
            if self._views:
                self._lines.show(*self._views)
        if self._views:
            self._lines.show(*self._views)


def words(view: SessionView) -> list[str]:
    """The session in words: the answer, the streams, the clock, the load."""
    streams = [_stream_words(view, stream) for stream in (view.imu, view.skeleton, *view.further)]
    output = view.output
    if output is None:
        return ["nothing has come yet", *streams, f"load {100 * view.load:.0f} %"]
    rest = []
    if output.now is not None:
        rest.append(f"sigma {100 * output.now.sigma_m:.1f} cm, {output.now.sigma_deg:.1f} degrees")
    if math.isfinite(output.clock_offset_s):
        offset = f"clock offset {1e3 * output.clock_offset_s:+.1f}"
        rest.append(f"{offset} +- {1e3 * output.clock_sigma_s:.1f} ms")
    if output.dropped.total:
        rest.append(f"{output.dropped.total} dropped")
    if math.isfinite(output.step_ms):
        rest.append(f"step {output.step_ms:.1f} ms")
    return [_state_words(view), *streams, *rest, f"load {100 * view.load:.0f} %"]


def delay_s(view: SessionView, stream: StreamView) -> float:
    """A stream's delay: the camera's from a frame's moment, as soon as its clock is known."""
    output = view.output
    if stream is view.skeleton and output is not None and math.isfinite(output.camera_latency_s):
        return output.camera_latency_s
    return stream.delay_s


def milliseconds(seconds: float) -> str:
    """A delay for a table."""
    return f"{1e3 * seconds:.0f} ms" if math.isfinite(seconds) else "-"


def _state_words(view: SessionView) -> str:
    output = view.output
    assert output is not None
    state = str(output.state)
    if state == "calibrating":
        return f"calibrating ({printable(output.calibration)})" if output.calibration else "calibrating"
    if state == "lost":
        is_lost = view.imu.is_lost or view.skeleton.is_lost
        return "a stream is lost: no answer" if is_lost else "no answer: catching up with the streams"
    if state == "gap" and output.now is not None and output.now.since_s is not None:
        return f"gap since {output.now_s - output.now.since_s:.1f} s"
    return state


def _stream_words(view: SessionView, stream: StreamView) -> str:
    name = {id(view.imu): "IMU", id(view.skeleton): "camera"}.get(id(stream), stream.name)
    if stream.is_lost:
        return f"{name}: nothing comes"
    missing = f", {stream.missing} missing" if stream.missing else ""
    return f"{name} {stream.rate_hz:.1f} /s, delay {milliseconds(delay_s(view, stream))}{missing}"
