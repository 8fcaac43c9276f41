"""A recording played as if it happened now."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from ..body import FOREARM
from ..errors import RecordingError
from ..io.mcap.messages import SECOND_NS, seconds
from ..io.recording.choose import StreamChoice, choose_arms
from ..io.recording.read import open_recording
from ..io.recording.write import joints_there
from ..recording import JOINTS
from .arrivals import Arrivals, Rows, SourceInfo

#: What a Kinect and its body tracking need for a frame, s.
CAMERA_LATENCY_S = 0.1
#: With speed 0 the session's time goes on by this much from look to look, s.
STEP_S = 0.01


class Playback:
    """Rows of each arm that are known beforehand, given out when they arrive."""

    def __init__(
        self,
        infos: Sequence[SourceInfo],
        arms: Sequence[Arrivals],
        speed: float = 1.0,
        step_s: float = STEP_S,
    ) -> None:
        self.infos, self.speed, self._step_s = infos, speed, step_s
        self.play(arms)
        self._first = self._now = min(float(arrival_s[0]) for arrival_s in self._needed)
        self._given = -np.inf
        self._began: float | None = None

    def play(self, arms: Sequence[Arrivals]) -> None:
        """Give these out from now on."""
        self.arms = [
            arm.by_row(lambda rows: rows.select(np.argsort(rows.arrival_s, kind="stable"))) for arm in arms
        ]
        needed = [rows for arm in self.arms for rows in (arm.imus[FOREARM.name], arm.frames)]
        self._needed = [rows.arrival_s for rows in needed]
        self._last = max(float(arrival_s[-1]) for arrival_s in self._needed)

    @property
    def ended(self) -> bool:
        """Everything was played."""
        return self._given >= self._last

    def now_s(self) -> float:
        """The recording's time, s."""
        if self.speed and self._began is not None:
            return self._first + self.speed * (time.monotonic() - self._began)
        return self._now

    def wait(self, seconds: float) -> None:
        """Until the next sample or frame is due, at most this long."""
        if not self.speed:
            return
        if self._began is None:
            self._began = time.monotonic()
        later = (each[np.searchsorted(each, self._given, "right") :] for each in self._needed)
        due = min((float(each[0]) for each in later if len(each)), default=np.inf)
        time.sleep(min(max((due - self.now_s()) / self.speed, 0.0), seconds))

    def arrivals(self) -> list[Arrivals]:
        """What arrived since the last call."""
        before, self._now = self._given, self.now_s() if self.speed else self._now + self._step_s
        self._given = self._now

        def arrived(rows: Rows) -> Rows:
            return rows.select(slice(*np.searchsorted(rows.arrival_s, [before, self._now], "right").tolist()))

        return [arm.by_row(arrived) for arm in self.arms]


class Replay(Playback):
    """The IMUs and the arms of a recording, each sample at its stamp and each frame some time after it."""

    def __init__(
        self,
        path: Path,
        imus: Mapping[str | None, str | None] | None = None,  # Topics of the forearms' IMUs by side
        skeleton: str | None = None,
        prefer_side: str | None = None,
        speed: float = 1.0,
        latency_s: float = CAMERA_LATENCY_S,
    ) -> None:
        file = open_recording(path, truth=False)
        choices: list[StreamChoice] = []
        with file.damage_told():
            for side, named in (imus or {None: None}).items():
                found, _ = choose_arms(
                    file, prefer_side=prefer_side, alone=True, imu=named, skeleton=skeleton, side=side
                )
                choices += found
        origin_ns = int(choices[0].imu.stamp_ns.min(initial=2**62)) // SECOND_NS * SECOND_NS
        latency_ns, infos, arms = round(latency_s * 1e9), [], []
        for choice in choices:
            arm, of_arm, topics = choice.arm, dict[str, Rows](), dict[str, str]()
            _check(path, choice, latency_ns)
            for segment, imu in {FOREARM.name: choice.imu, **choice.further}.items():
                if len(imu.stamp_ns):
                    t_s, topics[segment] = seconds(imu.stamp_ns, origin_ns), imu.topic
                    mag = {} if imu.mag is None else {"mag": imu.mag}
                    acc, gyro = imu.vectors
                    of_arm[segment] = Rows(t_s, t_s, {"acc": acc, "gyro": gyro, **mag})
            t_s, arrival_s = (seconds(arm.stamp_ns + ns, origin_ns) for ns in (0, latency_ns))
            frames = Rows(t_s, arrival_s, {"position": arm.position, "state": arm.state})
            arms.append(Arrivals(of_arm, frames))
            joints = tuple(JOINTS[column] for column in joints_there(arm.state))
            frame = file.camera_frame or arm.camera_frame
            notes = (*file.notes, *choice.notes, f"Frames arrive {latency_s:g} s after their stamps.")
            about = choice.side, joints, origin_ns, frame, file.gravity_hint, file.name, None, notes
            infos.append(SourceInfo(topics, arm.topic, *about))
        super().__init__(infos, arms, speed)


def _check(path: Path, choice: StreamChoice, latency_ns: int) -> None:
    """Refuse streams that nothing can be followed by."""
    imu_ns, frame_ns = choice.imu.stamp_ns, choice.arm.stamp_ns + latency_ns
    if not len(imu_ns) or not len(frame_ns):
        raise RecordingError(f"{path}: the IMU or the skeleton has no sample.")
    if choice.arm.lens is not None:
        raise RecordingError(
            f"{path}: {choice.arm.topic} is of a camera without depth, which live does not use;"
            " run `unocclude smooth`."
        )
    apart = max(int(imu_ns.min()), int(frame_ns.min())) - min(int(imu_ns.max()), int(frame_ns.max()))
    if apart >= 0:
        raise RecordingError(
            f"{path}: IMU and camera do not overlap in time, they are {apart / 1e9:.3f} s apart; record"
            " both at the same time, with clocks that agree to a second."
        )
