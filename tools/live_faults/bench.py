"""Plays damaged streams into a live session as fast as it goes, and measures where the answer is wrong."""

from __future__ import annotations

import os
import pickle
import select
import signal
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import cast

import numpy as np

from smoother.array_types import FloatArray
from smoother.body import FOREARM
from smoother.live.answers import LiveOutput, LiveState
from smoother.live.calibrations import InlineCalibrator
from smoother.live.smoother import LiveSmoother
from smoother.measurements.visibility import Gap
from smoother.recording import ImuStream
from smoother.simulation import ArmSimulation, SimulatedArm, simulate_arm
from smoother.streams.arrivals import Arrivals, FrameRows, ImuRows, SourceInfo
from smoother.streams.session import LiveSession
from tools.live_faults.kinds import KINDS, Streams

LATENCY_S, OFFSET_S, STEP_S = 0.1, -0.02, 1 / 30
#: Samples that a sensor sends together.
TOGETHER = 3
#: The answer is wrong where its error exceeds this many of its sigmas.
SIGMAS = 3.0


def simulated(
    seed: int,
    duration_s: float,
    gaps_s: tuple[float, ...] = (1.0,),
    preset: str = "realistic",
    imus: str = "wrist",
) -> SimulatedArm:
    """A realistic arm with 100 Hz IMUs and a 30 Hz camera."""
    return simulate_arm(
        ArmSimulation.preset(
            preset,
            protocol="random",
            duration_s=duration_s,
            imu_rate_hz=100,
            occlusion_lengths_s=gaps_s,
            imus=imus,  # type: ignore[arg-type]
        ),
        seed,
    )


def streams_of(simulation: SimulatedArm) -> Streams:
    """A sound session: samples by threes as they are taken, frames after the camera's latency."""
    recording = simulation.recording
    arm, frame_t = recording.arm, np.asarray(recording.arm.t_s, float)
    return Streams(
        _rows(recording.imu),
        FrameRows(
            frame_t, np.array(arm.position, float), np.array(arm.state), frame_t + OFFSET_S + LATENCY_S
        ),
        {segment: _rows(imu) for segment, imu in recording.further_imus.items()},
    )


def _rows(imu: ImuStream) -> ImuRows:
    t = np.asarray(imu.t_s, float)
    last = np.minimum((np.arange(len(t)) // TOGETHER + 1) * TOGETHER - 1, len(t) - 1)
    return ImuRows(t, np.array(imu.acc, float), np.array(imu.gyro, float), t[last] + 0.004)


class StreamsSource:
    """Streams as the source of a session whose time is theirs; it never waits."""

    speed = 0.0

    def __init__(self, streams: Streams, simulation: SimulatedArm):
        self._streams = streams.sorted()
        recording = simulation.recording
        joints = tuple(recording.arm.joints_seen) if hasattr(recording.arm, "joints_seen") else ()
        self.info = SourceInfo(
            "imu",
            "camera",
            recording.side,
            joints,
            0,
            recording.camera_frame,
            recording.gravity_hint,
            further={segment: segment for segment in streams.further},
        )
        self._now = float(min(self._streams.imu.arrival_s[0], self._streams.frames.arrival_s[0]))
        self._last = float(max(self._streams.imu.arrival_s[-1], self._streams.frames.arrival_s[-1]))
        self._next = [0] * len(self._rows)

    @property
    def _rows(self) -> list[ImuRows | FrameRows]:
        return [self._streams.imu, self._streams.frames, *self._streams.further.values()]

    @property
    def ended(self) -> bool:
        """Everything was played."""
        return self._now >= self._last

    def now_s(self) -> float:
        """The session's time, s."""
        return self._now

    def wait(self, seconds: float) -> None:
        """Nobody is waited for."""

    def arrivals(self) -> Arrivals:
        """What came since the last call."""
        self._now += STEP_S
        stop = [int(np.searchsorted(rows.arrival_s, self._now, "right")) for rows in self._rows]
        (imu, frames, *further), self._next = (
            [slice(*each) for each in zip(self._next, stop, strict=True)],
            stop,
        )
        streams = self._streams
        return Arrivals(
            streams.imu.select(imu),
            streams.frames.select(frames),
            further={
                segment: rows.select(new)
                for (segment, rows), new in zip(streams.further.items(), further, strict=True)
            },
        )

    def go_on_with(self, streams: Streams) -> None:
        """What comes from now on is of other streams, which are the same until now."""
        self._streams = streams.sorted()
        rows = self._rows
        self._next = [int(np.searchsorted(each.arrival_s, self._now, "right")) for each in rows]
        self._last = float(max(each.arrival_s[-1] for each in rows))

    def close(self) -> None:
        """Nothing to let go."""


@dataclass
class Answers:
    """All answers of a session; a receiver."""

    outputs: list[LiveOutput] = field(default_factory=list)
    events: list[tuple[float, str]] = field(default_factory=list)  # When, and what was said

    def send(self, output: LiveOutput, frames: FrameRows, gap: Gap | None, events: Sequence[str]) -> None:
        """Keep them."""
        self.outputs.append(output)
        self.events += [(output.now_s, text) for text in events]

    def close(self) -> None:
        """Nothing more will come."""


class Sound:
    """A sound session until a moment: faults branch off from it, each in a process of its own (`os.fork`)."""

    def __init__(self, simulation: SimulatedArm, until_s: float = -np.inf):
        recording = simulation.recording
        self.simulation, self.streams, self.until_s = simulation, streams_of(simulation), until_s
        self.answers = Answers()
        self._source = StreamsSource(self.streams, simulation)
        engine = LiveSmoother(
            recording.side,
            camera_frame=recording.camera_frame,
            calibrator=InlineCalibrator(15),
            further=list(recording.further_imus),
        )
        self._session = LiveSession(self._source, engine, receivers=[self.answers.send])
        self._session.run(lambda: self._source.now_s() >= until_s - STEP_S, lambda view: None)

    def ended_with(self, streams: Streams) -> Answers:
        """All answers where the session goes on with other streams; ends the session."""
        self._source.go_on_with(streams)
        self._session.run(lambda: False, lambda view: None)
        return self.answers


def forked(job: Callable[[], Verdict], longest_s: float) -> Verdict:
    """The answer of a job in a copy of this process, which is ended if it takes longer."""
    reader, writer = os.pipe()
    child = os.fork()
    if child == 0:
        try:
            with os.fdopen(writer, "wb") as file:
                pickle.dump(job(), file)
        finally:
            os._exit(0)
    os.close(writer)
    data, until = b"", time.monotonic() + longest_s
    try:
        while select.select([reader], [], [], max(until - time.monotonic(), 0.0))[0]:
            chunk = os.read(reader, 1 << 16)
            if not chunk:
                break
            data += chunk
        else:
            raise TimeoutError(f"no answer within {longest_s:g} s")
        return cast("Verdict", pickle.loads(data))
    finally:
        os.close(reader)
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)


@dataclass(frozen=True)
class Verdict:
    """How one kind of fault ended."""

    kind: str
    seed: int
    wrong_s: float  # Time with an answer whose error is beyond three of its sigmas
    silent_s: float  # Time after the fault began without an answer, or with one that is provisional
    worst_m: float  # The largest error in sigmas: the error, and the sigma that was stated
    at_sigma_m: float  # The largest error in sigmas: the error, and the sigma that was stated
    sound_cm: float  # Error (rms) of the last five seconds where the arm was visible; nan without an answer
    said_s: float  # After the fault began, the first sentence about it or answer that calls itself doubtful
    ended: str  # What was done, in the order of the first time
    said: tuple[str, ...]  # What was said after the fault began


#: What a sentence says was done, by words of it.
DONE = {
    "the smoother begins anew": "begun anew",
    "the camera is left out": "camera rejected",
    "arm is left out": "further IMU left out",
    "the camera leads": "IMU rejected",
    "the answer follows it": "clock followed",
    "were moved": "stamps moved",
    "later than before": "latency known",
    "nothing for": "stream missed",
    "dropped": "dropped",
}


def done(said: Sequence[str]) -> str:
    """What sentences say was done."""
    found = [what for text in said for words, what in DONE.items() if words in text]
    return ", ".join(dict.fromkeys(found)) or "-"


def errors_of(answers: Answers, simulation: SimulatedArm) -> FloatArray:
    """Of every step: time, error of `now` (m), its sigma (m), whether it is shown, whether visible (n, 5)."""
    rows = []
    for output in answers.outputs:
        now = output.now
        if now is None:
            rows.append((output.now_s, np.nan, np.nan, 0.0, 0.0))
            continue
        true = simulation.motion.imu_pose(np.array([now.t_s]))[1][0]
        error = float(np.linalg.norm(now.position - true))
        shown = 0.0 if getattr(now, "provisional", False) else 1.0
        rows.append((output.now_s, error, now.sigma_m, shown, float(now.state is LiveState.VISIBLE)))
    return np.array(rows)


def verdict_of(kind: str, seed: int, sound: Sound, segment: str = FOREARM.name) -> Verdict:
    """One kind of fault on one arm, of the IMU on a segment; ends the sound session."""
    rng, at_s = np.random.default_rng([seed, sum(kind.encode())]), sound.until_s
    answers = sound.ended_with(sound.streams.damaged(KINDS[kind], at_s, rng, segment))
    rows = errors_of(answers, sound.simulation)
    t, error, sigma, shown, visible = rows.T
    with np.errstate(invalid="ignore"):
        wrong = (shown > 0) & (error > SIGMAS * sigma)
    worst = int(np.nanargmax(np.where(shown > 0, error / sigma, np.nan)))
    last = (shown > 0) & (visible > 0) & (t > t[-1] - 5.0)
    events = [(when - at_s, text) for when, text in answers.events if when > at_s]
    usual = {each.doubt for each in answers.outputs if each.now_s <= at_s}
    doubts = [each.now_s - at_s for each in answers.outputs if each.now_s > at_s and each.doubt not in usual]
    return Verdict(
        kind,
        seed,
        float(wrong.sum() * STEP_S),
        float((~(shown > 0) & (t > at_s)).sum() * STEP_S),
        float(error[worst]),
        float(sigma[worst]),
        float(100 * np.sqrt(np.mean(error[last] ** 2))) if last.any() else float("nan"),
        min([when for when, _ in events] + doubts, default=float("nan")),
        done([text for _, text in events]),
        tuple(f"{when:+.1f} s: {text}" for when, text in events),
    )
