"""Foxglove's WebSocket: the layout of a result shows the session while it lasts."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Sequence
from types import ModuleType
from typing import Any

from ..errors import UnoccludeError
from ..io.wire.schemas import schema_data
from ..live.estimate import LiveOutput
from ..measurements.visibility import Gap
from ..runtime.packages import extra_module
from .arrivals import FrameRows, SourceInfo
from .live_messages import TOPICS, LiveMessage, LiveMessages

#: The port that Foxglove proposes, and the address that nobody but this computer reaches.
FOXGLOVE_PORT = 8765
LOOPBACK = "127.0.0.1"
#: The arm is drawn at most so often, s.
_DRAWN_EACH_S = 0.03


def foxglove_module() -> ModuleType:
    """The package `foxglove`, an extra.

    Raises
    ------
    UnoccludeError
        It is not installed, or too old; the sentence says how to get it.
    """
    return extra_module("foxglove", "foxglove-sdk", "live", ["Context", "start_server"])


class FoxgloveServer:
    """Sends messages to whoever is connected; one who is slow misses some and holds nobody up.

    Parameters
    ----------
    info : SourceInfo
        Of the session.
    port : int
        0 takes a free one.

    Raises
    ------
    UnoccludeError
        foxglove-sdk is not installed, or the port is taken.
    """

    def __init__(self, info: SourceInfo, port: int = FOXGLOVE_PORT):
        self._messages = LiveMessages(info)
        self._drawn_s = float("-inf")
        self._foxglove = foxglove_module()
        logging.getLogger("foxglove").setLevel(logging.ERROR)
        self._context = self._foxglove.Context()
        self._channels: dict[str, Any] = {
            topic: self._channel(topic, schema) for topic, schema in TOPICS.items()
        }
        try:
            self._server = self._foxglove.start_server(
                name="unocclude live", host=LOOPBACK, port=port, context=self._context
            )
        except (OSError, RuntimeError) as error:
            raise UnoccludeError(
                f"port {port} of {LOOPBACK} cannot be used for Foxglove ({error}); give another with"
                " --foxglove"
            ) from error

    @property
    def address(self) -> str:
        """What is entered in Foxglove under Open connection."""
        return f"ws://{LOOPBACK}:{self._server.port}"

    def send(self, output: LiveOutput, frames: FrameRows, gap: Gap | None, events: Sequence[str]) -> None:
        """Send what a step answered, the arm at most some 30 times a second."""
        wanted = {topic for topic, channel in self._channels.items() if channel.has_sinks()}
        if not wanted:
            return
        if len(frames):
            self.log(self._messages.frames(frames, output.clock_offset_s, wanted))
        if not abs(output.now_s - self._drawn_s) < _DRAWN_EACH_S:
            self._drawn_s = output.now_s
            for estimate in (output.now, output.settled):
                if estimate is not None:
                    self.log(self._messages.estimate(estimate, wanted))
        if gap is not None:
            self.log(self._messages.gap(gap))
        self.log(self._messages.line(text, output.now_s) for text in events)

    def log(self, messages: Iterable[LiveMessage]) -> None:
        """Send messages to whoever subscribed to their topics."""
        for message in messages:
            self._channels[message.topic].log(message.data, log_time=max(message.stamp_ns, 0))

    def close(self) -> None:
        """Let all connections go."""
        self._server.stop()

    def _channel(self, topic: str, schema: str) -> Any:
        described = self._foxglove.Schema(name=schema, encoding="protobuf", data=schema_data(schema))
        return self._foxglove.Channel(
            topic, schema=described, message_encoding="protobuf", context=self._context
        )
