"""The live smoother: samples in, the arm now and a lag ago out.

Who follows the arm: the tracker at work, and its successor with a newer calibration.
"""

from __future__ import annotations

import time
from collections import deque
from types import TracebackType

import numpy as np

from ..array_types import FloatArray
from ..calibration import ArmCalibration
from ..config import Config
from ..errors import UnoccludeError
from ..recording import CameraFrame
from .buffers import (
    USUAL_LATENCY_S,
    CameraClock,
    Dropped,
    FrameBuffer,
    ImuBatch,
    ImuBuffer,
    LiveEstimate,
    LiveOutput,
    LiveState,
    SkeletonFrame,
)
from .calibrations import BackgroundCalibrator, Calibrations, Calibrator, LiveCalibration
from .display import Display, predicted
from .tracker import AROUND_S, LENGTH_S, LONGEST_PAUSE_S, Tracker, first_state

#: A first tracker begins so long before the present, s, and catches up by so many frames a step: ten take
#: 13 to 17 ms of processor time, so that a step stays within 20 ms.
CATCH_UP_S, CATCH_UP_FRAMES = 5.0, 10
#: A successor catches up beside the one at work by so many frames a step.
SUCCESSOR_FRAMES = 4
#: After a pause of the IMU it takes so much to begin anew, s.
FRESH_S = 1.0


class TrackerHandover:
    """Holds the tracker at work; a successor catches up beside it and takes its place.

    Parameters
    ----------
    calibrations : Calibrations
        The last of them is a new tracker's.
    config : Config
    imu : ImuBuffer
    frames : FrameBuffer
        Both of the live smoother, read only.
    lag_s : float, s
        How long before the present `settled` is.

    Attributes
    ----------
    tracker : Tracker or None
        The one at work.
    has_followed : bool
        There was one at work at some time.
    """

    def __init__(
        self, calibrations: Calibrations, config: Config, imu: ImuBuffer, frames: FrameBuffer, lag_s: float
    ) -> None:
        self._calibrations, self._config, self._imu, self._frames = calibrations, config, imu, frames
        self._lag_s = lag_s
        self.tracker: Tracker | None = None
        self.has_followed = False
        self._successor: Tracker | None = None
        self._is_waiting = False

    def calibrated(self) -> None:
        """There is a new calibration: a successor begins with it, at once or where the arm is visible."""
        if self.tracker is None:
            self._successor = self._fresh()
        else:
            self._is_waiting, self._successor = True, None

    def begin_anew(self) -> None:
        """What is at work is lost: begin anew with the calibration that is there."""
        self.tracker, self._is_waiting = None, False
        self._successor = self._fresh()

    def advance(self, now_s: float) -> Tracker | None:
        """Let the successor catch up, and take the place of the one at work; that one, where it did."""
        self._begin_where_visible()
        successor = self._successor
        if successor is None:
            return None
        if not successor.started:
            self._start(successor, now_s)  # work enough for a step
            return None
        if successor.pause_s() > LONGEST_PAUSE_S or not self._catch_up(successor, now_s):
            self._successor = None if self.tracker is not None else self._fresh()
            return None
        if successor.solution is None or self.ready(successor):
            return None
        before, self.tracker, self._successor = self.tracker, successor, None
        self.has_followed = True
        return before

    def ready(self, tracker: Tracker) -> list[SkeletonFrame]:
        """Frames that a tracker has not seen and the IMU reaches."""
        frames = self._frames.since(np.nextafter(tracker.cursor_s, np.inf))
        reach_s = self._imu.end_s - tracker.offset_s
        return [frame for frame in frames if frame.t_s <= reach_s]

    def _begin_where_visible(self) -> None:
        """In a gap there is nothing that a successor could begin with."""
        active = self.tracker
        if self._is_waiting and active is not None and active.history.sees_all(active.window.t):
            self._is_waiting, self._successor = False, self._fresh()
            if self._successor is not None:
                self._successor.start(active.window.state(0))

    def _start(self, successor: Tracker, now_s: float) -> None:
        """Begin some seconds ago, where the streams suffice."""
        since_s = self._imu.since_pause_s(LONGEST_PAUSE_S, CATCH_UP_S + AROUND_S)
        if self._imu.end_s - since_s < FRESH_S:
            return
        offset_s = self._calibrations.offset_s
        state = first_state(
            self._imu.stream(since_s),
            self._frames.tracks(since_s - offset_s),
            successor.model,
            offset_s,
            self._calibrations.needed,
            max(now_s - CATCH_UP_S, since_s + 0.5 * FRESH_S),
        )
        if state is not None:
            successor.start(state)

    def _catch_up(self, successor: Tracker, now_s: float) -> bool:
        """Feed some frames; False where these did not determine the motion."""
        limit = CATCH_UP_FRAMES if self.tracker is None else SUCCESSOR_FRAMES
        ready = self.ready(successor)[:limit]
        try:
            if ready:
                successor.feed(ready)
                successor.solve(now_s - self._lag_s)
        except (np.linalg.LinAlgError, RuntimeError):
            return False
        return True

    def _fresh(self) -> Tracker | None:
        """A tracker with the last calibration, not yet begun; what the active one has learnt counts."""
        calibration = self._calibrations.last
        if calibration is None or calibration.model is None:
            return None
        return Tracker(
            calibration.model,
            self._calibrations.offset_s,
            self._calibrations.needed,
            self._config,
            self._imu,
            max(LENGTH_S, self._lag_s + 0.3),
            self.tracker,
        )


#: Samples are held for so long: what a self-calibration may read, s.
BUFFER_S = 120.0
#: More frames than this at once are a backlog; those in between are dropped.
MOST_FRAMES = 12
#: Without frames a node comes so often, s, and so long after the frames' usual delay.
EMPTY_S = 0.1
#: No sample of the IMU for so long: it is lost, s.
LOST_S = 0.5
#: Rates and load are of the last so many seconds.
RATE_S = 2.0


class LiveSmoother:
    """A fixed-lag smoother that calibrates itself; use as a context manager.

    It takes its times from the data and from `step`, never from this computer's clock, so that a recording
    played faster or slower gives the same answer.

    Parameters
    ----------
    side : {"left", "right", ""}
        Which arm.
    calibration : ArmCalibration, optional
        What is known beforehand; what it lacks is solved from the first seconds.
    config : Config, optional
        Settings, as of `smooth`.
    lag_s : float, s
        How long before the present `settled` is; 0 to 2.
    gravity_hint : ndarray, shape (3,), optional
        Direction of down in {K}, good to some degrees.
    camera_frame : CameraFrame, optional
        The convention of the camera's axes.
    calibrator : Calibrator, optional
        Who works the self-calibration out; a process in the background where None.

    Raises
    ------
    UnoccludeError
        The lag is not between 0 and 2 s.
    """

    def __init__(
        self,
        side: str = "",
        calibration: ArmCalibration | None = None,
        config: Config | None = None,
        lag_s: float = 0.2,
        gravity_hint: FloatArray | None = None,
        camera_frame: CameraFrame | None = None,
        calibrator: Calibrator | None = None,
    ) -> None:
        if not 0.0 <= lag_s <= 2.0:
            raise UnoccludeError(f"The lag is {lag_s:g} s; give one from 0 to 2 s.")
        self._lag_s = lag_s
        self._imu, self._frames, self._camera = ImuBuffer(BUFFER_S), FrameBuffer(BUFFER_S), CameraClock()
        given, config = calibration or ArmCalibration(side=side), config or Config()
        self._calibrations = Calibrations(
            calibrator or BackgroundCalibrator(), side, given, config, gravity_hint, camera_frame
        )
        self._handover = TrackerHandover(self._calibrations, config, self._imu, self._frames, lag_s)
        self._display = Display(lag_s)
        self._changed_s: float | None = None
        self._late: list[SkeletonFrame] = []
        self._backlog = 0
        self._state = LiveState.CALIBRATING
        self._notes: list[str] = []
        self._work: deque[tuple[float, float]] = deque()

    def __enter__(self) -> LiveSmoother:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.finish()

    def add_imu(self, batch: ImuBatch) -> None:
        """Take samples in, in any order; those older than half a second before the newest are dropped."""
        changed_s = self._imu.add(batch)
        if changed_s is not None:
            self._changed_s = changed_s if self._changed_s is None else min(self._changed_s, changed_s)

    def add_frame(self, frame: SkeletonFrame) -> None:
        """Take a frame in, in any order; one older than half a second before the newest is dropped."""
        frames, jump_s = self._camera.take(frame)
        for each in frames:
            is_new, tracker = self._frames.add(each), self._handover.tracker
            if is_new and tracker is not None and each.t_s <= tracker.cursor_s:
                self._late.append(each)
        if jump_s:
            self._notes.append(f"the camera's clock jumped by {-jump_s:.3f} s; the answer follows it")
            self._calibrations.clock_jumped()

    def step(self, now_s: float) -> LiveOutput:
        """Work in what has arrived, and answer for the present.

        Parameters
        ----------
        now_s : float, s
            The present on the IMU's clock; call it about as often as an answer is wanted (30 to 100 Hz).
        """
        began = time.thread_time()
        self._notes, notes = [], self._notes
        # 1. The calibration, in the background; who follows with it catches up, and takes over.
        self._calibrate(now_s)
        # 2. What has arrived, into the window; the past is mended.
        self._follow(now_s)
        # 3. The answers.
        now, settled = self._answers(now_s)
        step_s = time.thread_time() - began
        self._work.append((now_s, step_s))
        while self._work[0][0] < now_s - RATE_S:
            self._work.popleft()
        return LiveOutput(
            now_s=now_s,
            state=self._state,
            now=now,
            settled=settled,
            clock_offset_s=self._calibrations.offset_s + self._camera.correction_s,
            clock_sigma_s=self._calibrations.clock_sigma_s,
            camera_latency_s=self._latency_s,
            imu_rate_hz=float(np.sum(self._imu.t > self._imu.end_s - RATE_S) / RATE_S)
            if len(self._imu)
            else 0.0,
            frame_rate_hz=len(self._frames.since(self._frames.end_s - RATE_S)) / RATE_S,
            dropped=self._dropped,
            load=sum(s for _, s in self._work) / max(now_s - self._work[0][0], 1e-3),
            step_ms=1e3 * step_s,
            notes=(*notes, *self._notes),
            calibration=self._reason,
        )

    @property
    def state(self) -> LiveState:
        """As of the last step."""
        return self._state

    @property
    def calibration(self) -> LiveCalibration | None:
        """The one at work; None before the first."""
        return self._calibrations.last

    def finish(self) -> None:
        """End the background's work."""
        self._calibrations.close()

    # 1. The calibration

    def _calibrate(self, now_s: float) -> None:
        """Fetch a calibration that is ready, ask for the next when it is time, let a successor catch up."""
        if self._calibrations.fetch():
            self._handover.calibrated()
        self._calibrations.ask(self._imu, self._frames, self._camera)
        before = self._handover.advance(now_s)
        tracker = self._handover.tracker
        if before is not None and before.solution is not None and tracker is not None:
            self._display.spread(predicted(before, before.solution, now_s), tracker, now_s)

    # 2. The window

    def _follow(self, now_s: float) -> None:
        """Feed the window with what has arrived, and solve it."""
        tracker = self._handover.tracker
        if tracker is None:
            self._late, self._changed_s = [], None
            return
        if tracker.pause_s() > LONGEST_PAUSE_S:
            self._lose("the IMU's samples paused: the smoother begins anew")
            return
        solved, changed = tracker.solution, self._mend(tracker)
        ready = self._ready(tracker)
        ended_s = tracker.feed(ready) if ready else None
        empty_s = self._imu.end_s - self._usual_delay_s - EMPTY_S
        if not ready and empty_s - tracker.t_s > EMPTY_S:
            tracker.go_on(empty_s)
            changed = True
        if not ready and not changed:
            return
        try:
            tracker.solve(now_s - self._lag_s)
        except (np.linalg.LinAlgError, RuntimeError):
            self._lose("the last moments did not determine the motion: the smoother begins anew")
            return
        if ended_s is not None and solved is not None:
            self._display.spread(predicted(tracker, solved, now_s), tracker, now_s)

    def _mend(self, tracker: Tracker) -> bool:
        """Work in what came late; whether anything did."""
        changed = self._changed_s is not None
        if self._changed_s is not None:
            tracker.integrate_again(self._changed_s)
            self._changed_s = None
        for frame in self._late:
            if tracker.feed_late(frame):
                changed = True
            else:
                self._frames.late += 1
        self._late = []
        return changed

    def _ready(self, tracker: Tracker) -> list[SkeletonFrame]:
        """Frames that are due, at most so many: of a backlog the newest."""
        ready = self._handover.ready(tracker)
        if len(ready) > MOST_FRAMES:
            self._backlog += len(ready) - MOST_FRAMES
            self._notes.append(f"behind by {len(ready)} frames: dropped all but the newest {MOST_FRAMES}")
        return ready[-MOST_FRAMES:]

    def _lose(self, why: str) -> None:
        """Begin anew with the calibration that is there."""
        self._notes.append(why)
        self._late = []
        self._display.forget()
        self._handover.begin_anew()

    @property
    def _reason(self) -> str:
        """How the calibration stands, in words."""
        is_catching_up = self._calibrations.last is not None and self._handover.tracker is None
        return self._calibrations.reason + ("; catching up with the present" if is_catching_up else "")

    @property
    def _latency_s(self) -> float:
        return self._camera.delay_s - self._calibrations.offset_s

    @property
    def _usual_delay_s(self) -> float:
        latency_s = self._latency_s
        return USUAL_LATENCY_S if np.isnan(latency_s) else max(latency_s, 0.0)

    # 3. The answers

    def _answers(self, now_s: float) -> tuple[LiveEstimate | None, LiveEstimate | None]:
        tracker = self._handover.tracker
        if tracker is None or tracker.solution is None:
            self._state = LiveState.LOST if self._handover.has_followed else LiveState.CALIBRATING
            return None, None
        if now_s - self._imu.end_s > LOST_S:
            self._state = LiveState.LOST
            return None, None
        clock_sigma_s = self._calibrations.clock_sigma_s
        now = self._display.now(tracker, tracker.solution, now_s, clock_sigma_s, self._usual_delay_s)
        self._state = now.state
        return now, self._display.settled(tracker, tracker.solution, now_s, clock_sigma_s)

    @property
    def _dropped(self) -> Dropped:
        return Dropped(
            late_samples=self._imu.late,
            late_frames=self._frames.late,
            duplicate_samples=self._imu.duplicate,
            duplicate_frames=self._frames.duplicate,
            invalid_samples=self._imu.invalid,
            backlog_frames=self._backlog,
        )
