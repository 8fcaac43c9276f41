"""A person for the second simulator: bones, postures, and how the sensor sits on the wrist.

The person's frame {P} is a level camera's that the person faces: x to the person's right, y up, z away from
the camera, so forward is -z. Upper arm {U}: y shoulder to elbow, z the axis of flexion. Forearm {F}: origin
in the elbow, y elbow to wrist, and z the axis of flexion where the forearm is not turned. Everything here is
of a right arm; a left arm is its mirror image.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from smoother.array_types import FloatArray
from smoother.linalg import unit

#: Directions in {P}.
RIGHT, UP, FORWARD = np.eye(3)[0], np.eye(3)[1], -np.eye(3)[2]


@dataclass(frozen=True)
class Bones:
    """Lengths of a person, and the sensor on the forearm.

    Attributes
    ----------
    upper_arm, forearm, hand, half_shoulders : float, m
        Shoulder to elbow, elbow to wrist, wrist to the hand's centre, neck to shoulder.
    imu_in_forearm : ndarray, shape (3,), m
        In {F}.
    R_F_A : ndarray, shape (3, 3)
        Sensor axes to forearm axes.
    """

    upper_arm: float
    forearm: float
    hand: float
    half_shoulders: float
    imu_in_forearm: FloatArray
    R_F_A: FloatArray


def draw_bones(rng: np.random.Generator, *, small: bool = False) -> Bones:
    """A random adult (or a child of about eight years), the strap put on at random."""
    size = rng.uniform(0.72, 0.80) if small else rng.uniform(0.92, 1.10)
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
    """Where an arm is at a moment.

    Attributes
    ----------
    upper : Rotation
        `R_P_U`.
    flexion, pronation, wrist : float, rad
        Of elbow, forearm, and of the wrist (flexion).
    trunk : ndarray, shape (3,), m
        Shift of the whole trunk in {P}.
    girdle : ndarray, shape (3,), m
        Shift of the shoulder on the trunk in {P}.
    """

    upper: Rotation
    flexion: float
    pronation: float = 0.0
    wrist: float = 0.0
    trunk: FloatArray = (0.0, 0.0, 0.0)  # type: ignore[assignment]
    girdle: FloatArray = (0.0, 0.0, 0.0)  # type: ignore[assignment]


def pointing(upper: ArrayLike, forearm: ArrayLike, **more: object) -> Posture:
    """The posture with the upper arm and the forearm along two directions of {P} (3,).

    With the arm straight, where its plane is open, the elbow points outward and down.
    """
    u, f = unit(np.asarray(upper, float)), unit(np.asarray(forearm, float))
    axis = np.cross(u, f)
    size = np.linalg.norm(axis)
    if size < 0.02:
        axis = np.cross(u, FORWARD if abs(u @ FORWARD) < 0.9 else UP)
    axis = unit(axis)
    R_P_U = np.stack([np.cross(u, axis), u, axis], axis=1)
    return Posture(Rotation.from_matrix(R_P_U), float(np.arctan2(size, u @ f)), **more)  # type: ignore[arg-type]


def reaching(target: FloatArray, bones: Bones, swivel_deg: float = 0.0, **more: object) -> Posture:
    """The posture whose wrist is at a place seen from the shoulder (3,), m in {P}: two links in their plane.

    Parameters
    ----------
    target : ndarray, shape (3,), m
        In {P}; farther than the arm reaches, the arm is nearly straight.
    bones : Bones
        Whose arm.
    swivel_deg : float, degrees
        Where the elbow points: 0 down and back, 90 outward.
    more
        Further fields of the posture.
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
