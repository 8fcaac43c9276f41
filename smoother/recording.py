"""What a recording holds: one arm seen by a depth camera, and the IMU on its forearm.

All values are SI. Times are float seconds after `Recording.origin_ns`; the camera's stamps and the
IMU's stamps keep their own clocks (t_imu = t_camera + offset). Frames: `{K}` is the camera,
`{A}` the forearm IMU; `R_K_A` maps a vector from A to K.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import IntEnum, StrEnum

import numpy as np
from numpy.typing import NDArray

from .errors import RecordingError

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


def median_rate_hz(t_s: FloatArray) -> float:
    """Median rate of increasing times (n,), Hz; nan for fewer than two."""
    return float(1.0 / np.median(np.diff(t_s))) if len(t_s) > 1 else float("nan")


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

    @property
    def rate_hz(self) -> float:
        """Median sample rate, Hz (nan for fewer than two samples)."""
        return median_rate_hz(self.t_s)

    def select(self, rows: BoolArray | slice) -> ImuStream:
        """The same stream with some of the samples only."""
        mag = None if self.mag is None else self.mag[rows]
        return replace(self, t_s=self.t_s[rows], acc=self.acc[rows], gyro=self.gyro[rows], mag=mag)


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
    """

    name: str
    t_s: FloatArray
    position: FloatArray
    state: NDArray[np.int8]

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

    def select(self, rows: BoolArray | slice) -> JointTracks:
        """The same tracks with some of the frames only."""
        return JointTracks(self.name, self.t_s[rows], self.position[rows], self.state[rows])

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


def arm_words(side: str, body: int | None) -> str:
    """Which arm, in words: "right arm of body 2"; without a side "arm"."""
    return f"{side + ' ' if side else ''}arm{'' if body is None else f' of body {body}'}"


@dataclass(frozen=True)
class TrunkSensors:
    """An IMU on the trunk, and what the camera sees of the trunk besides the arm's own shoulder.

    Attributes
    ----------
    imu : ImuStream
        On the breastbone or the back, on a clock of its own, in its own axes {D}.
    other_arm : JointTracks, optional
        The other arm, whose shoulder counts; None where the skeleton has none.
    """

    imu: ImuStream
    other_arm: JointTracks | None = None


@dataclass(frozen=True, repr=False)
class Recording:
    """One arm, the IMU on its forearm, and what else was recorded with them.

    Attributes
    ----------
    imu : ImuStream
        The forearm IMU.
    arm : JointTracks
        The camera's joints of that arm.
    side : str
        "left", "right", or "" where the recording does not say (`strap` alone).
    camera_frame : CameraFrame, optional
        The convention of the camera's axes.
    gravity_hint : ndarray, shape (3,), optional
        Direction of down in {K}, good to some degrees.
    base_imu : ImuStream, optional
        An IMU fixed to the camera.
    truth : Truth, optional
        Reference motion, used by validation only.
    origin_ns : int, ns
        What the times count from (0 or a Unix time).
    name : str
        What to call the recording in messages (its file's name).
    notes : tuple of str
        What was dropped or decided on reading, one sentence each.
    gravity_sigma_rad : float, rad, optional
        How well `gravity_hint` is known, an axis; to some degrees where None.
    upper_imu : ImuStream, optional
        An IMU on the same arm's upper arm, on a clock of its own, in its own axes {B}.
    body : int, optional
        The camera's number of the person, where several are told apart.
    trunk : TrunkSensors, optional
        An IMU on the same person's trunk.
    undone : tuple of str
        Mistakes of the set-up that were undone in it, as options: "--mirror x".
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
    upper_imu: ImuStream | None = None
    body: int | None = None
    trunk: TrunkSensors | None = None
    undone: tuple[str, ...] = ()

    @property
    def arm_label(self) -> str:
        """Which arm, in words: "right arm of body 2"; without a side "arm"."""
        return arm_words(self.side, self.body)

    def __repr__(self) -> str:
        from .recording_view import recording_text

        return recording_text(self)

    def _repr_html_(self) -> str:
        """What was recorded, and a small picture, as notebooks show it."""
        from .recording_view import recording_html

        return recording_html(self)

    @classmethod
    def from_arrays(
        cls,
        imu_t_s: FloatArray,
        acc: FloatArray,
        gyro: FloatArray,
        frame_t_s: FloatArray,
        joints: Mapping[str, FloatArray],
        *,
        states: Mapping[str, NDArray] | None = None,
        mag: FloatArray | None = None,
        side: str = "",
        camera_frame: CameraFrame | str | None = None,
        gravity_hint: FloatArray | None = None,
        truth: Truth | None = None,
        name: str = "recording",
        upper_imu: ImuStream | None = None,
    ) -> Recording:
        """Build a recording from arrays, in SI units.

        Parameters
        ----------
        imu_t_s : array_like, shape (N,), s
            The IMU's stamps, increasing, on its own clock: centres of the intervals that samples average.
        acc : array_like, shape (N, 3), m/s^2
            Specific force in the sensor's axes (at rest about +9.81 upwards).
        gyro : array_like, shape (N, 3), rad/s
            Angular velocity in the sensor's axes.
        frame_t_s : array_like, shape (F,), s
            The camera's stamps, increasing, on its own clock.
        joints : mapping of str to array_like, shape (F, 3), m
            Positions in the camera's frame by name (shoulder, elbow, wrist, hand, strap); nan where the
            camera has none.
        states : mapping of str to array_like of int, shape (F,), optional
            `JointState` values by joint; without them a joint is tracked where its position is finite.
        mag : array_like, shape (N, 3), optional
            Magnetic field.
        side : str
            "left", "right" or "".
        camera_frame : CameraFrame or str, optional
            "kinect", "optical" or "zup".
        gravity_hint : array_like, shape (3,), optional
            Direction of down in the camera's frame.
        truth : Truth, optional
            Reference motion, for validation.
        name : str
            For messages.
        upper_imu : ImuStream, optional
            The samples of an IMU on the upper arm.

        Raises
        ------
        RecordingError
            A shape does not fit, a joint has another name, times do not increase, or samples are not finite.
        """
        from .recording_arrays import camera_frame_of, check_imu, direction_of, imu_of, joints_of, times_of

        t, frame_t = times_of(imu_t_s, "imu_t_s", name), times_of(frame_t_s, "frame_t_s", name)
        if side not in ("", "left", "right"):
            raise RecordingError(f"{name}: the side is left or right, not {side}")
        frame = camera_frame_of(camera_frame, name)
        imu = imu_of(t, acc, gyro, mag, name)
        arm = joints_of(frame_t, joints, states or {}, name)
        hint = None if gravity_hint is None else direction_of(gravity_hint, name)
        if upper_imu is not None:
            check_imu(upper_imu, "the upper arm's ", name)
        return cls(imu, arm, side, frame, hint, truth=truth, name=name, upper_imu=upper_imu)
