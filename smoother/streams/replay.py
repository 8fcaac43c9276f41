"""A recording played as if it happened now."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np

from ..array_types import IntArray
from ..errors import RecordingError
from ..io.mcap.stamps import SECOND_NS, seconds
from ..io.recording.choose import choose
from ..io.recording.read import open_recording
from ..io.recording.write import joints_there
from ..recording import JOINTS
from .arrival_times import LogTimes
from .arrivals import Arrivals, FrameRows, ImuRows, SourceInfo

#: With speed 0 the session's time goes on by so much from look to look, s.
_STEP_S = 0.01


class Replay:
    """The IMU and the arm of a recording, sample by sample in the order in which they arrived.

    Samples are played as they were recorded, those included that a reader would drop.

    Parameters
    ----------
    path : Path
        The recording.
    imu, skeleton, side, prefer_side : str, optional
        What to take of it, as `read_recording`.
    speed : float
        1 is real time; 0 plays as fast as this computer can, in steps of 10 ms of the recording, with nothing
        lost.
    latency_s : float, s, optional
        From a frame's stamp to its arrival; by the recording's log times where None, or 0.1 s.

    Raises
    ------
    RecordingError
        The recording cannot be used.
    """

    def __init__(
        self,
        path: Path,
        imu: str | None = None,
        skeleton: str | None = None,
        side: str | None = None,
        prefer_side: str | None = None,
        speed: float = 1.0,
        latency_s: float | None = None,
    ):
        file = open_recording(path, truth=False)
        with file.damage_told():
            choice = choose(file, imu=imu, skeleton=skeleton, side=side, prefer_side=prefer_side)
        arm = choice.arm
        if not len(choice.imu.stamp_ns) or not len(arm.stamp_ns):
            raise RecordingError(f"{path}: the IMU or the skeleton has no sample.")
        log_times = LogTimes(path, choice.imu.topic, arm.topic)
        imu_ns = log_times.of_imu(choice.imu.stamp_ns)
        frame_ns, note = log_times.of_frames(arm.stamp_ns, latency_s)
        self._check(path, imu_ns, frame_ns)
        origin = int(choice.imu.stamp_ns.min()) // SECOND_NS * SECOND_NS
        order, frame_order = np.argsort(imu_ns, kind="stable"), np.argsort(frame_ns, kind="stable")
        self._imu = ImuRows(
            seconds(choice.imu.stamp_ns, origin),
            choice.imu.acc,
            choice.imu.gyro,
            seconds(imu_ns, origin),
            choice.imu.mag,
        ).select(order)
        self._frames = FrameRows(
            seconds(arm.stamp_ns, origin), arm.position, arm.state, seconds(frame_ns, origin)
        ).select(frame_order)
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
        )
        self.speed = speed
        self._next_imu = self._next_frame = 0
        self._first = min(float(self._imu.arrival_s[0]), float(self._frames.arrival_s[0]))
        self._last = max(float(self._imu.arrival_s[-1]), float(self._frames.arrival_s[-1]))
        self._now = self._first
        self._began: float | None = None

    @property
    def info(self) -> SourceInfo:
        """What the session is made of."""
        return self._info

    @property
    def ended(self) -> bool:
        """Everything was played."""
        return self._next_imu == len(self._imu) and self._next_frame == len(self._frames)

    @property
    def progress(self) -> float:
        """Share of the recording that was played."""
        return (self._now - self._first) / max(self._last - self._first, 1e-9)

    def now_s(self) -> float:
        """The recording's time, s."""
        if self.speed and self._began is not None:
            return self._first + self.speed * (time.monotonic() - self._began)
        return self._now

    def wait(self, seconds: float) -> None:
        """Until the next sample or frame is due, at most so long."""
        if not self.speed:
            return
        if self._began is None:
            self._began = time.monotonic()
        due = min(
            rows.arrival_s[at]
            for rows, at in ((self._imu, self._next_imu), (self._frames, self._next_frame))
            if at < len(rows)
        )
        time.sleep(min(max((float(due) - self.now_s()) / self.speed, 0.0), seconds))

    def arrivals(self) -> Arrivals:
        """What arrived since the last call."""
        self._now = self.now_s() if self.speed else self._now + _STEP_S
        stop_imu = int(np.searchsorted(self._imu.arrival_s, self._now, "right"))
        stop_frame = int(np.searchsorted(self._frames.arrival_s, self._now, "right"))
        imu = self._imu.select(slice(self._next_imu, stop_imu))
        frames = self._frames.select(slice(self._next_frame, stop_frame))
        self._next_imu, self._next_frame = stop_imu, stop_frame
        return Arrivals(imu, frames)

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
