"""A session whose clocks are known: a beep, broadcasts and an arm in motion, all on the same three clocks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import fftconvolve

from calib.clock.links import ClockLink, Receptions

from ..array_types import FloatArray
from ..recording import Recording
from .arm import simulate_arm
from .config import ArmSimulation

#: Bluetooth stamps count in steps of this, s.
STEP_S = 0.3125e-3


@dataclass(frozen=True)
class Clocks:
    """Nodes whose clocks read tau + offset + skew tau.

    Attributes
    ----------
    offset_s : ndarray, shape (n,), s
    skew : ndarray, shape (n,)
    """

    offset_s: FloatArray
    skew: FloatArray

    def read(self, node: int, tau: float) -> float:
        """What a node's clock shows at a true time."""
        return float(tau + self.offset_s[node] + self.skew[node] * tau)

    def error_s(self, link: ClockLink) -> float:
        """Error of a link between nodes called n0, n1, .. at the time that it is stated for."""
        u, v = int(link.from_clock[1:]), int(link.to_clock[1:])
        tau = (link.at_s - self.offset_s[u]) / (1 + self.skew[u])
        return link.offset_s - (self.read(v, tau) - self.read(u, tau))

    def skew_error_ppm(self, link: ClockLink) -> float:
        """Error of a link's skew."""
        u, v = int(link.from_clock[1:]), int(link.to_clock[1:])
        return link.skew_ppm - 1e6 * ((1 + self.skew[v]) / (1 + self.skew[u]) - 1)


def broadcast(
    seed: int,
    nodes: int = 3,
    rounds: int = 20,
    span_s: float = 900.0,
    missed: float = 0.2,
    late: float = 0.05,
    start_s: float = 0.0,
    offset_s: Sequence[float] | None = None,
) -> tuple[Clocks, Receptions]:
    """Rounds of a broadcast that some nodes miss and some hear late; node n1 runs 390 ppm fast.

    Parameters
    ----------
    seed : int
    nodes, rounds : int
        How many.
    span_s : float, s
        Time from the first round to the last, at most.
    missed, late : float
        Fractions of the receptions.
    start_s : float, s
        Added to the clocks' offsets, the first excepted.
    offset_s : sequence of float, length n, s, optional
        The clocks' offsets; drawn where None.

    Returns
    -------
    clocks : Clocks
        The truth.
    receptions : Receptions
    """
    rng = np.random.default_rng(seed)
    offset = np.concatenate([[0.0], rng.uniform(-5, 5, nodes - 1) + start_s])
    skew = np.concatenate([[0.0, 390e-6], rng.uniform(-4e-4, 4e-4, nodes)])[:nodes]
    clocks, rows = Clocks(offset if offset_s is None else np.array(offset_s), skew), []
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
    seed: int, rate_hz: int = 16000, quiet_db: float = 25.0, room_s: float | None = None, voice: bool = True
) -> tuple[FloatArray, float, float]:
    """A buzzer near a microphone, in a room where somebody speaks.

    Parameters
    ----------
    seed : int
    rate_hz : int, Hz
        Of the samples.
    quiet_db : float, dB
        White noise below the beep.
    room_s : float, s, optional
        Time in which the echo dies by 60 dB; drawn where None.
    voice : bool
        Somebody speaks.

    Returns
    -------
    sound : ndarray, shape (4 rate_hz,)
    end_s : float, s
        The beep's end.
    tone_hz : float, Hz
    """
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
    if voice:
        harmonics = [np.sin(2 * np.pi * 150 * k * t + rng.uniform(0, 6)) / k for k in range(1, 20)]
        sound = sound + 0.1 * sum(harmonics) * (np.sin(2 * np.pi * 3 * t + rng.uniform(0, 6)) > 0.2)
    return sound + np.sqrt(0.5) * 10 ** (-quiet_db / 20) * rng.normal(size=len(t)), end, tone


#: The session's clocks, and how they are called: the camera's (true time), the base's, the IMU's.
CAMERA, BASE, IMU = "camera", "base", "forearm_right"
#: How far these clocks are ahead of the camera's, s. The motion needs stamps that overlap.
BASE_AHEAD_S, IMU_AHEAD_S = (5.0, 15.0), (1.0, 4.0)


@dataclass(frozen=True)
class ClockSession:
    """What `calibrate clock` reads, and what it should find.

    Attributes
    ----------
    sound : ndarray, shape (n,)
        The camera's sound, from the camera's time zero on; largest sample 1.
    sound_rate_hz : int, Hz
        Of the sound.
    event_time_s : float, s
        The beep's end on the base's clock, in the step of its stamps.
    receptions : Receptions
        Broadcasts as the base and the IMU received them.
    recording : Recording
        An arm in motion, frames on the camera's clock, samples on the IMU's.
    clocks : Clocks
        The truth: base, then IMU, against the camera's.
    """

    sound: FloatArray
    sound_rate_hz: int
    event_time_s: float
    receptions: Receptions
    recording: Recording
    clocks: Clocks

    def offset_s(self, from_clock: str, to_clock: str, at_s: float) -> float:
        """True offset between two clocks by name, t_to = t_from + offset, at a time on the first."""
        first, second = self._law(from_clock), self._law(to_clock)
        true_s = (at_s - first[0]) / (1.0 + first[1])
        return second[0] + (1.0 + second[1]) * true_s - at_s

    def _law(self, clock: str) -> tuple[float, float]:
        """Offset in s and skew of a clock against the true time."""
        if clock == CAMERA:
            return 0.0, 0.0
        node = (BASE, IMU).index(clock)
        return float(self.clocks.offset_s[node]), float(self.clocks.skew[node])


def simulate_clock_session(
    seed: int = 0,
    *,
    rounds: int = 20,
    minutes: float = 5.0,
    motion_s: float = 30.0,
    sound_rate_hz: int = 16000,
    noise_db: float = 25.0,
) -> ClockSession:
    """Simulate the sources of a session's clocks.

    Parameters
    ----------
    seed : int
        Of the clocks, the room, the receptions and the arm.
    rounds : int
        Broadcasts; a fifth of the receptions is missed and one of twenty is late.
    minutes : float, min
        Time over which they are spread.
    motion_s : float, s
        Length of the arm's recording.
    sound_rate_hz : int, Hz
        Of the sound.
    noise_db : float, dB
        Noise of the room below the beep.

    Returns
    -------
    session : ClockSession
        The IMU's clock runs 390 ppm fast.
    """
    rng = np.random.default_rng([seed, 3])
    ahead_s = [rng.uniform(*BASE_AHEAD_S), rng.uniform(*IMU_AHEAD_S)]
    clocks, received = broadcast(seed, nodes=2, rounds=rounds, span_s=60.0 * minutes, offset_s=ahead_s)
    receptions = replace(received, node=tuple((BASE, IMU)[int(node[1:])] for node in received.node))
    sound, end_s, _ = beep(seed, sound_rate_hz, noise_db)
    arm = simulate_arm(
        ArmSimulation.preset("white", protocol="random", duration_s=motion_s, side="right"), seed
    )
    imu = arm.recording.imu
    shown = clocks.offset_s[1] + (1.0 + clocks.skew[1]) * imu.t_s  # as `Clocks.read`, of many times
    recording = replace(arm.recording, imu=replace(imu, name=f"/imu/{IMU}", t_s=shown), truth=None)
    event_s = np.rint(clocks.read(0, end_s) / STEP_S) * STEP_S
    return ClockSession(
        sound / np.abs(sound).max(), sound_rate_hz, float(event_s), receptions, recording, clocks
    )
