"""What the person does: postures, smooth curves through them, joint angles over time for each protocol."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline
from scipy.spatial.transform import Rotation

from ..array_types import FloatArray
from .body import FLEXION, GIRDLE, POSTURE_SIZE, PRONATION, SHOULDER
from .config import ArmSimulation

#: Knots a second of a motion; the spline between them is quintic, so C^4.
KNOT_RATE_HZ = 100.0
#: How far a motion is defined beyond its start and end, s.
PAD_S = 0.5


@dataclass(frozen=True)
class PlannedMovement:
    """One movement from rest to rest."""

    through: FloatArray  # (V, D): points passed without a stop; the last is where it ends
    duration_s: float  # From the start of the movement to its end
    hold_s: float  # Rest after it
    label: str = ""  # What the movement and its hold are for

    @property
    def length_s(self) -> float:
        """Movement and hold, s."""
        return self.duration_s + self.hold_s


def knot_times(duration_s: float) -> FloatArray:
    """Times (N,) of the knots of a motion, s, from `-PAD_S` to `duration_s + PAD_S`."""
    count = int(np.ceil((duration_s + 2 * PAD_S) * KNOT_RATE_HZ)) + 1
    return -PAD_S + np.arange(count) / KNOT_RATE_HZ


def follow(start: FloatArray, movements: list[PlannedMovement], t_s: FloatArray) -> FloatArray:
    """Points (N, D) at `t_s` of a path that starts at `start` (D,) at time 0 and moves with minimum jerk.

    Minimum jerk: Flash and Hogan, J. Neuroscience 5:1688-1703 (1985). A movement through via points is the
    quintic spline through them that is at rest at both ends; the time between two points grows with the
    square root of their distance.
    """
    out = np.tile(start, (len(t_s), 1))
    at, begin = start, 0.0
    for movement in movements:
        points = np.vstack([at, movement.through])
        step = np.sqrt(np.linalg.norm(np.diff(points, axis=0), axis=1) + 1e-9)
        share = np.concatenate([[0.0], np.cumsum(step)])
        curve = wander(begin + movement.duration_s * share / share[-1], points)
        end = begin + movement.duration_s
        moving = (t_s >= begin) & (t_s <= end)
        out[moving] = curve(t_s[moving])
        at, begin = points[-1], begin + movement.length_s
        out[t_s > end] = at
    return out


def wander(times: FloatArray, points: FloatArray) -> BSpline:
    """The minimum-jerk curve through `points` (P, D) at `times` (P,), at rest at both ends."""
    still = np.zeros(points.shape[1])
    rest = [(1, still), (2, still)]
    return make_interp_spline(times, points, k=5, bc_type=(rest, rest))


def band_noise(
    t_s: FloatArray, low_hz: float, high_hz: float, size: int, rng: np.random.Generator
) -> FloatArray:
    """Smooth noise (N, size) of unit expected rms, a sum of eight sinusoids in the band for each column."""
    frequency = rng.uniform(low_hz, high_hz, (8, size))
    phase = rng.uniform(0, 2 * np.pi, (8, size))
    total = np.zeros((len(t_s), size))
    for f, p in zip(frequency, phase, strict=True):
        total += np.sin(2 * np.pi * t_s[:, None] * f + p)
    return total / 2.0  # eight terms of variance 1/2 each


def ramp(t_s: FloatArray, begin_s: float, length_s: float) -> FloatArray:
    """Smooth step (N,) from 0 to 1 that starts at `begin_s` and takes `length_s`."""
    x = np.clip((t_s - begin_s) / length_s, 0.0, 1.0)
    return x**3 * (10 - 15 * x + 6 * x**2)


# Directions in {T} (x the person's right, y up, z back): shoulder to elbow, elbow to wrist, palm; then the
# shift of the shoulder girdle, m.
_POSTURES: dict[str, tuple[tuple[float, float, float], ...]] = {
    "hang": ((0.12, -0.99, 0.02), (0.05, -0.97, -0.22), (-1.0, 0.0, 0.1), (0.0, 0.0, 0.0)),
    "initial": ((0.88, -0.38, -0.28), (0.05, 0.98, -0.20), (0.0, -0.1, -1.0), (0.0, 0.02, 0.0)),
    "beside_head": ((0.72, 0.62, -0.10), (-0.25, 0.85, 0.20), (-0.1, 0.0, -1.0), (-0.01, 0.04, 0.0)),
    "behind_head": ((0.36, 0.93, 0.02), (-0.90, -0.12, 0.40), (-0.3, 0.0, -1.0), (-0.02, 0.05, 0.01)),
    "on_nape": ((0.30, 0.95, 0.00), (-0.85, -0.36, 0.40), (-0.3, 0.0, -1.0), (-0.02, 0.05, 0.01)),
    "belly": ((0.30, -0.90, -0.28), (-0.88, 0.05, -0.40), (0.2, 0.0, 1.0), (0.0, 0.0, -0.01)),
    "side": ((0.50, -0.80, 0.25), (0.15, -0.98, -0.05), (-0.5, 0.0, 0.8), (0.0, 0.0, 0.01)),
    "behind_back": ((0.33, -0.85, 0.42), (-0.93, -0.20, 0.22), (0.0, -0.2, 1.0), (0.0, -0.01, 0.02)),
    "up_the_back": ((0.42, -0.80, 0.44), (-0.93, 0.12, 0.18), (0.0, -0.2, 1.0), (0.0, 0.0, 0.02)),
    "reach": ((0.35, -0.60, -0.65), (-0.20, 0.15, -0.95), (-0.9, -0.3, 0.0), (0.0, 0.01, -0.01)),
}


def _frames(name: str) -> tuple[Rotation, Rotation]:
    """Rotations `R_T_U` and `R_T_F` of a posture."""
    upper, fore, palm = (np.asarray(v) / np.linalg.norm(v) for v in _POSTURES[name][:3])
    # Flexion turns the forearm towards -x of {U}, so x points away from it.
    x_upper = upper * (fore @ upper) - fore
    x_upper /= np.linalg.norm(x_upper)
    x_fore = fore * (palm @ fore) - palm
    x_fore /= np.linalg.norm(x_fore)
    R_T_U = np.column_stack([x_upper, upper, np.cross(x_upper, upper)])
    R_T_F = np.column_stack([x_fore, fore, np.cross(x_fore, fore)])
    return Rotation.from_matrix(R_T_U), Rotation.from_matrix(R_T_F)


@cache
def reference() -> Rotation:
    """The upper arm's rotation `R_T_U` from which the shoulder's rotation vectors count: the mean posture."""
    return Rotation.concatenate([_frames(name)[0] for name in _POSTURES]).mean()


def posture(name: str) -> FloatArray:
    """The joint angles (8,) of a named posture, columns as in `body`."""
    R_T_U, R_T_F = _frames(name)
    bend = (R_T_U.inv() * R_T_F).as_matrix()
    flexion = np.arctan2(-bend[0, 1], bend[1, 1])
    turn = np.arctan2(-bend[2, 0], bend[2, 2])  # bend = Rz(flexion) Ry(turn)
    out = np.empty(POSTURE_SIZE)
    out[GIRDLE] = _POSTURES[name][3]
    out[SHOULDER] = (reference().inv() * R_T_U).as_rotvec()
    out[FLEXION], out[PRONATION] = flexion, -turn
    return out


#: How much a posture differs from its name each time: girdle m, shoulder rad, flexion rad, pronation rad.
_SPREAD = np.array([0.004, 0.004, 0.004, 0.05, 0.05, 0.05, 0.06, 0.12])
#: Slow variation of the joint angles within a posture, rms, same units.
_DRIFT = np.array([0.002, 0.002, 0.002, 0.015, 0.015, 0.015, 0.02, 0.03])


@dataclass(frozen=True)
class Performance:
    """Joint angles over time."""

    duration_s: float  # Length of the recording
    t_s: FloatArray  # (N,) s: knots, from a little before the start to a little after the end
    posture: FloatArray  # (N, 8): joint angles of a right arm, columns as in `body`
    sway: FloatArray  # (N, 3) m: shift of the whole trunk in {T}
    belly_s: FloatArray  # (B, 2) s: from when to when the forearm is before the belly


def _move(
    names: tuple[str, ...], seconds: float, hold: float, label: str, speed: float, rng: np.random.Generator
) -> PlannedMovement:
    """A movement through named postures, each a little different from its name."""
    points = np.array([posture(name) for name in names]) + _SPREAD * rng.normal(size=(len(names), 8))
    return PlannedMovement(
        points, seconds * rng.uniform(0.9, 1.15) / speed, hold * rng.uniform(0.8, 1.3), label
    )


def _behind(repetitions: int, speed: float, rng: np.random.Generator) -> list[PlannedMovement]:
    """The clinical protocol: held pose, behind the head and back, belly, behind the back and back."""
    movements = []
    tempo = speed * rng.uniform(0.9, 1.25)  # some people are brisk

    def move(names: str, seconds: float, hold: float, label: str = "") -> None:
        movements.append(_move(tuple(names.split()), seconds, hold, label, tempo, rng))

    for _ in range(repetitions):
        move("beside_head behind_head", 1.3, 0.15)
        move("on_nape", 0.6, 0.15)
        move("beside_head initial", 1.3, 1.6)
        move("belly", 1.3, 1.6, "belly")
        move("side behind_back", 1.6, 0.1)
        move("up_the_back", 0.6, 0.1)
        move("side initial", 1.7, 2.0)
    return movements


def _random_postures(
    end_s: float, speed: float, flexion_rad: tuple[float, float], rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """Times (P,) and postures (P, 8) of an arm that moves about in front of the body without a rest."""
    count = int(np.ceil((end_s + 2 * PAD_S) / 0.45 * speed)) + 3
    times = -PAD_S + np.cumsum(rng.uniform(0.45, 0.9, count)) / speed
    times -= times[0] + PAD_S
    points = np.tile(posture("reach"), (count, 1))
    points[:, GIRDLE] += rng.normal(0, 0.008, (count, 3))
    points[:, SHOULDER] += rng.uniform(-0.65, 0.65, (count, 3))
    points[:, FLEXION] = rng.uniform(*flexion_rad, count)
    points[:, PRONATION] = rng.uniform(0.5, 2.4, count)
    used = int(np.searchsorted(times, end_s + PAD_S)) + 1
    return times[:used], points[:used]


def perform(config: ArmSimulation, rng: np.random.Generator) -> Performance:
    """Joint angles for the configured protocol, with sway, slow variation and tremor."""
    hang = posture("hang")
    movements: list[PlannedMovement] = []
    start = hang
    if config.protocol == "behind":
        start = posture("initial") + _SPREAD * rng.normal(size=POSTURE_SIZE)
        movements = [PlannedMovement(start[None], 0.1, rng.uniform(2.8, 3.6))]
        movements += _behind(config.repetitions, config.speed, rng)
    if config.still_start_s > 0 and config.protocol != "hang":
        to_start = start if config.protocol == "behind" else posture("reach")
        lift = PlannedMovement(to_start[None], 1.5 / config.speed, 0.0)
        movements = [PlannedMovement(hang[None], config.still_start_s, 0.0), lift, *movements]
        start = hang

    ends = np.cumsum([m.length_s for m in movements])
    duration = float(ends[-1]) if config.protocol == "behind" else config.duration_s
    belly = [(end - m.length_s, end) for m, end in zip(movements, ends, strict=True) if m.label == "belly"]
    t_s = knot_times(duration)
    if config.still_all:
        movements, start = [], hang
    angles = follow(start, movements, t_s)
    if config.protocol == "random" and not config.still_all:
        free = wander(*_random_postures(duration, config.speed, config.flexion_rad, rng))(t_s)
        # After a still start the random motion fades in.
        weight = ramp(t_s, config.still_start_s, 1.5) if config.still_start_s > 0 else np.ones(len(t_s))
        angles += weight[:, None] * (free - angles)

    alive = np.ones(len(t_s))
    if config.still_start_s > 0:
        alive = ramp(t_s, config.still_start_s, 0.5)
    if config.still_all:
        alive = np.zeros(len(t_s))
    angles += alive[:, None] * _DRIFT * band_noise(t_s, 0.1, 0.7, POSTURE_SIZE, rng)
    tremor = config.tremor_rad * band_noise(t_s, 7.0, 11.0, 5, rng)
    angles[:, SHOULDER.start :] += alive[:, None] * tremor
    sway = alive[:, None] * config.sway_m * band_noise(t_s, 0.05, 0.4, 3, rng)
    return Performance(duration, t_s, angles, sway, np.array(belly).reshape(-1, 2))
