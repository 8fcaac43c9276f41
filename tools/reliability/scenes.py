"""The second simulator: people before a camera, and what sensors make of them.

Written apart from `smoother.simulation`; `python -m tools.accuracy oracle` counts its unusual set-ups.

The person's frame {P} is a level camera's that the person faces: x to the person's right, y up, z away from
the camera, so forward is -z. Upper arm {U}: y shoulder to elbow, z the axis of flexion. Forearm {F}: origin
in the elbow, y elbow to wrist, and z the axis of flexion where the forearm is not turned. Everything here is
of a right arm.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import BSpline, make_interp_spline
from scipy.ndimage import gaussian_filter1d
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation, Slerp

from smoother.array_types import FloatArray
from smoother.linalg import interpolate, unit
from smoother.recording import JOINTS, CameraFrame, ImuStream, JointState, JointTracks, Recording

#: Directions in {P}.
RIGHT, UP, FORWARD = np.eye(3)[0], np.eye(3)[1], -np.eye(3)[2]
#: Occlusions, as (start, end) pairs, s of true time.
Gaps = tuple[tuple[float, float], ...]


class Bones(NamedTuple):
    """Lengths of a person, and the sensor on the forearm."""

    upper_arm: float  # m
    forearm: float  # m: elbow to wrist
    hand: float  # m: wrist to the hand's centre
    half_shoulders: float  # m: neck to shoulder
    imu_in_forearm: FloatArray  # (3,) m: in {F}
    R_F_A: FloatArray  # (3, 3): sensor axes to forearm axes


def draw_bones(rng: np.random.Generator) -> Bones:
    """A random adult, the strap put on at random."""
    size = rng.uniform(0.92, 1.10)
    forearm = size * rng.uniform(0.235, 0.265)
    around = rng.uniform(-0.5, 0.5) + (np.pi if rng.uniform() < 0.5 else 0.0)  # back of the wrist, or inside
    off_axis = rng.uniform(0.024, 0.040)
    place = np.array(
        [off_axis * np.cos(around), forearm - rng.uniform(0.02, 0.08), off_axis * np.sin(around)]
    )
    # The face points away from the bone; the case is turned on it in any way, and lies a little tilted.
    outward = unit(place * [1.0, 0.0, 1.0])
    face = np.stack([np.cross([0.0, 1.0, 0.0], outward), [0.0, 1.0, 0.0], outward], axis=1)
    turn = Rotation.from_euler("z", rng.uniform(0, 360), degrees=True)
    tilt = Rotation.from_rotvec(rng.normal(0, 5, 3), degrees=True)
    return Bones(
        upper_arm=size * rng.uniform(0.27, 0.31),
        forearm=forearm,
        hand=size * rng.uniform(0.07, 0.09),
        half_shoulders=size * rng.uniform(0.16, 0.19),
        imu_in_forearm=place,
        R_F_A=(Rotation.from_matrix(face) * turn * tilt).as_matrix(),
    )


class Posture(NamedTuple):
    """Where an arm is at a moment."""

    upper: Rotation  # `R_P_U`
    flexion: float  # rad: of the elbow
    pronation: float = 0.0  # rad
    wrist: float = 0.0  # rad: flexion
    trunk: FloatArray = np.zeros(3)  # (3,) m: its shift

    def numbers(self) -> FloatArray:
        """All but the upper arm's turn; the shoulder girdle rests but for what wanders."""
        return np.array([self.flexion, self.pronation, self.wrist, *self.trunk, 0.0, 0.0, 0.0])


def pointing(upper: ArrayLike, forearm: ArrayLike, **more: object) -> Posture:
    """The posture with the upper arm and the forearm along two directions of {P} (3,)."""
    u, f = unit(np.asarray(upper, float)), unit(np.asarray(forearm, float))
    axis = np.cross(u, f)
    size = np.linalg.norm(axis)
    if size < 0.02:
        axis = np.cross(u, FORWARD if abs(u @ FORWARD) < 0.9 else UP)
    axis = unit(axis)
    R_P_U = np.stack([np.cross(u, axis), u, axis], axis=1)
    return Posture(Rotation.from_matrix(R_P_U), float(np.arctan2(size, u @ f)), **more)  # type: ignore[arg-type]


def reaching(
    target: FloatArray,  # (3,) m
    bones: Bones,
    swivel_deg: float = 0.0,
    **more: object,
) -> Posture:
    """The posture whose wrist is at a place seen from the shoulder (3,), m in {P}: two links in their
    plane.
    """
    a, b, way = bones.upper_arm, bones.forearm, np.asarray(target, float)
    far = float(np.clip(np.linalg.norm(way), 1.05 * abs(a - b) + 0.05, 0.995 * (a + b)))
    along = unit(way)
    swivel = np.radians(swivel_deg)
    aside = np.cos(swivel) * unit(-UP - FORWARD) + np.sin(swivel) * RIGHT
    side = unit(aside - (aside @ along) * along)
    cosine = (a * a + far * far - b * b) / (2 * a * far)
    elbow = a * (cosine * along + np.sqrt(1.0 - cosine * cosine) * side)
    return pointing(elbow, far * along - elbow, **more)


#: Postures are blended on a grid this fine, smoothed this wide, and then read through quintic splines, Hz, s.
GRID_HZ, SMOOTH_S = 200.0, 0.05
#: Columns of the grid: quaternion x, y, z, w of `R_P_U`, angles, trunk's and girdle's shift.
_UPPER, _FLEXION, _PRONATION, _WRIST, _TRUNK, _GIRDLE = slice(0, 4), 4, 5, 6, slice(7, 10), slice(10, 13)


class Move(NamedTuple):
    """A movement to a posture in this many seconds; the same posture again is a pause."""

    duration_s: float
    to: Posture


def slow_noise(
    t_s: FloatArray, columns: int, sigma: float, tau_s: float, rng: np.random.Generator
) -> FloatArray:
    """(N, columns) smooth random curves of a standard deviation, with features as long as `tau_s`."""
    step_s = float(t_s[1] - t_s[0])
    width = max(tau_s / step_s / 2.0, 1.0)
    raw = gaussian_filter1d(rng.normal(size=(len(t_s), columns)), width, axis=0)
    return np.asarray(sigma * raw * np.sqrt(2.0 * width * np.sqrt(np.pi)))


def arm_path(
    start: Posture, moves: Sequence[Move], sway_m: float, wander_deg: float, rng: np.random.Generator
) -> BSpline:
    """The grid's columns over time: the moves, and what no two repetitions share, sway and wandering."""
    end_s = sum(move.duration_s for move in moves)
    t_s = np.arange(int(end_s * GRID_HZ) + 1) / GRID_HZ
    grid = np.empty((len(t_s), 13))
    begin_s, last = 0.0, start
    for move in moves:
        rows = (t_s >= begin_s - 1e-9) & (t_s <= begin_s + move.duration_s + 1e-9)
        x = np.clip((t_s[rows] - begin_s) / move.duration_s, 0.0, 1.0)
        share = np.clip(x**3 * (10 - 15 * x + 6 * x**2), 0.0, 1.0)  # least jerk
        both = Rotation.from_quat(np.stack([last.upper.as_quat(), move.to.upper.as_quat()]))
        grid[rows, _UPPER] = Slerp([0.0, 1.0], both)(share).as_quat()
        grid[rows, 4:] = last.numbers() + share[:, None] * (move.to.numbers() - last.numbers())
        begin_s, last = begin_s + move.duration_s, move.to
    grid[:, _UPPER] = _without_flips(grid[:, _UPPER])
    grid = gaussian_filter1d(grid, SMOOTH_S * GRID_HZ, axis=0, mode="nearest")
    wander = np.radians(wander_deg)
    turn = slow_noise(t_s, 3, wander, 1.2, rng)
    angles = slow_noise(t_s, 3, wander, 1.0, rng) * [1.0, 2.0, 2.0]
    grid[:, _TRUNK] += slow_noise(t_s, 3, sway_m, 1.5, rng)
    grid[:, _GIRDLE] += slow_noise(t_s, 3, 0.3 * sway_m, 0.8, rng)
    turned = Rotation.from_quat(grid[:, _UPPER]) * Rotation.from_rotvec(turn)
    grid[:, _UPPER] = _without_flips(turned.as_quat())
    # flexion never goes below zero: bent back smoothly from a degree or two on
    soft = np.radians(1.5)
    grid[:, _FLEXION] = soft * np.logaddexp(0.0, (grid[:, _FLEXION] + angles[:, 0]) / soft)
    grid[:, [_PRONATION, _WRIST]] += angles[:, 1:]
    return make_interp_spline(t_s, grid, k=5)


def _without_flips(quaternion: FloatArray) -> FloatArray:
    flip = np.where((quaternion[1:] * quaternion[:-1]).sum(axis=1) < 0, -1.0, 1.0)
    return np.concatenate([quaternion[:1], quaternion[1:] * np.cumprod(flip)[:, None]])


@dataclass(frozen=True)
class Motion:
    """A person before a camera."""

    bones: Bones
    path: BSpline  # Of the right arm
    wobble: BSpline  # rad: rotation vectors (N, 3) of the strap on the skin
    R_K_P: FloatArray  # (3, 3): the person's axes to the camera's
    person_K: FloatArray  # (3,) m: the neck at rest, in {K}

    @property
    def gravity(self) -> FloatArray:
        """(3,) m/s^2 in {K}."""
        return -9.81 * self.R_K_P @ UP

    def frames(self, t_s: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Shoulder (N, 3) m, `R_P_U` and `R_P_F` (N, 3, 3) in {P}, flexion of the wrist (N, 1)."""
        values = _inside(self.path, t_s)
        upper, values = Rotation.from_quat(values[:, _UPPER]), values[:, 4:]
        bend = Rotation.from_euler("ZY", values[:, :2])
        shoulder = np.array([self.bones.half_shoulders, 0.0, 0.0]) + values[:, 3:6] + values[:, 6:9]
        return shoulder, upper.as_matrix(), (upper * bend).as_matrix(), values[:, 2:3]

    def joints(self, t_s: FloatArray) -> dict[str, FloatArray]:
        """Joints (N, 3), m in {K}, by name."""
        shoulder, R_P_U, R_P_F, bend = self.frames(t_s)
        elbow = shoulder + self.bones.upper_arm * R_P_U[:, :, 1]
        wrist = elbow + self.bones.forearm * R_P_F[:, :, 1]
        hand = wrist + self.bones.hand * (np.cos(bend) * R_P_F[:, :, 1] + np.sin(bend) * R_P_F[:, :, 0])
        joints = {"shoulder": shoulder, "elbow": elbow, "wrist": wrist, "hand": hand}
        return {name: self._to_camera(place) for name, place in joints.items()}

    def imu_pose(self, t_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """`R_K_A` (N, 3, 3) and the sensor's place (N, 3), m in {K}."""
        shoulder, R_P_U, R_P_F, _ = self.frames(t_s)
        place = shoulder + self.bones.upper_arm * R_P_U[:, :, 1] + R_P_F @ self.bones.imu_in_forearm
        R_P_A = Rotation.from_matrix(R_P_F @ self.bones.R_F_A)
        R_P_A = (R_P_A * Rotation.from_rotvec(_inside(self.wobble, t_s))).as_matrix()
        return self.R_K_P @ R_P_A, self._to_camera(place)

    def _to_camera(self, place_P: FloatArray) -> FloatArray:
        return np.asarray(place_P @ self.R_K_P.T + self.person_K)


def _inside(spline: BSpline, t_s: FloatArray) -> FloatArray:
    return np.asarray(spline(np.clip(t_s, 0.0, spline.t[-1])))


# What people do: an exercise is a generator of moves, each repetition a little different from the last.


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
        yield draw.move(0.5, _lap(draw))
        x, y = draw.rng.uniform(-0.25, 0.25), draw.rng.uniform(-0.25, 0.25)
        target = draw.reach((x, y, -0.42), 35.0, pronation=draw.rng.uniform(-30, 60))
        trunk = np.array([0.0, -0.02, -0.08]) * draw.rng.uniform(0, 1)
        target = target._replace(trunk=trunk)
        yield draw.move(1.1, target)
        yield draw.move(0.4, target)
        yield draw.move(1.2, _lap(draw))


def drinking(draw: Draw) -> Moves:
    """A cup from the table to the mouth."""
    while True:
        cup = draw.reach((-0.10, -0.33, -0.36), 25.0, pronation=0.0)
        yield draw.move(1.1, cup)
        yield draw.move(0.5, cup)
        mouth = draw.reach((-0.15, 0.08, -0.22), 45.0, pronation=-35.0, wrist=15.0)
        yield draw.move(1.3, mouth)
        yield draw.move(0.7, mouth._replace(pronation=mouth.pronation - 0.4))
        yield draw.move(1.2, cup)
        yield draw.move(1.0, _lap(draw))


def combing(draw: Draw) -> Moves:
    """The hand to the back of the head, strokes, and down again."""
    while True:
        yield draw.move(0.4, _lap(draw))
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
        yield draw.move(0.4, _lap(draw))
        side = pointing(draw.near((0.45, -0.9, 0.1), 0.06), draw.near((0.2, -0.8, -0.2), 0.06))
        back = pointing(
            draw.near((0.35, -0.85, 0.4), 0.06), draw.near((-0.9, -0.1, 0.4), 0.08), pronation=np.radians(50)
        )
        yield draw.move(0.8, side)
        yield draw.move(1.0, back)
        yield draw.move(0.4, back)
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
        yield draw.move(0.5, reaching(centre, draw.bones, 25.0, pronation=np.radians(70)))


def lifting(draw: Draw) -> Moves:
    """A weight up to the front or to the side, the arm nearly straight, and down."""
    while True:
        down = pointing(draw.near((0.12, -1.0, -0.05), 0.03), draw.near((0.08, -1.0, -0.2), 0.04))
        yield draw.move(0.6, down)
        side = draw.rng.uniform(0, 1)
        way = draw.near((side, draw.rng.uniform(-0.2, 0.4), -(1 - side) - 0.1), 0.05)
        up = pointing(way, way + draw.near((0, 0.2, -0.1), 0.05), pronation=np.radians(draw.about(50, 15)))
        yield draw.move(1.6, up)
        yield draw.move(0.6, up)
        yield draw.move(1.7, down)


def pronating(draw: Draw) -> Moves:
    """The elbow at the side, the palm turned up and down."""
    while True:
        for pronation in (80.0, -60.0):
            at = pointing((0.1, -1.0, 0.0), draw.near((0.0, 0.05, -1.0), 0.08))
            yield draw.move(1.0, at._replace(pronation=np.radians(draw.about(pronation, 10))))
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
            yield draw.move(seconds, at._replace(trunk=np.array([0.0, 0.3 * lean, lean])))
        if draw.rng.uniform() < 0.12:
            yield draw.move(1.0, _lap(draw))


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
        yield draw.move(0.5, _lap(draw))
        far = draw.reach(
            (draw.rng.uniform(-0.2, 0.2), draw.rng.uniform(-0.3, 0.2), -0.44), 35.0, pronation=20.0
        )
        sideways, length = draw.rng.uniform(-0.25, 0.25), draw.rng.uniform(0.35, 0.6)
        trunk = np.array([sideways, -0.15 * length, -length])
        yield draw.move(0.62 / draw.pace, far._replace(trunk=trunk))
        yield draw.move(0.62 / draw.pace, _lap(draw))


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
            yield draw.move(0.55, pointing(u, f, trunk=at + up))
        yield draw.move(0.8, draw.reach((0.0, -0.05, -0.40), pronation=30.0)._replace(trunk=at))
        yield draw.move(0.8, pointing((0.12, -1.0, 0.0), (0.08, -1.0, -0.3), trunk=at))


#: Exercises by name; in the first ones the arm moves enough in all directions for most set-ups to matter.
EXERCISES: dict[str, Callable[[Draw], Moves]] = {
    each.__name__.replace("_", " "): each
    for each in (
        *(reaching_out, drinking, combing, behind_the_back, wiping, lifting, wheelchair, daily_life),
        *(in_one_plane, bending_forward, walking_about),
    )
}
LIVELY = tuple(EXERCISES)[:8]


def perform(name: str, duration_s: float, rng: np.random.Generator, gaps: Gaps) -> Motion:
    """A person who does an exercise before a camera."""
    body_rng, plan_rng, _, strap_rng, shake_rng, _ = rng.spawn(6)
    bones, pace = draw_bones(body_rng), body_rng.uniform(0.85, 1.25)
    sway_m, wander_deg = 0.004, 0.8
    if name != "in one plane":
        sway_m, wander_deg = body_rng.uniform(0.004, 0.010), body_rng.uniform(0.8, 2.5)
    # a camera on a stand or a shelf: tilted, to the person's side, 1.5 to 2.8 m away
    yaw, pitch, roll = body_rng.uniform(-25.0, 25.0), body_rng.uniform(-12, 6), body_rng.normal(0, 1.0)
    R_K_P = Rotation.from_euler("zxy", [roll, pitch, yaw], degrees=True).as_matrix()
    person_K = np.array([body_rng.uniform(*of) for of in ((-0.3, 0.3), (-0.1, 0.4), (1.5, 2.8))])
    draw = Draw(plan_rng, bones, pace, gaps)
    plan, moves, end_s = EXERCISES[name](draw), list[Move](), 0.0
    first, draw.t_s = next(plan), 0.0
    while end_s < duration_s + 0.1:
        moves.append(next(plan))
        end_s += moves[-1].duration_s
    path = arm_path(first.to, moves, sway_m, wander_deg, shake_rng)
    # a strap that turns to and fro on the skin by some degrees rms
    t_s = np.arange(0.0, duration_s + 0.5, 0.02)
    turns = slow_noise(t_s, 3, np.radians(body_rng.uniform(0.2, 2.0)), 0.5, strap_rng)
    return Motion(bones, path, make_interp_spline(t_s, turns, k=5), R_K_P, person_K)


#: Lowest rate at which the motion is sampled, and rates of IMUs, Hz.
FINE_HZ, IMU_RATES_HZ = 1000.0, (50.0, 60.0, 100.0, 120.0)
#: Of an ordinary IMU: density of the white noise, bias per axis, its walk per sqrt(s), full scale of 16 bits.
SENSORS = {"acc": (0.002, 0.05, 5e-4, 16 * 9.81), "gyro": (2e-4, 0.008, 5e-5, np.radians(2000.0))}
#: Scale and misalignment per axis, as fractions and rad.
SCALE, MISALIGNMENT = 0.002, 0.003


def ideal_imu(motion: Motion, duration_s: float, rate_hz: float) -> ImuStream:
    """Error-free samples: means over each sample's interval, stamped at its centre."""
    fine, count = int(np.ceil(FINE_HZ / rate_hz)), int(duration_s * rate_hz)
    h = 1.0 / (rate_hz * fine)
    edges = h * np.arange(count * fine + 1, dtype=np.float64)
    middles = edges[:-1] + 0.5 * h
    turns, R_K_A = Rotation.from_matrix(motion.imu_pose(edges)[0]), motion.imu_pose(middles)[0]
    rate = (turns[:-1].inv() * turns[1:]).as_rotvec() / h
    before, here, after = (motion.imu_pose(middles + k * 0.5 * h)[1] for k in (-1, 0, 1))
    acceleration = (after - 2 * here + before) / (0.5 * h) ** 2
    force = np.einsum("nji,nj->ni", R_K_A, acceleration - motion.gravity)
    acc, gyro = (values.reshape(count, fine, 3).mean(axis=1) for values in (force, rate))
    return ImuStream("simulated wrist", (np.arange(count, dtype=np.float64) + 0.5) / rate_hz, acc, gyro)


def worn_imu(motion: Motion, duration_s: float, rate_hz: float, rng: np.random.Generator) -> ImuStream:
    """An ordinary IMU on a wrist, better or worse by half."""
    quality, samples = rng.uniform(0.5, 1.5), {}
    ideal = ideal_imu(motion, duration_s, rate_hz)
    for name, (density, bias, walk, full) in SENSORS.items():
        true = getattr(ideal, name)
        matrix = np.eye(3) + np.diag(rng.normal(0, SCALE * quality, 3))
        matrix += np.tril(rng.normal(0, MISALIGNMENT, (3, 3)), -1)
        drift = rng.normal(0, bias * quality, 3)
        drift = drift + np.cumsum(rng.normal(0, walk / np.sqrt(ideal.rate_hz), true.shape), axis=0)
        values = true @ matrix.T + drift + rng.normal(0, density * np.sqrt(ideal.rate_hz), true.shape)
        step = full / 2**15
        samples[name] = np.clip(np.round(values / step) * step, -full, full)
    return replace(ideal, **samples)


class Tracker(NamedTuple):
    """How well a skeleton tracker sees."""

    white_m: float  # White noise, per axis
    slow_m: tuple[float, ...]  # Noise with a memory, 3D rms, by joint
    memory_s: float  # Of the slow noise
    offset_m: float  # Constant error of a joint, 3D, half of it fixed to the camera and half to the limb


#: Depth cameras and networks from good to poor, with how often each is drawn.
TRACKERS = {
    "good": (0.3, Tracker(0.003, (0.004, 0.005, 0.007, 0.010), 0.3, 0.006)),
    "ordinary": (0.5, Tracker(0.005, (0.008, 0.012, 0.018, 0.025), 0.5, 0.010)),
    "poor": (0.2, Tracker(0.006, (0.015, 0.022, 0.040, 0.050), 0.6, 0.015)),
}
#: Frames per second, and the part of them that never arrives.
FRAMES_HZ, DROPPED = 30.0, 0.01
#: How many joints the tracker knows, the first of their columns; the strap's column stays empty.
TRACKED = 4


def plan_gaps(duration_s: float, rng: np.random.Generator, every_s: float) -> Gaps:
    """When the arm will be hidden: one or more gaps of 0.5 to 4 s, at least 1.5 s of sight between them."""
    gaps: list[tuple[float, float]] = []
    t_s = rng.uniform(3.0, 6.0)
    while True:
        length_s = float(rng.choice([0.5, 1.0, 1.5, 2.0, 3.0, 4.0]))
        if t_s + length_s > duration_s - 2.5:
            break
        gaps.append((t_s, t_s + length_s))
        t_s += length_s + 1.5 + rng.exponential(every_s - 1.5)
    # a short recording has one all the same
    return tuple(gaps) or ((0.5 * duration_s - 0.6, 0.5 * duration_s + 0.6),)


def film(
    motion: Motion, tracker: Tracker, duration_s: float, gaps: Gaps, rng: np.random.Generator
) -> JointTracks:
    """What a tracker makes of a person who is hidden now and then, stamped by the true time."""
    times_rng, noise_rng, state_rng = rng.spawn(3)
    t_s = np.arange(times_rng.uniform(0, 1) / FRAMES_HZ, duration_s, 1.0 / FRAMES_HZ)
    t_s = t_s[times_rng.uniform(size=len(t_s)) >= DROPPED]
    position = np.full((len(t_s), len(JOINTS), 3), np.nan)
    for name, place in motion.joints(t_s).items():
        position[:, JOINTS.index(name)] = place
    hidden = np.zeros(len(t_s), dtype=bool)
    state = np.zeros((len(t_s), len(JOINTS)), dtype=np.int8)
    state[:, :TRACKED] = JointState.TRACKED
    for start_s, end_s in gaps:
        inside = (t_s >= start_s) & (t_s < end_s)
        hidden |= inside
        later = (t_s >= start_s + state_rng.uniform(0, 0.12)) & (t_s < end_s)
        state[inside, 2:4] = JointState.NOT_TRACKED
        state[later, 1] = JointState.NOT_TRACKED
    state[hidden & (state_rng.uniform(size=len(t_s)) < 0.05), 0] = JointState.NOT_TRACKED
    state[state_rng.uniform(size=len(t_s)) < 0.01, 3] = JointState.NOT_TRACKED  # hands are lost at any time
    return JointTracks("skeleton", t_s, position + tracker_error(motion, tracker, t_s, noise_rng), state)


def tracker_error(motion: Motion, tracker: Tracker, t_s: FloatArray, rng: np.random.Generator) -> FloatArray:
    """(F, 5, 3) m: white and slow noise, constant errors of the camera and of the limbs."""
    error = rng.normal(0, tracker.white_m, (len(t_s), len(JOINTS), 3))
    memory = np.exp(-1.0 / (FRAMES_HZ * tracker.memory_s))
    drive = rng.normal(size=(len(t_s), TRACKED, 3)) * np.sqrt(1 - memory**2)
    drive[0] /= np.sqrt(1 - memory**2)
    slow = lfilter([1.0], [1.0, -memory], drive, axis=0)
    error[:, :TRACKED] += slow * (np.array(tracker.slow_m) / np.sqrt(3))[:, None]
    joints = motion.joints(t_s)
    along = unit(joints["wrist"] - joints["elbow"])
    for column in range(TRACKED):
        error[:, column] += 0.6 * tracker.offset_m * unit(rng.normal(size=3))
        error[:, column] += 0.6 * tracker.offset_m * rng.normal() * along
    return np.asarray(error)


@dataclass(frozen=True)
class Scene:
    """What is smoothed, and what is known of it."""

    motion: Motion  # Whose skeleton it is
    recording: Recording  # As a user gives it; the IMU's clock is the true time
    gaps: Gaps  # When the arm is hidden, true time
    rng: np.random.Generator  # Of the case's draws
    # How the camera has turned at times (N,), from what it was at the start
    swayed: Callable[[FloatArray], Rotation] = lambda t_s: Rotation.identity(len(t_s))

    def imu_pose(self, t_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """`R_K_A` (N, 3, 3) and the sensor's place (N, 3), m, as the camera has them."""
        (R, place), turn = self.motion.imu_pose(t_s), self.swayed(t_s)
        return turn.as_matrix() @ R, turn.apply(place)

    def with_arm(self, **changes: object) -> Scene:
        """The scene with another skeleton."""
        arm = replace(self.recording.arm, **changes)  # type: ignore[arg-type]
        return replace(self, recording=replace(self.recording, arm=arm))


def draw_scene(exercise: str, duration_s: float, seed: int, every_s: float = 5.0) -> Scene:
    """A sound recording of an exercise, stamped by the camera's clock, 1 ms unevenly."""
    plan_rng, motion_rng, camera_rng, imu_rng, case_rng = np.random.default_rng([seed, 0]).spawn(5)
    shares = [share for share, _ in TRACKERS.values()]
    _, tracker = TRACKERS[str(plan_rng.choice(list(TRACKERS), p=shares))]
    gaps = plan_gaps(duration_s, plan_rng, every_s)
    motion = perform(exercise, duration_s, motion_rng, gaps)
    rate_hz = float(plan_rng.choice(IMU_RATES_HZ))
    arm = film(motion, tracker, duration_s, gaps, camera_rng)
    imu, offset_s = worn_imu(motion, duration_s, rate_hz, imu_rng), float(plan_rng.uniform(-0.12, 0.12))
    stamps = arm.t_s - offset_s + np.clip(plan_rng.normal(0, 0.001, len(arm)), -0.004, 0.004)
    unseen = arm.state[:, :, None] == JointState.NOT_TRACKED
    arm = replace(arm, t_s=stamps, position=np.where(unseen, np.nan, arm.position))
    recording = Recording(imu, arm, side="right", camera_frame=CameraFrame.KINECT, name=exercise)
    return Scene(motion, recording, gaps, case_rng)


# Unusual set-ups, each a function of a sound scene


def trial_cut_by_hand(scene: Scene) -> Scene:
    """A trial of 8 to 10 s, camera and IMU cut from their recordings by eye, up to 3 s apart."""
    shift_s = float(scene.rng.choice([-1.0, 1.0]) * scene.rng.uniform(1.0, 3.0))
    scene = scene.with_arm(t_s=scene.recording.arm.t_s - shift_s)
    return replace(scene, recording=replace(scene.recording, clocks_unrelated=True))


def shoulder_moves_fast(scene: Scene) -> Scene:
    """The trunk bends forward and back at 0.8 to 1.9 m/s, or walks."""
    return scene


def camera_sways(scene: Scene) -> Scene:
    """A camera that somebody holds: it turns by a degree or two to and fro."""
    arm = scene.recording.arm
    fine_s = np.arange(-5.0, arm.t_s[-1] + 5.0, 0.02)
    turns = slow_noise(fine_s, 3, np.radians(1.5), 1.5, scene.rng)

    def swayed(t_s: FloatArray) -> Rotation:
        return Rotation.from_rotvec(interpolate(fine_s, turns, t_s))

    position = np.einsum("fij,fnj->fni", swayed(arm.t_s).as_matrix(), arm.position)
    return replace(scene.with_arm(position=position), swayed=swayed)


#: Set-ups: what is done to a sound scene, exercises, shortest and longest, s, from a gap to the next one, s.
UNUSUAL: tuple[tuple[Callable[[Scene], Scene], tuple[str, ...], tuple[float, float], float], ...] = (
    (trial_cut_by_hand, LIVELY, (8.0, 10.0), 3.0),
    (shoulder_moves_fast, ("bending forward", "walking about"), (26.0, 45.0), 5.0),
    (camera_sways, LIVELY, (26.0, 45.0), 5.0),
)


def unusual_scenes(count: int, rng: np.random.Generator) -> Iterator[Callable[[], Scene]]:
    """As many set-ups, the cases in turn; the first do not depend on how many follow."""
    for number in range(count):
        _, exercises, lengths_s, _ = UNUSUAL[number % len(UNUSUAL)]
        exercise, duration_s = str(rng.choice(exercises)), round(float(rng.uniform(*lengths_s)), 1)
        yield partial(unusual, number % len(UNUSUAL), exercise, duration_s, int(rng.integers(2**31)))


def unusual(case: int, exercise: str, duration_s: float, seed: int) -> Scene:
    """One set-up."""
    change, _, _, every_s = UNUSUAL[case]
    return change(draw_scene(exercise, duration_s, seed, every_s))
