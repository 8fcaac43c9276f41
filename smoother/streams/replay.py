"""A recording played as if it happened now."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..array_types import IntArray
from ..body import FOREARM
from ..errors import RecordingError
from ..io.mcap.container import Container
from ..io.mcap.messages import SECOND_NS, Topic, seconds
from ..io.recording.choose import choose_arms
from ..io.recording.decode import Decoder, decoder_of
from ..io.recording.read import open_recording
from ..io.recording.write import joints_there
from ..recording import JOINTS
from .arrivals import Arrivals, FrameRows, ImuRows, Rows, SourceInfo

#: What a Kinect and its body tracking need for a frame, where the recording does not state it, s.
CAMERA_LATENCY_S = 0.1
#: Log times that are farther from the stamps are of another clock, ns.
_ONE_CLOCK_NS = 2_000_000_000


class LogTimes:
    """Stamps and log times of some topics of a file."""

    def __init__(self, path: Path, imu: str, skeleton: str, further: Sequence[str] = ()):
        self._imu, self._skeleton = imu, skeleton
        self._stamp: dict[str, IntArray] = {}
        self._log: dict[str, IntArray] = {}
        container = Container(path)
        decoders: dict[str, Decoder] = {}
        logs: dict[str, list[IntArray]] = {}

        def wanted(topic: Topic) -> bool:
            return topic.label in (imu, skeleton, *further)

        for batch in container.by_topic(wanted):
            for position, messages in batch.items():
                topic = container.topics[position]
                if topic.label not in decoders:
                    decoder = decoder_of(topic)
                    if decoder is None:
                        continue
                    decoders[topic.label] = decoder
                decoders[topic.label].feed(messages)
                logs.setdefault(topic.label, []).append(messages.log_ns)
        for label, decoder in decoders.items():
            stamp, log = decoder.stamps(), np.concatenate(logs[label])
            if len(stamp) == len(log):  # else messages are damaged
                self._stamp[label], self._log[label] = stamp, log

    def of_frames(
        self,
        stamp_ns: IntArray,  # int (n,) ns
        latency_s: float | None,
    ) -> tuple[IntArray, str]:
        """When frames (n,) arrived, on the IMU's clock, ns, and how that is known."""
        if latency_s is None and self._skeleton in self._log:
            delay = self._log[self._skeleton] - self._stamp[self._skeleton]
            if np.ptp(delay) > 0 or abs(float(np.median(delay))) > 0:
                return self.of(self._skeleton, stamp_ns), "Frames arrive at the recording's log times."
        seconds = CAMERA_LATENCY_S if latency_s is None else latency_s
        return stamp_ns + round(seconds * 1e9), f"Frames arrive {seconds:g} s after their stamps."

    def of(self, topic: str, stamp_ns: IntArray) -> IntArray:
        """When messages (n,) arrived, on the forearm IMU's clock, ns; at their stamps where it is unknown."""
        if topic not in self._log:
            return stamp_ns
        shift = int((self._log[self._imu] - self._stamp[self._imu]).min()) if self._imu in self._log else 0
        shift = shift if abs(shift) > _ONE_CLOCK_NS else 0  # else they are of one clock
        order = np.argsort(self._stamp[topic], kind="stable")
        at = np.searchsorted(self._stamp[topic][order], stamp_ns)
        at = order[np.minimum(at, len(order) - 1)]
        same = self._stamp[topic][at] == stamp_ns
        return np.where(same, self._log[topic][at] - shift, stamp_ns)


#: With speed 0 the session's time goes on by this much from look to look, s.
_STEP_S = 0.01
_CAMERA = "camera"  # among the IMUs' segments


class Replay:
    """The IMU and the arm of a recording, sample by sample in the order in which they arrived."""

    def __init__(
        self,
        path: Path,
        imu: str | None = None,
        skeleton: str | None = None,
        side: str | None = None,
        prefer_side: str | None = None,
        speed: float = 1.0,
        latency_s: float | None = None,
        beside: Replay | None = None,
    ):
        file = open_recording(path, truth=False)
        with file.damage_told():
            (choice,), _ = choose_arms(
                file, prefer_side=prefer_side, alone=True, imu=imu, skeleton=skeleton, side=side
            )
        arm = choice.arm
        if not len(choice.imu.stamp_ns) or not len(arm.stamp_ns):
            raise RecordingError(f"{path}: the IMU or the skeleton has no sample.")
        if arm.lens is not None:
            raise RecordingError(
                f"{path}: {arm.topic} is of a camera without depth, which live does not use;"
                " run `unocclude smooth`."
            )
        origin = int(choice.imu.stamp_ns.min()) // SECOND_NS * SECOND_NS
        origin = origin if beside is None else beside.info.origin_ns
        log_times = LogTimes(path, choice.imu.topic, arm.topic, [s.topic for s in choice.further.values()])
        frame_ns, note = log_times.of_frames(arm.stamp_ns, latency_s)
        self._check(path, log_times.of(choice.imu.topic, choice.imu.stamp_ns), frame_ns)
        frames = FrameRows(seconds(arm.stamp_ns, origin), arm.position, arm.state, seconds(frame_ns, origin))
        self._frames = frames.select(np.argsort(frame_ns, kind="stable"))
        self._imus = {
            segment: ImuRows(
                seconds(each.stamp_ns, origin), each.acc, each.gyro, seconds(at_ns, origin), each.mag
            ).select(np.argsort(at_ns, kind="stable"))
            for segment, each in {FOREARM.name: choice.imu, **choice.further}.items()
            for at_ns in [log_times.of(each.topic, each.stamp_ns)]
            if len(each.stamp_ns)
        }
        self._info = SourceInfo(
            choice.imu.topic,
            arm.topic,
            choice.side,
            tuple(JOINTS[i] for i in joints_there(arm.state)),
            origin,
            file.camera_frame or arm.camera_frame,
            file.gravity_hint,
            path.name,
            notes=(*file.notes, *choice.notes, note),
            further={
                segment: each.topic for segment, each in choice.further.items() if segment in self._imus
            },
        )
        self.speed = speed
        self._next = dict.fromkeys((*self._imus, _CAMERA), 0)
        first_imu = self._imus[FOREARM.name]
        self._first = min(float(first_imu.arrival_s[0]), float(self._frames.arrival_s[0]))
        self._now = self._first
        self._began: float | None = None
        self._beside = beside
        if beside is not None:
            beside._first = beside._now = self._first = self._now = min(self._first, beside._first)

    @property
    def info(self) -> SourceInfo:
        """What the session is made of."""
        return self._info

    @property
    def ended(self) -> bool:
        """Everything was played."""
        return not self._due()

    def now_s(self) -> float:
        """The recording's time, s."""
        if self._beside is not None:
            return self._beside.now_s()
        if self.speed and self._began is not None:
            return self._first + self.speed * (time.monotonic() - self._began)
        return self._now

    def wait(self, seconds: float) -> None:
        """Until the next sample or frame is due, at most this long."""
        if not self.speed:
            return
        if self._began is None:
            self._began = time.monotonic()
        due = self._due()
        if not due:  # the other arm goes on
            time.sleep(seconds)
            return
        wait_s = (float(min(due)) - self.now_s()) / self.speed
        time.sleep(min(max(wait_s, 0.0), seconds))

    def arrivals(self) -> Arrivals:
        """What arrived since the last call."""
        lasts = self.speed or self._beside is not None
        self._now = self.now_s() if lasts else self._now + _STEP_S
        imus = {segment: self._arrived(segment, rows) for segment, rows in self._imus.items()}
        return Arrivals(imus.pop(FOREARM.name), self._arrived(_CAMERA, self._frames), further=imus)

    def _arrived(self, stream: str, rows: Rows) -> Rows:
        """What arrived of a stream since the last call."""
        first, stop = self._next[stream], int(np.searchsorted(rows.arrival_s, self._now, "right"))
        self._next[stream] = stop
        return rows.select(slice(first, stop))

    def _due(self) -> list[float]:
        """When the next sample of the forearm's IMU and the next frame arrive, as far as there are any."""
        streams = {FOREARM.name: self._imus[FOREARM.name], _CAMERA: self._frames}
        return [
            float(rows.arrival_s[at])
            for stream, rows in streams.items()
            if (at := self._next[stream]) < len(rows)
        ]

    def close(self) -> None:
        """Nothing to let go."""

    @staticmethod
    def _check(path: Path, imu_ns: IntArray, frame_ns: IntArray) -> None:
        apart = max(int(imu_ns.min()), int(frame_ns.min())) - min(int(imu_ns.max()), int(frame_ns.max()))
        if apart >= 0:
            raise RecordingError(
                f"{path}: IMU and camera do not overlap in time, they are {apart / 1e9:.3f} s apart; record"
                " both at the same time, with clocks that agree to a second."
            )
