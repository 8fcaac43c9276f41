"""Foxglove's WebSocket: the layout of a result shows the session while it lasts, in a result's messages."""

from __future__ import annotations

import logging
import secrets
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np

from ..array_types import FloatArray
from ..errors import UnoccludeError
from ..io.mcap.merge import Output
from ..io.recording.read import RESULT_PREFIX
from ..io.recording.write import CAMERA
from ..io.result.messages import gap_messages
from ..io.result.streams import recovery_streams
from ..io.wire.schemas import message_class, schema_data
from ..live.answers import LiveEstimate, LiveOutput, LiveState
from ..measurements.visibility import Gap
from ..recording import JOINTS, JointTracks
from ..result import Recovery
from ..runtime.packages import extra_module
from .arrivals import FrameRows, SourceInfo
from .origin_gate import LOOPBACK, OriginGate

#: Topics of the present, of the settled answer (only those with numbers), of the camera's frames, of gaps.
_NOW = {
    "skeleton": "unocclude.Skeleton",
    "forearm": "foxglove.Odometry",
    "arm": "foxglove.SceneUpdate",
    "beads": "foxglove.PointCloud",
    "tf": "foxglove.FrameTransforms",
    "joints": "foxglove.JointStates",
}
_SETTLED = {name: _NOW[name] for name in ("skeleton", "forearm")}
_FRAMES = {"camera": "unocclude.Skeleton", "arm_camera": "foxglove.SceneUpdate"}
_GAPS = {"gaps": "foxglove.Event", "log": "foxglove.Log"}


def topics_of(suffix: str) -> dict[str, str]:
    """Every topic of an arm, and the full name of its schema; gaps and log are of both arms."""
    of_arm = {f"{RESULT_PREFIX}{name}{suffix}": schema for name, schema in (_NOW | _FRAMES).items()}
    settled = {f"{RESULT_PREFIX}{name}{suffix}/settled": schema for name, schema in _SETTLED.items()}
    return of_arm | settled | {f"{RESULT_PREFIX}{name}": schema for name, schema in _GAPS.items()}


#: Of a session with one arm.
TOPICS = topics_of("")


class LiveMessage(NamedTuple):
    """One message to be sent."""

    topic: str  # Where, and the full name of what it is
    schema: str  # Where, and the full name of what it is
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

    def __init__(self, info: SourceInfo, suffix: str = ""):
        self._info, self._suffix = info, suffix
        self._down = info.down

    def estimate(self, estimate: LiveEstimate, wanted: Collection[str] = TOPICS) -> Iterator[LiveMessage]:
        """The arm at a moment, on those of its topics that are wanted."""
        names, suffix = (_NOW, "") if estimate.kind == "now" else (_SETTLED, "/settled")
        none = FrameRows()
        here = JointTracks(self._info.skeleton, none.t_s, none.position, none.state)
        yield from self._encoded(estimate, here, self._suffix + suffix, names, wanted)

    def frames(
        self, frames: FrameRows, offset_s: float, wanted: Collection[str] = TOPICS
    ) -> Iterator[LiveMessage]:
        """The camera's joints as they came, on the IMU's clock."""
        t_s = frames.t_s + (offset_s if np.isfinite(offset_s) else 0.0)
        tracks = JointTracks(self._info.skeleton, t_s, frames.position, frames.state)
        yield from self._encoded(None, tracks, self._suffix, _FRAMES, wanted)

    def gap(self, gap: Gap) -> Iterator[LiveMessage]:
        """A gap that is over, as an event and a line of the log."""
        start, end = (round(t * 1e9) + self._info.origin_ns for t in (gap.start_s, gap.end_s))
        events, lines = gap_messages([gap], np.array([start]), np.array([end]), self._info.side)
        yield LiveMessage(f"{RESULT_PREFIX}gaps", "foxglove.Event", start, events[0])
        yield LiveMessage(f"{RESULT_PREFIX}log", "foxglove.Log", end, lines[0])

    def line(self, text: str, t_s: float) -> LiveMessage:
        """A line of the log."""
        line = message_class("foxglove.Log")()
        stamp = round(t_s * 1e9) + self._info.origin_ns
        line.timestamp.FromNanoseconds(stamp)
        line.level, line.message, line.name = line.INFO, text, "unocclude"
        data = line.SerializeToString(deterministic=True)
        return LiveMessage(f"{RESULT_PREFIX}log", "foxglove.Log", stamp, data)

    def _encoded(
        self,
        estimate: LiveEstimate | None,
        arm: JointTracks,
        suffix: str,
        names: Collection[str],
        wanted: Collection[str],
    ) -> Iterator[LiveMessage]:
        """Messages of an estimate and of frames, on those of some topics that are wanted."""
        topics = {f"{RESULT_PREFIX}{name}{suffix}" for name in names} & set(wanted)
        if not topics:
            return
        channels, recovery = _Channels(), self._recovery(estimate, arm)
        joints = [JOINTS.index(joint) for joint in self._info.joints]
        for stream in recovery_streams(channels, recovery, suffix, CAMERA, 0, self._down, joints):
            topic, schema = channels.names[stream.channel]
            if topic not in topics:
                continue
            encoded = stream.encode(slice(0, len(stream.time_ns)))
            for stamp, row in zip(stream.time_ns.tolist(), encoded, strict=True):
                data = row if isinstance(row, bytes) else row.tobytes()
                yield LiveMessage(topic, schema, stamp, data)

    def _recovery(self, estimate: LiveEstimate | None, arm: JointTracks) -> Recovery:
        """An estimate as a recovery of one sample; of none where there is no estimate."""
        count = 0 if estimate is None else 1

        def column(value: Callable[[LiveEstimate], FloatArray], *shape: int) -> FloatArray:
            return np.empty((0, *shape)) if estimate is None else np.array([value(estimate)], float)

        joints = () if estimate is None else [joint for joint in JOINTS if joint in estimate.joints]
        is_gap = estimate is not None and estimate.state is not LiveState.VISIBLE
        return Recovery(
            method="live",
            t_s=column(lambda e: np.array(e.t_s)),
            occluded=np.full(count, is_gap),
            position=column(lambda e: e.position, 3),
            quaternion=column(lambda e: e.quaternion, 4),
            velocity=column(lambda e: e.velocity, 3),
            pose_covariance=column(lambda e: e.pose_covariance, 6, 6),
            velocity_covariance=np.full((count, 3, 3), np.nan),
            joints={joint: column(lambda e, j=joint: e.joints[j], 3) for joint in joints},  # type: ignore[misc]
            joint_covariance={
                joint: column(lambda e, j=joint: e.joint_covariance[j], 3, 3)  # type: ignore[misc]
                for joint in joints
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

    def __init__(self, info: SourceInfo, port: int = FOXGLOVE_PORT, others: Sequence[SourceInfo] = ()):
        infos = (info, *others)
        suffixes = [f"/{each.side}" if others else "" for each in infos]
        self._messages = [LiveMessages(each, suffix) for each, suffix in zip(infos, suffixes, strict=True)]
        self._drawn_s = [float("-inf")] * len(infos)
        topics = {topic: schema for suffix in suffixes for topic, schema in topics_of(suffix).items()}
        self._foxglove = foxglove_module()
        logging.getLogger("foxglove").setLevel(logging.ERROR)
        self._context = self._foxglove.Context()
        self._channels: dict[str, Any] = {
            topic: self._channel(topic, schema) for topic, schema in topics.items()
        }
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

    def send(
        self,
        output: LiveOutput,
        frames: FrameRows,
        gap: Gap | None,
        events: Sequence[str],
        number: int = 0,
    ) -> None:
        """Send what a step answered of an arm, that at most some 30 times per second."""
        messages = self._messages[number]
        wanted = {topic for topic, channel in self._channels.items() if channel.has_sinks()}
        if not wanted:
            return
        if len(frames):
            self.log(messages.frames(frames, output.clock_offset_s, wanted))
        if not abs(output.now_s - self._drawn_s[number]) < _DRAWN_EACH_S:
            self._drawn_s[number] = output.now_s
            for estimate in (output.now, output.settled):
                if estimate is not None:
                    self.log(messages.estimate(estimate, wanted))
        if gap is not None:
            self.log(messages.gap(gap))
        self.log(messages.line(text, output.now_s) for text in events)

    def log(self, messages: Iterable[LiveMessage]) -> None:
        """Send messages to whoever subscribed to their topics."""
        for message in messages:
            self._channels[message.topic].log(message.data, log_time=max(message.stamp_ns, 0))

    def close(self) -> None:
        """Let all connections go."""
        self._gate.close()
        self._server.stop()

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
