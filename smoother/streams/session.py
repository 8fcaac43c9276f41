"""A session: what arrives is recorded, recovered, and sent on, until somebody ends it."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

from calib.file import CalibrationFile, read_calibration, sigma_factors_of
from calib.sensor import SensorCalibration, sensor_of

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
from .session_figures import SessionFigures
from .session_recording import SessionRecording

if TYPE_CHECKING:
    from ..live.smoother import LiveSmoother


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
        factors, sensors, notes = sigma_factors_of(file), {}, []
        arm = replace(file.arm(info.side), sigma_factors=factors) if file.arms else None
        if arm is None and factors is not None:
            arm = ArmCalibration(info.side, sigma_factors=factors)
        for segment, name in info.imus.items():
            topic = imu_topic(name, info.side, segment)
            if (sensor := sensor_of(file, topic)) is not None:
                sensors[segment] = sensor
                notes.append(f"{topic}: {', '.join(sensor.named)} corrected ({file.source})")
        return cls(arm, sensors, tuple(notes))

    def corrected(self, rows: ImuRows, segment: str) -> ImuRows:
        """Samples as the sensor should have given them."""
        sensor = self.sensors.get(segment)
        if sensor is None or not len(rows):
            return rows
        stream = sensor.apply(ImuStream("", rows.t_s, rows.acc, rows.gyro))
        return replace(rows, acc=stream.acc, gyro=stream.gyro)

    def config(self, config: Config) -> Config:
        """The settings with the sensor's own noise where it was measured."""
        sensor, none = self.sensors.get(FOREARM.name), ImuRows()
        if sensor is None:
            return config
        return with_measured_noise(config, sensor.apply(ImuStream("", none.t_s, none.acc, none.gyro)))


def prefer_side(file: CalibrationFile | None) -> str | None:
    """The side of a calibration of one arm: settles what the streams leave open."""
    sides = [] if file is None else [name for name in file.arms if name != "any"]
    return sides[0] if len(sides) == 1 else None


def read_calibration_file(path: Path | None) -> CalibrationFile | None:
    """The calibration file, or None."""
    return None if path is None else read_calibration(path)


#: Longest wait for samples, and shortest time between two steps, s.
_WAIT_S, _STEP_S = 0.02, 0.005


#: Is sent what a step answered, the frames before it, the gap that it ended, and what happened.
Receiver: TypeAlias = Callable[[LiveOutput, FrameRows, Gap | None, Sequence[str]], None]


class LiveSession:
    """Runs from the first sample to the end; use `run`."""

    def __init__(
        self,
        source: Source,
        engine: LiveSmoother,
        calibration: SessionCalibration | None = None,
        recording: SessionRecording | None = None,
        receivers: Sequence[Receiver] = (),
        arm: int = 0,
    ):
        self.source, self.engine, self._arm = source, engine, arm
        self.recording, self.receivers = recording, receivers
        self._calibration = calibration or SessionCalibration()
        self._frame_steps: StampSteps[FrameRows] = StampSteps(source.info.skeleton)
        self._imu_steps = {
            segment: StampSteps[ImuRows](name, STEP_OF_IMU_S, STEP_OF_IMU_S)
            for segment, name in source.info.imus.items()
        }
        self.figures = SessionFigures(source.info)
        self._last_step = 0.0

    def run(self, stopped: Callable[[], bool], show: Callable[..., None]) -> SessionFigures:
        """Until it is stopped, or the source has ended."""
        return run_together([self], stopped, show)[0]

    def advance(self) -> None:
        """Take in what arrived, and answer."""
        arrivals = self._mended(self.source.arrivals())
        if self.recording is not None:
            self.recording.take(arrivals, self._arm)
        self._add(arrivals)
        now_s = self.source.now_s()
        events = [*arrivals.events, *self._counted(arrivals, now_s)]
        output = self.engine.step(now_s)
        if self.recording is not None:
            self.recording.shown(output, self._arm)
            events += self.recording.events()
        self._answered(output, arrivals.frames, [*events, *output.notes])

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
        imus, events = {}, list(arrivals.events)
        frames, said_frames = self._frame_steps.corrected(arrivals.frames)
        for segment, rows in arrivals.imus.items():
            imus[segment], said = self._imu_steps[segment].corrected(rows)
            events += said
            if segment == FOREARM.name:
                events += said_frames
        return Arrivals(imus.pop(FOREARM.name), frames, tuple(events), imus)

    def _counted(self, arrivals: Arrivals, now_s: float) -> list[str]:
        """Count what arrived; sentences on streams that are back or gone."""
        back, gone = list[str](), list[str]()
        streams = [(self.figures.imus[segment], rows) for segment, rows in arrivals.imus.items()]
        for health, rows in [*streams, (self.figures.skeleton, arrivals.frames)]:
            said = health.take(rows.t_s, rows.arrival_s), health.look(now_s)
            # what becomes of a further IMU, the smoother says
            if health in (self.figures.imu, self.figures.skeleton):
                back += said[0]
                gone += said[1]
        return back + gone

    def _add(self, arrivals: Arrivals) -> None:
        for segment, came in arrivals.imus.items():
            used = self._calibration.corrected(came, segment)
            if not len(used):
                continue
            batch = ImuBatch(used.t_s, used.acc, used.gyro)
            if segment == FOREARM.name:
                self.engine.add_imu(batch)
            else:
                self.engine.add_further_imu(segment, batch)
        frames = arrivals.frames
        # the smoother follows the camera's clock by itself, with its uncertainty
        t_s = frames.t_s - self._frame_steps.stepped_s
        rows = zip(t_s.tolist(), frames.arrival_s.tolist(), frames.position, frames.state, strict=True)
        for stamp_s, arrival_s, position, state in rows:
            self.engine.add_frame(SkeletonFrame(stamp_s, arrival_s, position, state))

    def _answered(self, output: LiveOutput, frames: FrameRows, events: list[str]) -> None:
        self.figures.event(output.now_s, events)
        gap = self.figures.step(output)
        for send in self.receivers:
            send(output, frames.stamped(frames.t_s - self._frame_steps.stepped_s), gap, events)
        if self.source.speed:
            delays_s = (self.source.now_s() - frames.arrival_s) / self.source.speed
            self.figures.frame_delays_s.extend(delays_s.tolist())


def run_together(
    sessions: Sequence[LiveSession],
    stopped: Callable[[], bool],
    show: Callable[..., None],
) -> list[SessionFigures]:
    """Sessions of the arms of one person, step by step side by side, until they are stopped or have ended."""
    figures = [session.figures for session in sessions]
    while not stopped() and not all(session.source.ended for session in sessions):
        sessions[0].wait()
        for session in sessions:
            session.advance()
        show(*figures)
    for session in sessions:
        session.end()
    return figures
