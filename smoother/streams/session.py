"""A session: what arrives is recorded, recovered, and sent on, until somebody ends it."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from calib.file import CalibrationFile, sigma_factors_of
from calib.sensor import SensorCalibration, sensor_of

from ..body import FOREARM
from ..calibration import ArmCalibration
from ..config import Config
from ..io.recording.write import imu_topic
from ..live.buffers import SkeletonFrame
from ..recording import ImuStream
from ..window.priors import with_measured_noise
from .arrivals import (
    STEP_OF_IMU_S,
    Arrivals,
    FrameRows,
    ImuRows,
    LiveStep,
    Receiver,
    Source,
    SourceInfo,
    StampSteps,
)
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

    def corrected(self, rows: ImuRows, segment: str) -> ImuStream:
        """Samples as the sensor should have given them."""
        stream, sensor = ImuStream(segment, rows.t_s, rows.acc, rows.gyro), self.sensors.get(segment)
        return stream if sensor is None else sensor.apply(stream)

    def config(self, config: Config) -> Config:
        """The settings with the sensor's own noise where it was measured."""
        if FOREARM.name not in self.sensors:
            return config
        return with_measured_noise(config, self.corrected(ImuRows(), FOREARM.name))


#: Longest wait for samples, and shortest time between two steps, s.
_WAIT_S, _STEP_S = 0.02, 0.005


class _Arm:
    """One arm of a session: its smoother, its clocks and its figures."""

    def __init__(self, info: SourceInfo, engine: LiveSmoother, calibration: SessionCalibration) -> None:
        self.engine, self.calibration, self.figures = engine, calibration, SessionFigures(info)
        self.frame_steps: StampSteps[FrameRows] = StampSteps(info.skeleton)
        self.imu_steps = {
            segment: StampSteps[ImuRows](name, STEP_OF_IMU_S, STEP_OF_IMU_S)
            for segment, name in info.imus.items()
        }

    def mended(self, came: Arrivals) -> Arrivals:
        """What arrived, with steps of the clocks taken out; as its events state."""
        imus, events = {}, list(came.events)
        frames, said_frames = self.frame_steps.corrected(came.frames)
        for segment, rows in came.imus.items():
            imus[segment], said = self.imu_steps[segment].corrected(rows)
            events += said + (said_frames if segment == FOREARM.name else ())
        return Arrivals(imus, frames, tuple(events))

    def counted(self, arrivals: Arrivals, now_s: float) -> list[str]:
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


class LiveSession:
    """Runs from the first sample to the end, the arms of a person step by step side by side."""

    def __init__(
        self,
        source: Source,
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
            for number, came in enumerate(self.source.arrivals()):
                self._advance(number, came)
            show(*self.figures)
        if self._recording is not None:  # what its last rows met belongs to the session
            self._recording.wait()
            self.figures[0].event(self.source.now_s(), self._recording.events())

    def _advance(self, number: int, came: Arrivals) -> None:
        """Take in what arrived of an arm, and answer."""
        arm = self._arms[number]
        arrivals, now_s = arm.mended(came), self.source.now_s()
        for segment, rows in arrivals.imus.items():
            if len(rows):
                arm.engine.add_imu(arm.calibration.corrected(rows, segment), segment)
        # on the camera's own clock, which the smoother follows by itself, with its uncertainty
        frames = arrivals.frames.stamped(arrivals.frames.t_s - arm.frame_steps.stepped_s)
        columns = frames.t_s.tolist(), frames.arrival_s.tolist(), frames.position, frames.state
        for row in zip(*columns, strict=True):
            arm.engine.add_frame(SkeletonFrame(*row))
        events = [*arrivals.events, *arm.counted(arrivals, now_s)]
        output = arm.engine.step(now_s)
        if self._recording is not None:
            events += self._recording.events()
        events += output.notes
        arm.figures.event(output.now_s, events)
        step = LiveStep(number, arrivals, frames, output, arm.figures.step(output), events)
        for receiver in self._receivers:
            receiver.send(step)
        if self.source.speed:
            delays_s = (self.source.now_s() - frames.arrival_s) / self.source.speed
            arm.figures.frame_delays_s.extend(delays_s.tolist())
