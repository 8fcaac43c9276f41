"""What a recording holds: one arm seen by a depth camera, and the IMU on its forearm.

All values are SI. Times are float seconds after `Recording.origin_ns`; the camera's stamps and the
IMU's stamps keep their own clocks (t_imu = t_camera + offset). Frames: `{K}` is the camera,
`{A}` the forearm IMU; `R_K_A` maps a vector from A to K.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from enum import IntEnum, StrEnum

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int64]

#: Joints of one arm, in the order of every joint axis. `strap` is the IMU's own position.
JOINTS = ("shoulder", "elbow", "wrist", "hand", "strap")
#: The joints that ride on the forearm's rigid body.
FOREARM_JOINTS = ("elbow", "wrist", "hand", "strap")


class JointState(IntEnum):
    """What the camera says of a joint in a frame (Kinect SDK's three tracking states)."""

    NOT_TRACKED = 0
    INFERRED = 1
    TRACKED = 2


class CameraFrame(StrEnum):
    """Conventions for the camera's axes."""

    KINECT = "kinect"  # x left, y up, z forward
    OPTICAL = "optical"  # x right, y down, z forward
    ZUP = "zup"  # any frame with z up

    @property
    def down(self) -> FloatArray:
        """Direction of gravity in a camera that stands level, unit vector (3,)."""
        return {
            CameraFrame.KINECT: np.array([0.0, -1.0, 0.0]),
            CameraFrame.OPTICAL: np.array([0.0, 1.0, 0.0]),
            CameraFrame.ZUP: np.array([0.0, 0.0, -1.0]),
        }[self]


@dataclass(frozen=True)
class ImuStream:
    """Samples of one inertial sensor, on its own clock, in its own axes.

    Attributes
    ----------
    name : where it came from (a topic, a file's section).
    t_s : (N,) centre of the interval that a sample averages, s after the recording's origin.
    acc : (N, 3) specific force, m/s^2 (at rest about +9.81 upwards).
    gyro : (N, 3) angular velocity, rad/s.
    mag : (N, 3) magnetic field in the sensor's unit, or None.
    mag_calibrated : `mag` is corrected, of length 1 in the field where it was calibrated.
    accelerometer_density, gyroscope_density : white noise measured of this sensor, m/s^2/sqrt(Hz) and
        rad/s/sqrt(Hz); None where nobody did.
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

    @property
    def rate_hz(self) -> float:
        """Median sample rate (nan for fewer than two samples)."""
        return float(1.0 / np.median(np.diff(self.t_s))) if len(self.t_s) > 1 else float("nan")

    def select(self, keep: BoolArray | slice) -> ImuStream:
        """The same stream with the kept samples only."""
        mag = None if self.mag is None else self.mag[keep]
        return replace(self, t_s=self.t_s[keep], acc=self.acc[keep], gyro=self.gyro[keep], mag=mag)


@dataclass(frozen=True)
class JointTracks:
    """The joints of one arm as the camera saw them, on the camera's clock.

    Attributes
    ----------
    name : where it came from (a topic, a file).
    t_s : (F,) frame times, s after the recording's origin.
    position : (F, 5, 3) m in {K}, joints in the order of `JOINTS`; nan where there is none.
    state : (F, 5) `JointState` values, int8.
    """

    name: str
    t_s: FloatArray
    position: FloatArray
    state: NDArray[np.int8]

    def __len__(self) -> int:
        return len(self.t_s)

    @property
    def rate_hz(self) -> float:
        """Median frame rate (nan for fewer than two frames)."""
        return float(1.0 / np.median(np.diff(self.t_s))) if len(self.t_s) > 1 else float("nan")

    @property
    def present(self) -> tuple[str, ...]:
        """Joints that were tracked at least once."""
        seen = (self.state == JointState.TRACKED).any(axis=0)
        return tuple(joint for joint, is_seen in zip(JOINTS, seen, strict=True) if is_seen)

    def joint(self, name: str) -> FloatArray:
        """Positions (F, 3) of a joint, m in {K}, whatever its state."""
        return self.position[:, JOINTS.index(name)]

    def tracked(self, name: str) -> BoolArray:
        """(F,) True where the joint is tracked and its position finite."""
        index = JOINTS.index(name)
        finite = np.isfinite(self.position[:, index]).all(axis=1)
        return (self.state[:, index] == JointState.TRACKED) & finite

    def select(self, keep: BoolArray | slice) -> JointTracks:
        """The same tracks with the kept frames only."""
        return JointTracks(self.name, self.t_s[keep], self.position[keep], self.state[keep])

    def hide(self, hidden: BoolArray, joints: tuple[str, ...] = FOREARM_JOINTS) -> JointTracks:
        """A copy in which the joints are not tracked, and have no position, in the hidden frames (F,)."""
        position, state = self.position.copy(), self.state.copy()
        for index in (JOINTS.index(joint) for joint in joints):
            position[hidden, index] = np.nan
            state[hidden, index] = JointState.NOT_TRACKED
        return JointTracks(self.name, self.t_s, position, state)


@dataclass(frozen=True)
class Truth:
    """Reference motion of the forearm IMU, on the IMU's clock and in the camera frame.

    Attributes
    ----------
    t_s : (M,) s after the recording's origin.
    position : (M, 3) m in {K}; nan where the reference has none.
    quaternion : (M, 4) qw, qx, qy, qz of `R_K_A`; nan where there is none.
    score : (M,) samples to score on (BROAD scores while the sensor is in motion).
    joints : further reference positions (M, 3) by joint name, m in {K}.
    """

    t_s: FloatArray
    position: FloatArray
    quaternion: FloatArray
    score: BoolArray
    joints: dict[str, FloatArray] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.t_s)


@dataclass(frozen=True)
class Recording:
    """One arm, the IMU on its forearm, and what else was recorded with them.

    Attributes
    ----------
    imu : the forearm IMU.
    arm : the camera's joints of that arm.
    side : "left", "right", or "" where the recording does not say (`strap` alone).
    camera_frame : the convention of the camera's axes; None where the recording does not say.
    gravity_hint : (3,) direction of down in {K}, good to some degrees, or None.
    base_imu : an IMU fixed to the camera, or None.
    truth : reference motion, used by validation only, or None.
    origin_ns : what the times count from, ns (0 or a Unix time).
    name : what to call the recording in messages (its file's name).
    notes : what was dropped or decided on reading, one sentence each.
    gravity_sigma_rad : how well `gravity_hint` is known, an axis; None = to some degrees.
    """

    imu: ImuStream
    arm: JointTracks
    side: str = ""
    camera_frame: CameraFrame | None = None
    gravity_hint: FloatArray | None = None
    base_imu: ImuStream | None = None
    truth: Truth | None = None
    origin_ns: int = 0
    name: str = "recording"
    notes: tuple[str, ...] = ()
    gravity_sigma_rad: float | None = None
