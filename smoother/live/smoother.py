"""The live smoother: samples in, the arm now and a lag ago out."""

from __future__ import annotations

import time
from collections import deque
from dataclasses import replace
from types import TracebackType

import numpy as np

from ..calibration import ArmCalibration
from ..config import Config
from ..errors import UnoccludeError
from ..measurements.visibility import MISSING_S, joints_needed
from ..recording import CameraFrame, FloatArray, Recording
from ..window.lag_solution import LagSolution
from .answer import Circumstances, estimate_of, shown_state
from .calibration_job import CalibrationJob, LiveCalibration
from .calibrator import BackgroundCalibrator, Calibrator
from .camera_clock import USUAL_LATENCY_S, CameraClock
from .estimate import LiveEstimate
from .follower import AROUND_S, LENGTH_S, LONGEST_PAUSE_S, Follower, first_state
from .frame_buffer import FrameBuffer
from .imu_batch import ImuBatch
from .imu_buffer import ImuBuffer
from .jump import SPREAD_S, Jump
from .live_state import LiveState
from .output import Dropped, LiveOutput
from .prediction import Prediction, predict
from .skeleton_frame import SkeletonFrame

#: Samples are held for so long: what a self-calibration may read, s.
HELD_S = 120.0
#: Self-calibrations begin with so much and are tried so often until one works; then at these lengths, and
#: as often as the last says, s.
FIRST_S, RETRY_S = 8.0, 2.0
AGAIN_S = (15.0, 30.0, 60.0, 120.0)
#: The smoother begins so long before the present, and catches up by so many frames a step, s.
CATCH_UP_S, CATCH_UP_FRAMES = 5.0, 6
#: After a pause of the IMU it takes so much to begin anew, s.
FRESH_S = 1.0
#: A calibration's successor catches up beside the one at work by so many frames a step.
SUCCESSOR_FRAMES = 4
#: More frames than this at once are a backlog; those in between are dropped.
MOST_FRAMES = 12
#: Without frames a node comes so often, s, and so long after the frames' usual delay.
EMPTY_S = 0.1
#: No sample of the IMU for so long: it is lost, s.
LOST_S = 0.5
#: Rates and load are of the last so many seconds.
RATE_S = 2.0
#: What a jump of the camera's clock leaves open, s.
JUMP_SIGMA_S = 0.02


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
        self._given = calibration or ArmCalibration(side=side)
        self._side, self._config, self._lag_s = side, config or Config(), lag_s
        self._gravity_hint, self._camera_frame = gravity_hint, camera_frame
        self._calibrator = calibrator or BackgroundCalibrator()
        self._imu, self._frames, self._camera = ImuBuffer(HELD_S), FrameBuffer(HELD_S), CameraClock()
        self._follower: Follower | None = None
        self._successor: Follower | None = None
        self._calibration: LiveCalibration | None = None
        self._offset_s = self._clock_sigma_s = float("nan")
        self._asked_s: float | None = None
        self._calibrations = 0
        self._is_waiting = False
        self._needed = 1
        self._jump: Jump | None = None
        self._changed_s: float | None = None
        self._late: list[SkeletonFrame] = []
        self._backlog = 0
        self._state, self._now_s = LiveState.CALIBRATING, -np.inf
        self._notes: list[str] = []
        self._reason = "waiting for the first seconds of both streams"
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
            is_new, follower = self._frames.add(each), self._follower
            if is_new and follower is not None and each.t_s <= follower.cursor_s:
                self._late.append(each)
        if jump_s:
            self._notes.append(f"the camera's clock jumped by {-jump_s:.3f} s; the answer follows it")
            self._clock_sigma_s = float(np.hypot(self._clock_sigma_s, JUMP_SIGMA_S))
            self._asked_s = None if self._calibration is None else -np.inf

    def step(self, now_s: float) -> LiveOutput:
        """Work in what has arrived, and answer for the present.

        Parameters
        ----------
        now_s : float, s
            The present on the IMU's clock; call it about as often as an answer is wanted (30 to 100 Hz).
        """
        began = time.thread_time()
        self._now_s, self._notes, notes = now_s, [], self._notes
        # 1. The calibration, in the background.
        self._calibrate()
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
            clock_offset_s=self._offset_s + self._camera.correction_s,
            clock_sigma_s=self._clock_sigma_s,
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
        return self._calibration

    def finish(self) -> None:
        """End the background's work."""
        self._calibrator.close()

    # 1. The calibration

    def _calibrate(self) -> None:
        """Fetch a calibration that is ready, and ask for the next when it is time."""
        answer = self._calibrator.answer()
        if answer is not None:
            self._take(answer)
        if self._calibrator.busy or not len(self._imu) or not len(self._frames):
            return
        newest_s = self._imu.end_s
        if self._asked_s is None:
            start_s = max(float(self._imu.t[0]), self._frames.since(-np.inf)[0].t_s + self._arrival_offset_s)
            due = newest_s - start_s >= FIRST_S
        else:
            wait = (
                RETRY_S if self._calibration is None else AGAIN_S[min(self._calibrations, len(AGAIN_S)) - 1]
            )
            due = newest_s - self._asked_s >= wait
        if due:
            self._asked_s = newest_s
            arm = self._frames.tracks(-np.inf)
            self._needed = joints_needed(arm)
            recording = Recording(
                imu=self._imu.stream(-np.inf),
                arm=arm,
                side=self._side,
                camera_frame=self._camera_frame,
                gravity_hint=self._gravity_hint,
                name="live",
            )
            offset_s = self._arrival_offset_s if np.isnan(self._offset_s) else self._offset_s
            self._calibrator.submit(CalibrationJob(recording, self._given, self._config, offset_s))

    @property
    def _arrival_offset_s(self) -> float:
        """The clocks' offset as the frames' arrival has it, s."""
        return self._camera.delay_s - USUAL_LATENCY_S

    def _take(self, answer: LiveCalibration) -> None:
        """A calibration's answer: a successor begins with it."""
        if answer.model is None or answer.clock is None:
            self._reason = answer.reason
            return
        self._calibrations += 1
        self._calibration = answer
        self._reason = f"calibrated from {answer.until_s - answer.from_s:.0f} s of motion"
        at = np.array([answer.until_s - answer.clock.mean_s])
        self._offset_s, self._clock_sigma_s = float(answer.clock.at(at)[0]), answer.clock.sigma_s
        if self._follower is None:
            self._successor = self._fresh()
        else:
            self._is_waiting, self._successor = True, None

    # 2. The window

    def _follow(self, now_s: float) -> None:
        """Feed the window with what has arrived, and solve it."""
        self._replace_follower(now_s)
        follower, changed = self._follower, False
        if follower is None:
            self._late, self._changed_s = [], None
            return
        if follower.pause_s() > LONGEST_PAUSE_S:
            self._lose("the IMU's samples paused: the smoother begins anew", now_s)
            return
        if self._changed_s is not None:
            follower.integrate_again(self._changed_s)
            self._changed_s, changed = None, True
        for frame in self._late:
            if follower.feed_late(frame):
                changed = True
            else:
                self._frames.late += 1
        self._late = []
        ready = self._ready(follower)
        if len(ready) > MOST_FRAMES:
            self._backlog += len(ready) - MOST_FRAMES
            self._notes.append(f"behind by {len(ready)} frames: dropped all but the newest {MOST_FRAMES}")
            ready = ready[-MOST_FRAMES:]
        solved = follower.solution
        ended_s = follower.feed(ready) if ready else None
        empty_s = self._imu.end_s - self._usual_delay_s - EMPTY_S
        if not ready and empty_s - follower.t_s > EMPTY_S:
            follower.go_on(empty_s)
            changed = True
        if not ready and not changed:
            return
        try:
            follower.solve(now_s - self._lag_s)
        except (np.linalg.LinAlgError, RuntimeError):
            self._lose("the last moments did not determine the motion: the smoother begins anew", now_s)
            return
        if ended_s is not None and solved is not None:
            self._spread(_predicted(follower, solved, now_s), now_s)

    def _replace_follower(self, now_s: float) -> None:
        """Let a successor catch up, and take its place."""
        active = self._follower
        if self._is_waiting and active is not None and active.sees_all():
            # in a gap there is nothing that a successor could begin with
            self._is_waiting, self._successor = False, self._fresh()
            if self._successor is not None:
                self._successor.start(active.window.state(0))
        successor = self._successor
        if successor is None:
            return
        if not successor.started:
            since_s = self._imu.since_pause_s(LONGEST_PAUSE_S, CATCH_UP_S + AROUND_S)
            if self._imu.end_s - since_s < FRESH_S:
                return
            state = first_state(
                self._imu.stream(since_s),
                self._frames.tracks(since_s - self._offset_s),
                successor.model,
                self._offset_s,
                self._needed,
                max(now_s - CATCH_UP_S, since_s + 0.5 * FRESH_S),
            )
            if state is None:
                return
            successor.start(state)
        if successor.pause_s() > LONGEST_PAUSE_S:
            self._successor = None if self._follower is not None else self._fresh()
            return
        ready = self._ready(successor)
        limit = CATCH_UP_FRAMES if self._follower is None else SUCCESSOR_FRAMES
        try:
            if ready:
                successor.feed(ready[:limit])
                successor.solve(now_s - self._lag_s)
        except (np.linalg.LinAlgError, RuntimeError):
            self._successor = None if self._follower is not None else self._fresh()
            return
        if len(ready) > limit or successor.solution is None:
            return
        before, self._follower, self._successor = self._follower, successor, None
        if before is not None and before.solution is not None:
            self._spread(_predicted(before, before.solution, now_s), now_s)

    def _fresh(self) -> Follower | None:
        """A follower with the last calibration, not yet begun; what the active one has learnt counts."""
        if self._calibration is None or self._calibration.model is None:
            return None
        return Follower(
            self._calibration.model,
            self._offset_s,
            self._needed,
            self._config,
            self._imu,
            max(LENGTH_S, self._lag_s + 0.3),
            self._follower,
        )

    def _lose(self, why: str, now_s: float) -> None:
        """Begin anew with the calibration that is there."""
        self._notes.append(why)
        self._follower, self._jump, self._late, self._is_waiting = None, None, [], False
        self._successor = self._fresh()

    def _ready(self, follower: Follower) -> list[SkeletonFrame]:
        """Frames that a follower has not seen and the IMU reaches."""
        frames = self._frames.since(np.nextafter(follower.cursor_s, np.inf))
        reach_s = self._imu.end_s - follower.offset_s
        return [frame for frame in frames if frame.t_s <= reach_s]

    @property
    def _latency_s(self) -> float:
        return self._camera.delay_s - self._offset_s

    @property
    def _usual_delay_s(self) -> float:
        latency_s = self._latency_s
        return USUAL_LATENCY_S if np.isnan(latency_s) else max(latency_s, 0.0)

    # 3. The answers

    def _spread(self, before: Prediction, now_s: float) -> None:
        """Spread the change from what was shown to what is known now."""
        follower = self._follower
        if follower is not None and follower.solution is not None:
            after = _predicted(follower, follower.solution, now_s)
            self._jump = Jump.between(shown_state(before.state, self._jump), after.state)

    def _answers(self, now_s: float) -> tuple[LiveEstimate | None, LiveEstimate | None]:
        follower = self._follower
        if follower is None or follower.solution is None:
            self._state = LiveState.CALIBRATING if self._calibration is None else LiveState.LOST
            return None, None
        if now_s - self._imu.end_s > LOST_S:
            self._state = LiveState.LOST
            return None, None
        if self._jump is not None and now_s - self._jump.at_s > SPREAD_S:
            self._jump = None
        solution, model = follower.solution, follower.model
        prediction = _predicted(follower, solution, now_s)
        walk = follower.noise.shoulder_walk**2
        self._state, since_s = self._state_now(follower, now_s)
        about = Circumstances(
            "now",
            self._state,
            since_s,
            self._clock_sigma_s,
            walk * max(prediction.state.t - solution.newest.t, 0.0),
            self._jump,
        )
        now = estimate_of(prediction, solution, model, about)
        settled_s = now_s - self._lag_s
        if settled_s < float(follower.window.t[0]):
            return now, None
        start = solution.settled
        signal = follower.signal(start.t)
        state, since_s = self._state_at(follower, settled_s)
        about = replace(about, kind="settled", state=state, since_s=since_s, jump=None, shoulder_variance=0.0)
        settled = predict(start, solution, signal, max(settled_s, start.t), follower.noise)
        return now, estimate_of(settled, solution, model, about)

    def _state_now(self, follower: Follower, now_s: float) -> tuple[LiveState, float | None]:
        """Visible or gap at the present, as far as the frames that have arrived say."""
        if now_s - follower.visible_s > self._usual_delay_s + MISSING_S:
            return LiveState.GAP, follower.visible_s
        newest, is_visible = max(follower.seen, default=(0.0, True))
        if not is_visible and newest > follower.visible_s:
            return LiveState.GAP, follower.visible_s
        return LiveState.VISIBLE, None

    def _state_at(self, follower: Follower, t_s: float) -> tuple[LiveState, float | None]:
        """Visible or gap at a moment a little ago."""
        visible = sorted(t for t, is_visible in follower.seen if is_visible)
        before = [t for t in visible if t <= t_s]
        after = [t for t in visible if t > t_s]
        first = before[-1] if before else follower.visible_s
        last = after[0] if after else np.inf
        if last - first > MISSING_S and t_s - first > 1e-6:
            return LiveState.GAP, first
        return LiveState.VISIBLE, None

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


def _predicted(follower: Follower, solution: LagSolution, now_s: float) -> Prediction:
    """A solution's newest node propagated to the present."""
    return predict(solution.newest, solution, follower.signal(solution.newest.t), now_s, follower.noise)
