"""The live smoother: samples in, the arm now and a lag ago out."""

from __future__ import annotations

import time
from collections.abc import Sequence
from types import TracebackType

import numpy as np

from ..array_types import FloatArray
from ..body import SEGMENTS
from ..calibration import ArmCalibration
from ..config import Config
from ..errors import UnoccludeError
from ..recording import CameraFrame
from .answers import LiveEstimate, LiveOutput, LiveState
from .buffers import FrameBuffer, ImuBatch, ImuBuffer, SkeletonFrame
from .calibrations import JUMP_SIGMA_S, BackgroundCalibrator, Calibrations, InlineCalibrator
from .camera_clock import USUAL_LATENCY_S, CameraClock, Shift, ShiftCause
from .display import Display, predicted
from .further_imus import LiveFurtherImu
from .monitor import Culprit
from .tracker import LONGEST_PAUSE_S, Tracker
from .tracker_handover import TrackerHandover

#: Samples are held for this long: what a self-calibration may read, s.
BUFFER_S = 120.0
#: More frames than this at once are a backlog; those in between are dropped.
MOST_FRAMES = 12
#: Without frames, nodes are this far apart, s, and come this long after the frames' usual delay.
EMPTY_S = 0.1
#: No sample of the IMU for this long: it is lost, s.
LOST_S = 0.5


class LiveSmoother:
    """A fixed-lag smoother that calibrates itself; use as a context manager."""

    def __init__(
        self,
        side: str = "",
        calibration: ArmCalibration | None = None,
        config: Config | None = None,
        lag_s: float = 0.2,
        gravity_hint: FloatArray | None = None,
        camera_frame: CameraFrame | None = None,
        calibrator: InlineCalibrator | None = None,
        further: Sequence[str] = (),
    ) -> None:
        if not 0.0 <= lag_s <= 2.0:
            raise UnoccludeError(f"The lag is {lag_s:g} s; give one from 0 to 2 s.")
        self._lag_s = lag_s
        self._imu, self._frames, self._camera = ImuBuffer(BUFFER_S), FrameBuffer(BUFFER_S), CameraClock()
        given, config = calibration or ArmCalibration(side=side), config or Config()
        self._calibrations = Calibrations(
            calibrator or BackgroundCalibrator(), side, given, config, gravity_hint, camera_frame
        )
        self._worn = {name: LiveFurtherImu(SEGMENTS[name], BUFFER_S) for name in further}
        self._handover = TrackerHandover(
            self._calibrations, config, self._imu, self._frames, lag_s, self._worn
        )
        self._display = Display(lag_s)
        self._changed_s: float | None = None
        self._late: list[SkeletonFrame] = []
        self._backlog = 0
        self._because: tuple[str, ...] = ()
        self._state = LiveState.CALIBRATING
        self._notes: list[str] = []

    def __enter__(self) -> LiveSmoother:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.finish()

    def add_imu(self, batch: ImuBatch) -> None:
        """Take samples in, in any order; those older than half a second before the newest are dropped."""
        self._imu_changed(self._imu.add(batch))

    def add_further_imu(self, segment: str, batch: ImuBatch) -> None:
        """Take samples of the IMU on a segment beyond the forearm in, as `add_imu`."""
        self._worn[segment].add(batch)

    def _imu_changed(self, since_s: float | None) -> None:
        """Samples from some time on are others now."""
        if since_s is not None:
            self._changed_s = since_s if self._changed_s is None else min(self._changed_s, since_s)

    def add_frame(self, frame: SkeletonFrame) -> None:
        """Take a frame in, in any order; one older than half a second before the newest is dropped."""
        frames, jump = self._camera.take(frame)
        if jump is not None:
            self._jumped(jump)
        for each in frames:
            is_new, tracker = self._frames.add(each), self._handover.tracker
            if is_new and tracker is not None and each.t_s <= tracker.cursor_s:
                self._late.append(each)

    def _jumped(self, jump: Shift) -> None:
        """Frames come at other times after their stamps: was the clock set, or is the camera later?"""
        if jump.cause is ShiftCause.LATENCY:
            self._notes.append(f"the camera's frames come {jump.seconds:+.3f} s later than before")
            return
        # where neither stamps nor arrivals say, the clock may be right: it is uncertain by all of the jump
        self._calibrations.clock_jumped(JUMP_SIGMA_S if jump.cause is ShiftCause.CLOCK else abs(jump.seconds))
        self._notes.append(f"the camera's clock jumped by {-jump.seconds:.3f} s; the answer follows it")

    def step(self, now_s: float) -> LiveOutput:
        """Work in what has arrived, and answer for the present."""
        began = time.thread_time()
        self._notes, notes = [], self._notes
        self._check_imu()
        for worn in self._worn.values():
            self._notes += worn.check(now_s)
        # 1. The calibration, in the background; who follows with it catches up, and takes over.
        self._calibrate(now_s)
        # 2. What has arrived, into the window; the past is corrected.
        self._follow(now_s)
        # 3. The answers.
        now, settled = self._answers(now_s)
        self._notes, notes = [], [*notes, *self._notes]
        return LiveOutput(
            now_s=now_s,
            state=self._state,
            now=now,
            settled=settled,
            clock_offset_s=self._calibrations.offset_s + self._camera.correction_s,
            clock_sigma_s=self._calibrations.clock_sigma_s,
            camera_latency_s=self._latency_s,
            dropped={
                "late_samples": self._imu.late,
                "late_frames": self._frames.late,
                "duplicate_samples": self._imu.duplicate,
                "duplicate_frames": self._frames.duplicate,
                "invalid_samples": self._imu.invalid,
                "backlog_frames": self._backlog,
            },
            step_ms=1e3 * (time.thread_time() - began),
            notes=tuple(notes),
            calibration=self._reason,
            doubt=self._doubt,
        )

    def finish(self) -> None:
        """End the background's work."""
        self._calibrations.close()

    def _check_imu(self) -> None:
        """Look at what came of the IMU; say once what is wrong with it, and when it is plausible again."""
        self._imu_changed(self._imu.check() if len(self._imu) else None)
        because = self._imu.doubtful_because
        self._notes += [
            f"{why}; the camera is followed meanwhile" for why in because if why not in self._because
        ]
        if self._because and not because:
            self._notes.append("the IMU is plausible again")
        self._because = because

    # 1. The calibration

    def _calibrate(self, now_s: float) -> None:
        """Fetch a calibration that is ready, ask for the next when it is time, let a successor catch up."""
        if self._calibrations.fetch():
            self._handover.calibrated()
            self._notes += self._calibrations.left_out()
        self._calibrations.ask(self._imu, self._frames, self._camera, self._worn)
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
            self._lose("the IMU's samples paused: the smoother restarts")
            return
        solved, changed = tracker.solution, self._mend(tracker)
        ready = self._ready(tracker)
        ended_s = tracker.feed(ready) if ready else None
        if not self._heed(tracker, now_s):
            return
        empty_s = self._imu.end_s - self._usual_delay_s - EMPTY_S
        if not ready and empty_s - tracker.t_s > EMPTY_S:
            tracker.go_on(empty_s)
            changed = True
        if not ready and not changed:
            return
        try:
            tracker.solve(now_s - self._lag_s)
        except (np.linalg.LinAlgError, RuntimeError):
            self._lose("the last moments did not determine the motion: the smoother restarts")
            return
        if ended_s is not None and solved is not None:
            self._display.spread(predicted(tracker, solved, now_s), tracker, now_s)

    def _heed(self, tracker: Tracker, now_s: float) -> bool:
        """Act on what the monitor of the camera found; False where the tracker is lost by it."""
        for stamp_s in tracker.left_out:
            self._frames.leave_out(stamp_s, np.nextafter(stamp_s, np.inf))
        tracker.left_out.clear()
        findings, tracker.findings = tracker.findings, []
        for finding in findings:
            if finding.cause is Culprit.TRACKER:
                self._frames.restore()
                self._lose(finding.sentence, now_s)
                return False
            self._notes += [finding.sentence] if finding.sentence else []
            if finding.cause is Culprit.IMU:
                self._imu_changed(self._imu.contradicted(*finding.doubt_s))
                if finding.again:
                    self._calibrations.clock_doubted()
            elif finding.cause is Culprit.CAMERA:
                since_s = finding.retract_s - tracker.offset_s
                self._frames.leave_out(since_s, np.inf)
            else:
                self._frames.confirm()
        return True

    def _mend(self, tracker: Tracker) -> bool:
        """Work in what came late; whether anything did."""
        changed = self._changed_s is not None
        for follower in tracker.further:
            if follower.worn.changed_s is not None:
                follower.integrate_again(tracker.window, follower.worn.changed_s)
                follower.worn.changed_s = None
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
        """Frames that are due, at most this many: of a backlog the newest."""
        ready = self._handover.ready(tracker)
        if len(ready) > MOST_FRAMES:
            self._backlog += len(ready) - MOST_FRAMES
            self._notes.append(f"behind by {len(ready)} frames: dropped all but the newest {MOST_FRAMES}")
        return ready[-MOST_FRAMES:]

    def _lose(self, why: str, not_before_s: float = -np.inf) -> None:
        """Begin anew with the calibration that is there, with nothing from before a time."""
        self._notes.append(why)
        self._late = []
        self._display.forget()
        self._handover.begin_anew(not_before_s)

    @property
    def _reason(self) -> str:
        """How the calibration stands, in words."""
        is_catching_up = self._calibrations.last is not None and self._handover.tracker is None
        return self._calibrations.reason + ("; catching up with the present" if is_catching_up else "")

    @property
    def _doubt(self) -> str:
        """Why the answer is to be taken with care."""
        tracker = self._handover.tracker
        if tracker is None:
            return ""
        if tracker.monitor.since_s is not None:
            return "the camera is left out: it contradicts the IMU"
        if self._imu.is_doubted:
            return "; ".join(self._because) or "the IMU contradicts the camera"
        return "the first calibration, of some seconds" if self._calibrations.sigma_factor != 1.0 else ""

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
        settled = self._display.settled(tracker, tracker.solution, now_s, clock_sigma_s)
        factor = self._calibrations.sigma_factor
        if factor != 1.0:
            return now.widened(factor), None if settled is None else settled.widened(factor)
        return now, settled
