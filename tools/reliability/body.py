"""The body of the second simulator, and paths through its postures.

The person's frame {P} is a level camera's that the person faces: x to the person's right, y up, z away from
the camera, so forward is -z. Upper arm {U}: y shoulder to elbow, z the axis of flexion. Forearm {F}: origin
in the elbow, y elbow to wrist, and z the axis of flexion where the forearm is not turned. Everything here is
of a right arm; a left arm is its mirror image.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import make_interp_spline
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation, Slerp

from smoother.array_types import FloatArray
from smoother.linalg import unit

#: Directions in {P}.
RIGHT, UP, FORWARD = np.eye(3)[0], np.eye(3)[1], -np.eye(3)[2]


@dataclass(frozen=True)
class Bones:
    """Lengths of a person, and the sensor on the forearm."""

    upper_arm: float  # m: shoulder to elbow, elbow to wrist, wrist to the hand's centre, neck to shoulder
    forearm: float  # m: shoulder to elbow, elbow to wrist, wrist to the hand's centre, neck to shoulder
    hand: float  # m: shoulder to elbow, elbow to wrist, wrist to the hand's centre, neck to shoulder
    # m: Shoulder to elbow, elbow to wrist, wrist to the hand's centre, neck to shoulder
    half_shoulders: float
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


@dataclass(frozen=True)
class Posture:
    """Where an arm is at a moment."""

    upper: Rotation  # `R_P_U`
    flexion: float  # rad: of elbow, forearm, and of the wrist (flexion)
    pronation: float = 0.0  # rad: of elbow, forearm, and of the wrist (flexion)
    wrist: float = 0.0  # rad: of elbow, forearm, and of the wrist (flexion)
    trunk: FloatArray = (0.0, 0.0, 0.0)  # type: ignore[assignment]
    girdle: FloatArray = (0.0, 0.0, 0.0)  # type: ignore[assignment]


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


#: Postures are blended on a grid this fine, smoothed, and then read through quintic splines, Hz.
GRID_HZ = 200.0
#: Columns of the grid: quaternion x, y, z, w of `R_P_U`, angles, trunk's and girdle's shift.
_UPPER, _FLEXION, _PRONATION, _WRIST, _TRUNK, _GIRDLE = slice(0, 4), 4, 5, 6, slice(7, 10), slice(10, 13)


@dataclass(frozen=True)
class Move:
    """A movement to a posture in this many seconds, s; the same posture again is a pause."""

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


@dataclass(frozen=True)
class Jitter:
    """How a person differs from the plan."""

    sway_m: float = 0.006  # Slow sway of the trunk, per axis
    wander_deg: float = 1.5  # Slow wandering of the arm's angles
    smooth_s: float = 0.05  # Width of the smoothing over the moves


class ArmPath:
    """A right arm's postures over time, as splines."""

    def __init__(
        self, start: Posture, moves: Sequence[Move], jitter: Jitter, rng: np.random.Generator
    ) -> None:
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
            grid[rows, 4:] = _numbers(last) + share[:, None] * (_numbers(move.to) - _numbers(last))
            begin_s, last = begin_s + move.duration_s, move.to
        flip = np.where((grid[1:, _UPPER] * grid[:-1, _UPPER]).sum(axis=1) < 0, -1.0, 1.0)
        grid[1:, _UPPER] *= np.cumprod(flip)[:, None]
        grid = gaussian_filter1d(grid, jitter.smooth_s * GRID_HZ, axis=0, mode="nearest")
        _wander(grid, t_s, jitter, rng)
        self.t_s, self._grid = t_s, grid
        self._spline = make_interp_spline(t_s, grid, k=5)

    @property
    def duration_s(self) -> float:
        """Where the path ends, s."""
        return float(self.t_s[-1])

    def at(self, t_s: FloatArray) -> tuple[Rotation, FloatArray]:
        """`R_P_U`, and the further columns (N, 9), at times (N,)."""
        values = self._spline(np.clip(t_s, 0.0, self.duration_s))
        return Rotation.from_quat(values[:, _UPPER]), values[:, 4:]


def _numbers(posture: Posture) -> FloatArray:
    return np.array([posture.flexion, posture.pronation, posture.wrist, *posture.trunk, *posture.girdle])


def _wander(grid: FloatArray, t_s: FloatArray, jitter: Jitter, rng: np.random.Generator) -> None:
    """Add what no two repetitions share: sway and wandering angles."""
    wander, sway = np.radians(jitter.wander_deg), jitter.sway_m
    turn = slow_noise(t_s, 3, wander, 1.2, rng)
    angles = slow_noise(t_s, 3, wander, 1.0, rng) * [1.0, 2.0, 2.0]
    grid[:, _TRUNK] += slow_noise(t_s, 3, sway, 1.5, rng)
    grid[:, _GIRDLE] += slow_noise(t_s, 3, 0.3 * sway, 0.8, rng)
    upper = Rotation.from_quat(grid[:, _UPPER]) * Rotation.from_rotvec(turn)
    quaternion = upper.as_quat()
    flip = np.where((quaternion[1:] * quaternion[:-1]).sum(axis=1) < 0, -1.0, 1.0)
    quaternion[1:] *= np.cumprod(flip)[:, None]
    grid[:, _UPPER] = quaternion
    grid[:, _FLEXION] = _bounded(grid[:, _FLEXION] + angles[:, 0])
    grid[:, _PRONATION] += angles[:, 1]
    grid[:, _WRIST] += angles[:, 2]


def _bounded(flexion: FloatArray) -> FloatArray:
    """Flexion that never goes below zero: bent back smoothly from a degree or two on."""
    soft = np.radians(1.5)
    return np.asarray(soft * np.logaddexp(0.0, flexion / soft))


@dataclass(frozen=True)
class Camera:
    """Where the camera stands."""

    R_K_P: FloatArray  # (3, 3): the person's axes to the camera's
    person_K: FloatArray  # (3,) m: the neck at rest, in {K}

    @property
    def gravity(self) -> FloatArray:
        """(3,) m/s^2 in {K}."""
        return -9.81 * self.R_K_P @ UP


def draw_camera(rng: np.random.Generator) -> Camera:
    """A camera on a stand or a shelf: tilted, to the person's side, 1.5 to 2.8 m away."""
    yaw, pitch, roll = rng.uniform(-25.0, 25.0), rng.uniform(-12, 6), rng.normal(0, 1.0)
    R_K_P = Rotation.from_euler("zxy", [roll, pitch, yaw], degrees=True).as_matrix()
    return Camera(R_K_P, np.array([rng.uniform(-0.3, 0.3), rng.uniform(-0.1, 0.4), rng.uniform(1.5, 2.8)]))


@dataclass(frozen=True)
class Motion:
    """A person before a camera."""

    bones: Bones  # Of the person
    path: ArmPath  # Of the right arm
    camera: Camera  # Who looks
    wobble: Callable[[FloatArray], FloatArray]  # Times (N,) to rotation vectors (N, 3), rad

    def frames(self, t_s: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Shoulder (N, 3) m, `R_P_U` and `R_P_F` (N, 3, 3) in {P}."""
        upper, values = self.path.at(t_s)
        bend = Rotation.from_euler("ZY", values[:, :2])
        shoulder = np.array([self.bones.half_shoulders, 0.0, 0.0]) + values[:, 3:6] + values[:, 6:9]
        return shoulder, upper.as_matrix(), (upper * bend).as_matrix()

    def joints(self, t_s: FloatArray) -> dict[str, FloatArray]:
        """Joints (N, 3), m in {K}, by name."""
        shoulder, R_P_U, R_P_F = self.frames(t_s)
        elbow = shoulder + self.bones.upper_arm * R_P_U[:, :, 1]
        wrist = elbow + self.bones.forearm * R_P_F[:, :, 1]
        bend = self.path.at(t_s)[1][:, 2:3]
        hand = wrist + self.bones.hand * (np.cos(bend) * R_P_F[:, :, 1] + np.sin(bend) * R_P_F[:, :, 0])
        joints = {"shoulder": shoulder, "elbow": elbow, "wrist": wrist, "hand": hand}
        return {name: self._to_camera(place) for name, place in joints.items()}

    def imu_pose(self, t_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """`R_K_A` (N, 3, 3) and the sensor's place (N, 3), m in {K}."""
        shoulder, R_P_U, R_P_F = self.frames(t_s)
        place = shoulder + self.bones.upper_arm * R_P_U[:, :, 1] + R_P_F @ self.bones.imu_in_forearm
        R_P_A = R_P_F @ self.bones.R_F_A
        R_P_A = (Rotation.from_matrix(R_P_A) * Rotation.from_rotvec(self.wobble(t_s))).as_matrix()
        return self.camera.R_K_P @ R_P_A, self._to_camera(place)

    def _to_camera(self, place_P: FloatArray) -> FloatArray:
        return np.asarray(place_P @ self.camera.R_K_P.T + self.camera.person_K)


def draw_wobble(
    duration_s: float, deg: float, rng: np.random.Generator
) -> Callable[[FloatArray], FloatArray]:
    """A strap that turns to and fro on the skin by this many degrees rms."""
    t_s = np.arange(0.0, duration_s + 0.5, 0.02)
    spline = make_interp_spline(t_s, slow_noise(t_s, 3, np.radians(deg), 0.5, rng), k=5)
    return lambda t: np.asarray(spline(np.clip(t, 0.0, t_s[-1])))
