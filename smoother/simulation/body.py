"""The person: measures, the chain shoulder-elbow-wrist-hand, and what hides the arm from the camera.

Torso frame `{T}` of a person who faces the camera: x to the person's right, y up, z to the back (the axes of
a level Kinect). Upper-arm frame `{U}`: y shoulder to elbow, z the axis of elbow flexion. Forearm frame
`{F}`: y elbow to wrist, x to the back of the hand, origin in the arm's core under the strap.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from ..array_types import BoolArray, FloatArray

#: Columns of a posture: girdle shift (3, m in {T}), shoulder rotation vector (3, rad), flexion, pronation.
GIRDLE, SHOULDER, FLEXION, PRONATION = slice(0, 3), slice(3, 6), 6, 7
POSTURE_SIZE = 8


@dataclass(frozen=True)
class BodyMeasures:
    """One person's arm and how the IMU sits on it."""

    upper_arm: float  # m: shoulder to elbow, elbow to wrist, wrist to the hand's centre
    forearm: float  # m: shoulder to elbow, elbow to wrist, wrist to the hand's centre
    hand: float  # m: shoulder to elbow, elbow to wrist, wrist to the hand's centre
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
