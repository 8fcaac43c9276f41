"""A session recorded while it lasts: a file that can be read at any moment."""

from __future__ import annotations

import json
import os
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from queue import Full, Queue, SimpleQueue
from typing import TYPE_CHECKING

import numpy as np

from ..errors import UnoccludeError
from ..io.mcap.merge import Output, OutputStream
from ..io.mcap.messages import nanoseconds
from ..io.recording.read import METADATA, RESULT_PREFIX
from ..io.recording.streams import ARRIVAL, ORDER, ArmFrames, ImuSamples
from ..io.recording.write import CAMERA, arm_messages, imu_messages, imu_topic
from ..live.answers import LiveOutput
from ..recording import JOINTS
from ..runtime.outputs import check_output, umask
from .arrivals import Arrivals, SourceInfo

if TYPE_CHECKING:
    from .foxglove import LiveMessages

#: What came is written after this long, s: a killed program loses no more.
_FLUSH_S = 1.0
#: What was shown; readers of recordings leave it alone.
SHOWN_TOPIC = "/live/forearm"
_SHOWN_EACH_S = 0.03
#: So much may wait for a slow disk; what comes then is not recorded.
_MOST_WAITING = 20_000
#: The file's end is waited for no longer than this, s.
_CLOSE_S = 60.0


class _RecordedArm:
    """The topics of one arm, and when it was shown last."""

    def __init__(self, info: SourceInfo, several: bool, taken: set[str]):
        self.info, self.shown_s = info, -np.inf
        self.present = [JOINTS.index(joint) for joint in info.joints]
        self.topics = {
            segment: self._free(imu_topic(name, info.side, segment), taken)
            for segment, name in info.imus.items()
        }
        self.shown_topic = f"{SHOWN_TOPIC}/{info.side}" if several else SHOWN_TOPIC
        self.messages: LiveMessages | None = None

    def _free(self, topic: str, taken: set[str]) -> str:
        """A topic that no other IMU has: devices may all have one name."""
        topic = f"{topic}_{self.info.side}" if topic in taken else topic
        taken.add(topic)
        return topic


class SessionRecording:
    """Writes IMU and skeleton to an MCAP file as they arrive: stamps inside, arrival as log time.

    A thread writes, so that a slow disk delays no answer; a full one ends the recording alone.
    """

    def __init__(
        self,
        path: Path,
        info: SourceInfo,
        force: bool = False,
        others: Sequence[SourceInfo] = (),
        patient: bool = False,
    ):
        check_recording(path, force)
        self.path, self.growing = path, growing_name(path)
        self._info = info
        self._notes: list[str] = []
        self.has_samples = self._is_broken = False
        try:
            os.close(os.open(self.growing, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o600))
            self._output = Output(self.growing)
            self._output.__enter__()
        except OSError as error:
            raise UnoccludeError(f"{self.growing} cannot be written: {error.strerror or error}") from error
        taken: set[str] = set()
        self._arms = [_RecordedArm(each, bool(others), taken) for each in (info, *others)]
        self._flushed_s = -np.inf
        self._write_metadata()
        self._patient, self._has_ended, self._lost = patient, False, 0
        self._jobs: Queue[Callable[[], None] | None] = Queue(_MOST_WAITING)
        self._events: SimpleQueue[str] = SimpleQueue()
        self._thread = threading.Thread(target=self._work, name="recorder", daemon=True)
        self._thread.start()

    def take(self, arrivals: Arrivals, number: int = 0) -> None:
        """Write what arrived of an arm; its events become notes of the recording."""
        self._put(partial(self._take, arrivals, number))

    def shown(self, output: LiveOutput, number: int = 0) -> None:
        """Write what was shown of an arm, some 30 times per second: the pose of the IMU *now*."""
        self._put(partial(self._show, output, number))

    def events(self) -> list[str]:
        """What became of the recording since the last call."""
        events: list[str] = []
        while not self._events.empty():
            events.append(self._events.get_nowait())
        return events

    def wait(self) -> None:
        """Return once all that was given is written, or the recording has ended."""
        written, until_s = threading.Event(), time.monotonic() + _CLOSE_S
        self._put(written.set)
        while not (self._has_ended or written.wait(0.02)) and time.monotonic() < until_s:
            pass

    def _put(self, job: Callable[[], None]) -> None:
        if self._has_ended:
            return
        try:
            self._jobs.put(job, block=self._patient, timeout=_CLOSE_S)
        except Full:
            self._lost += 1
            if self._lost == 1:
                self._events.put("the disk is too slow: the recording has gaps from now on")

    def _work(self) -> None:
        while (job := self._jobs.get()) is not None:
            if self._has_ended:
                continue
            try:
                job()
            except UnoccludeError as error:
                self._events.put(f"the recording has ended, the session continues: {error}")
                self._has_ended = True

    def _take(self, arrivals: Arrivals, number: int) -> None:
        self._notes += arrivals.events
        frames, outgoing = arrivals.frames, []
        origin, of_arm = self._info.origin_ns, self._arms[number]
        for segment, rows in arrivals.imus.items():
            if not len(rows):
                continue
            topic = of_arm.topics[segment]
            stamp = nanoseconds(rows.t_s, origin)
            samples = ImuSamples(topic, topic.rpartition("/")[2], stamp, rows.acc, rows.gyro, rows.mag)
            messages = imu_messages(self._output, samples)
            outgoing.append(replace(messages, time_ns=nanoseconds(rows.arrival_s, origin)))
        if len(frames):
            stamp = nanoseconds(frames.t_s, origin)
            side = of_arm.info.side
            arm = ArmFrames("/skeleton", CAMERA, 0, side, stamp, frames.position, frames.state)
            messages = arm_messages(self._output, arm, of_arm.present)
            outgoing.append(replace(messages, time_ns=nanoseconds(frames.arrival_s, origin)))
        if not outgoing:
            return
        self.has_samples = True
        came = [rows.arrival_s for rows in (frames, *arrivals.imus.values()) if len(rows)]
        self._write(outgoing, max(float(arrival_s[-1]) for arrival_s in came))

    def _show(self, output: LiveOutput, number: int) -> None:
        now, arm = output.now, self._arms[number]
        if now is None or abs(output.now_s - arm.shown_s) < _SHOWN_EACH_S:
            return
        arm.shown_s = output.now_s
        if arm.messages is None:
            from .foxglove import LiveMessages

            arm.messages = LiveMessages(arm.info)
        wanted = {f"{RESULT_PREFIX}forearm"}
        data = [message.data for message in arm.messages.estimate(now, wanted)]
        time_ns = np.full(len(data), round(output.now_s * 1e9) + self._info.origin_ns)
        channel = self._output.channel(arm.shown_topic, "foxglove.Odometry")
        self._write([OutputStream(channel, time_ns, lambda part: data[part])], output.now_s)

    def _write(self, outgoing: list[OutputStream], newest: float) -> None:
        try:
            self._output.write(outgoing)
            if newest - self._flushed_s > _FLUSH_S:
                self._output.flush()
                self._flushed_s = newest
        except OSError as error:
            self._is_broken = True
            raise UnoccludeError(
                f"{self.growing} cannot be written any more ({error.strerror or error}); what is in it can be"
                f" read: `unocclude repair {self.growing} -o {self.path}`"
            ) from error

    def close(self) -> None:
        """Write what waits and the file's end, and give it its name; one without any sample goes."""
        with suppress(Full):
            self._jobs.put(None, timeout=_CLOSE_S)
        self._thread.join(_CLOSE_S)
        if self._is_broken or not self.has_samples:
            self._output.__exit__(UnoccludeError, None, None)
            if not self.has_samples:
                self.growing.unlink()
            return
        if self._notes:
            self._write_metadata()
        self._output.__exit__(None, None, None)
        with open(self.growing, "rb+") as file:
            os.fsync(file.fileno())
        os.chmod(self.growing, 0o666 & ~umask())
        os.replace(self.growing, self.path)

    def _write_metadata(self) -> None:
        values = {"notes": json.dumps(self._notes), "name": self._info.name, ORDER: ARRIVAL}
        if self._info.camera_frame is not None:
            values["camera_frame"] = str(self._info.camera_frame)
        if self._info.gravity_hint is not None:
            values["gravity"] = json.dumps([float(value) for value in self._info.gravity_hint])
        self._output.metadata(METADATA, values)


def growing_name(path: Path) -> Path:
    """What a recording is called while the session lasts."""
    return path.with_name(f"{path.stem}.recording.mcap")


def check_recording(path: Path, force: bool = False) -> None:
    """Refuse a name that could not be given in the end, before the session begins."""
    check_output(path, force)
    growing = growing_name(path)
    if growing.exists():
        raise UnoccludeError(
            f"{growing} was left by a session that was killed, or another session writes to it;"
            f" `unocclude repair {growing} -o NAME.mcap` saves what is in it, then remove it"
        )
