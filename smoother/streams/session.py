"""A session: what arrives is recorded, recovered, and sent on, until somebody ends it; how its streams do."""

from __future__ import annotations

import time
from array import array
from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from calib.file import CalibrationFile, SensorCalibration, known_arm, sensor_of

from ..array_types import FloatArray
from ..body import FOREARM
from ..calibration import ArmCalibration
from ..config import Config
from ..io.recording.write import imu_topic
from ..live.answers import LiveOutput, LiveState
from ..live.buffers import SkeletonFrame
from ..measurements.visibility import Gap
from ..recording import ImuStream
from ..window.priors import with_measured_noise
from .arrivals import STEP_OF_IMU_S, Arrivals, LiveStep, Receiver, Rows, SourceInfo, StampSteps
from .session_recording import SessionRecording

if TYPE_CHECKING:
    from ..live.smoother import LiveSmoother
    from .lsl import LslSource
    from .replay import Playback

#: Rates and delays are those of the last seconds.
_RECENT_S = 5.0
#: A stream is treated as lost after this long without a sample, s.
_SILENT_S = 1.0
#: Samples and frames are missing where two are farther apart than this many usual intervals.
_MISSING = 1.6
#: Intervals by which the usual one is known.
_INTERVALS = 200


class StreamHealth:
    """Counts one stream; memory does not grow with the session."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.count = self.missing = self.late = self.lost_times = 0
        self.lost_s = 0.0
        self.is_lost = False
        self._arrivals: deque[tuple[float, int, float]] = deque()  # last arrival, how many, median delay
        self._intervals: deque[float] = deque(maxlen=_INTERVALS)
        self._newest = self._last_arrival = np.nan

    def take(self, t_s: FloatArray, arrival_s: FloatArray) -> list[str]:
        """Count what came; a sentence where the stream is back."""
        if not len(t_s):
            return []
        events: list[str] = []
        if self.is_lost:
            self.is_lost, away_s = False, float(arrival_s[0]) - self._last_arrival
            self.lost_s += away_s
            events = [f"{self.name}: back, after {away_s:.1f} s"]
        self.count += len(t_s)
        order = np.append(self._newest, t_s)
        highest = np.fmax.accumulate(order)
        self.late += int((t_s < highest[:-1]).sum())
        steps = np.diff(np.unique(highest[np.isfinite(highest)]))
        if len(self._intervals):
            usual = float(np.median(self._intervals))
            self.missing += int((np.rint(steps[steps > _MISSING * usual] / usual) - 1).sum())
        self._intervals.extend(steps[steps > 0].tolist())
        self._newest, self._last_arrival = float(highest[-1]), float(arrival_s[-1])
        self._arrivals.append((self._last_arrival, len(t_s), float(np.median(arrival_s - t_s))))
        return events

    def look(self, now_s: float) -> list[str]:
        """Notice a stream that has gone; a sentence where it has."""
        while self._arrivals and self._arrivals[0][0] < now_s - _RECENT_S:
            self._arrivals.popleft()
        if np.isnan(self._last_arrival):
            self._last_arrival = now_s  # since it is looked at
        if self.is_lost or not now_s - self._last_arrival > _SILENT_S:
            return []
        self.is_lost = True
        self.lost_times += 1
        return [f"{self.name}: nothing for {now_s - self._last_arrival:.1f} s"]

    @property
    def delay_s(self) -> float:
        """Median delay of the last seconds."""
        return float(np.median([delay for *_, delay in self._arrivals])) if self._arrivals else float("nan")

    def rate_hz(self, now_s: float) -> float:
        """Samples or frames per second, of the last seconds."""
        recent = [(arrival, count) for arrival, count, _ in self._arrivals if arrival > now_s - _RECENT_S]
        if len(recent) < 2:
            return 0.0
        return sum(count for _, count in recent[1:]) / min(max(now_s - recent[0][0], 0.2), _RECENT_S)

    def figures(self) -> dict[str, float | int]:
        """What a summary states of the stream."""
        counts = {name: getattr(self, name) for name in ("count", "missing", "late", "lost_times")}
        return counts | {"lost_s": round(self.lost_s, 3), "delay_s": self.delay_s}


#: Events that a summary states at most; more are counted.
_MOST_EVENTS = 200


class SessionFigures:
    """Counts while a session of an arm lasts."""

    def __init__(self, info: SourceInfo) -> None:
        self.side, self.skeleton = info.side, StreamHealth(info.skeleton)
        self.imus = {segment: StreamHealth(name) for segment, name in info.imus.items()}
        self.imu = self.imus[FOREARM.name]
        self.frame_delays_s = array("f")
        self.events: deque[tuple[float, str]] = deque(maxlen=_MOST_EVENTS)
        self.output: LiveOutput | None = None
        self.steps = self.event_count = self.gaps = 0
        self.state_s = dict.fromkeys(LiveState, 0.0)
        self.longest_gap_s = self.largest_sigma_m = 0.0
        self._gap_start: float | None = None
        self._first_s = self.now_s = float("nan")  # s: the session's beginning and its last step
        self._wall, self._processor = time.monotonic(), time.process_time()

    def event(self, now_s: float, sentences: Iterable[str]) -> None:
        """Remember what happened, by the time since the session's beginning."""
        if np.isnan(self._first_s):
            self._first_s = self.now_s = now_s
        for sentence in sentences:
            self.events.append((now_s - self._first_s, sentence))
            self.event_count += 1

    def step(self, output: LiveOutput) -> Gap | None:
        """Count a step; the gap that it ended, if it did."""
        self.event(output.now_s, ())
        self.steps += 1
        self.state_s[output.state] += max(output.now_s - self.now_s, 0.0)
        self.now_s, self.output, now = output.now_s, output, output.now
        if now is not None:
            self.largest_sigma_m = max(self.largest_sigma_m, now.sigma_m)
        if output.state is LiveState.GAP and now is not None:
            if self._gap_start is None:
                self._gap_start = now.t_s if now.since_s is None else now.since_s
                self.gaps += 1
            self.longest_gap_s = max(self.longest_gap_s, output.now_s - self._gap_start)
            return None
        start, self._gap_start = self._gap_start, None
        return None if start is None else Gap(start, output.now_s)

    @property
    def seconds(self) -> float:
        """Since the session began, s."""
        return 0.0 if self.output is None else self.now_s - self._first_s

    @property
    def load(self) -> float:
        """Processor time of this program as a share of one core, since the session began."""
        return (time.process_time() - self._processor) / max(time.monotonic() - self._wall, 1e-3)

    def figures(self) -> dict[str, Any]:
        """What `--json` states."""
        further = {name: own.figures() for name, own in self.imus.items() if own is not self.imu}
        of_output = ("clock_offset_s", "clock_sigma_s", "camera_latency_s", "dropped", "calibration")
        delays = np.asarray(self.frame_delays_s if self.frame_delays_s else [np.nan], float)
        median, percentile_99, largest = (1e3 * np.percentile(delays, (50, 99, 100))).tolist()
        return {
            "seconds": self.seconds,
            "steps": self.steps,
            "imu": self.imu.figures(),
            "skeleton": self.skeleton.figures(),
            **({"further": further} if further else {}),
            "state_s": {str(state): seconds for state, seconds in self.state_s.items()},
            "gaps": self.gaps,
            "longest_gap_s": self.longest_gap_s,
            "largest_sigma_cm": 100 * self.largest_sigma_m,
            **{name: getattr(self.output, name, None) for name in of_output},
            "frame_done": {
                "count": len(self.frame_delays_s),
                "median_ms": median,
                "percentile_99_ms": percentile_99,
                "largest_ms": largest,
                "share_within_20_ms": float(np.mean(np.where(np.isnan(delays), delays, delays <= 0.020))),
            },
            "load": self.load,
            "events": [{"t_s": when, "event": sentence} for when, sentence in self.events],
            "event_count": self.event_count,
        }


@dataclass(frozen=True)
class SessionCalibration:
    """What is known before a session."""

    arm: ArmCalibration | None = None  # Of the arm
    # Of IMUs by segment: taken off what is used, not off what is recorded
    sensors: Mapping[str, SensorCalibration] = field(default_factory=dict)
    notes: tuple[str, ...] = ()  # What of it is used, one sentence each

    @classmethod
    def of(cls, file: CalibrationFile | None, info: SourceInfo) -> SessionCalibration:
        """Of a file, for a session; nothing without one."""
        if file is None:
            return cls()
        sensors, notes = {}, []
        for segment, name in info.imus.items():
            topic = imu_topic(name, info.side, segment)
            if (sensor := sensor_of(file, topic)) is not None:
                sensors[segment] = sensor
                notes.append(f"{topic}: {', '.join(sensor.named)} corrected ({file.source})")
        return cls(known_arm(file, info.side), sensors, tuple(notes))

    def corrected(self, imu: ImuStream, segment: str) -> ImuStream:
        """Samples as the sensor should have given them."""
        sensor = self.sensors.get(segment)
        return imu if sensor is None else sensor.apply(imu)

    def config(self, config: Config) -> Config:
        """The settings with the sensor's own noise where it was measured."""
        if FOREARM.name not in self.sensors:
            return config
        nothing = ImuStream(FOREARM.name, np.empty(0), np.empty((0, 3)), np.empty((0, 3)))
        return with_measured_noise(config, self.corrected(nothing, FOREARM.name))


#: Longest wait for samples, and shortest time between two steps, s.
_WAIT_S, _STEP_S = 0.02, 0.005


class _Arm:
    """One arm of a session: its smoother, its clocks and its figures."""

    def __init__(self, info: SourceInfo, engine: LiveSmoother, calibration: SessionCalibration) -> None:
        self._engine, self._calibration, self.figures = engine, calibration, SessionFigures(info)
        self._frame_steps = StampSteps(info.skeleton)
        self._imu_steps = {segment: StampSteps(name, STEP_OF_IMU_S) for segment, name in info.imus.items()}

    def answered(self, number: int, came: Arrivals, now_s: float, more: Sequence[str]) -> LiveStep:
        """Give the smoother what arrived, steps of the clocks taken out, and let it answer."""
        imus, repairs = dict[str, Rows](), list(came.events)
        frames, said_frames = self._frame_steps.corrected(came.frames)
        for segment, rows in came.imus.items():
            imus[segment], said = self._imu_steps[segment].corrected(rows)
            repairs += said + (said_frames if segment == FOREARM.name else [])
        for segment, rows in imus.items():
            if len(rows):
                imu = ImuStream(segment, rows.t_s, rows["acc"], rows["gyro"])
                self._engine.add_imu(self._calibration.corrected(imu, segment), segment)
        # on the camera's own clock, which the smoother follows by itself, with its uncertainty
        own = replace(frames, t_s=frames.t_s - self._frame_steps.stepped_s)
        if len(own):
            columns = own.t_s.tolist(), own.arrival_s.tolist(), own["position"], own["state"]
            for row in zip(*columns, strict=True):
                self._engine.add_frame(SkeletonFrame(*row))
        events = repairs + self._counted(imus, frames, now_s)
        output = self._engine.step(now_s)
        events += [*more, *output.notes]
        self.figures.event(output.now_s, events)
        gap = self.figures.step(output)
        return LiveStep(number, Arrivals(imus, frames, tuple(repairs)), own, output, gap, events)

    def _counted(self, imus: Mapping[str, Rows], frames: Rows, now_s: float) -> list[str]:
        """Count what arrived; sentences on streams that are back or gone."""
        back, gone, figures = list[str](), list[str](), self.figures
        streams = [(figures.imus[segment], rows) for segment, rows in imus.items()]
        for health, rows in [*streams, (figures.skeleton, frames)]:
            said = health.take(rows.t_s, rows.arrival_s), health.look(now_s)
            # what becomes of a further IMU, the smoother says
            if health in (figures.imu, figures.skeleton):
                back += said[0]
                gone += said[1]
        return back + gone


class LiveSession:
    """Runs from the first sample to the end, the arms of a person step by step side by side."""

    def __init__(
        self,
        source: LslSource | Playback,
        engines: Sequence[LiveSmoother],
        calibrations: Sequence[SessionCalibration] = (),
        recording: SessionRecording | None = None,
        receivers: Sequence[Receiver] = (),
    ) -> None:
        self.source, self._recording = source, recording
        self._receivers = [*([] if recording is None else [recording]), *receivers]
        known = calibrations or [SessionCalibration()] * len(engines)
        self._arms = [_Arm(*each) for each in zip(source.infos, engines, known, strict=True)]
        self.figures = [arm.figures for arm in self._arms]

    def run(self, stopped: Callable[[], bool], show: Callable[..., None] = lambda *arms: None) -> None:
        """Until it is stopped, or the source has ended."""
        last_s = 0.0
        while not stopped() and not self.source.ended:
            self.source.wait(_WAIT_S)
            if self.source.speed:
                time.sleep(max(last_s + _STEP_S - time.monotonic(), 0.0))
            last_s = time.monotonic()
            for number, (arm, came) in enumerate(zip(self._arms, self.source.arrivals(), strict=True)):
                more = [] if self._recording is None else self._recording.events()
                step = arm.answered(number, came, self.source.now_s(), more)
                for receiver in self._receivers:
                    receiver.send(step)
                if self.source.speed:
                    delays_s = (self.source.now_s() - step.frames.arrival_s) / self.source.speed
                    arm.figures.frame_delays_s.extend(delays_s.tolist())
            show(*self.figures)
        if self._recording is not None:  # what its last rows met belongs to the session
            self._recording.wait()
            self.figures[0].event(self.source.now_s(), self._recording.events())
