"""What calibrations of the rig are made of: a sensor turned by hand, alone; clocks of a session."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.signal import fftconvolve
from scipy.spatial.transform import Rotation

from calib.clock import ClockLink, Receptions

from ..array_types import FloatArray
from ..linalg import unit
from ..recording import ImuStream, Recording
from ..units import GRAVITY
from .arm import simulate_arm
from .config import ArmSimulation, ClockSources
from .inertial import Held, ideal_imu

#: Bluetooth stamps count in steps of this, s.
STEP_S = 0.3125e-3
SOUND_RATE_HZ = 16000


@dataclass(frozen=True)
class Clocks:
    """Clocks that read tau + offset + skew tau, by name."""

    names: tuple[str, ...]
    offset_s: FloatArray  # (n,) s
    skew: FloatArray  # (n,)

    def read(self, node: int, tau: float) -> float:
        """What a node's clock shows at a true time."""
        return float(tau + self.offset_s[node] + self.skew[node] * tau)

    def offset_between_s(self, from_clock: str, to_clock: str, at_s: float) -> float:
        """True offset, t_to = t_from + offset, at a time on the first clock."""
        u, v = self.names.index(from_clock), self.names.index(to_clock)
        tau = (at_s - self.offset_s[u]) / (1.0 + self.skew[u])
        return float(self.offset_s[v] + (1.0 + self.skew[v]) * tau - at_s)

    def error_s(self, link: ClockLink) -> float:
        """Error of a link at the time that it is stated for."""
        return link.offset_s - self.offset_between_s(link.from_clock, link.to_clock, link.at_s)

    def skew_error_ppm(self, link: ClockLink) -> float:
        """Error of a link's skew."""
        u, v = self.names.index(link.from_clock), self.names.index(link.to_clock)
        return link.skew_ppm - 1e6 * ((1 + self.skew[v]) / (1 + self.skew[u]) - 1)


def broadcast(
    seed: int,
    nodes: int = 3,
    rounds: int = 20,
    span_s: float = 900.0,
    missed: float = 0.2,
    late: float = 0.05,
    offset_s: Sequence[float] | None = None,
) -> tuple[Clocks, Receptions]:
    """Rounds of a broadcast that some nodes miss and some hear late; node n1 runs 390 ppm fast."""
    rng = np.random.default_rng(seed)
    offset = np.concatenate([[0.0], rng.uniform(-5, 5, nodes - 1)])
    skew = np.concatenate([[0.0, 390e-6], rng.uniform(-4e-4, 4e-4, nodes)])[:nodes]
    names = tuple(f"n{node}" for node in range(nodes))
    clocks, rows = Clocks(names, offset if offset_s is None else np.array(offset_s), skew), []
    for number, tau in enumerate(np.sort(rng.uniform(0, span_s, rounds)).tolist()):
        for node in range(nodes):
            if rng.random() < missed:
                continue
            t = clocks.read(node, tau) + (rng.uniform(0.005, 0.1) if rng.random() < late else 0.0)
            rows.append((number, f"n{node}", np.floor(t / STEP_S) * STEP_S))
    event, name, t_s = zip(*rows, strict=True)
    sigma = np.full(len(rows), STEP_S / np.sqrt(12))
    return clocks, Receptions(np.array(event), name, np.array(t_s), sigma, "broadcast")


def beep(
    seed: int, rate_hz: int = SOUND_RATE_HZ, quiet_db: float = 25.0, room_s: float | None = None
) -> tuple[FloatArray, float, float]:  # sound (4 rate_hz,), end_s, tone_hz
    """A buzzer near a microphone, in a room where somebody speaks."""
    rng = np.random.default_rng(seed)
    t = np.arange(4 * rate_hz) / rate_hz
    tone, end, lasts = rng.uniform(1800, 4500), rng.uniform(1.5, 3.0), rng.uniform(0.1, 0.8)
    rise = 1 - np.exp(-np.maximum(t - end + lasts, 0) / 0.003)
    ring = np.exp(-np.maximum(t - end, 0) / rng.uniform(0.0003, 0.003))
    sound = np.sin(2 * np.pi * tone * t + rng.uniform(0, 2 * np.pi)) * rise * ring
    room_s = room_s if room_s is not None else float(rng.choice([0.0, 0.2, 0.4]))
    if room_s > 0:  # the echo dies by 60 dB in room_s; its level is 10 dB below the buzzer's
        count = int(room_s * rate_hz)
        echo = rng.normal(size=count) * 10 ** (-3 * np.arange(count) / count)
        echo *= 0.3 / np.sqrt((echo**2).sum())
        sound = fftconvolve(sound, np.concatenate([[1.0], np.zeros(int(0.002 * rate_hz)), echo]))[: len(t)]
    voice = [np.sin(2 * np.pi * 150 * k * t + rng.uniform(0, 6)) / k for k in range(1, 20)]
    sound = sound + 0.1 * sum(voice) * (np.sin(2 * np.pi * 3 * t + rng.uniform(0, 6)) > 0.2)
    return sound + np.sqrt(0.5) * 10 ** (-quiet_db / 20) * rng.normal(size=len(t)), end, tone


#: The session's clocks, and how they are called: the camera's (true time), the base's, the IMU's.
CAMERA, BASE, IMU = "camera", "base", "forearm_right"
#: How far these clocks are ahead of the camera's, s. The motion needs stamps that overlap.
BASE_AHEAD_S, IMU_AHEAD_S = (5.0, 15.0), (1.0, 4.0)


@dataclass(frozen=True)
class SimulatedClocks:
    """What `calibrate clock` reads, and what it should find."""

    sound: FloatArray  # (n,): the camera's sound, from the camera's time zero on; largest sample 1
    event_time_s: float  # The beep's end on the base's clock, in the step of its stamps
    receptions: Receptions  # Broadcasts as the base and the IMU received them
    recording: Recording  # An arm in motion, frames on the camera's clock, samples on the IMU's
    clocks: Clocks  # The truth: camera, base, IMU


def simulate_clock_session(config: ClockSources, seed: int) -> SimulatedClocks:
    """Simulate the sources of a session's clocks."""
    rng = np.random.default_rng([seed, 3])
    ahead_s = [rng.uniform(*BASE_AHEAD_S), rng.uniform(*IMU_AHEAD_S)]
    span_s = 60.0 * config.minutes
    clocks, received = broadcast(seed, nodes=2, rounds=config.rounds, span_s=span_s, offset_s=ahead_s)
    receptions = replace(received, node=tuple((BASE, IMU)[int(node[1:])] for node in received.node))
    sound, end_s, _ = beep(seed, SOUND_RATE_HZ, config.noise_db)
    arm = simulate_arm(ArmSimulation.preset("white", protocol="random", duration_s=config.motion_s), seed)
    imu = arm.recording.imu
    shown = clocks.offset_s[1] + (1.0 + clocks.skew[1]) * imu.t_s  # as `Clocks.read`, of many times
    recording = replace(arm.recording, imu=replace(imu, name=f"/imu/{IMU}", t_s=shown), truth=None)
    event_s = np.rint(clocks.read(0, end_s) / STEP_S) * STEP_S
    clocks = Clocks((CAMERA, BASE, IMU), np.append(0.0, clocks.offset_s), np.append(0.0, clocks.skew))
    sound /= np.abs(sound).max()
    return SimulatedClocks(sound, float(event_s), receptions, recording, clocks)


#: Six sides, twelve edges and eight corners: the poses in order.
_SIDES = np.vstack([np.eye(3), -np.eye(3)])
_EDGES = np.array([v for v in np.ndindex(3, 3, 3) if np.abs(np.array(v) - 1).sum() == 2], float) - 1.0
_CORNERS = np.array(list(np.ndindex(2, 2, 2)), float) * 2.0 - 1.0
REST_POSES = unit(np.vstack([_SIDES, _EDGES[::2], _EDGES[1::2], _CORNERS]))

#: How long a sensor is turned for its magnetometer, s.
TURNING_S = 60.0


@dataclass(frozen=True)
class SensorModel:
    """measured = matrix @ true + offset; the matrix is symmetric, as a calibration cannot see a rotation."""

    offset: FloatArray  # (3,)
    matrix: FloatArray  # (3, 3)

    @classmethod
    def draw(cls, seed: int | list[int], *, offset: float, scale: float, cross: float) -> SensorModel:
        """Errors of the given sizes, their signs and shares at random."""
        rng = np.random.default_rng(seed)
        matrix = np.eye(3) + np.diag(scale * rng.uniform(-1.0, 1.0, 3))
        off = cross * rng.uniform(-1.0, 1.0, (3, 3))
        matrix += np.triu(off, 1) + np.triu(off, 1).T
        return cls(offset * rng.choice([-1.0, 1.0], 3), matrix)

    def distort(self, true: FloatArray) -> FloatArray:
        """What the sensor reads (N, 3) of true values (N, 3)."""
        return true @ self.matrix.T + self.offset

    def correction(self, unit_of: float = 1.0) -> dict[str, list[Any]]:
        """What a calibration should find: true = matrix @ (read - offset)."""
        matrix = np.linalg.inv(self.matrix) / unit_of
        return {"offset": (unit_of * self.offset).tolist(), "matrix": matrix.tolist()}


def rest_poses(
    model: SensorModel,
    poses: int,
    *,
    seed: int = 0,
    rest_s: float = 2.0,
    turn_s: float = 1.0,
    rate_hz: float = 100.0,
    acc_noise: float = 0.02,  # m/s^2 and rad/s
    gyro_noise: float = 0.002,  # m/s^2 and rad/s
    gravity: float = GRAVITY,  # m/s^2
) -> tuple[ImuStream, FloatArray]:  # imu, gyroscope_bias (3,) rad/s
    """A sensor laid still in one pose after the other, turned by hand between."""
    rng = np.random.default_rng(seed)
    up = REST_POSES[:poses] + rng.normal(0.0, 0.06, (poses, 3))
    turns = [Rotation.align_vectors([[0.0, 0.0, 1.0]], [axis])[0].as_matrix() for axis in up]
    body = Held(np.array(turns), np.zeros((poses, 3)), rest_s, turn_s)
    ideal = ideal_imu(body.imu_pose, body.duration_s, rate_hz, np.array([0.0, 0.0, -gravity]))
    turning = (ideal.t_s % (rest_s + turn_s) > rest_s)[:, None]
    shake = turning * rng.normal(0.0, 1.5, ideal.acc.shape)
    bias = rng.normal(0.0, 0.01, 3)
    acc = model.distort(ideal.acc + shake) + rng.normal(0.0, acc_noise, shake.shape)
    gyro = ideal.gyro + bias + rng.normal(0.0, gyro_noise, shake.shape)
    return ImuStream("/imu/forearm_right", ideal.t_s, acc, gyro), bias


def magnetometer_turns(model: SensorModel, count: int, *, noise: float = 0.01, seed: int = 0) -> FloatArray:
    """Samples (count, 3) of a sensor turned slowly about all its axes in a field of length 1."""
    rng = np.random.default_rng(seed)
    R, _ = _turned(seed).imu_pose(np.linspace(0.0, TURNING_S, count))
    field = R.transpose(0, 2, 1) @ [np.cos(np.radians(60.0)), 0.0, -np.sin(np.radians(60.0))]
    return model.distort(field) + rng.normal(0.0, noise, (count, 3))


def turning_sensor(
    model: SensorModel, *, seed: int = 0, field: float = 48.0, noise: float = 0.01
) -> ImuStream:
    """A sensor turned slowly about all its axes for a minute, on one spot, at 50 Hz."""
    ideal = ideal_imu(_turned(seed).imu_pose, TURNING_S, 50.0, np.array([0.0, 0.0, -GRAVITY]))
    rng = np.random.default_rng([seed, 1])
    acc, gyro = (
        values + rng.normal(0.0, sigma, values.shape)
        for values, sigma in ((ideal.acc, 0.02), (ideal.gyro, 0.002))
    )
    mag = field * magnetometer_turns(model, len(ideal), noise=noise, seed=seed)
    return ImuStream("/imu/forearm_right", ideal.t_s, acc, gyro, mag)


def _turned(seed: int) -> Held:
    """A sensor that is turned for a minute, through an orientation at random a second."""
    R = Rotation.random(round(TURNING_S) + 1, random_state=seed).as_matrix()
    return Held(R, np.zeros((len(R), 3)), hold_s=0.0, move_s=1.0)


def long_rest(
    model: SensorModel, rest_s: float, *, seed: int = 0
) -> tuple[ImuStream, FloatArray]:  # imu, gyroscope_bias (3,) rad/s
    """A sensor at rest at 100 Hz; its bias wanders by a twentieth of the white noise in a second."""
    rng, rate_hz = np.random.default_rng(seed), 100.0
    count = round(rest_s * rate_hz)
    bias = rng.normal(0.0, 0.01, 3)

    def noise(density: float) -> tuple[FloatArray, FloatArray]:
        white = density * np.sqrt(rate_hz) * rng.normal(size=(count, 3))
        return white, np.cumsum(density / 20.0 / np.sqrt(rate_hz) * rng.normal(size=(count, 3)), axis=0)

    up = np.tile(np.array([0.0, 0.0, GRAVITY]), (count, 1))
    acc = model.distort(up) + np.sum(noise(2e-3), axis=0)
    white, walk = noise(2e-4)
    t = (np.arange(float(count)) + 0.5) / rate_hz
    gyro = np.asarray(bias + walk + white)
    return ImuStream("/imu/forearm_right", t, acc, gyro), np.asarray(bias + walk.mean(axis=0))
