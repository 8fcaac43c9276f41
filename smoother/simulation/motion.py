"""The person and what they do: measures, postures, joint angles over time, and the arm's motion in {K}.

Torso frame `{T}` of a person who faces the camera: x to the person's right, y up, z to the back (the axes of
a level Kinect). Upper-arm frame `{U}`: y shoulder to elbow, z the axis of elbow flexion. Forearm frame
`{F}`: y elbow to wrist, x to the back of the hand, origin in the arm's core under the strap.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation

from ..array_types import BoolArray, FloatArray
from ..recording import CameraFrame
from ..units import GRAVITY
from .config import ArmSimulation

#: Columns of a posture: girdle shift (3, m in {T}), shoulder rotation vector (3, rad), flexion, pronation.
GIRDLE, SHOULDER, FLEXION, PRONATION = slice(0, 3), slice(3, 6), 6, 7
POSTURE_SIZE = 8


@dataclass(frozen=True)
class BodyMeasures:
    """One person's arm and how the IMU sits on it."""

    upper_arm: float  # m: shoulder to elbow
    forearm: float  # m: elbow to wrist
    hand: float  # m: wrist to the hand's centre
    strap_to_wrist: float  # m: along the forearm
    imu_in_forearm: FloatArray  # (3,) m: the IMU in {F}
    R_F_A: FloatArray  # (3, 3): IMU axes to forearm axes
    shoulder: FloatArray  # (3,) m: right shoulder in {T} at rest

    @property
    def along_forearm(self) -> dict[str, float]:
        """Joints on the forearm's axis, m along y of {F}."""
        wrist = self.strap_to_wrist
        return {"elbow": wrist - self.forearm, "wrist": wrist, "hand": wrist + self.hand}

    def lever_arm(self, joint: str) -> FloatArray:
        """(3,) the joint in the IMU's axes {A}, m, for a strap that sits as it was put on."""
        in_forearm = np.array([0.0, self.along_forearm[joint], 0.0])
        return self.R_F_A.T @ (in_forearm - self.imu_in_forearm)


def draw_measures(rng: np.random.Generator) -> BodyMeasures:
    """A random adult and a random way to put on the strap."""
    upper_arm = rng.uniform(0.26, 0.34)
    forearm = rng.uniform(0.23, 0.28)
    # The IMU is on the back of the wrist: rolled round the arm, turned on its face, a little tilted.
    roll = Rotation.from_euler("y", rng.normal(0, 15), degrees=True)
    face = Rotation.from_matrix([[0, 0, 1], [1, 0, 0], [0, 1, 0]])  # z of {A} along x of {F}
    turn = Rotation.from_euler("z", rng.uniform(-180, 180), degrees=True)
    tilt = Rotation.from_rotvec(rng.normal(0, 4, 3), degrees=True)
    return BodyMeasures(
        upper_arm=upper_arm,
        forearm=forearm,
        hand=rng.uniform(0.07, 0.09),
        strap_to_wrist=rng.uniform(0.03, 0.07),
        imu_in_forearm=roll.apply([rng.uniform(0.028, 0.042), 0.0, 0.0]),
        R_F_A=(roll * face * turn * tilt).as_matrix(),
        shoulder=np.array([rng.uniform(0.17, 0.20), 0.0, 0.0]),
    )


def arm_chain(
    posture: FloatArray,
    reference: Rotation,
    measures: BodyMeasures,  # posture (N, 8)
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Shoulder and elbow (N, 3) and the forearm's rotation `R_T_F` (N, 3, 3) of a right arm."""
    R_T_U = (reference * Rotation.from_rotvec(posture[:, SHOULDER])).as_matrix()
    shoulder = measures.shoulder + posture[:, GIRDLE]
    elbow = shoulder + measures.upper_arm * R_T_U[:, :, 1]
    bend = Rotation.from_euler("ZY", posture[:, [FLEXION, PRONATION]] * [1.0, -1.0]).as_matrix()
    return shoulder, elbow, R_T_U @ bend


@dataclass(frozen=True)
class Ellipsoid:
    """A part of the body that hides what is behind it."""

    centre: tuple[float, float, float]  # m: in {T}
    half_axes: tuple[float, float, float]  # m: in {T}

    def hides(self, points: FloatArray, eye: FloatArray) -> BoolArray:
        """(N,) True where the line from `eye` (N, 3) to the point (N, 3) meets this part, m in {T}."""
        start = (eye - self.centre) / self.half_axes
        ray = (points - self.centre) / self.half_axes - start
        along = np.clip(-(start * ray).sum(axis=1) / (ray**2).sum(axis=1), 0.0, 1.0)
        nearest = start + along[:, None] * ray
        return np.asarray((nearest**2).sum(axis=1) < 1.0)


#: Head, neck with the shoulders' slope, and trunk of the simulated person.
BODY = (
    Ellipsoid((0.0, 0.26, -0.02), (0.095, 0.14, 0.10)),
    Ellipsoid((0.0, 0.10, 0.0), (0.11, 0.14, 0.08)),
    Ellipsoid((0.0, -0.27, 0.0), (0.17, 0.36, 0.12)),
)


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


def _behind(repetitions: int, speed: float, rng: np.random.Generator) -> list[PlannedMovement]:
    """The clinical protocol: held pose, behind the head and back, belly, behind the back and back."""
    movements = []
    tempo = speed * rng.uniform(0.9, 1.25)  # some people are brisk
    for names, seconds, hold_s in repetitions * (
        ("beside_head behind_head", 1.3, 0.15),
        ("on_nape", 0.6, 0.15),
        ("beside_head initial", 1.3, 1.6),
        ("belly", 1.3, 1.6),
        ("side behind_back", 1.6, 0.1),
        ("up_the_back", 0.6, 0.1),
        ("side initial", 1.7, 2.0),
    ):
        # each posture is a little different from its name
        points = np.array([posture(name) for name in names.split()])
        points += _SPREAD * rng.normal(size=points.shape)
        length_s = seconds * rng.uniform(0.9, 1.15) / tempo
        movements.append(PlannedMovement(points, length_s, hold_s * rng.uniform(0.8, 1.3)))
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

    duration = config.duration_s
    if config.protocol == "behind":
        duration = float(np.cumsum([m.length_s for m in movements])[-1])
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
    return Performance(duration, t_s, angles, sway)


#: What the trunk turns about, between the hips, m in {T}.
HIPS = np.array([0.0, -0.45, 0.0])
#: How the turning is shared by leaning forwards, turning about the vertical and leaning sideways.
SHARES = np.sqrt([0.25, 0.6, 0.15])


class TrunkTurn:
    """How the trunk turns about the hips over time."""

    def __init__(self, performance: Performance, rms_deg: float, rng: np.random.Generator) -> None:
        self._spline: BSpline | None = None
        if rms_deg > 0.0:
            turn = np.radians(rms_deg) * SHARES * band_noise(performance.t_s, 0.05, 0.3, 3, rng)
            self._spline = make_interp_spline(performance.t_s, turn, k=5)

    @property
    def is_still(self) -> bool:
        """The trunk never turns."""
        return self._spline is None

    def at(self, t_s: FloatArray) -> FloatArray:
        """The trunk as it is turned against the upright one, (N, 3, 3)."""
        if self._spline is None:
            return np.tile(np.eye(3), (len(t_s), 1, 1))
        return np.asarray(Rotation.from_rotvec(self._spline(t_s)).as_matrix())

    def moved(self, points_T: FloatArray, t_s: FloatArray, way: str = "nij,nj->ni") -> FloatArray:
        """Points (N, 3) of the upright trunk, m in {T}, where its turning takes them."""
        if self._spline is None:
            return points_T
        return HIPS + np.einsum(way, self.at(t_s), points_T - HIPS)

    def back(self, points_T: FloatArray, t_s: FloatArray) -> FloatArray:
        """The other way round: points (N, 3) of the turned trunk as the upright one has them."""
        return self.moved(points_T, t_s, "nji,nj->ni")


#: Axes of a level Kinect to those of other level cameras.
LEVEL_FROM_KINECT = {
    CameraFrame.KINECT: np.eye(3),
    CameraFrame.OPTICAL: np.diag([-1.0, -1.0, 1.0]),
    CameraFrame.ZUP: np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]),
}


def optical_axes(frame: CameraFrame) -> FloatArray:
    """`R_K_C` (3, 3): optical axes (x right, y down, z forward) to the axes of a recording's camera frame."""
    return np.asarray(LEVEL_FROM_KINECT[frame] @ LEVEL_FROM_KINECT[CameraFrame.OPTICAL].T)


@dataclass(frozen=True)
class Stage:
    """Where the person stands before the camera."""

    R_K_T: FloatArray  # (3, 3): torso axes to camera axes
    origin_K: FloatArray  # (3,) m: origin of {T} (between the shoulders) in {K}

    @property
    def gravity(self) -> FloatArray:
        """(3,) m/s^2 in {K}; the torso is upright."""
        return np.asarray(self.R_K_T @ [0.0, -GRAVITY, 0.0])


def tilt_rotation(degrees: float, heading: float, up: FloatArray) -> Rotation:
    """A rotation by `degrees` about a level axis; `up` (3,) is a unit axis, `heading` rad turns about it."""
    level = np.roll(up, 1)
    axis = Rotation.from_rotvec(heading * up).apply(level)
    return Rotation.from_rotvec(np.radians(degrees) * axis)


def draw_stage(distance_m: float, frame: CameraFrame, rng: np.random.Generator) -> Stage:
    """A camera tilted by 3 to 10 degrees, and a person about `distance_m` before it who faces it."""
    up = np.array([0.0, 1.0, 0.0])
    tilt = tilt_rotation(rng.uniform(3, 10), rng.uniform(-np.pi, np.pi), up)
    turn = Rotation.from_euler("y", rng.normal(0, 4), degrees=True)
    origin = [rng.normal(0, 0.08), rng.uniform(0.1, 0.35), distance_m * rng.uniform(0.95, 1.05)]
    to_frame = LEVEL_FROM_KINECT[frame]
    return Stage(to_frame @ (tilt * turn).as_matrix(), to_frame @ origin)


def draw_wobble(performance: Performance, rms_deg: float, rng: np.random.Generator) -> FloatArray:
    """Rotation vectors (N, 3), rad in {F}, of a strap that slides as the arm moves; the mean is zero."""
    drive = performance.posture[:, [SHOULDER.start, SHOULDER.start + 1, FLEXION, PRONATION]]
    spread = drive.std(axis=0)
    moving = spread > 1e-6
    if rms_deg == 0.0 or not moving.any():
        return np.zeros((len(drive), 3))
    drive = (drive[:, moving] - drive[:, moving].mean(axis=0)) / spread[moving]
    drive = gaussian_filter1d(drive, 0.2 * KNOT_RATE_HZ, axis=0, mode="nearest")
    delay = int(0.2 * KNOT_RATE_HZ)
    drive = np.concatenate([np.repeat(drive[:1], delay, axis=0), drive[:-delay]])
    wobble = drive @ rng.normal(size=(drive.shape[1], 3))
    wobble /= wobble.std(axis=0)
    wobble = 0.8 * wobble + 0.6 * band_noise(performance.t_s, 0.1, 0.5, 3, rng)
    wobble -= wobble.mean(axis=0)
    wobble *= np.sqrt([0.2, 0.6, 0.2]) / wobble.std(axis=0)
    return np.radians(rms_deg) * wobble


def wrist_angles(performance: Performance, rms_deg: float, rng: np.random.Generator) -> FloatArray:
    """The wrist's flexion and deviation to the thumb (N, 2), rad; zero where it is held straight."""
    if rms_deg == 0.0:
        return np.zeros((len(performance.t_s), 2))
    angles = band_noise(performance.t_s, 0.1, 0.8, 2, rng)
    return np.asarray(np.radians(rms_deg) * angles * [1.0, 1.0 / 3.0])


@dataclass(frozen=True, eq=False)
class ArmMotion:
    """An arm that performs a protocol before the camera, at any time (and 0.4 s beyond its ends)."""

    performance: Performance
    measures: BodyMeasures
    stage: Stage
    wobble: FloatArray  # Of the strap, see `draw_wobble`
    side: str
    trunk: TrunkTurn
    wrist: FloatArray | None = None  # The wrist's angles; None where it is held straight

    @cached_property
    def _spline(self) -> BSpline:
        table = np.hstack([self.performance.posture, self.performance.sway, self.wobble])
        return make_interp_spline(self.performance.t_s, table, k=5)

    @cached_property
    def _wrist(self) -> BSpline | None:
        bends = self.wrist is not None and bool(self.wrist.any())
        return make_interp_spline(self.performance.t_s, self.wrist, k=5) if bends else None

    @property
    def _mirror(self) -> FloatArray:
        """A left arm is the mirror image of a right one."""
        return np.diag([-1.0 if self.side == "left" else 1.0, 1.0, 1.0])

    @property
    def _flip(self) -> FloatArray:
        """The z axis of a left arm's {F} is mirrored twice (x cross y)."""
        return np.diag([1.0, 1.0, -1.0 if self.side == "left" else 1.0])

    def upper_arm(self, t_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The bone of the upper arm: elbow (N, 3) m in {K}, and `R_K_U` (N, 3, 3) (see `body`)."""
        table = self._spline(t_s)
        _, elbow, _, _ = self._chain(t_s)
        R_T_U = (reference() * Rotation.from_rotvec(table[:, SHOULDER])).as_matrix()
        return self._to_camera(elbow, t_s), self._trunk(t_s) @ self._mirror @ R_T_U @ self._flip

    def hand(self, t_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The hand: wrist (N, 3) m in {K}, and `R_K_H` (N, 3, 3), {H} as {F} where the wrist is straight."""
        _, elbow, R_T_F, _ = self._chain(t_s)
        wrist = elbow + self.measures.forearm * R_T_F[:, :, 1]
        return self._to_camera(wrist, t_s), self._trunk(t_s) @ R_T_F @ self._bend(t_s)

    def _bend(self, t_s: FloatArray) -> FloatArray:
        """`R_F_H` (N, 3, 3): flexion takes the hand to the palm (-x of {F}), deviation to the thumb."""
        if self._wrist is None:
            return np.tile(np.eye(3), (len(t_s), 1, 1))
        flexion, deviation = self._wrist(t_s).T
        thumb = self._flip[2, 2]  # z of {F} points to the thumb's side of a right arm
        turned = Rotation.from_euler("ZX", np.stack([flexion, thumb * deviation], axis=1))
        return np.asarray(turned.as_matrix())

    def _chain(self, t_s: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Shoulder, elbow (N, 3) and `R_T_F` (N, 3, 3) in {T}, and the strap's rotation vector (N, 3)."""
        table = self._spline(t_s)
        sway = table[:, POSTURE_SIZE : POSTURE_SIZE + 3]
        shoulder, elbow, R_T_F = arm_chain(table[:, :POSTURE_SIZE], reference(), self.measures)
        mirror = self._mirror
        return (
            (shoulder + sway) @ mirror,
            (elbow + sway) @ mirror,
            mirror @ R_T_F @ self._flip,
            table[:, POSTURE_SIZE + 3 :],
        )

    def _to_camera(self, points_T: FloatArray, t_s: FloatArray) -> FloatArray:
        moved = self.trunk.moved(points_T, t_s)
        return np.asarray(moved @ self.stage.R_K_T.T + self.stage.origin_K)

    def _trunk(self, t_s: FloatArray) -> FloatArray:
        """`R_K_T` of the trunk as it is turned: (3, 3) of one that stands still, else (N, 3, 3)."""
        return self.stage.R_K_T if self.trunk.is_still else self.stage.R_K_T @ self.trunk.at(t_s)

    def imu_pose(self, t_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """`R_K_A` (N, 3, 3) and the IMU's position (N, 3) m in {K}."""
        _, elbow, R_T_F, wobble = self._chain(t_s)
        strap = Rotation.from_rotvec(wobble).as_matrix()
        # The strap turns about the arm's core: the sensor moves with it.
        in_forearm = strap @ self.measures.imu_in_forearm
        in_forearm[:, 1] -= self.measures.along_forearm["elbow"]
        position = elbow + np.einsum("nij,nj->ni", R_T_F, in_forearm)
        R_K_A = self._trunk(t_s) @ R_T_F @ strap @ self.measures.R_F_A
        return R_K_A, self._to_camera(position, t_s)

    def joints(self, t_s: FloatArray) -> dict[str, FloatArray]:
        """Positions (N, 3) by joint, m in {K}."""
        shoulder, elbow, R_T_F, _ = self._chain(t_s)
        along, direction = self.measures.along_forearm, R_T_F[:, :, 1]
        positions = {"shoulder": shoulder, "elbow": elbow}
        positions["wrist"] = elbow + (along["wrist"] - along["elbow"]) * direction
        if self._wrist is None:
            positions["hand"] = elbow + (along["hand"] - along["elbow"]) * direction
        else:
            fingers = (R_T_F @ self._bend(t_s))[:, :, 1]
            positions["hand"] = positions["wrist"] + self.measures.hand * fingers
        return {joint: self._to_camera(position, t_s) for joint, position in positions.items()}

    def bone_axes(self, t_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Elbow's flexion axis, from the medial to the lateral epicondyle, (N, 3), and `R_K_F` (N, 3, 3)."""
        _, _, R_T_F, _ = self._chain(t_s)
        # Undo the pronation: what is left turns about the flexion axis only, z of {U}.
        turn = np.asarray(self._spline(t_s)[:, PRONATION])
        axis_F = np.stack([np.sin(turn), np.zeros_like(turn), np.cos(turn)], axis=1) @ self._flip
        lateral = np.einsum("nij,nj->ni", R_T_F, axis_F)
        R_K_T = self._trunk(t_s)
        return (R_K_T @ lateral[:, :, None])[:, :, 0], np.asarray(R_K_T @ R_T_F)

    def other_arm(self, t_s: FloatArray) -> dict[str, FloatArray]:
        """The joints of the other arm, which hangs and sways with the trunk: (N, 3) by joint, m in {K}."""
        sway = self._spline(t_s)[:, POSTURE_SIZE : POSTURE_SIZE + 3] @ self._mirror
        rest = self.measures.shoulder * [-1.0, 1.0, 1.0] @ self._mirror
        down = np.array([0.0, -1.0, 0.0])
        reach = {
            "shoulder": 0.0,
            "elbow": self.measures.upper_arm,
            "wrist": self.measures.upper_arm + self.measures.forearm,
            "hand": self.measures.upper_arm + self.measures.forearm + self.measures.hand,
        }
        return {joint: self._to_camera(rest + sway + length * down, t_s) for joint, length in reach.items()}

    def hidden(self, t_s: FloatArray) -> BoolArray:
        """(N,) True where the body stands between the camera and the wrist or the hand."""
        # The body sways with the shoulder.
        sway = self._spline(t_s)[:, POSTURE_SIZE : POSTURE_SIZE + 3] @ self._mirror
        R_T_K = self.stage.R_K_T.T
        camera = np.tile(-R_T_K @ self.stage.origin_K, (len(t_s), 1))
        eye = self.trunk.back(camera, t_s) - sway
        joints = self.joints(t_s)
        hidden = np.zeros(len(t_s), dtype=bool)
        for joint in ("wrist", "hand"):
            position_T = self.trunk.back((joints[joint] - self.stage.origin_K) @ R_T_K.T, t_s) - sway
            for part in BODY:
                hidden |= part.hides(position_T, eye)
        return hidden
