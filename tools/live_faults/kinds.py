"""Kinds of faults: each takes the streams of a sound session and damages them from a moment on."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from smoother.array_types import BoolArray, FloatArray
from smoother.recording import JOINTS
from smoother.streams.arrivals import FrameRows, ImuRows
from smoother.units import GRAVITY

_SHOULDER, _ELBOW, _WRIST = (JOINTS.index(joint) for joint in ("shoulder", "elbow", "wrist"))


@dataclass(frozen=True)
class Streams:
    """What a session gets, in order of arrival."""

    imu: ImuRows
    frames: FrameRows
    further: Mapping[str, ImuRows] = field(default_factory=dict)  # Of IMUs beyond the forearm, by segment

    def sorted(self) -> Streams:
        """In order of arrival."""
        imu = self.imu.select(np.argsort(self.imu.arrival_s, kind="stable"))
        frames = self.frames.select(np.argsort(self.frames.arrival_s, kind="stable"))
        further = {
            segment: rows.select(np.argsort(rows.arrival_s, kind="stable"))
            for segment, rows in self.further.items()
        }
        return Streams(imu, frames, further)

    def damaged(self, damage: Damage, at_s: float, rng: np.random.Generator, segment: str) -> Streams:
        """With a fault of the forearm's IMU and the camera, or of the IMU on another segment alone."""
        if segment not in self.further:
            return damage(self, at_s, rng)
        found = damage(Streams(self.further[segment], self.frames), at_s, rng)
        return replace(self, further={**self.further, segment: found.imu})


#: Streams, the time at which it begins (s, arrival), random numbers.
Damage = Callable[[Streams, float, np.random.Generator], Streams]


def _between(rows: ImuRows | FrameRows, start_s: float, length_s: float) -> BoolArray:
    """Rows that arrive in a time."""
    return np.asarray((rows.arrival_s >= start_s) & (rows.arrival_s < start_s + length_s))


def _imu(change: Callable[[FloatArray, FloatArray, np.random.Generator], None], length_s: float) -> Damage:
    """Values of the IMU changed for a time: `change` gets acc and gyro of it (n, 3) and changes them."""

    def damage(streams: Streams, at_s: float, rng: np.random.Generator) -> Streams:
        rows = _between(streams.imu, at_s, length_s)
        acc, gyro = streams.imu.acc.copy(), streams.imu.gyro.copy()
        part_acc, part_gyro = acc[rows], gyro[rows]
        change(part_acc, part_gyro, rng)
        acc[rows], gyro[rows] = part_acc, part_gyro
        return replace(streams, imu=replace(streams.imu, acc=acc, gyro=gyro))

    return damage


def _camera(change: Callable[[FloatArray, np.ndarray, np.random.Generator], None], length_s: float) -> Damage:
    """Frames changed for a time: `change` gets positions (n, 5, 3) and states (n, 5) and changes them."""

    def damage(streams: Streams, at_s: float, rng: np.random.Generator) -> Streams:
        rows = _between(streams.frames, at_s, length_s)
        position, state = streams.frames.position.copy(), streams.frames.state.copy()
        part, part_state = position[rows], state[rows]
        change(part, part_state, rng)
        position[rows], state[rows] = part, part_state
        return replace(streams, frames=replace(streams.frames, position=position, state=state))

    return damage


def _hold(*arrays: FloatArray) -> None:
    for values in arrays:
        values[:] = values[0]


def _spikes(values: FloatArray, share: float, size: float, rng: np.random.Generator) -> None:
    hit = rng.random(len(values)) < share
    axes = rng.normal(size=(int(hit.sum()), 3))
    values[hit] += size * axes / np.linalg.norm(axes, axis=1)[:, None]


def _scale(factor: float, *arrays: FloatArray) -> None:
    for values in arrays:
        values *= factor


def _lost(stream: str, length_s: float) -> Damage:
    """Nothing comes for a time."""

    def damage(streams: Streams, at_s: float, rng: np.random.Generator) -> Streams:
        rows = getattr(streams, stream)
        left = rows.select(np.flatnonzero(~_between(rows, at_s, length_s)))
        return replace(streams, **{stream: left})

    return damage


def _both(*damages: Damage) -> Damage:
    def damage(streams: Streams, at_s: float, rng: np.random.Generator) -> Streams:
        for one in damages:
            streams = one(streams, at_s, rng)
        return streams

    return damage


def _halved(stream: str) -> Damage:
    """Every second row from the moment on."""

    def damage(streams: Streams, at_s: float, rng: np.random.Generator) -> Streams:
        rows = getattr(streams, stream)
        wanted = (rows.arrival_s < at_s) | (np.arange(len(rows)) % 2 == 0)
        return replace(streams, **{stream: rows.select(np.flatnonzero(wanted))})

    return damage


def _twice(stream: str) -> Damage:
    """Every row twice."""

    def damage(streams: Streams, at_s: float, rng: np.random.Generator) -> Streams:
        rows = getattr(streams, stream)
        count = np.where(rows.arrival_s < at_s, 1, 2)
        return replace(streams, **{stream: rows.select(np.repeat(np.arange(len(rows)), count))})

    return damage


def _bursts(stream: str, each_s: float, length_s: float) -> Damage:
    """Held up, then all at once, again and again."""

    def damage(streams: Streams, at_s: float, rng: np.random.Generator) -> Streams:
        rows = getattr(streams, stream)
        held = _between(rows, at_s, length_s)
        until = at_s + each_s * np.ceil((rows.arrival_s - at_s + 1e-9) / each_s)
        later = replace(rows, arrival_s=np.where(held, until, rows.arrival_s))
        return replace(streams, **{stream: later})

    return damage


def _later(stream: str, seconds: float, length_s: float = np.inf) -> Damage:
    """The latency is longer by some seconds; the stamps stay right."""

    def damage(streams: Streams, at_s: float, rng: np.random.Generator) -> Streams:
        rows = getattr(streams, stream)
        moved = np.where(_between(rows, at_s, length_s), seconds, 0.0)
        return replace(streams, **{stream: replace(rows, arrival_s=rows.arrival_s + moved)})

    return damage


def _disorder(stream: str, seconds: float) -> Damage:
    """Each row late by a time of its own."""

    def damage(streams: Streams, at_s: float, rng: np.random.Generator) -> Streams:
        rows = getattr(streams, stream)
        late = np.where(rows.arrival_s >= at_s, rng.uniform(0.0, seconds, len(rows)), 0.0)
        return replace(streams, **{stream: replace(rows, arrival_s=rows.arrival_s + late)})

    return damage


def _clock(stream: str, seconds: float) -> Damage:
    """The clock of the stamps is set forward (or back) by some seconds."""

    def damage(streams: Streams, at_s: float, rng: np.random.Generator) -> Streams:
        rows = getattr(streams, stream)
        moved = np.where(rows.arrival_s >= at_s, seconds, 0.0)
        return replace(streams, **{stream: replace(rows, t_s=rows.t_s + moved)})

    return damage


def _single_stamps(stream: str) -> Damage:
    """One stamp in fifty is wrong by a second."""

    def damage(streams: Streams, at_s: float, rng: np.random.Generator) -> Streams:
        rows = getattr(streams, stream)
        wrong = (rows.arrival_s >= at_s) & (rng.random(len(rows)) < 0.02)
        moved = np.where(wrong, rng.choice([-1.0, 1.0], len(rows)), 0.0)
        return replace(streams, **{stream: replace(rows, t_s=rows.t_s + moved)})

    return damage


def _thinned(stream: str, share: float) -> Damage:
    """A share of the rows never comes."""

    def damage(streams: Streams, at_s: float, rng: np.random.Generator) -> Streams:
        rows = getattr(streams, stream)
        wanted = (rows.arrival_s < at_s) | (rng.random(len(rows)) >= share)
        return replace(streams, **{stream: rows.select(np.flatnonzero(wanted))})

    return damage


def _noisy_hold(position: FloatArray, rng: np.random.Generator) -> None:
    position[:] = position[0] + rng.normal(scale=0.003, size=position.shape)


def _shorter(position: FloatArray) -> None:
    """A child 0.6 m beside: every bone a quarter shorter."""
    middle = position[:, [_SHOULDER]]
    position[:] = middle + 0.75 * (position - middle) + np.array([0.6, 0.0, 0.0])


def _at_the_hip(position: FloatArray, rng: np.random.Generator) -> None:
    """Elbow and wrist guessed: beside the trunk, a little noise."""
    noise = rng.normal(scale=0.005, size=(len(position), 2, 3))
    for place, (joint, down_m) in enumerate(((_ELBOW, 0.28), (_WRIST, 0.52))):
        off = position[:, joint] - position[:, _SHOULDER]
        sunk = np.zeros(3)
        sunk[int(np.argmax(np.abs(np.nanmean(off[:, :2], axis=0))))] = 0.05
        sunk[1] += down_m
        position[:, joint] = position[:, _SHOULDER] + sunk + noise[:, place]


def _other_arm(position: FloatArray) -> None:
    """Left and right exchanged: the arm 0.36 m beside, which hangs still."""
    first = position[0].copy()
    position[:] = first + np.array([0.36, 0.0, 0.0]) + 0.1 * (position - first)


def _jumps(position: FloatArray, rng: np.random.Generator) -> None:
    """One frame in twenty is half a metre off."""
    hit = rng.random(len(position)) < 0.05
    position[hit] += rng.choice([-0.5, 0.5], (int(hit.sum()), 1, 3))


def _nothing(position: FloatArray) -> None:
    position[:] = np.nan


#: Every kind: what it is called, and what it does. The first is none.
KINDS: dict[str, Damage] = {
    "nothing wrong": lambda streams, at_s, rng: streams,
    "IMU held for 1 s": _imu(lambda acc, gyro, rng: _hold(acc, gyro), 1.0),
    "gyroscope held for 1 s": _imu(lambda acc, gyro, rng: _hold(gyro), 1.0),
    "accelerometer held for 1 s": _imu(lambda acc, gyro, rng: _hold(acc), 1.0),
    "accelerometer spikes of 30 m/s^2, 1 %": _imu(lambda acc, gyro, rng: _spikes(acc, 0.01, 30.0, rng), 10.0),
    "accelerometer spikes of 100 m/s^2, 1 %": _imu(
        lambda acc, gyro, rng: _spikes(acc, 0.01, 100.0, rng), 10.0
    ),
    "gyroscope spikes of 30 rad/s, 1 %": _imu(lambda acc, gyro, rng: _spikes(gyro, 0.01, 30.0, rng), 10.0),
    "IMU of 1e6 for 1 s": _imu(lambda acc, gyro, rng: _scale(1e6, acc, gyro), 1.0),
    "IMU ten times too large for 1 s": _imu(lambda acc, gyro, rng: _scale(10.0, acc, gyro), 1.0),
    "IMU zero for 1 s": _imu(lambda acc, gyro, rng: _scale(0.0, acc, gyro), 1.0),
    "IMU nan for 1 s": _imu(lambda acc, gyro, rng: _scale(np.nan, acc, gyro), 1.0),
    "accelerometer clips at 12 m/s^2": _imu(lambda acc, gyro, rng: np.clip(acc, -12, 12, out=acc), 10.0),
    "gyroscope clips at 2 rad/s": _imu(lambda acc, gyro, rng: np.clip(gyro, -2, 2, out=gyro), 10.0),
    "accelerometer in g from then on": _imu(lambda acc, gyro, rng: _scale(1 / GRAVITY, acc), np.inf),
    "gyroscope in deg/s from then on": _imu(lambda acc, gyro, rng: _scale(180 / np.pi, gyro), np.inf),
    "IMU pauses 0.2 s": _lost("imu", 0.2),
    "IMU away for 1 s": _lost("imu", 1.0),
    "IMU away for 5 s": _lost("imu", 5.0),
    "IMU restarts after 2 s, with a clock of its own": _both(_lost("imu", 2.0), _clock("imu", 5000.0)),
    "IMU rate halved": _halved("imu"),
    "IMU loses 20 % of its samples": _thinned("imu", 0.2),
    "IMU samples twice": _twice("imu"),
    "IMU in bursts of 0.4 s": _bursts("imu", 0.4, 6.0),
    "IMU 0.15 s later": _later("imu", 0.15),
    "IMU in disorder, 0.3 s": _disorder("imu", 0.3),
    "IMU clock set forward 0.1 s": _clock("imu", 0.1),
    "IMU clock set back 0.1 s": _clock("imu", -0.1),
    "IMU clock set forward 2 s": _clock("imu", 2.0),
    "IMU clock set back 2 s": _clock("imu", -2.0),
    "single IMU stamps wrong": _single_stamps("imu"),
    "camera frozen for 5 s": _camera(lambda position, state, rng: _hold(position), 5.0),
    "camera frozen with noise for 5 s": _camera(lambda p, state, rng: _noisy_hold(p, rng), 5.0),
    "other body 1 m away for 3 s": _camera(lambda p, state, rng: np.add(p, [1.0, 0, 0], out=p), 3.0),
    "child 0.6 m away for 3 s": _camera(lambda position, state, rng: _shorter(position), 3.0),
    "joints guessed at the hip for 3 s": _camera(lambda p, state, rng: _at_the_hip(p, rng), 3.0),
    "other arm for 3 s": _camera(lambda position, state, rng: _other_arm(position), 3.0),
    "joints jump, 5 %": _camera(lambda position, state, rng: _jumps(position, rng), 10.0),
    "camera nan for 2 s": _camera(lambda position, state, rng: _nothing(position), 2.0),
    "camera in mm from then on": _camera(lambda position, state, rng: _scale(1000.0, position), np.inf),
    "camera away for 3 s": _lost("frames", 3.0),
    "camera restarts after 2 s, with a clock of its own": _both(
        _lost("frames", 2.0), _clock("frames", 5000.0)
    ),
    "camera rate halved": _halved("frames"),
    "frames twice": _twice("frames"),
    "frames in bursts of 0.5 s": _bursts("frames", 0.5, 6.0),
    "frames 0.1 s later": _later("frames", 0.1),
    "frames 0.1 s later for 5 s": _later("frames", 0.1, 5.0),
    "frames in disorder, 0.2 s": _disorder("frames", 0.2),
    "camera clock set forward 0.3 s": _clock("frames", 0.3),
    "camera clock set back 0.3 s": _clock("frames", -0.3),
    "camera clock set forward 0.05 s": _clock("frames", 0.05),
    "camera clock set back 2 s": _clock("frames", -2.0),
    "both away for 3 s": _both(_lost("imu", 3.0), _lost("frames", 3.0)),
}
