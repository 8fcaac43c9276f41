"""What a session shows while it lasts: a line now and then, and one for whatever happens."""

from __future__ import annotations

import math
import sys
import threading
import time
from contextlib import suppress
from queue import Full, Queue
from types import TracebackType
from typing import TYPE_CHECKING

from ..runtime.printable import printable
from .output import say

if TYPE_CHECKING:
    from ..live.answers import LiveOutput
    from ..streams.session_figures import SessionFigures, StreamHealth

#: How often a line is printed, s.
_LINE_S = 2.0
#: How long a terminal is waited for in the end, s, and how many lines wait for it at most.
_PATIENCE_S, _MOST_WAITING = 2.0, 1000


class Lines:
    """A line every two seconds for each arm, and one for whatever happens.

    They are printed by a thread of its own: a slow terminal delays no answer.
    """

    def __init__(self) -> None:
        self._last = -math.inf
        self._events: dict[str, int] = {}
        self._waiting: Queue[str | None] = Queue(_MOST_WAITING)
        self._thread = threading.Thread(target=self._work, name="lines", daemon=True)

    def __enter__(self) -> Lines:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._put(None)
        self._thread.join(_PATIENCE_S)

    def show(self, *arms: SessionFigures) -> None:
        """Print what happened to each arm since, and the line if it is time."""
        is_time = time.monotonic() - self._last > _LINE_S
        for figures in arms:
            arm = f"{figures.side} arm: " if len(arms) > 1 else ""
            new = figures.event_count - self._events.get(figures.side, 0)
            for when, sentence in list(figures.events)[-new:] if new else ():
                self._put(f"{when:8.1f} s  {arm}{sentence}")
            self._events[figures.side] = figures.event_count
            if is_time:
                self._last = time.monotonic()
                self._put(f"{figures.seconds:8.1f} s  {arm}{'; '.join(words(figures))}")

    def _put(self, line: str | None) -> None:
        with suppress(Full):
            self._waiting.put_nowait(line)

    def _work(self) -> None:
        while (line := self._waiting.get()) is not None:
            say(line)
            sys.stdout.flush()


def words(figures: SessionFigures) -> list[str]:
    """The session in words: the answer, the streams, the clock, the load."""
    output, camera = figures.output, figures.skeleton
    imu, *further = figures.imus.values()
    # the camera's delay is from a frame's moment, as soon as its clock is known
    is_known = output is not None and math.isfinite(output.camera_latency_s)
    latency_s = output.camera_latency_s if output is not None and is_known else camera.delay_s
    streams = [
        _stream_words("IMU", imu, imu.delay_s, figures.now_s),
        _stream_words("camera", camera, latency_s, figures.now_s),
        *(_stream_words(each.name, each, each.delay_s, figures.now_s) for each in further),
    ]
    load = f"load {100 * figures.load:.0f} %"
    if output is None:
        return ["nothing has come yet", *streams, load]
    rest = []
    if output.now is not None:
        rest.append(f"sigma {100 * output.now.sigma_m:.1f} cm, {output.now.sigma_deg:.1f} degrees")
    if math.isfinite(output.clock_offset_s):
        offset = f"clock offset {1e3 * output.clock_offset_s:+.1f}"
        rest.append(f"{offset} +- {1e3 * output.clock_sigma_s:.1f} ms")
    if dropped := sum(output.dropped.values()):
        rest.append(f"{dropped} dropped")
    if math.isfinite(output.step_ms):
        rest.append(f"step {output.step_ms:.1f} ms")
    return [_state_words(figures, output), *streams, *rest, load]


def _state_words(figures: SessionFigures, output: LiveOutput) -> str:
    state = str(output.state)
    if state == "calibrating":
        return f"calibrating ({printable(output.calibration)})" if output.calibration else "calibrating"
    if state == "lost":
        is_lost = figures.imu.is_lost or figures.skeleton.is_lost
        return "a stream is lost: no answer" if is_lost else "no answer: catching up with the streams"
    if state == "gap" and output.now is not None and output.now.since_s is not None:
        return f"gap since {output.now_s - output.now.since_s:.1f} s"
    return state


def _stream_words(name: str, stream: StreamHealth, delay_s: float, now_s: float) -> str:
    if stream.is_lost:
        return f"{name}: nothing comes"
    delay = f"{1e3 * delay_s:.0f} ms" if math.isfinite(delay_s) else "-"
    missing = f", {stream.missing} missing" if stream.missing else ""
    return f"{name} {stream.rate_hz(now_s):.1f} /s, delay {delay}{missing}"
