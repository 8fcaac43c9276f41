"""What the person does: joint angles over time for each protocol."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..array_types import FloatArray
from .body import FLEXION, GIRDLE, POSTURE_SIZE, PRONATION, SHOULDER
from .config import ArmSimulation
from .path import PAD_S, PlannedMovement, band_noise, follow, knot_times, ramp, wander
from .posture import posture

#: How much a posture differs from its name each time: girdle m, shoulder rad, flexion rad, pronation rad.
_SPREAD = np.array([0.004, 0.004, 0.004, 0.05, 0.05, 0.05, 0.06, 0.12])
#: Slow variation of the joint angles within a posture, rms, same units.
_DRIFT = np.array([0.002, 0.002, 0.002, 0.015, 0.015, 0.015, 0.02, 0.03])


@dataclass(frozen=True)
class Performance:
    """Joint angles over time.

    Attributes
    ----------
    duration_s : float, s
        Length of the recording.
    t_s : ndarray, shape (N,), s
        Knots, from a little before the start to a little after the end.
    posture : ndarray, shape (N, 8)
        Joint angles of a right arm, columns as in `body`.
    sway : ndarray, shape (N, 3), m
        Shift of the whole trunk in {T}.
    belly_s : ndarray, shape (B, 2), s
        From when to when the forearm is before the belly.
    """

    duration_s: float
    t_s: FloatArray
    posture: FloatArray
    sway: FloatArray
    belly_s: FloatArray


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
