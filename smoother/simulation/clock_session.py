"""A session whose clocks are known: a beep, broadcasts and an arm in motion, all on the same three clocks."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from calib.clock.links import Receptions

from ..array_types import FloatArray
from ..recording import Recording
from .arm import simulate_arm
from .clocks import STEP_S, Clocks, beep, broadcast
from .config import ArmSimulation

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
