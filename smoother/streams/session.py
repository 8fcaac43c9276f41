"""A session: what arrives is recorded, recovered, and sent on, until somebody ends it."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from calib.file import CalibrationFile, SensorCalibration, known_arm, sensor_of

from ..body import FOREARM
from ..calibration import ArmCalibration
from ..config import Config
from ..io.recording.write import imu_topic
from ..live.buffers import SkeletonFrame
from ..recording import ImuStream
from ..window.priors import with_measured_noise
from .arrivals import STEP_OF_IMU_S, Arrivals, LiveStep, Receiver, Rows, Source, SourceInfo, StampSteps
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
