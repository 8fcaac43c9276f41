"""A session: what arrives is recorded, recovered, and sent on, until somebody ends it."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Protocol

from calib.file import CalibrationFile, read_calibration, sigma_factors_of
from calib.imu.sensor import SensorCalibration, sensor_of

from ..body import FOREARM
from ..calibration import ArmCalibration
from ..config import Config
from ..io.recording.write import imu_topic
from ..live.answers import LiveOutput
from ..live.buffers import ImuBatch, SkeletonFrame
from ..measurements.visibility import Gap
from ..recording import ImuStream
from ..window.priors import with_measured_noise
from .arrivals import STEP_OF_IMU_S, Arrivals, FrameRows, ImuRows, Source, SourceInfo, StampSteps
from .session_figures import SessionFigures, SessionView, StreamHealth
from .session_recording import Recorder


@dataclass(frozen=True)
class SessionCalibration:
    """What is known before a session."""

    arm: ArmCalibration | None = None  # Of the arm
    sensor: SensorCalibration | None = None  # Of the IMU: taken off what is used, not off what is recorded
    notes: tuple[str, ...] = ()  # What of it is used, one sentence each
    # Likewise of IMUs beyond the forearm, by segment
    further: Mapping[str, SensorCalibration] = field(default_factory=dict)

    @classmethod
    def of(cls, file: CalibrationFile | None, info: SourceInfo) -> SessionCalibration:
        """Of a file, for a session; nothing without one."""
        if file is None:
            return cls()
        topic = imu_topic(info.imu, info.side)
        sensor, factors = sensor_of(file, topic), sigma_factors_of(file)
        arm = replace(file.arm(info.side), sigma_factors=factors) if file.arms else None
        if arm is None and factors is not None:
            arm = ArmCalibration(info.side, sigma_factors=factors)
        topics = {segment: imu_topic(name, info.side, segment) for segment, name in info.further.items()}
        further = {
            segment: found for segment, name in topics.items() if (found := sensor_of(file, name)) is not None
        }
        used = [] if sensor is None else [(topic, sensor)]
        used += [(topics[segment], each) for segment, each in further.items()]
        notes = [f"{name}: {', '.join(each.named)} corrected ({file.source})" for name, each in used]
        return cls(arm, sensor, tuple(notes), further)

    def corrected(self, rows: ImuRows, segment: str = FOREARM.name) -> ImuRows:
        """Samples as the sensor should have given them."""
        sensor = self.sensor if segment == FOREARM.name else self.further.get(segment)
        if sensor is None or not len(rows):
            return rows
        stream = sensor.apply(ImuStream("", rows.t_s, rows.acc, rows.gyro))
        return replace(rows, acc=stream.acc, gyro=stream.gyro)

    def config(self, config: Config) -> Config:
        """The settings with the sensor's own noise where it was measured."""
        if self.sensor is None:
            return config
        none = ImuRows.none()
        return with_measured_noise(config, self.sensor.apply(ImuStream("", none.t_s, none.acc, none.gyro)))


def prefer_side(file: CalibrationFile | None) -> str | None:
    """The side of a calibration of one arm: settles what the streams leave open."""
    sides = [] if file is None else [name for name in file.arms if name != "any"]
    return sides[0] if len(sides) == 1 else None


def read_calibration_file(path: Path | None) -> CalibrationFile | None:
    """The calibration file, or None."""
    return None if path is None else read_calibration(path)


#: Longest wait for samples, and shortest time between two steps, s.
_WAIT_S, _STEP_S = 0.02, 0.005


class Engine(Protocol):
    """What recovers the arm: `live.smoother.LiveSmoother`."""

    def add_imu(self, batch: ImuBatch) -> None:
        """Take samples in."""

    def add_further_imu(self, segment: str, batch: ImuBatch) -> None:
        """Take samples of the IMU on a further segment in."""

    def add_frame(self, frame: SkeletonFrame) -> None:
        """Take a frame in."""

    def step(self, now_s: float) -> LiveOutput:
        """Answer for the present."""


class Receiver(Protocol):
    """Who is sent what a session answers."""

    def send(self, output: LiveOutput, frames: FrameRows, gap: Gap | None, events: Sequence[str]) -> None:
        """Send what a step answered, the frames before it, the gap that it ended, and what happened."""

    def close(self) -> None:
        """Nothing more will come."""


class SharedReceiver(Protocol):
    """Who is sent what the sessions of both arms answer."""

    def send(
        self,
        output: LiveOutput,
        frames: FrameRows,
        gap: Gap | None,
        events: Sequence[str],
        number: int = 0,
    ) -> None:
        """As `Receiver`, and which arm it is of."""

    def close(self) -> None:
        """Nothing more will come."""


@dataclass(frozen=True)
class OneArmReceiver:
    """A shared receiver as the session of one arm sees it."""

    shared: SharedReceiver
    number: int  # Of the arm

    def send(self, output: LiveOutput, frames: FrameRows, gap: Gap | None, events: Sequence[str]) -> None:
        """As `Receiver`."""
        self.shared.send(output, frames, gap, events, self.number)

    def close(self) -> None:
        """As `Receiver`."""
        self.shared.close()


class LiveSession:
    """Runs from the first sample to the end; use `run`."""

    def __init__(
        self,
        source: Source,
        engine: Engine,
        calibration: SessionCalibration | None = None,
        recording: Recorder | None = None,
        receivers: Sequence[Receiver] = (),
        arm: int = 0,
    ):
        self.source, self.engine, self._arm = source, engine, arm
        self.recording, self.receivers = recording, receivers
        self._calibration = calibration or SessionCalibration()
        info = source.info
        self._imu_steps: StampSteps[ImuRows] = StampSteps(info.imu, STEP_OF_IMU_S, STEP_OF_IMU_S)
        self._frame_steps: StampSteps[FrameRows] = StampSteps(info.skeleton)
        self._further_steps = {
            segment: StampSteps[ImuRows](name, STEP_OF_IMU_S, STEP_OF_IMU_S)
            for segment, name in info.further.items()
        }
        self._healths = StreamHealth(info.imu), StreamHealth(info.skeleton)
        self._further = {segment: StreamHealth(name) for segment, name in info.further.items()}
        self.figures = SessionFigures(*self._healths, self._further, info.side)
        self._last_step = 0.0

    def run(self, stopped: Callable[[], bool], show: Callable[[SessionView], None]) -> SessionFigures:
        """Until it is stopped, or the source has ended."""
        return run_together([self], stopped, show)[0]

    def advance(self) -> SessionView:
        """Take in what arrived, and answer; what is shown of it."""
        arrivals = self._mended(self.source.arrivals())
        if self.recording is not None:
            self.recording.take(arrivals, self._arm)
        self._add(arrivals)
        now_s = self.source.now_s()
        events = [*arrivals.events, *self._counted(arrivals), *self._look(now_s)]
        output = self.engine.step(now_s)
        if self.recording is not None:
            self.recording.shown(output, self._arm)
            events += self.recording.events()
        self._answered(output, arrivals.frames, [*events, *output.notes])
        return self.figures.view(now_s)

    def end(self) -> None:
        """Wait for the recording; what its last rows met belongs to the session."""
        if self.recording is not None:
            self.recording.wait()
            self.figures.event(self.source.now_s(), self.recording.events())

    def wait(self) -> None:
        """Until something comes, and the last step is long enough ago."""
        self.source.wait(_WAIT_S)
        if self.source.speed:
            time.sleep(max(self._last_step + _STEP_S - time.monotonic(), 0.0))
        self._last_step = time.monotonic()

    def _mended(self, arrivals: Arrivals) -> Arrivals:
        """What arrived, with steps of the clocks taken out; as its events state."""
        imu, imu_events = self._imu_steps.corrected(arrivals.imu)
        frames, frame_events = self._frame_steps.corrected(arrivals.frames)
        events, further = [*arrivals.events, *imu_events, *frame_events], {}
        for segment, rows in arrivals.further.items():
            further[segment], said = self._further_steps[segment].corrected(rows)
            events += said
        return Arrivals(imu, frames, tuple(events), further)

    def _counted(self, arrivals: Arrivals) -> list[str]:
        """Count what arrived; sentences on streams that are back."""
        imu, frames = arrivals.imu, arrivals.frames
        of_imu, of_camera = self._healths
        for segment, rows in arrivals.further.items():  # what becomes of it, the smoother says
            self._further[segment].take(rows.t_s, rows.arrival_s)
        return [*of_imu.take(imu.t_s, imu.arrival_s), *of_camera.take(frames.t_s, frames.arrival_s)]

    def _add(self, arrivals: Arrivals) -> None:
        imu: ImuRows = self._calibration.corrected(arrivals.imu)
        if len(imu):
            self.engine.add_imu(ImuBatch(imu.t_s, imu.acc, imu.gyro))
        for segment, came in arrivals.further.items():
            used = self._calibration.corrected(came, segment)
            if len(used):
                self.engine.add_further_imu(segment, ImuBatch(used.t_s, used.acc, used.gyro))
        frames = arrivals.frames
        # the smoother follows the camera's clock by itself, with its uncertainty
        t_s = frames.t_s - self._frame_steps.stepped_s
        rows = zip(t_s.tolist(), frames.arrival_s.tolist(), frames.position, frames.state, strict=True)
        for stamp_s, arrival_s, position, state in rows:
            self.engine.add_frame(SkeletonFrame(stamp_s, arrival_s, position, state))

    def _look(self, now_s: float) -> list[str]:
        """What became of the streams."""
        for health in self._further.values():
            health.look(now_s)
        return [sentence for health in self._healths for sentence in health.look(now_s)]

    def _answered(self, output: LiveOutput, frames: FrameRows, events: list[str]) -> None:
        self.figures.event(output.now_s, events)
        gap = self.figures.step(output)
        for receiver in self.receivers:
            receiver.send(output, frames.stamped(frames.t_s - self._frame_steps.stepped_s), gap, events)
        if self.source.speed:
            done_s = self.source.now_s()
            for arrival_s in frames.arrival_s.tolist():
                self.figures.frame_delays.add((done_s - arrival_s) / self.source.speed)


def run_together(
    sessions: Sequence[LiveSession],
    stopped: Callable[[], bool],
    show: Callable[..., None],
) -> list[SessionFigures]:
    """Sessions of the arms of one person, step by step side by side, until they are stopped or have ended."""
    while not stopped() and not all(session.source.ended for session in sessions):
        sessions[0].wait()
        show(*[session.advance() for session in sessions])
    for session in sessions:
        session.end()
    return [session.figures for session in sessions]
