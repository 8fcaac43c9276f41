"""Who follows the arm: the tracker at work, and its successor with a newer calibration."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ..config import Config
from .buffers import FrameBuffer, ImuBuffer, SkeletonFrame
from .calibrations import Calibrations
from .further_imus import LiveFurtherImu, SegmentFollower
from .monitor import Culprit
from .tracker import AROUND_S, LENGTH_S, LONGEST_PAUSE_S, Tracker, first_state

#: A first tracker begins this long before the present, s, and catches up by this many frames a step: ten take
#: 13 to 17 ms of processor time, so that a step stays within 20 ms.
CATCH_UP_S, CATCH_UP_FRAMES = 5.0, 10
#: A successor catches up beside the one at work by this many frames a step.
SUCCESSOR_FRAMES = 2
#: After a pause of the IMU this much is needed to begin anew, s.
FRESH_S = 1.0
#: The camera must not have contradicted a first tracker for this long, s.
PROVED_S = 0.8


class TrackerHandover:
    """Holds the tracker at work; a successor catches up beside it and takes its place."""

    def __init__(
        self,
        calibrations: Calibrations,
        config: Config,
        imu: ImuBuffer,
        frames: FrameBuffer,
        lag_s: float,
        worn: Mapping[str, LiveFurtherImu] | None = None,
    ) -> None:
        self._calibrations, self._config, self._imu, self._frames = calibrations, config, imu, frames
        self._lag_s, self._worn = lag_s, worn or {}
        self.tracker: Tracker | None = None
        self.has_followed = False
        self._successor: Tracker | None = None
        self._is_waiting = False
        self._not_before_s = -np.inf

    def calibrated(self) -> None:
        """There is a new calibration: a successor begins with it, at once or where the arm is visible."""
        if self.tracker is None:
            self._successor = self._fresh()
        else:
            self._is_waiting, self._successor = True, None

    def begin_anew(self, not_before_s: float = -np.inf) -> None:
        """What is at work is lost: begin anew with the calibration that is there, after some time, s."""
        self._not_before_s = not_before_s
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
        # a first one has nothing to go on by where the camera is wrong
        is_left_alone = self.tracker is None and successor.monitor.since_s is not None
        if is_left_alone or any(finding.cause is Culprit.TRACKER for finding in successor.findings):
            if self.tracker is None:
                self._not_before_s = max(self._not_before_s, now_s - FRESH_S)
            self._successor = None if self.tracker is not None else self._fresh()
            return None
        if successor.solution is None or self.ready(successor) or not self._is_proved(successor):
            return None
        before, self.tracker, self._successor = self.tracker, successor, None
        self.has_followed = True
        return before

    def ready(self, tracker: Tracker) -> list[SkeletonFrame]:
        """Frames that a tracker has not seen and the IMU reaches."""
        frames = self._frames.since(np.nextafter(tracker.cursor_s, np.inf))
        reach_s = self._imu.end_s - tracker.offset_s
        return [frame for frame in frames if frame.t_s <= reach_s]

    def _is_proved(self, successor: Tracker) -> bool:
        """Whether the camera has not contradicted it for some time; after a pause none is needed."""
        if self.tracker is not None or (self.has_followed and not np.isfinite(self._not_before_s)):
            return successor.monitor.since_s is None
        return successor.t_s - successor.monitor.sound_since_s >= PROVED_S

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
        model, offset_s = calibration.model, self._calibrations.offset_s
        return Tracker(
            model,
            offset_s,
            self._calibrations.needed,
            self._config,
            self._imu,
            max(LENGTH_S, self._lag_s + 0.3),
            self.tracker,
            [
                SegmentFollower(self._worn[place.segment], place, model, self._frames, offset_s)
                for place in calibration.further
            ],
        )
