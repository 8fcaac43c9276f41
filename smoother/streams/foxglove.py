"""Foxglove's WebSocket: the layout of a result shows the session while it lasts, in a result's messages."""

from __future__ import annotations

import logging
import os
import secrets
import selectors
import socket
import socketserver
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
from .arrivals import LiveStep, Rows, SourceInfo

#: Of a settled answer, the topics with numbers.
_SETTLED = tuple(f"{RESULT_PREFIX}{name}" for name in ("skeleton", "forearm"))
#: No frame.
_NONE = Rows(
    columns={"position": np.empty((0, len(JOINTS), 3)), "state": np.empty((0, len(JOINTS)), np.int8)}
)


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

    def arm(
        self,
        estimate: LiveEstimate | None,
        wanted: Callable[[str], bool],
        frames: Rows = _NONE,
        offset_s: float = 0.0,
    ) -> Iterator[LiveMessage]:
        """The arm at a moment, and the camera's joints as they came, on those topics that are wanted."""
        is_settled = estimate is not None and estimate.kind == "settled"
        frames = frames if len(frames) else _NONE
        t_s = frames.t_s + (offset_s if np.isfinite(offset_s) else 0.0)  # on the IMU's clock
        seen = JointTracks(self._info.skeleton, t_s, frames["position"], frames["state"])
        recovery = self._recovery([] if estimate is None else [estimate], seen)
        channels, suffix = _Channels(), self._suffix + ("/settled" if is_settled else "")
        joints = [JOINTS.index(joint) for joint in self._info.joints]
        for stream in recovery_streams(channels, recovery, suffix, CAMERA, 0, self._info.down, joints):
            topic, schema = channels.names[stream.channel]
            is_due = len(stream.time_ns) > 0 and (not is_settled or topic.startswith(_SETTLED))
            if is_due and wanted(topic):
                encoded = stream.encode(slice(0, len(stream.time_ns)))
                for stamp, row in zip(stream.time_ns.tolist(), encoded, strict=True):
                    yield LiveMessage(topic, schema, stamp, row if isinstance(row, bytes) else row.tobytes())

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
    return not DOOR.refusal(joined((key, value) for key, _, value in lines), changes=False)


class _Guest(socketserver.BaseRequestHandler):
    """A connection: refused, or passed on to the server behind the gate until a side closes."""

    server: OriginGate

    def handle(self) -> None:
        """Serve it, in a thread of its own."""
        with suppress(OSError):  # a client that is gone, or says nothing that can be passed on
            self.request.settimeout(_HEAD_S)
            head = b""
            while b"\r\n\r\n" not in head:
                part = self.request.recv(_HEAD_BYTES)
                head += part
                if not part or len(head) > _HEAD_BYTES:
                    return
            if not is_allowed(head[: head.index(b"\r\n\r\n")]):
                self.request.sendall(_REFUSAL)
                return
            with socket.create_connection(self.server.behind) as behind, selectors.DefaultSelector() as ready:
                behind.sendall(head)
                for side, other in ((self.request, behind), (behind, self.request)):
                    side.settimeout(_PATIENCE_S)
                    ready.register(side, selectors.EVENT_READ, (side, other))
                while True:
                    for key, _ in ready.select():
                        side, other = key.data
                        if not (chunk := side.recv(1 << 16)):
                            return
                        other.sendall(chunk)


class OriginGate(socketserver.ThreadingTCPServer):
    """Listens on this computer, and passes on to a server behind it what is not of a foreign page."""

    daemon_threads = True
    allow_reuse_address = os.name == "posix"

    def __init__(self, port: int, behind: tuple[str, int]):
        self.behind = behind
        super().__init__((LOOPBACK, port), _Guest)
        threading.Thread(target=self.serve_forever, args=(0.05,), name="origin-gate", daemon=True).start()


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
        return f"ws://{LOOPBACK}:{self._gate.server_address[1]}"

    def send(self, step: LiveStep) -> None:
        """Send what a step answered of an arm, that at most some 30 times per second."""
        messages, output = self._messages[step.arm], step.output
        if self._is_announced and not any(channel.has_sinks() for channel in self._channels.values()):
            return
        self._is_announced |= output.settled is not None and len(step.frames) > 0
        is_due = not abs(output.now_s - self._drawn_s[step.arm]) < _DRAWN_EACH_S
        if is_due:
            self._drawn_s[step.arm] = output.now_s
        now, settled = (output.now, output.settled) if is_due else (None, None)
        if now is not None or len(step.frames):
            self._log(messages.arm(now, self._is_wanted, step.frames, output.clock_offset_s))
        if settled is not None:
            self._log(messages.arm(settled, self._is_wanted))
        if step.gap is not None:
            self._log(messages.gap(step.gap))
        self._log(messages.line(text, output.now_s) for text in step.events)

    def close(self) -> None:
        """Let all connections go."""
        self._gate.shutdown()
        self._gate.server_close()
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
