"""What people do in therapy and on a wheelchair: exercises for the second simulator.

An exercise is a generator of moves, repetition by repetition, each a little different from the last.
`perform` cuts them to a length, puts a person before a camera, and leaves the rest to `path`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from smoother.array_types import FloatArray
from tools.reliability.body import ArmPath, Jitter, Motion, Move, draw_camera, draw_wobble

from .body import Bones, Posture, draw_bones, pointing, reaching

#: Occlusions, as (start, end) pairs, s of true time.
Gaps = tuple[tuple[float, float], ...]
Moves = Iterator[Move]


@dataclass
class Draw:
    """Random numbers as the exercises need them."""

    rng: np.random.Generator
    bones: Bones  # Whose arm moves
    pace: float = 1.0  # Factor on all durations: how slowly this person moves
    gaps: Gaps = ()  # s: when the camera will not see the arm
    t_s: float = 0.0  # How long the moves drawn so far take

    def move(self, seconds: float, to: Posture) -> Move:
        """A move of about this many seconds."""
        length_s = max(self.pace * seconds * float(np.exp(self.rng.normal(0, 0.15))), 0.15)
        self.t_s += length_s
        return Move(length_s, to)

    def hold(self, seconds: float, at: Posture) -> Move:
        """The same posture for about this many seconds."""
        return self.move(seconds, at)

    def near(self, target: tuple[float, float, float], spread_m: float = 0.03) -> FloatArray:
        """(3,) m: a place near another one."""
        return np.asarray(target) + self.rng.normal(0, spread_m, 3)

    def about(self, value: float, spread: float) -> float:
        """A number near another one."""
        return float(self.rng.normal(value, spread))

    def reach(self, target: tuple[float, float, float], swivel_deg: float = 25.0, **more: float) -> Posture:
        """The wrist near a place seen from the shoulder, m in {P} for an arm of 0.54 m."""
        scale = (self.bones.upper_arm + self.bones.forearm) / 0.54
        turn = {name: np.radians(self.about(value, 6.0)) for name, value in more.items()}
        return reaching(scale * self.near(target), self.bones, self.about(swivel_deg, 6.0), **turn)


def _lap(draw: Draw) -> Posture:
    return draw.reach((-0.06, -0.40, -0.24), 20.0, pronation=60.0)


def reaching_out(draw: Draw) -> Moves:
    """From the lap to places on a shelf and on a table, and back."""
    while True:
        yield draw.hold(0.5, _lap(draw))
        x, y = draw.rng.uniform(-0.25, 0.25), draw.rng.uniform(-0.25, 0.25)
        target = draw.reach((x, y, -0.42), 35.0, pronation=draw.rng.uniform(-30, 60))
        trunk = np.array([0.0, -0.02, -0.08]) * draw.rng.uniform(0, 1)
        target = replace(target, trunk=trunk)
        yield draw.move(1.1, target)
        yield draw.hold(0.4, target)
        yield draw.move(1.2, _lap(draw))


def drinking(draw: Draw) -> Moves:
    """A cup from the table to the mouth."""
    while True:
        cup = draw.reach((-0.10, -0.33, -0.36), 25.0, pronation=0.0)
        yield draw.move(1.1, cup)
        yield draw.hold(0.5, cup)
        mouth = draw.reach((-0.15, 0.08, -0.22), 45.0, pronation=-35.0, wrist=15.0)
        yield draw.move(1.3, mouth)
        yield draw.hold(0.7, replace(mouth, pronation=mouth.pronation - 0.4))
        yield draw.move(1.2, cup)
        yield draw.move(1.0, _lap(draw))


def combing(draw: Draw) -> Moves:
    """The hand to the back of the head, strokes, and down again."""
    while True:
        yield draw.hold(0.4, _lap(draw))
        front = draw.reach((-0.12, 0.26, -0.18), 75.0, pronation=-20.0)
        yield draw.move(1.2, front)
        for _ in range(draw.rng.integers(1, 4)):
            upper = draw.near((0.75, 0.55, -0.25), 0.08)
            behind = pointing(upper, draw.near((-0.75, 0.35, 0.55), 0.08), pronation=np.radians(-40))
            yield draw.move(0.7, behind)
            yield draw.move(0.7, draw.reach((-0.12, 0.26, -0.18), 75.0, pronation=-20.0))
        yield draw.move(1.2, _lap(draw))


def behind_the_back(draw: Draw) -> Moves:
    """The hand to the small of the back and to the other shoulder."""
    while True:
        yield draw.hold(0.4, _lap(draw))
        side = pointing(draw.near((0.45, -0.9, 0.1), 0.06), draw.near((0.2, -0.8, -0.2), 0.06))
        back = pointing(
            draw.near((0.35, -0.85, 0.4), 0.06), draw.near((-0.9, -0.1, 0.4), 0.08), pronation=np.radians(50)
        )
        yield draw.move(0.8, side)
        yield draw.move(1.0, back)
        yield draw.hold(0.4, back)
        yield draw.move(0.9, side)
        yield draw.move(0.9, draw.reach((-0.32, -0.02, -0.2), 30.0, pronation=40.0))


def wiping(draw: Draw) -> Moves:
    """Circles and lines with a cloth on a table."""
    centre, radius, angle = draw.near((-0.02, -0.30, -0.36), 0.02), draw.rng.uniform(0.07, 0.12), 0.0
    sense = draw.rng.choice([-1.0, 1.0])
    while True:
        for _ in range(draw.rng.integers(6, 14)):
            angle += sense * draw.rng.uniform(0.5, 0.9)
            place = centre + radius * np.array([1.3 * np.cos(angle), 0.0, np.sin(angle)])
            yield draw.move(
                0.16, reaching(place, draw.bones, 30.0, pronation=np.radians(70 + 8 * np.cos(angle)))
            )
        sense = -sense
        yield draw.hold(0.5, reaching(centre, draw.bones, 25.0, pronation=np.radians(70)))


def lifting(draw: Draw) -> Moves:
    """A weight up to the front or to the side, the arm nearly straight, and down."""
    while True:
        down = pointing(draw.near((0.12, -1.0, -0.05), 0.03), draw.near((0.08, -1.0, -0.2), 0.04))
        yield draw.hold(0.6, down)
        side = draw.rng.uniform(0, 1)
        way = draw.near((side, draw.rng.uniform(-0.2, 0.4), -(1 - side) - 0.1), 0.05)
        up = pointing(way, way + draw.near((0, 0.2, -0.1), 0.05), pronation=np.radians(draw.about(50, 15)))
        yield draw.move(1.6, up)
        yield draw.hold(0.6, up)
        yield draw.move(1.7, down)


def pronating(draw: Draw) -> Moves:
    """The elbow at the side, the palm turned up and down."""
    while True:
        for pronation in (80.0, -60.0):
            at = pointing((0.1, -1.0, 0.0), draw.near((0.0, 0.05, -1.0), 0.08))
            yield draw.move(1.0, replace(at, pronation=np.radians(draw.about(pronation, 10))))
        if draw.rng.uniform() < 0.3:
            yield draw.move(0.9, draw.reach((0.1, 0.0, -0.40), pronation=0.0))


def wheelchair(draw: Draw) -> Moves:
    """Pushing the rims: a stroke forward and down, a loop back, the trunk swings along."""
    while True:
        for place, lean, seconds in (
            ((0.10, -0.42, 0.14), 0.0, 0.55),
            ((0.13, -0.36, -0.06), -0.02, 0.22),
            ((0.13, -0.40, -0.26), -0.06, 0.25),
            ((0.16, -0.46, -0.20), -0.04, 0.20),
        ):
            at = draw.reach(place, 40.0, pronation=15.0)
            yield draw.move(seconds, replace(at, trunk=np.array([0.0, 0.3 * lean, lean])))
        if draw.rng.uniform() < 0.12:
            yield draw.hold(1.0, _lap(draw))


def daily_life(draw: Draw) -> Moves:
    """A bit of everything, in any order."""
    exercises = [exercise(draw) for exercise in (reaching_out, drinking, combing, lifting, pronating)]
    while True:
        one = exercises[draw.rng.integers(len(exercises))]
        first = next(one)
        yield draw.move(1.3, first.to)  # from wherever the last one ended
        for _ in range(draw.rng.integers(3, 7)):
            yield next(one)


def in_one_plane(draw: Draw) -> Moves:
    """Flexion and extension in one upright plane while the camera sees it; anything while it does not."""
    heading = draw.rng.uniform(-0.3, 0.3)
    ahead, free = np.array([np.sin(heading), 0.0, -np.cos(heading)]), daily_life(draw)
    down = np.array([0.0, -1.0, 0.0])
    while True:
        if any(start - 0.4 <= draw.t_s + 0.5 <= end - 0.6 for start, end in draw.gaps):
            yield next(free)
            continue
        lift, bend = draw.rng.uniform(-0.2, 1.3), draw.rng.uniform(0.3, 2.0)
        u = np.cos(lift) * down + np.sin(lift) * ahead
        f = np.cos(lift + bend) * down + np.sin(lift + bend) * ahead
        yield draw.move(1.0, pointing(u, f))


def bending_forward(draw: Draw) -> Moves:
    """Reaching with the whole trunk, quickly: the shoulder moves at 0.8 to 1.9 m/s."""
    while True:
        yield draw.hold(0.5, _lap(draw))
        far = draw.reach(
            (draw.rng.uniform(-0.2, 0.2), draw.rng.uniform(-0.3, 0.2), -0.44), 35.0, pronation=20.0
        )
        sideways, length = draw.rng.uniform(-0.25, 0.25), draw.rng.uniform(0.35, 0.6)
        trunk = np.array([sideways, -0.15 * length, -length])
        yield draw.move(0.62 / draw.pace, replace(far, trunk=trunk))
        yield draw.move(0.62 / draw.pace, replace(_lap(draw), trunk=np.zeros(3)))


def walking_about(draw: Draw) -> Moves:
    """To and fro before the camera with swinging arms: the shoulder travels at 0.5 to 1.2 m/s."""
    at, swing = np.zeros(3), 1.0
    while True:
        goal = np.array([draw.rng.uniform(-0.9, 0.9), 0.0, draw.rng.uniform(-0.5, 0.8)])
        step_m = draw.rng.uniform(0.3, 0.6)
        for _ in range(max(round(float(np.linalg.norm(goal - at)) / step_m), 1)):
            way = goal - at
            at = at + way * min(step_m / max(float(np.linalg.norm(way)), 1e-9), 1.0)
            swing = -swing
            angle, bend = np.radians(swing * draw.about(22.0, 5.0)), np.radians(draw.about(25.0, 6.0))
            u = np.array([0.12, -np.cos(angle), -np.sin(angle)])
            f = np.array([0.06, -np.cos(angle + bend), -np.sin(angle + bend)])
            up = np.array([0.0, 0.02 * swing, 0.0])
            yield draw.move(0.55, replace(pointing(u, f), trunk=at + up))
        yield draw.move(0.8, replace(draw.reach((0.0, -0.05, -0.40), pronation=30.0), trunk=at))
        yield draw.move(0.8, replace(pointing((0.12, -1.0, 0.0), (0.08, -1.0, -0.3)), trunk=at))


Exercise = Callable[[Draw], Moves]


#: Exercises by name.
EXERCISES: dict[str, Exercise] = {
    each.__name__.replace("_", " "): each
    for each in (
        reaching_out,
        drinking,
        combing,
        behind_the_back,
        wiping,
        lifting,
        wheelchair,
        daily_life,
        in_one_plane,
        bending_forward,
        walking_about,
    )
}


def perform(name: str, duration_s: float, rng: np.random.Generator, gaps: Gaps) -> Motion:
    """A person who does an exercise before a camera."""
    body_rng, plan_rng, _, strap_rng, shake_rng, _ = rng.spawn(6)
    bones, pace = draw_bones(body_rng), body_rng.uniform(0.85, 1.25)
    jitter = Jitter(sway_m=0.004, wander_deg=0.8)
    if name != "in one plane":
        jitter = Jitter(sway_m=body_rng.uniform(0.004, 0.010), wander_deg=body_rng.uniform(0.8, 2.5))
    camera = draw_camera(body_rng)
    plan = Draw(plan_rng, bones, pace, gaps)
    path = _arm_path(EXERCISES[name], plan, duration_s, jitter, shake_rng)
    wobble = draw_wobble(duration_s, body_rng.uniform(0.2, 2.0), strap_rng)
    return Motion(bones, path, camera, wobble)


def _arm_path(
    exercise: Exercise, draw: Draw, duration_s: float, jitter: Jitter, rng: np.random.Generator
) -> ArmPath:
    plan, moves = exercise(draw), []
    first = next(plan)
    end_s = 0.0
    draw.t_s = 0.0
    while end_s < duration_s + 0.1:
        move = next(plan)
        moves.append(move)
        end_s += move.duration_s
    return ArmPath(first.to, moves, jitter, rng)
