"""Unusual set-ups, each a function of a sound scene, and wrong pairs of the project's own presets."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from smoother.array_types import FloatArray
from smoother.linalg import interpolate, runs
from smoother.recording import JOINTS, JointState
from smoother.simulation import ArmSimulation, simulate_arm
from tools.reliability.body import slow_noise
from tools.reliability.judging import Outcome, Trial, run, trial_of
from tools.reliability.scene import TRACKED, Scene, draw_scene

#: Exercises in which the arm moves enough in all directions for most set-ups to matter.
LIVELY = (
    "reaching out",
    "drinking",
    "combing",
    "behind the back",
    "wiping",
    "lifting",
    "wheelchair",
    "daily life",
)


def trial_cut_by_hand(scene: Scene) -> Scene:
    """A trial of 8 to 10 s, camera and IMU cut from their recordings by eye, up to 3 s apart."""
    shift_s = float(scene.rng.choice([-1.0, 1.0]) * scene.rng.uniform(1.0, 3.0))
    return scene.changed(offset_s=shift_s, clocks_unrelated=True)


def shoulder_moves_fast(scene: Scene) -> Scene:
    """The trunk bends forward and back at 0.8 to 1.9 m/s, or walks; the shoulder is seen all the time."""
    state = scene.film.state.copy()
    state[:, 0] = JointState.TRACKED
    return scene.changed(film=replace(scene.film, state=state), judged_joints=("wrist", "shoulder"))


def camera_sways(scene: Scene) -> Scene:
    """A camera that somebody holds: it turns by a degree or two to and fro."""
    fine_s = np.arange(0.0, scene.duration_s + 1.0, 0.02)
    turns = slow_noise(fine_s, 3, np.radians(1.5), 1.5, scene.rng)

    def view(t_s: FloatArray, place: FloatArray) -> FloatArray:
        return Rotation.from_rotvec(interpolate(fine_s, turns, t_s)).apply(place)

    position = scene.film.position.copy()
    for column in (JOINTS.index(joint) for joint in TRACKED):
        position[:, column] = view(scene.film.t_s, position[:, column])
    return scene.changed(film=replace(scene.film, position=position), view=view)


def mirrored_in_one_plane(scene: Scene) -> Scene:
    """A mirrored skeleton; what the camera sees stays in one upright plane, what it does not see does not."""
    mirror = np.array([-1.0, 1.0, 1.0])
    film = replace(scene.film, position=scene.film.position * mirror)
    return scene.changed(film=film, view=lambda t_s, place: place * mirror)


@dataclass(frozen=True)
class Case:
    """A set-up."""

    apply: Callable[[Scene], Scene]  # A sound scene to this one
    exercises: tuple[str, ...] = LIVELY  # What the person does, one of these
    duration_s: tuple[float, float] = (26.0, 45.0)  # The shortest and the longest
    every_s: float = 5.0  # From a gap to the next one, on average


UNUSUAL = (
    Case(trial_cut_by_hand, LIVELY, (8.0, 10.0), every_s=3.0),
    Case(shoulder_moves_fast, ("bending forward", "walking about")),
    Case(camera_sways),
)


def unusual_jobs(count: int, rng: np.random.Generator) -> Iterator[Unusual]:
    """As many set-ups to smooth and judge, the cases in turn; the first do not depend on how many follow."""
    for number in range(count):
        case = UNUSUAL[number % len(UNUSUAL)]
        exercise, duration_s = str(rng.choice(case.exercises)), round(float(rng.uniform(*case.duration_s)), 1)
        yield Unusual(number % len(UNUSUAL), exercise, duration_s, int(rng.integers(2**31)))


@dataclass(frozen=True)
class Unusual:
    """A set-up of the second simulator."""

    case: int  # Its number in `UNUSUAL`
    exercise: str
    duration_s: float
    seed: int

    def __call__(self) -> Outcome:
        """Smooth and judge it."""
        case = UNUSUAL[self.case]
        # the second number is of a family of seeds
        scene = draw_scene(self.exercise, self.duration_s, [self.seed, 0], every_s=case.every_s)
        return run(trial_of(case.apply(scene)))


PRESETS = ("white", "realistic", "azure")
#: What the presets' people do: the protocol, and how long.
PROTOCOLS = ("behind", "random")
PRESET_S = 70.0


@dataclass(frozen=True)
class WrongPair:
    """The skeleton of one simulated arm with the IMU of another one that does the same."""

    preset: str
    protocol: str
    skeleton_seed: int
    imu_seed: int

    def __call__(self) -> Outcome:
        """Smooth and judge it."""
        config = ArmSimulation.preset(self.preset, protocol=self.protocol, repetitions=3, duration_s=PRESET_S)
        one, other = simulate_arm(config, self.skeleton_seed), simulate_arm(config, self.imu_seed)
        offset_s = float(one.parameters["clock_offset_s"])
        true_t = one.recording.arm.t_s + offset_s

        def truth_at(t_s: FloatArray) -> dict[str, FloatArray]:
            inside = np.clip(t_s, true_t[0], true_t[-1])
            return {"wrist": np.where((t_s == inside)[:, None], one.motion.joints(inside)["wrist"], np.nan)}

        hidden = tuple(
            (float(true_t[gap.start]), float(true_t[gap.stop - 1]))
            for gap in runs(one.occluded)
            if gap.stop - gap.start > 3
        )
        return run(
            Trial(replace(one.recording, imu=other.recording.imu, truth=None), truth_at, hidden, offset_s)
        )


def wrong_pairs(count: int, rng: np.random.Generator) -> Iterator[WrongPair]:
    """As many pairs."""
    for number in range(count):
        skeleton, imu = int(rng.integers(2**30)), int(rng.integers(2**30, 2**31))
        yield WrongPair(PRESETS[number % len(PRESETS)], PROTOCOLS[number % len(PROTOCOLS)], skeleton, imu)
