"""The live smoother: samples in, the arm now and a lag ago out."""

from __future__ import annotations

import time
from collections.abc import Sequence
from functools import partial
from types import TracebackType
from typing import Literal

import numpy as np

from ..array_types import FloatArray
from ..body import FOREARM, SEGMENTS
from ..calibration import ArmCalibration
from ..config import Config
from ..errors import UnoccludeError
from ..recording import FOREARM_JOINTS, JOINTS, CameraFrame, ImuStream, Recording
from ..recovery.samples import widen_turns
from ..rotation import Rotation
from ..selfcal.self_calibration import SelfCalibration
from ..window.shared import JOINT_ERRORS
from .answers import LiveEstimate, LiveOutput, LiveState
from .buffers import USUAL_LATENCY_S, CameraClock, FrameBuffer, Shift, ShiftCause, SkeletonFrame
from .calibrations import JUMP_SIGMA_S, BackgroundCalibrator, Calibrations, InlineCalibrator
from .imu import LONGEST_PAUSE_S, LiveImu
from .monitor import Culprit
from .signal import Prediction, joint_at, predict
from .tracker import AROUND_S, LENGTH_S, Tracker, first_state

_POSE = np.ix_([3, 4, 5, 0, 1, 2], [3, 4, 5, 0, 1, 2])


def _estimate(
    kind: Literal["now", "settled"],
    known: tuple[LiveState, float | None],  # visible or gap, and since when
    prediction: Prediction,
    model: SelfCalibration,
    clock_sigma_s: float,  # of the camera's clock
) -> LiveEstimate:
    """The arm at a moment with its covariance."""
    solution, state = prediction.solution, prediction.state
    names = list(solution.levers)
    covariance = prediction.covariance([*names, *([] if solution.shoulder is None else ["shoulder"])])
    # a clock that is off by a moment moves the whole path along itself
    common = common_error(model) + clock_sigma_s**2 * state.v[:, None] * state.v
    pose = covariance[_POSE]
    pose[:3, :3] += common
    places, spreads = {}, {}
    for k, joint in enumerate(names):
        places[joint], spread = joint_at(state.R, state.p, solution.levers[joint], k, covariance)
        spreads[joint] = spread + common
    if solution.shoulder is not None:
        places["shoulder"], spreads["shoulder"] = solution.shoulder, covariance[-3:, -3:].copy()
    return LiveEstimate(
        t_s=state.t,
        kind=kind,
        state=known[0],
        since_s=known[1],
        position=state.p,
        quaternion=Rotation.from_matrix(state.R).as_quat(scalar_first=True),
        velocity=state.v,
        pose_covariance=widen_turns(pose[None])[0],
        joints=places,
        joint_covariance=spreads,
    )


def common_error(model: SelfCalibration) -> FloatArray:
    """Covariance (3, 3), m^2, of what the camera's errors of the forearm's joints have in common."""
    used = [JOINTS.index(joint) for joint in FOREARM_JOINTS if joint in model.joint_bias.joints]
    if model.errors.considered is None or not used:
        return np.eye(3) * model.joint_bias.sigma_m**2
    covariance = model.errors.considered.covariance[JOINT_ERRORS, JOINT_ERRORS]
    mean = np.zeros((3, covariance.shape[0]))
    for column in used:
        mean[:, 3 * column : 3 * column + 3] = np.eye(3) / len(used)
    return np.asarray(mean @ covariance @ mean.T)


#: Samples are held for this long: what a self-calibration may read, s.
BUFFER_S = 120.0
#: More frames than this at once are a backlog; those in between are dropped.
MOST_FRAMES = 12
#: Without frames, nodes are this far apart, s, and come this long after the frames' usual delay.
EMPTY_S = 0.1
#: No sample of the forearm's IMU for this long: there is no answer, s.
LOST_S = 0.5
#: A first tracker begins this long before the present, s, and catches up by this many frames a step: ten take
#: 13 to 17 ms of processor time, so that a step stays within 20 ms.
CATCH_UP_S, CATCH_UP_FRAMES = 5.0, 10
#: A successor catches up beside the one at work by this many frames a step.
SUCCESSOR_FRAMES = 2
#: After a pause of the IMU this much is needed to begin anew, s.
FRESH_S = 1.0
#: The camera must not have contradicted a first tracker for this long, s.
UNCONTRADICTED_S = 0.8


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
        self._lag_s, self._config = lag_s, config or Config()
        self._frames, self._camera = FrameBuffer(BUFFER_S), CameraClock()
        self._calibrator = calibrator or BackgroundCalibrator()
        given = calibration or ArmCalibration(side=side)
        session = partial(
            Recording, side=side, camera_frame=camera_frame, gravity_hint=gravity_hint, name="live"
        )
        self._calibrations = Calibrations(self._calibrator, given, self._config, session)
        self._imus = {name: LiveImu(SEGMENTS[name], BUFFER_S) for name in (FOREARM.name, *further)}
        self._imu = self._imus[FOREARM.name]
        # who follows the arm, and who catches up beside with a newer calibration and takes its place
        self._tracker: Tracker | None = None
        self._successor: Tracker | None = None
        self._waits_for_sight = self._has_followed = False
        self._not_before_s = -np.inf
        self._backlog = 0
        self._state = LiveState.CALIBRATING
        self._notes: list[str] = []

    def __enter__(self) -> LiveSmoother:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._calibrator.close()

    def add_imu(self, samples: ImuStream, segment: str = FOREARM.name) -> None:
        """Take samples in, in any order; those older than half a second before the newest are dropped."""
        self._imus[segment].add(samples)

    def add_frame(self, frame: SkeletonFrame) -> None:
        """Take a frame in, in any order; one older than half a second before the newest is dropped."""
        frames, jump = self._camera.take(frame)
        if jump is not None:
            self._jumped(jump)
        for each in frames:
            is_new = self._frames.add(each)
            if is_new and self._tracker is not None and each.t_s <= self._tracker.cursor_s:
                self._tracker.late.append(each)

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
        for imu in self._imus.values():
            self._notes += imu.check(now_s)
        # 1. The calibration, in the background; who follows with it catches up, and takes over.
        if self._calibrations.fetch():
            self._waits_for_sight = self._tracker is not None
            self._successor = None if self._waits_for_sight else self._fresh()
            self._notes += self._calibrations.left_out()
        self._calibrations.ask(self._imus, self._frames, self._camera)
        self._hand_over(now_s)
        # 2. What has arrived, into the window; the past is corrected.
        self._follow(now_s)
        # 3. The answers.
        now, settled = self._answers(now_s)
        notes, self._notes = self._notes, []
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

    # 1. Who follows the arm

    def _hand_over(self, now_s: float) -> None:
        """Let the successor catch up, and take the place of the one at work."""
        before = self._tracker
        if self._waits_for_sight and before is not None and before.history.sees_all(before.window.t):
            # in a gap there is nothing that a successor could begin with
            self._waits_for_sight, self._successor = False, self._fresh()
            self._successor.start(before.window.state(0))
        successor = self._successor
        if successor is None:
            return
        if not successor.started:
            self._start(successor, now_s)  # work enough for a step
            return
        if successor.pause_s() > LONGEST_PAUSE_S or not self._catch_up(successor, now_s):
            self._successor = self._fresh() if before is None else None
            return
        # a first one has nothing to go on by where the camera is wrong
        is_left_alone = before is None and successor.monitor.since_s is not None
        if is_left_alone or any(finding.cause is Culprit.TRACKER for finding in successor.findings):
            if before is None:
                self._not_before_s = max(self._not_before_s, now_s - FRESH_S)
            self._successor = self._fresh() if before is None else None
            return
        if successor.solution is None or successor.due() or not self._is_proved(successor):
            return
        self._tracker, self._successor, self._has_followed = successor, None, True

    def _is_proved(self, successor: Tracker) -> bool:
        """Whether the camera has not contradicted it for some time; after a pause none is needed."""
        if self._tracker is not None or (self._has_followed and not np.isfinite(self._not_before_s)):
            return successor.monitor.since_s is None
        return successor.t_s - successor.monitor.sound_since_s >= UNCONTRADICTED_S

    def _start(self, successor: Tracker, now_s: float) -> None:
        """Begin some seconds ago, where the streams suffice."""
        since_s = self._imu.since_pause_s(CATCH_UP_S + AROUND_S)
        since_s = max(since_s, self._not_before_s)
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
        ready = successor.due()[: CATCH_UP_FRAMES if self._tracker is None else SUCCESSOR_FRAMES]
        if ready:
            successor.feed(ready)
        return not ready or self._solved(successor, now_s)

    def _solved(self, tracker: Tracker, now_s: float) -> bool:
        """Solve a window; False where the last moments did not determine the motion."""
        try:
            tracker.solve(now_s - self._lag_s)
        except (np.linalg.LinAlgError, RuntimeError):
            return False
        return True

    def _fresh(self) -> Tracker:
        """A tracker with the last calibration, not yet begun; what the active one has learnt counts."""
        assert self._calibrations.last is not None  # nobody follows, or catches up, before the first one
        about = self._calibrations.last, self._calibrations.offset_s, self._calibrations.needed, self._config
        length_s = max(LENGTH_S, self._lag_s + 0.3)
        return Tracker(*about, self._imus, self._frames, length_s, self._tracker)

    # 2. The window

    def _follow(self, now_s: float) -> None:
        """Feed the window with what has arrived, and solve it."""
        tracker = self._tracker
        if tracker is None:
            self._imu.changed_s = None
            return
        if tracker.pause_s() > LONGEST_PAUSE_S:
            self._lose("the IMU's samples paused: the smoother restarts")
            return
        changed, ready = tracker.mend(), tracker.due()
        if len(ready) > MOST_FRAMES:
            self._backlog += len(ready) - MOST_FRAMES
            self._notes.append(f"behind by {len(ready)} frames: dropped all but the newest {MOST_FRAMES}")
        if ready:
            tracker.feed(ready[-MOST_FRAMES:])
        if not self._heed(tracker, now_s):
            return
        empty_s = self._imu.end_s - self._usual_delay_s - EMPTY_S
        if not ready and empty_s - tracker.t_s > EMPTY_S:
            tracker.go_on(empty_s)
            changed = True
        if not ready and not changed:
            return
        if not self._solved(tracker, now_s):
            self._lose("the last moments did not determine the motion: the smoother restarts")

    def _heed(self, tracker: Tracker, now_s: float) -> bool:
        """Act on what the monitor of the camera found; False where the tracker is lost by it."""
        for finding in tracker.leave_out():
            if finding.cause is Culprit.TRACKER:
                self._frames.restore()
                self._lose(finding.sentence, now_s)
                return False
            self._notes += [finding.sentence] if finding.sentence else []
            if finding.cause is Culprit.IMU:
                self._imu.contradicted(*finding.doubt_s)
                if finding.again:
                    self._calibrations.clock_doubted()
            elif finding.cause is Culprit.CAMERA:
                self._frames.leave_out(finding.retract_s - tracker.offset_s, np.inf)
            else:
                self._frames.confirm()
        return True

    def _lose(self, why: str, not_before_s: float = -np.inf) -> None:
        """Begin anew with the calibration that is there, with nothing from before a time."""
        self._notes.append(why)
        self._not_before_s = not_before_s
        self._tracker, self._waits_for_sight = None, False
        self._successor = self._fresh()

    @property
    def _reason(self) -> str:
        """How the calibration stands, in words."""
        is_catching_up = self._calibrations.last is not None and self._tracker is None
        return self._calibrations.reason + ("; catching up with the present" if is_catching_up else "")

    @property
    def _doubt(self) -> str:
        """Why the answer is to be taken with care."""
        if self._tracker is None:
            return ""
        if self._tracker.monitor.since_s is not None:
            return "the camera is left out: it contradicts the IMU"
        if self._imu.is_doubted:
            return "; ".join(self._imu.because) or "the IMU contradicts the camera"
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
        tracker = self._tracker
        if tracker is None or tracker.solution is None:
            self._state = LiveState.LOST if self._has_followed else LiveState.CALIBRATING
            return None, None
        if now_s - self._imu.end_s > LOST_S:
            self._state = LiveState.LOST
            return None, None
        solution, factor = tracker.solution, self._calibrations.sigma_factor
        prediction = predict(solution, tracker.signal, now_s, tracker.noise)
        known = tracker.history.state_now(now_s, self._usual_delay_s)
        about = tracker.model, self._calibrations.clock_sigma_s
        now, settled = _estimate("now", known, prediction, *about), None
        if solution.shoulder is not None:  # how far it may have gone since its knot
            beyond_s = max(prediction.state.t - solution.newest.t, 0.0)
            now.joint_covariance["shoulder"] += tracker.noise.shoulder_walk**2 * beyond_s * np.eye(3)
        if (settled_s := now_s - self._lag_s) >= float(tracker.window.t[0]):
            at_s, known = max(settled_s, solution.settled.t), tracker.history.state_at(settled_s)
            prediction = predict(solution, tracker.signal, at_s, tracker.noise, settled=True)
            settled = _estimate("settled", known, prediction, *about).widened(factor)
        self._state = now.state
        return now.widened(factor), settled
