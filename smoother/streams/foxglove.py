"""Foxglove's WebSocket: the layout of a result shows the session while it lasts, in a result's messages."""

from __future__ import annotations

import logging
import secrets
from collections.abc import Callable, Iterable, Iterator, Sequence
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
from ..runtime.packages import extra_module
from .arrivals import FrameRows, LiveStep, SourceInfo
from .origin_gate import LOOPBACK, OriginGate

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
        count = len(estimates)

        def column(values: list[FloatArray], *shape: int) -> FloatArray:
            return np.array(values, float).reshape(count, *shape)

        return Recovery(
            method="live",
            t_s=np.array([each.t_s for each in estimates], float),
            occluded=np.array([each.state is not LiveState.VISIBLE for each in estimates], bool),
            position=column([each.position for each in estimates], 3),
            quaternion=column([each.quaternion for each in estimates], 4),
            velocity=column([each.velocity for each in estimates], 3),
            pose_covariance=column([each.pose_covariance for each in estimates], 6, 6),
            velocity_covariance=np.full((count, 3, 3), np.nan),
            joints={joint: column([each.joints[joint] for each in estimates], 3) for joint in joints},
            joint_covariance={
                joint: column([each.joint_covariance[joint] for each in estimates], 3, 3) for joint in joints
            },
            gaps=(),
            calibration=None,
            gravity_direction=np.full(3, np.nan),
            clock_offset_s=0.0,
            clock_offset_sigma_s=0.0,
            arm=arm,
            origin_ns=self._info.origin_ns,
            side=self._info.side,
        )


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
        for message in messages:
            if message.topic not in self._channels:
                self._channels[message.topic] = self._channel(message.topic, message.schema)
            self._channels[message.topic].log(message.data, log_time=max(message.stamp_ns, 0))

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

    def _channel(self, topic: str, schema: str) -> Any:
        described = self._foxglove.Schema(name=schema, encoding="protobuf", data=schema_data(schema))
        return self._foxglove.Channel(
            topic, schema=described, message_encoding="protobuf", context=self._context
        )
