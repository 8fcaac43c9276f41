"""The window of the last moments fed with frames and samples under one calibration."""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right, insort
from collections import deque
from collections.abc import Mapping, Sequence

import numpy as np

from ..array_types import BoolArray, FloatArray
from ..body import FOREARM
from ..config import Config
from ..graph.lag_window import LagWindow
from ..linalg import interpolate
from ..measurements.alignment import located
from ..measurements.clock import constant_clock
from ..measurements.segment import SegmentTraits, make_segment
from ..measurements.visibility import MISSING_S
from ..recording import FOREARM_JOINTS, JOINTS, ImuStream, JointState, JointTracks
from ..selfcal.self_calibration import SelfCalibration
from ..units import GRAVITY
from ..window.cut import CHANGE_TIME_S, STILL_ACCELERATION
from ..window.prepare import prepare
from ..window.priors import first_priors, noise_of
from ..window.problem import Priors
from ..window.shared import Gaussian
from ..window.solution import LagSolution, NodeState
from .answers import LiveState
from .buffers import FrameBuffer, SkeletonFrame
from .calibrations import LiveCalibration
from .further_imus import SegmentFollower, integrate_again
from .imu import LiveImu
from .monitor import CameraMonitor, Culprit, FrameFinding
from .signal import DoubtfulSignal, LiveSignal, increments_between, propagated

#: A first state is read from this much around it, s.
AROUND_S = 3.0


def first_state(
    imu: ImuStream, frames: JointTracks, model: SelfCalibration, offset_s: float, needed: int, t_s: float
) -> NodeState | None:
    """A state to begin with, from what camera and IMU say around it."""
    samples = imu.select(np.abs(imu.t_s - t_s) < AROUND_S)
    clock = constant_clock(offset_s)
    rows = np.abs(frames.t_s + offset_s - t_s) < AROUND_S
    if len(samples) < 40 or rows.sum() < 10:
        return None
    arm = frames.select(rows)
    traits = SegmentTraits(model.initial.down, None, needed, False)
    segment = make_segment(samples, samples.t_s, arm, slice(0, len(arm)), traits)
    if segment is None:
        return None
    segment = model.errors.corrected(segment)
    ready = prepare(segment, model.estimate, clock, model.joint_sigma_m, AROUND_S)
    if ready is None:
        return None
    prepared, alignment = ready
    usable = prepared.frame_node >= 0
    usable &= prepared.accepted[:, [JOINTS.index(joint) for joint in FOREARM_JOINTS]].sum(axis=1) >= needed
    if usable.sum() < 6:
        return None
    candidates = prepared.frame_t_imu[usable]
    at = candidates[[int(np.argmin(np.abs(candidates - t_s)))]]
    if not samples.t_s[0] < at[0] < samples.t_s[-1]:
        return None
    R = (alignment.at(at) * segment.attitude.at(at)).as_matrix()[0]
    p, v = (
        interpolate(prepared.t, prepared.forearm.start.p, at)[0],
        interpolate(prepared.t, prepared.forearm.start.v, at)[0],
    )
    return NodeState(float(at[0]), R, p, v)


#: This many frames are remembered.
FRAMES = 400


class FrameHistory:
    """The last frames, and whether each showed the forearm."""

    def __init__(self) -> None:
        self._frames: list[tuple[float, bool]] = []  # in order of time
        self.visible_s = -math.inf

    def add(self, t_s: float, is_visible: bool) -> None:
        """Add a frame, in any order."""
        insort(self._frames, (t_s, is_visible))
        del self._frames[:-FRAMES]
        if is_visible:
            self.visible_s = max(self.visible_s, t_s)

    def sees_all(self, t: FloatArray) -> bool:
        """Whether the forearm was visible all the time that nodes at these times (n,) cover."""
        if len(t) <= 5:
            return False
        first = bisect_left(self._frames, (float(t[0]), False))
        return all(is_visible for _, is_visible in self._frames[first:])

    def state_now(self, now_s: float, usual_delay_s: float) -> tuple[LiveState, float | None]:
        """Visible or gap at the present, as far as the frames that have arrived say."""
        if now_s - self.visible_s > usual_delay_s + MISSING_S:
            return LiveState.GAP, self.visible_s
        newest_s, is_visible = self._frames[-1] if self._frames else (0.0, True)
        if not is_visible and newest_s > self.visible_s:
            return LiveState.GAP, self.visible_s
        return LiveState.VISIBLE, None

    def state_at(self, t_s: float) -> tuple[LiveState, float | None]:
        """Visible or gap at a moment a little ago, and when the gap began."""
        after = bisect_right(self._frames, (t_s, True))
        before = (t for t, is_visible in reversed(self._frames[:after]) if is_visible)
        first = next(before, self.visible_s)
        last = next((t for t, is_visible in self._frames[after:] if is_visible), math.inf)
        if last - first > MISSING_S and t_s - first > 1e-6:
            return LiveState.GAP, first
        return LiveState.VISIBLE, None


#: Nodes stay for this long after the newest, s; longer where `settled` asks for it.
LENGTH_S = 1.2
#: A frame nearer than this to the newest node joins it, s.
SAME_S = 0.004
#: A gap that ends after this shows where the arm is by the camera alone, s.
SEEN_AGAIN_S = 0.2
#: What one calibration has learnt counts for the next with this much wider sigmas.
WIDER = 2.0


class Tracker:
    """Follows the arm with one calibration."""

    def __init__(
        self,
        calibration: LiveCalibration,
        offset_s: float,
        needed: int,
        config: Config,
        imus: Mapping[str, LiveImu],  # By segment, the forearm's first
        frames: FrameBuffer,
        length_s: float = LENGTH_S,
        before: Tracker | None = None,
    ) -> None:
        assert calibration.model is not None
        self.model = model = calibration.model
        self.offset_s, self._needed, self._frames, self._imu = offset_s, needed, frames, imus[FOREARM.name]
        self.noise = noise_of(config, model.upper_arm_sigma_m, model.estimate)
        priors = first_priors(model.initial, model.estimate, config)
        if before is not None and before.solution is not None:
            priors = _with_learnt(priors, before.solution)
        self.window = LagWindow(priors, self.noise, model.joint_sigma_m, length_s)
        self.signal, self.history = LiveSignal(self._imu, model.errors.imu), FrameHistory()
        self.monitor = CameraMonitor(model, self.noise, self.signal)
        self._further = [
            SegmentFollower(imus[place.segment], place, model, frames, offset_s)
            for place in calibration.further
        ]
        self.findings: list[FrameFinding] = []
        self.late: list[SkeletonFrame] = []  # that came after later ones
        self._left_out: list[float] = []
        self._located = np.array(JOINTS)[located(model.estimate)].tolist()
        self._forces: deque[tuple[float, FloatArray]] = deque()
        self.solution: LagSolution | None = None
        self.cursor_s = -np.inf

    def start(self, state: NodeState) -> None:
        """Begin with a first node."""
        self.window.add(state, None)
        self.cursor_s, self.history.visible_s = state.t - self.offset_s, state.t

    @property
    def started(self) -> bool:
        """It has a first node."""
        return len(self.window.t) > 0

    @property
    def t_s(self) -> float:
        """Time of the newest node, s."""
        return float(self.window.t[-1])

    def due(self) -> list[SkeletonFrame]:
        """Frames that it has not seen and the IMU reaches."""
        frames, reach_s = (
            self._frames.since(np.nextafter(self.cursor_s, np.inf)),
            self._imu.end_s - self.offset_s,
        )
        return [frame for frame in frames if frame.t_s <= reach_s]

    def feed(self, frames: Sequence[SkeletonFrame]) -> None:
        """Add frames in order of time, each as a node or at one."""
        signal = self.signal.since(self.t_s)
        for frame in frames:
            t_s = frame.t_s + self.offset_s
            position = frame.position - self.model.joint_bias.error_m
            accepted = self._judged(frame.t_s, t_s, position, self.accepted(frame))
            is_visible = self.is_visible(accepted)
            again = is_visible and t_s - self.history.visible_s > SEEN_AGAIN_S
            if t_s - self.t_s > SAME_S:
                state = self._propagated(t_s, signal)
                if again:
                    state = self._by_camera(state, frame, accepted)
                self._add(state, is_visible, signal)
            if t_s > self.t_s - 2.0 * SAME_S:
                self._measure(-1, position, accepted)
            self.cursor_s = max(self.cursor_s, frame.t_s)
            self.history.add(t_s, is_visible)

    def _judged(self, stamp_s: float, t_s: float, position: FloatArray, accepted: BoolArray) -> BoolArray:
        """Which of a frame's accepted joints are used; what the monitor finds is noted, and taken back."""
        finding = self.monitor.judge(t_s, position, accepted, self.solution)
        if finding.cause is not Culprit.NOBODY or finding.sentence:
            self.findings.append(finding)
        if np.isfinite(finding.retract_s):
            self.window.retract(finding.retract_s)
        if accepted.any() and not finding.accepted.any():
            self._left_out.append(stamp_s)
        return finding.accepted

    def go_on(self, t_s: float) -> None:
        """Add a node without a frame."""
        signal = self.signal.since(self.t_s)
        self._add(self._propagated(t_s, signal), False, signal)

    def leave_out(self) -> list[FrameFinding]:
        """Take the frames that it did not use from what a calibration reads; what was found since then."""
        for stamp_s in self._left_out:
            self._frames.leave_out(stamp_s, np.nextafter(stamp_s, np.inf))
        findings, self.findings, self._left_out = self.findings, [], []
        return findings

    def mend(self) -> bool:
        """Work in what came late; whether anything did."""
        changed = self._imu.changed_s is not None
        for follower in self._further:
            follower.mend(self.window)
        if self._imu.changed_s is not None:
            integrate_again(self.window, self.signal, FOREARM.name, self._imu.changed_s)
            self._imu.changed_s = None
        for frame in self.late:
            if self._feed_late(frame):
                changed = True
            else:
                self._frames.late += 1
        self.late = []
        return changed

    def _feed_late(self, frame: SkeletonFrame) -> bool:
        """Add a late frame at the node nearest to it, where the IMU puts it; False where that has left."""
        t, t_s = self.window.t, frame.t_s + self.offset_s
        if t_s < t[0] - SAME_S:
            return False
        accepted, nearest = self.accepted(frame), int(np.argmin(np.abs(t - t_s)))
        node = self.window.state(nearest)
        position = frame.position - self.model.joint_bias.error_m
        if abs(node.t - t_s) > 1e-6:
            position = position - self._shift(node, t_s)
        self._measure(nearest, position, accepted)
        self.history.add(t_s, self.is_visible(accepted))
        return True

    def solve(self, settled_s: float) -> LagSolution:
        """Solve the window, with what the IMUs beyond the forearm reach."""
        for follower in self._further:
            follower.follow(self.window)
        self.solution = self.window.solve(settled_s)
        for follower in self._further:
            follower.judge(self.window)
        self.monitor.solved(self.solution)
        return self.solution

    def pause_s(self) -> float:
        """Longest time without samples since the newest node, s."""
        return self.signal.pause_s(self.t_s)

    def accepted(self, frame: SkeletonFrame) -> BoolArray:
        """Which joints of a frame may be used, (5,)."""
        return np.asarray((frame.state == JointState.TRACKED) & np.isfinite(frame.position).all(axis=1))

    def is_visible(self, accepted: BoolArray) -> bool:
        """Whether the accepted joints (5,) show the forearm."""
        return int(accepted[[JOINTS.index(joint) for joint in FOREARM_JOINTS]].sum()) >= self._needed

    def _propagated(self, t_s: float, signal: DoubtfulSignal) -> NodeState:
        """Where the IMU leads from the newest node."""
        return propagated(self.window.state(-1), t_s, signal, self.window.bias, self.window.gravity)

    def _by_camera(self, state: NodeState, frame: SkeletonFrame, accepted: BoolArray) -> NodeState:
        """The state where the camera's joints put the IMU."""
        position = frame.position - self.model.joint_bias.error_m
        places = [
            position[JOINTS.index(joint)] - state.R @ self.window.lever(joint)
            for joint in FOREARM_JOINTS
            if accepted[JOINTS.index(joint)] and (joint == "strap" or joint in self.model.estimate.lever_arms)
        ]
        return NodeState(state.t, state.R, np.mean(places, axis=0), state.v) if places else state

    def _add(self, state: NodeState, is_visible: bool, signal: DoubtfulSignal) -> None:
        increments = increments_between(signal, self.t_s, state.t, self.window.bias)
        dt = state.t - self.t_s
        force = state.R @ increments.acc.mean(axis=(0, 1))
        self._forces.append((state.t, force))
        while self._forces[0][0] < state.t - 1.0:
            self._forces.popleft()
        change = np.inf
        if not is_visible and len(self._forces) >= 10:  # see `window.cut`: a still arm keeps its velocity
            std = float(np.std([force for _, force in self._forces], axis=0).max())
            change = float(np.hypot(std, STILL_ACCELERATION) * np.sqrt(dt * CHANGE_TIME_S))
        self.window.add(state, increments, change)

    def _measure(self, index: int, position: FloatArray, accepted: BoolArray) -> None:
        """Add a frame's joints at a node."""
        for column in np.flatnonzero(accepted):
            joint = JOINTS[column]
            if joint in ("shoulder", "strap", *self._located):
                self.window.measure(index, joint, position[column])

    def _shift(self, node: NodeState, t_s: float) -> FloatArray:
        """How far each joint moves from a node to a time near it, (5, 3) m."""
        signal = self.signal.since(min(node.t, t_s))
        there = propagated(node, t_s, signal, self.window.bias, self.window.gravity)
        shift = np.zeros((len(JOINTS), 3))
        for column, joint in enumerate(JOINTS):
            if joint != "shoulder":
                shift[column] = there.p - node.p + (there.R - node.R) @ self.window.lever(joint)
        return shift


def _with_learnt(priors: Priors, solution: LagSolution) -> Priors:
    """The priors with the biases and gravity of an earlier solution, their sigmas wider."""
    layout, mean, covariance = priors.layout, priors.shared.mean.copy(), priors.shared.covariance.copy()
    to_shared = np.zeros((8, 9))
    to_shared[:6, :6] = np.eye(6)
    to_shared[6:, 6:] = layout.gravity_axes / GRAVITY
    mean[:6], mean[layout.gravity] = solution.bias, layout.gravity_axes @ solution.gravity / GRAVITY
    covariance[:8, :] = covariance[:, :8] = 0.0
    covariance[:8, :8] = WIDER**2 * to_shared @ solution.block("bias", "gravity") @ to_shared.T
    return Priors(layout, Gaussian(mean, covariance), priors.bias_walk)
