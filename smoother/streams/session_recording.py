"""A session recorded while it lasts: a file that can be read at any moment."""

from __future__ import annotations

import json
import os
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..errors import UnoccludeError
from ..io.mcap.merge import Output
from ..io.mcap.stamps import nanoseconds
from ..io.recording.read import METADATA
from ..io.recording.stamps import ARRIVAL, ORDER
from ..io.recording.streams import ArmFrames, ImuSamples
from ..io.recording.write import CAMERA, arm_messages, imu_messages, imu_topic
from ..recording import JOINTS
from ..runtime.outputs import check_output, umask
from .arrivals import Arrivals, SourceInfo

#: What came is written after so long, s: more a killed program cannot lose.
_FLUSH_S = 1.0


class SessionRecording:
    """Writes IMU and skeleton to an MCAP file as they arrive: stamps inside, arrival as log time.

    While the session lasts the file is NAME.recording.mcap beside its place: no command sweeps it away, and
    what a killed program leaves can be read and repaired. `close` gives it its name.

    Attributes
    ----------
    path, growing : Path
        The file's name in the end, and while the session lasts.
    has_samples : bool
        Something was written.

    Parameters
    ----------
    path : Path
        The file's name in the end.
    info : SourceInfo
        Of the session.
    force : bool
        Overwrite a file that exists.

    Raises
    ------
    UnoccludeError
        The file exists, or one that a killed session left, or it cannot be written.
    """

    def __init__(self, path: Path, info: SourceInfo, force: bool = False):
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
        self._imu_topic = imu_topic(info.imu, info.side)
        self._present = [JOINTS.index(joint) for joint in info.joints]
        self._flushed_s = -np.inf
        self._write_metadata()

    def take(self, arrivals: Arrivals) -> None:
        """Write what arrived; its events become notes of the recording.

        Raises
        ------
        UnoccludeError
            The disk is full.
        """
        self._notes += arrivals.events
        imu, frames, outgoing = arrivals.imu, arrivals.frames, []
        origin = self._info.origin_ns
        if len(imu):
            stamp = nanoseconds(imu.t_s, origin)
            samples = ImuSamples(
                self._imu_topic, self._imu_topic.rpartition("/")[2], stamp, imu.acc, imu.gyro, imu.mag
            )
            messages = imu_messages(self._output, samples)
            outgoing.append(replace(messages, time_ns=nanoseconds(imu.arrival_s, origin)))
        if len(frames):
            stamp = nanoseconds(frames.t_s, origin)
            arm = ArmFrames("/skeleton", CAMERA, 0, self._info.side, stamp, frames.position, frames.state)
            messages = arm_messages(self._output, arm, self._present)
            outgoing.append(replace(messages, time_ns=nanoseconds(frames.arrival_s, origin)))
        if not outgoing:
            return
        self.has_samples = True
        try:
            self._output.write(outgoing)
            newest = max(float(rows.arrival_s[-1]) for rows in (imu, frames) if len(rows))
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
        """Write the file's end, and give it its name; one without any sample goes.

        One that could not be written any more stays as it is, under the name that it has.
        """
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
    """Refuse a name that could not be given in the end, before the session begins.

    Raises
    ------
    UnoccludeError
        The file exists and `force` is not given, or a session that was killed left its own there.
    """
    check_output(path, force)
    growing = growing_name(path)
    if growing.exists():
        raise UnoccludeError(
            f"{growing} was left by a session that was killed, or another session writes to it;"
            f" `unocclude repair {growing} -o NAME.mcap` saves what is in it, then remove it"
        )
