"""A session recorded while it lasts: a file that can be read at any moment."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from queue import Full, Queue, SimpleQueue
from typing import Generic, TypeVar

import numpy as np

from ..errors import UnoccludeError
from ..io.mcap.merge import Output, OutputStream
from ..io.mcap.messages import nanoseconds
from ..io.recording.read import METADATA
from ..io.recording.streams import ARRIVAL, ORDER, ArmFrames, ImuSamples, RecordingFile
from ..io.recording.write import CAMERA, arm_messages, imu_messages, imu_topic, recording_metadata
from ..recording import JOINTS
from ..runtime.outputs import check_output, umask
from .arrivals import LiveStep, Rows, SourceInfo

Item = TypeVar("Item")


class Outbox(Generic[Item]):
    """Does a job with each thing that it is given; a slow disk or terminal delays no answer."""

    def __init__(self, job: Callable[[Item], None], most: int, name: str) -> None:
        self._job = job
        self._waiting: Queue[Item] = Queue(most)
        threading.Thread(target=self._work, name=name, daemon=True).start()

    def put(self, item: Item, seconds: float = 0.0) -> bool:
        """Give it a thing; False where there was no room for it within some time."""
        try:
            self._waiting.put(item, seconds > 0.0, seconds)
        except Full:
            return False
        return True

    def drain(self, seconds: float) -> bool:
        """Wait, no longer than some time; whether everything is done."""
        until_s = time.monotonic() + seconds
        while self._waiting.unfinished_tasks and time.monotonic() < until_s:
            time.sleep(0.01)
        return not self._waiting.unfinished_tasks

    def _work(self) -> None:
        while True:
            self._job(self._waiting.get())
            self._waiting.task_done()


#: What came is written after this long, s: a killed program loses no more.
_FLUSH_S = 1.0
#: So much may wait for a slow disk; what comes then is not recorded.
_MOST_WAITING = 20_000
#: The file's end is waited for no longer than this, s.
_CLOSE_S = 60.0


class SessionRecording:
    """Writes IMU and skeleton to an MCAP file as they arrive: stamps inside, arrival as log time.

    A thread writes, so that a slow disk delays no answer; a full one ends the recording alone.
    """

    def __init__(
        self, path: Path, infos: Sequence[SourceInfo], force: bool = False, patient: bool = False
    ) -> None:
        check_recording(path, force)
        self.path, self.growing, self._infos = path, growing_name(path), infos
        try:
            os.close(os.open(self.growing, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o600))
            self._output = Output(self.growing)
            self._output.__enter__()
        except OSError as error:
            raise UnoccludeError(f"{self.growing} cannot be written: {error.strerror or error}") from error
        self._topics: list[dict[str, str]] = []  # of the IMUs of each arm
        for info in infos:
            named = {segment: imu_topic(name, info.side, segment) for segment, name in info.imus.items()}
            taken = [topic for own in self._topics for topic in own.values()]  # devices may all have one name
            self._topics.append(
                {at: f"{each}_{info.side}" if each in taken else each for at, each in named.items()}
            )
        self._flushed_s = -np.inf
        self._notes: list[str] = []
        self.is_whole = False  # it has its end, and its name
        self._has_samples = self._has_ended = self._is_stuck = False
        self._write_metadata()
        self._patient, self._lost = patient, 0
        self._events: SimpleQueue[str] = SimpleQueue()
        self._steps = Outbox(self._take, _MOST_WAITING, "recorder")

    def send(self, step: LiveStep) -> None:
        """Write what arrived before a step."""
        if self._has_ended or self._steps.put(step, _CLOSE_S if self._patient else 0.0):
            return
        self._lost += 1
        if self._lost == 1:
            self._events.put("the disk is too slow: the recording has gaps from now on")

    def events(self) -> list[str]:
        """What became of the recording since the last call."""
        return [self._events.get_nowait() for _ in range(self._events.qsize())]

    def wait(self) -> None:
        """Return once all that was given is written, or the disk has not taken it for long."""
        if not self._is_stuck and not self._steps.drain(_CLOSE_S):
            self._is_stuck = True
            self._end(f"the recording has no end: the disk did not take it within {_CLOSE_S:g} s")

    def _take(self, step: LiveStep) -> None:
        try:
            if not self._has_ended:
                self._write(step)
        except OSError as error:
            self._end(
                f"the recording has ended, the session continues: {self.growing} cannot be written any more"
                f" ({error.strerror or error})"
            )

    def _end(self, why: str) -> None:
        """Write no more."""
        self._has_ended = True
        repair = f"`unocclude repair {self.growing} -o {self.path}`"
        self._events.put(f"{why}; what is in it can be read: {repair}")

    def _write(self, step: LiveStep) -> None:
        info, topics, origin = self._infos[step.arm], self._topics[step.arm], self._infos[0].origin_ns
        outgoing: list[tuple[Rows, OutputStream]] = []
        self._notes += step.arrivals.events
        for segment, rows in step.arrivals.imus.items():
            if len(rows):
                topic, stamp = topics[segment], nanoseconds(rows.t_s, origin)
                columns = rows["acc"], rows["gyro"], rows.columns.get("mag")
                samples = ImuSamples(topic, topic.rpartition("/")[2], stamp, *columns)
                outgoing.append((rows, imu_messages(self._output, samples)))
        frames = step.arrivals.frames
        if len(frames):
            stamp = nanoseconds(frames.t_s, origin)
            joints = ArmFrames("/skeleton", CAMERA, 0, info.side, stamp, frames["position"], frames["state"])
            present = [JOINTS.index(joint) for joint in info.joints]
            outgoing.append((frames, arm_messages(self._output, joints, present)))
        self._has_samples |= bool(outgoing)
        streams = [
            replace(messages, time_ns=nanoseconds(rows.arrival_s, origin)) for rows, messages in outgoing
        ]
        if streams:
            self._output.write(streams)
        if step.output.now_s - self._flushed_s > _FLUSH_S:
            self._output.flush()
            self._flushed_s = step.output.now_s

    def close(self) -> None:
        """Write what waits and the file's end, and give it its name; one without any sample goes."""
        self.wait()
        if self._is_stuck:  # the thread that writes still has the file
            return
        if self._has_ended or not self._has_samples:
            self._output.__exit__(UnoccludeError, None, None)
            if not self._has_samples:
                self.growing.unlink()
            return
        if self._notes:
            self._write_metadata()
        self._output.__exit__(None, None, None)
        with open(self.growing, "rb+") as file:
            os.fsync(file.fileno())
        os.chmod(self.growing, 0o666 & ~umask())
        os.replace(self.growing, self.path)
        self.is_whole = True

    def _write_metadata(self) -> None:
        info = self._infos[0]
        file = RecordingFile(Path(info.name), camera_frame=info.camera_frame, gravity_hint=info.gravity_hint)
        file.notes = self._notes
        self._output.metadata(METADATA, recording_metadata(file) | {ORDER: ARRIVAL})


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
