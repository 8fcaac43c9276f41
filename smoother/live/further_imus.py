"""IMUs on segments beyond the forearm: their part in a tracker's window."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from ..array_types import FloatArray
from ..graph.lag_window import LagWindow
from ..measurements.inertial import ImuRun, imu_run
from ..measurements.segment import Segment
from ..measurements.visibility import accepted_samples
from ..selfcal.self_calibration import SelfCalibration
from ..window.prepare import prepare_further
from ..window.problem import States
from ..window.solution import NodeState
from .buffers import FrameBuffer
from .imu import LiveImu
from .signal import BEFORE_S, LiveSignal, increments_between, propagated

#: It contradicts the rest of the arm where the mean squared error of its factors at the nodes of the last
#: moments, s, is above this (a sound one's is 0.02 at most), in this many solutions in a row.
LOOKED_S, CONTRADICTS, IN_A_ROW = 0.5, 0.3, 3
#: Where it begins is read from this much before, s, with this many samples, and tried this often, s.
AROUND_S, FEWEST_SAMPLES, EACH_S = 3.0, 40, 0.25
#: Its first velocity is read off this many nodes.
NODES = 6


@dataclass(frozen=True)
class FurtherPlace:
    """How an IMU beyond the forearm sits, as a self-calibration found it, beside the joints in its axes."""

    segment: str  # That it is on
    errors: FloatArray  # (2, 3, 3): scale errors of accelerometer and gyroscope
    shift_s: float  # What is added to its stamps: to the clock of the forearm's IMU


def integrate_again(window: LagWindow, signal: LiveSignal, segment: str, since_s: float) -> None:
    """Integrate the intervals of an IMU anew that samples from a time on belong to."""
    t, at = window.t, window.nodes_of(segment)
    late = [(before, index) for before, index in pairwise(at) if t[index] >= since_s - BEFORE_S]
    if late:
        samples = signal.since(float(t[late[0][0]]))
        for before, index in late:
            bias = window.bias_of(segment)
            increments = increments_between(samples, float(t[before]), float(t[index]), bias)
            window.set_increments(index, increments, segment)


class SegmentFollower:
    """Gives a tracker's window the motion of an IMU beyond the forearm."""

    def __init__(
        self,
        worn: LiveImu,
        place: FurtherPlace,
        model: SelfCalibration,
        frames: FrameBuffer,
        offset_s: float,
    ) -> None:
        self.worn, self._place, self._model = worn, place, model
        self._frames, self._offset_s = frames, offset_s
        self._signal = LiveSignal(worn, place.errors, place.shift_s)
        self._tried_s, self._bad = -np.inf, 0

    def follow(self, window: LagWindow) -> None:
        """Add what its samples reach; leave out what is doubtful."""
        name, shift_s = self.worn.segment.name, self._place.shift_s
        if not len(self.worn):
            return
        t, at = window.t, window.nodes_of(name)
        doubted_s, usable_s = self.worn.doubted_s + shift_s, self.worn.usable_s + shift_s
        if any(doubted_s <= t[k] < usable_s for k in at):
            window.detach(name, doubted_s)
            at = window.nodes_of(name)
        since_s = max(self.worn.usable_s, self.worn.since_pause_s(AROUND_S)) + shift_s
        if not at or t[at[-1]] < since_s:
            at = self._begin(window, since_s, at)
        if not at:
            return
        signal = self._signal.since(float(t[at[-1]]))
        last = at[-1]
        for index in range(last + 1, int(np.searchsorted(t, signal.end_s, side="right"))):
            start_s, end_s, bias = float(t[last]), float(t[index]), window.bias_of(name)
            if window.is_due(index, name, start_s):
                state = propagated(window.state(last, name), end_s, signal, bias, window.gravity)
                window.attach(index, name, state, increments_between(signal, start_s, end_s, bias))
                last = index

    def judge(self, window: LagWindow) -> None:
        """Leave it out where a solved window shows that it contradicts the rest of the arm."""
        t, name = window.t, self.worn.segment.name
        self._bad = self._bad + 1 if window.misfit(name, t[-1] - LOOKED_S) > CONTRADICTS else 0
        if self._bad >= IN_A_ROW:
            self.worn.contradicted_by_arm(t[0] - self._place.shift_s)
            window.detach(name, t[0])
            self._bad = 0

    def mend(self, window: LagWindow) -> None:
        """Integrate the intervals anew whose samples have changed."""
        if self.worn.changed_s is not None:
            since_s = self.worn.changed_s + self._place.shift_s
            integrate_again(window, self._signal, self.worn.segment.name, since_s)
            self.worn.changed_s = None

    def _begin(self, window: LagWindow, since_s: float, before: Sequence[int]) -> list[int]:
        """Begin at a node with what camera and IMU say around it; its index, or none."""
        t, name = window.t, self.worn.segment.name
        first = 0 if not before else before[-1] + 1
        at = [k for k in range(first, len(t)) if since_s + BEFORE_S < t[k] <= self._signal.end_s][-NODES:]
        if len(at) < 2 or t[at[-1]] - self._tried_s < EACH_S:
            return []
        self._tried_s = float(t[at[-1]])
        states = [window.state(k) for k in at]
        parent = States(*(np.array([getattr(state, kind) for state in states]) for kind in "Rpv"))
        run = self._run(max(since_s, self._tried_s - AROUND_S), self._tried_s + AROUND_S)
        start = None if run is None else self._start(run, t[at], parent)
        if start is None:
            return []
        window.attach(at[0], name, NodeState(float(t[at[0]]), start.R[0], start.p[0], start.v[0]))
        return [at[0]]

    def _run(self, start_s: float, end_s: float) -> ImuRun | None:
        """Its samples between two times of the forearm IMU's clock, with their attitude."""
        shift_s = self._place.shift_s
        imu = self.worn.stream(start_s - shift_s, end_s - shift_s)
        if len(imu) < FEWEST_SAMPLES:
            return None
        accelerometer, gyroscope = np.eye(3) - self._place.errors
        acc, gyro = imu.acc @ accelerometer.T, imu.gyro @ gyroscope.T
        return imu_run(self.worn.segment.name, replace(imu, t_s=imu.t_s + shift_s, acc=acc, gyro=gyro))

    def _start(self, run: ImuRun, t: FloatArray, parent: States) -> States | None:
        """Its states at some nodes, (k,); None where the camera sees too little of the segment."""
        start_s, end_s = run.signal.start_s, run.signal.end_s
        arm = self._frames.tracks(start_s - self._offset_s)
        arm = arm.select(arm.t_s + self._offset_s < end_s)
        if len(arm) < 2:
            return None
        accepted, position = accepted_samples(arm), arm.position - self._model.joint_bias.error_m
        segment = Segment(
            signal=run.signal,
            attitude=run.attitude,
            frame_t_camera=arm.t_s,
            position=position,
            accepted=accepted,
            reason=np.zeros(accepted.shape, np.uint8),
            down=self._model.initial.down,
            needed=1,
            frames=slice(0, len(arm)),
            start_s=start_s,
            end_s=end_s,
            further=(run,),
        )
        hangs = None if self.worn.segment.carries_parent else parent
        found = prepare_further(segment, arm.t_s + self._offset_s, accepted, self._model.estimate, t, hangs)
        return found[0].start if found and found[0].first == 0 else None
