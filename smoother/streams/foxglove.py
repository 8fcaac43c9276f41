"""Foxglove's WebSocket: the layout of a result shows the session while it lasts, in a result's messages."""

from __future__ import annotations

import asyncio
import logging
import secrets
import socket
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np

from ..array_types import FloatArray
from ..errors import UnoccludeError
from ..io.mcap.merge import Output
from ..io.recording.read import RESULT_PREFIX
from ..io.recording.write import CAMERA
from ..io.result.streams import gap_messages, recovery_streams
from ..io.wire.schemas import message_class, schema_data
from ..live.answers import LiveEstimate, LiveState
from ..measurements.visibility import Gap
from ..recording import JOINTS, JointTracks
from ..result import Recovery
from ..runtime.local_requests import LOOPBACK, OWN_NAMES, LocalDoor, joined
from ..runtime.packages import extra_module
from .arrivals import FrameRows, LiveStep, SourceInfo

#: Of a settled answer, the topics with numbers.
_SETTLED = tuple(f"{RESULT_PREFIX}{name}" for name in ("skeleton", "forearm"))


class LiveMessage(NamedTuple):
    """One message to be sent."""

    topic: str  # Where
    schema: str  # Full name of what it is
    stamp_ns: int
    data: bytes  # Its wire form, protobuf


class _Channels(Output):
    """Takes the place of a file: what channels are, and no file."""

    def __init__(self) -> None:
        self.names: list[tuple[str, str]] = []

    def channel(self, topic: str, schema: str) -> int:
        self.names.append((topic, schema))
        return len(self.names) - 1


class LiveMessages:
    """Makes messages of what a session answers."""

    def __init__(self, info: SourceInfo, suffix: str = "") -> None:
        self._info, self._suffix = info, suffix

    def estimate(self, estimate: LiveEstimate, wanted: Callable[[str], bool]) -> Iterator[LiveMessage]:
        """The arm at a moment, on those of its topics that are wanted."""
        none, settled = FrameRows(), estimate.kind == "settled"
        here = JointTracks(self._info.skeleton, none.t_s, none.position, none.state)
        suffix = self._suffix + ("/settled" if settled else "")

        def is_due(topic: str) -> bool:
            return wanted(topic) and (not settled or topic.startswith(_SETTLED))

        yield from self._encoded([estimate], here, suffix, is_due)

    def frames(
        self, frames: FrameRows, offset_s: float, wanted: Callable[[str], bool]
    ) -> Iterator[LiveMessage]:
        """The camera's joints as they came, on the IMU's clock."""
        t_s = frames.t_s + (offset_s if np.isfinite(offset_s) else 0.0)
        tracks = JointTracks(self._info.skeleton, t_s, frames.position, frames.state)
        yield from self._encoded([], tracks, self._suffix, wanted)

    def gap(self, gap: Gap) -> Iterator[LiveMessage]:
        """A gap that is over, as an event and a line of the log."""
        start, end = (round(t * 1e9) + self._info.origin_ns for t in (gap.start_s, gap.end_s))
        event, line = gap_messages(gap, start, end, self._info.side)
        yield LiveMessage(f"{RESULT_PREFIX}gaps", "foxglove.Event", start, event)
        yield LiveMessage(f"{RESULT_PREFIX}log", "foxglove.Log", end, line)

    def line(self, text: str, t_s: float) -> LiveMessage:
        """A line of the log."""
        line = message_class("foxglove.Log")()
        stamp = round(t_s * 1e9) + self._info.origin_ns
        line.timestamp.FromNanoseconds(stamp)
        line.level, line.message, line.name = line.INFO, text, "unocclude"
        data = line.SerializeToString(deterministic=True)
        return LiveMessage(f"{RESULT_PREFIX}log", "foxglove.Log", stamp, data)

    def _encoded(
        self, estimates: list[LiveEstimate], arm: JointTracks, suffix: str, wanted: Callable[[str], bool]
    ) -> Iterator[LiveMessage]:
        """Messages of an estimate or none and of frames, on those topics that are wanted."""
        channels, recovery = _Channels(), self._recovery(estimates, arm)
        joints = [JOINTS.index(joint) for joint in self._info.joints]
        for stream in recovery_streams(channels, recovery, suffix, CAMERA, 0, self._info.down, joints):
            topic, schema = channels.names[stream.channel]
            if len(stream.time_ns) and wanted(topic):
                encoded = stream.encode(slice(0, len(stream.time_ns)))
                for stamp, row in zip(stream.time_ns.tolist(), encoded, strict=True):
                    yield LiveMessage(topic, schema, stamp, row if isinstance(row, bytes) else row.tobytes())

    def _recovery(self, estimates: list[LiveEstimate], arm: JointTracks) -> Recovery:
        """An estimate or none as a recovery of one sample or none."""
        joints = [joint for joint in JOINTS if all(joint in each.joints for each in estimates)]

        def column(name: str, *shape: int, joint: str = "") -> FloatArray:
            values = [getattr(each, name) for each in estimates]
            return np.array([each[joint] if joint else each for each in values], float).reshape(-1, *shape)

        return Recovery(
            method="live",
            t_s=column("t_s"),
            occluded=np.array([each.state is not LiveState.VISIBLE for each in estimates], bool),
            position=column("position", 3),
            quaternion=column("quaternion", 4),
            velocity=column("velocity", 3),
            pose_covariance=column("pose_covariance", 6, 6),
            velocity_covariance=np.full((len(estimates), 3, 3), np.nan),
            joints={joint: column("joints", 3, joint=joint) for joint in joints},
            joint_covariance={joint: column("joint_covariance", 3, 3, joint=joint) for joint in joints},
            gaps=(),
            calibration=None,
            gravity_direction=np.full(3, np.nan),
            clock_offset_s=0.0,
            clock_offset_sigma_s=0.0,
            arm=arm,
            origin_ns=self._info.origin_ns,
            side=self._info.side,
        )


#: Pages that may connect: Foxglove's own and those of this computer, and its desktop application. Any page
#: that a browser shows may connect to a WebSocket on this computer; the browser sends the page's origin
#: (Origin, RFC 6455, 10.2). A client that sends no Origin is a program of this computer.
DOOR = LocalDoor(guests=("app.foxglove.dev", "foxglove.dev", *OWN_NAMES), schemes=("file", "foxglove", "app"))
#: The head of a request is awaited this long, s, and is no longer than this, bytes.
_HEAD_S, _HEAD_BYTES = 5.0, 16384
#: A side that takes nothing for this long is let go, s.
_PATIENCE_S = 10.0
_REFUSAL = (
    b"HTTP/1.1 403 Forbidden\r\nContent-Type: text/plain\r\nConnection: close\r\n\r\n"
    b"unocclude live lets Foxglove and programs of this computer in, no other page.\n"
)


def is_allowed(head: bytes) -> bool:
    """Whether the head of a request is of no foreign page."""
    lines = (line.partition(":") for line in head.decode("latin-1").split("\r\n")[1:])
    return DOOR.refusal(joined((key, value) for key, _, value in lines), changes=False) is None


class OriginGate:
    """Listens on this computer, and passes on to a server behind it what is not of a foreign page."""

    def __init__(self, port: int, behind: tuple[str, int]):
        listener = socket.create_server((LOOPBACK, port))
        self.port, self._behind = int(listener.getsockname()[1]), behind
        self._loop = asyncio.new_event_loop()
        started = asyncio.start_server(self._serve, sock=listener, limit=_HEAD_BYTES)
        self._server = self._loop.run_until_complete(started)
        self._thread = threading.Thread(target=self._loop.run_forever, name="origin-gate", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Let all connections go."""
        self._loop.call_soon_threadsafe(self._server.close)
        for task in asyncio.all_tasks(self._loop):
            self._loop.call_soon_threadsafe(task.cancel)
        self._loop.call_soon_threadsafe(self._loop.call_later, 0.05, self._loop.stop)
        self._thread.join(_PATIENCE_S)
        self._loop.close()

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writers = [writer]
        try:
            head = await asyncio.wait_for(reader.readuntil(b"\r\n\r\n"), _HEAD_S)
            if not is_allowed(head[:-4]):
                writer.write(_REFUSAL)
                return await writer.drain()
            back, behind = await asyncio.open_connection(*self._behind)
            writers.append(behind)
            behind.write(head)
            ways = [asyncio.ensure_future(_pass_on(*way)) for way in ((reader, behind), (back, writer))]
            try:
                await asyncio.wait(ways, return_when=asyncio.FIRST_COMPLETED)
            finally:
                for way in ways:
                    way.cancel()
        except (OSError, EOFError, asyncio.LimitOverrunError, TimeoutError, asyncio.CancelledError):
            pass  # a client that is gone, or says nothing that this can pass on
        finally:
            for each in writers:
                each.close()


async def _pass_on(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    """Bytes one way until a side closes."""
    with suppress(OSError, TimeoutError):
        while chunk := await reader.read(1 << 16):
            writer.write(chunk)
            await asyncio.wait_for(writer.drain(), _PATIENCE_S)


#: The port that Foxglove proposes.
FOXGLOVE_PORT = 8765
#: Shortest interval between two drawings of the arm, s.
_DRAWN_EACH_S = 0.03


def foxglove_module() -> ModuleType:
    """The package `foxglove`, an extra."""
    return extra_module("foxglove", "foxglove-sdk", "live", ["Context", "start_server"])


class FoxgloveServer:
    """Sends messages to whoever is connected; a slow client misses some and does not delay the others."""

    def __init__(self, infos: Sequence[SourceInfo], port: int = FOXGLOVE_PORT) -> None:
        several = len(infos) > 1
        self._messages = [LiveMessages(info, f"/{info.side}" if several else "") for info in infos]
        self._drawn_s = [float("-inf")] * len(infos)
        self._foxglove = foxglove_module()
        logging.getLogger("foxglove").setLevel(logging.ERROR)
        self._context = self._foxglove.Context()
        self._channels: dict[str, Any] = {}
        self._is_announced = False  # every topic but those of gaps and events
        self._host, self._server = self._hidden_server()
        try:
            self._gate = OriginGate(port, (self._host, self._server.port))
        except OSError as error:
            self._server.stop()
            raise UnoccludeError(
                f"port {port} of {LOOPBACK} cannot be used for Foxglove ({error}); give another with"
                " --foxglove"
            ) from error

    @property
    def address(self) -> str:
        """What is entered in Foxglove under Open connection."""
        return f"ws://{LOOPBACK}:{self._gate.port}"

    def send(self, step: LiveStep) -> None:
        """Send what a step answered of an arm, that at most some 30 times per second."""
        messages, output = self._messages[step.arm], step.output
        if self._is_announced and not any(channel.has_sinks() for channel in self._channels.values()):
            return
        self._is_announced |= output.settled is not None and len(step.frames) > 0
        if len(step.frames):
            self._log(messages.frames(step.frames, output.clock_offset_s, self._is_wanted))
        if not abs(output.now_s - self._drawn_s[step.arm]) < _DRAWN_EACH_S:
            self._drawn_s[step.arm] = output.now_s
            for estimate in (output.now, output.settled):
                if estimate is not None:
                    self._log(messages.estimate(estimate, self._is_wanted))
        if step.gap is not None:
            self._log(messages.gap(step.gap))
        self._log(messages.line(text, output.now_s) for text in step.events)

    def close(self) -> None:
        """Let all connections go."""
        self._gate.close()
        self._server.stop()

    def _is_wanted(self, topic: str) -> bool:
        """Whether somebody looks at a topic, or it has to be announced first."""
        return topic not in self._channels or bool(self._channels[topic].has_sinks())

    def _log(self, messages: Iterable[LiveMessage]) -> None:
        for topic, schema, stamp_ns, data in messages:
            if topic not in self._channels:
                described = self._foxglove.Schema(name=schema, encoding="protobuf", data=schema_data(schema))
                self._channels[topic] = self._foxglove.Channel(
                    topic, schema=described, message_encoding="protobuf", context=self._context
                )
            self._channels[topic].log(data, log_time=max(stamp_ns, 0))

    def _hidden_server(self) -> tuple[str, Any]:
        """The server behind the gate, on a loopback address that no page guesses, where there are several."""
        unguessed = f"127.{secrets.randbelow(256)}.{secrets.randbelow(256)}.{1 + secrets.randbelow(254)}"
        for host in (unguessed, LOOPBACK):
            try:
                return host, self._foxglove.start_server(
                    name="unocclude live", host=host, port=0, context=self._context
                )
            except (OSError, RuntimeError) as error:
                failure = error
        raise UnoccludeError(f"Foxglove's server cannot be started: {failure}") from failure
