"""What a recording is made of: an IMU's samples, a camera's joints and its place, reference motion."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from enum import IntEnum, StrEnum
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ..array_types import BoolArray, CameraNumbers, FloatArray, IntArray
from ..linalg import median_rate_hz, rows_of

#: Joints of one arm, in the order of every joint axis. `strap` is the IMU's own position.
JOINTS = ("shoulder", "elbow", "wrist", "hand", "strap")
#: The joints that ride on the forearm's rigid body.
FOREARM_JOINTS = ("elbow", "wrist", "hand", "strap")
#: Standard error of a focal length as a part of it: where a calibration states it, and where a data sheet, a
#: field of view or a hand-written file does (lenses of a model vary by some percent).
FOCAL_CALIBRATED, FOCAL_DATA_SHEET = 0.01, 0.05


class JointState(IntEnum):
    """The camera's tracking state of a joint in a frame (Kinect SDK's three tracking states)."""

    NOT_TRACKED = 0
    INFERRED = 1
    TRACKED = 2


@dataclass(frozen=True)
class JointTracks:
    """The joints of one arm as the camera saw them, on the camera's clock.

    Attributes
    ----------
    name : str
        Where it came from (a topic, a file).
    t_s : ndarray, shape (F,), s
        Frame times after the recording's origin.
    position : ndarray, shape (F, 5, 3), m
        In {K}, joints in the order of `JOINTS`; nan where there is none.
    state : ndarray of int8, shape (F, 5)
        `JointState` values.
    camera : ndarray of int8, shape (F,), optional
        Which camera each frame is of, where frames of several are joined (`cameras.joined`); None where all
        are of one.
    pixel_rad : float, rad, optional
        Of a camera without depth the angle of a pixel: positions are then points of the joints' rays, a metre
        in front of the camera. None of a depth camera.
    focal_share : float
        Of a camera without depth: standard error of the focal length, as a part of it.
    ray_origin_m : ndarray, shape (c, 3), m, optional
        Where the rays of each camera begin in {K}, once a depth was put on them (`cameras.rig`): then
        only what is across a ray was measured. A row of nan is of a depth camera; None where all are.
    """

    name: str
    t_s: FloatArray
    position: FloatArray
    state: NDArray[np.int8]
    camera: CameraNumbers | None = None
    pixel_rad: float | None = None
    ray_origin_m: FloatArray | None = None
    focal_share: float = FOCAL_DATA_SHEET

    def __len__(self) -> int:
        return len(self.t_s)

    @property
    def rate_hz(self) -> float:
        """Median frame rate, Hz (nan for fewer than two frames)."""
        return median_rate_hz(self.t_s)

    @property
    def present(self) -> tuple[str, ...]:
        """Joints that were tracked at least once."""
        tracked = (self.state == JointState.TRACKED).any(axis=0)
        return tuple(joint for joint, is_tracked in zip(JOINTS, tracked, strict=True) if is_tracked)

    def joint(self, name: str) -> FloatArray:
        """Positions (F, 3) of a joint, m in {K}, whatever its state."""
        return self.position[:, JOINTS.index(name)]

    def tracked(self, name: str) -> BoolArray:
        """(F,) True where the joint is tracked and its position finite."""
        index = JOINTS.index(name)
        finite = np.isfinite(self.position[:, index]).all(axis=1)
        return (self.state[:, index] == JointState.TRACKED) & finite

    @property
    def of_first_camera(self) -> JointTracks:
        """The frames of the recording's first camera; all of them where they are of one."""
        return self if self.camera is None else self.select(np.asarray(self.camera) == 0)

    @property
    def rows_by_camera(self) -> list[IntArray]:
        """The frames of each camera, in the order of their numbers; one entry where all are of one."""
        if self.camera is None:
            return [np.arange(len(self))]
        camera = np.asarray(self.camera)
        return [np.flatnonzero(camera == number) for number in range(int(camera.max(initial=0)) + 1)]

    @property
    def forearm_tracked(self) -> BoolArray:
        """(F,) frames in which a joint of the forearm is tracked."""
        columns = [JOINTS.index(joint) for joint in FOREARM_JOINTS]
        return np.asarray((self.state[:, columns] == JointState.TRACKED).any(axis=1))

    def select(self, rows: BoolArray | IntArray | slice) -> JointTracks:
        """The same tracks with some of the frames only."""
        return rows_of(self, rows, "t_s", "position", "state", "camera")

    def hide(self, hidden: BoolArray, joints: tuple[str, ...] = FOREARM_JOINTS) -> JointTracks:
        """A copy in which the joints are not tracked, and have no position, in the hidden frames (F,)."""
        position, state = self.position.copy(), self.state.copy()
        for index in (JOINTS.index(joint) for joint in joints):
            position[hidden, index] = np.nan
            state[hidden, index] = JointState.NOT_TRACKED
        return replace(self, position=position, state=state)


@dataclass(frozen=True)
class ImuStream:
    """Samples of one inertial sensor, on its own clock, in its own axes.

    Attributes
    ----------
    name : str
        Where it came from (a topic, a file's section).
    t_s : ndarray, shape (N,), s
        Centre of the interval that a sample averages, after the recording's origin.
    acc : ndarray, shape (N, 3), m/s^2
        Specific force: at rest about +9.81 upwards.
    gyro : ndarray, shape (N, 3), rad/s
        Angular velocity.
    mag : ndarray, shape (N, 3), optional
        Magnetic field in the sensor's unit.
    mag_calibrated : bool
        `mag` is corrected, of length 1 in the field where it was calibrated.
    accelerometer_density, gyroscope_density : float, m/s^2/sqrt(Hz) and rad/s/sqrt(Hz), optional
        White noise measured of this sensor.
    """

    name: str
    t_s: FloatArray
    acc: FloatArray
    gyro: FloatArray
    mag: FloatArray | None = None
    mag_calibrated: bool = False
    accelerometer_density: float | None = None
    gyroscope_density: float | None = None

    def __len__(self) -> int:
        return len(self.t_s)

    @cached_property
    def rate_hz(self) -> float:
        """Median sample rate, Hz (nan for fewer than two samples)."""
        return median_rate_hz(self.t_s)

    def select(self, rows: BoolArray | slice) -> ImuStream:
        """The same stream with some of the samples only."""
        return rows_of(self, rows, "t_s", "acc", "gyro", "mag")


#: What the recording's own camera is called beside others.
FIRST_CAMERA = "camera"


class CameraFrame(StrEnum):
    """Conventions for the camera's axes."""

    KINECT = "kinect"  # x left, y up, z forward
    OPTICAL = "optical"  # x right, y down, z forward
    ZUP = "zup"  # any frame with z up

    @property
    def down(self) -> FloatArray:
        """Direction of gravity in a level camera, unit vector (3,)."""
        return {
            CameraFrame.KINECT: np.array([0.0, -1.0, 0.0]),
            CameraFrame.OPTICAL: np.array([0.0, 1.0, 0.0]),
            CameraFrame.ZUP: np.array([0.0, 0.0, -1.0]),
        }[self]


@dataclass(frozen=True)
class CameraPose:
    """Where a camera {C} is in the frame {K} of the recording's first one."""

    R_K_C: FloatArray  # (3, 3): maps a vector from {C} to {K}
    p_K_C_m: FloatArray  # (3,) m: its origin in {K}
    sigma_rad: float  # One standard deviation per axis
    sigma_m: float  # One standard deviation per axis, of the place at which it sees the arm

    def to_first(self, points_C: FloatArray) -> FloatArray:
        """Points (..., 3) m of {C} in {K}."""
        return np.asarray(points_C @ self.R_K_C.T + self.p_K_C_m)


@dataclass(frozen=True)
class Camera:
    """A further camera's joints of the recording's arm, as it saw them."""

    name: str  # In messages and results
    arm: JointTracks  # On its own clock, in its own frame {C}
    camera_frame: CameraFrame | None = None  # The convention of its axes
    gravity_hint: FloatArray | None = None  # (3,): direction of down in {C}, good to some degrees
    pose: CameraPose | None = None  # If that was measured beforehand

    def with_arm(self, arm: JointTracks) -> Camera:
        """The same with other frames."""
        return replace(self, arm=arm)


@dataclass(frozen=True)
class Truth:
    """Reference motion of the forearm IMU, on the IMU's clock and in the camera frame.

    Attributes
    ----------
    t_s : ndarray, shape (M,), s
        After the recording's origin.
    position : ndarray, shape (M, 3), m
        In {K}; nan where the reference has none.
    quaternion : ndarray, shape (M, 4)
        qw, qx, qy, qz of `R_K_A`; nan where there is none.
    score : ndarray of bool, shape (M,)
        Samples to score on (BROAD scores while the sensor is in motion).
    joints : dict of str to ndarray, shape (M, 3), m
        Further reference positions by joint name, in {K}.
    """

    t_s: FloatArray
    position: FloatArray
    quaternion: FloatArray
    score: BoolArray
    joints: dict[str, FloatArray] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.t_s)

    def select(self, rows: BoolArray | slice) -> Truth:
        """The same reference with some of the samples only."""
        return rows_of(self, rows, "t_s", "position", "quaternion", "score", "joints")
