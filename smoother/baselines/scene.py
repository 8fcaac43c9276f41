"""What every baseline gets, and what it gives back.

A baseline gets the graph's calibration, clock and accepted samples, so that a comparison is of methods and of
nothing else. `Scene` is one segment of the recording (between pauses of the IMU); a baseline is a function
from a scene to a `Path`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from ..array_types import BoolArray, FloatArray
from ..calibration import ArmCalibration
from ..linalg import interpolate
from ..measurements.visibility import Gap, occluded_at
from ..recording import JOINTS, ImuStream

#: The note of a path where a method has too little to begin with.
TOO_LITTLE_SEEN = "The camera saw too little of this segment."


@dataclass(frozen=True)
class Scene:
    """One segment as a baseline gets it; all times on the IMU's clock, all vectors in {K} unless said.

    Attributes
    ----------
    imu : ImuStream, n samples
        In {A}, the calibration's biases taken off.
    R_K_A : ndarray, shape (n, 3, 3)
        Orientation at the samples by the chosen filter, aligned to the camera.
    attitude_sigma_rad : float, rad
        One standard deviation of that orientation, an axis.
    gravity : ndarray, shape (3,), m/s^2
    acceleration : ndarray, shape (n, 3), m/s^2
        Of the sensor, without gravity, from that orientation.
    frame_t : ndarray, shape (f,), s
        Times of the camera frames, increasing.
    joints : ndarray, shape (f, 5, 3), m
        Accepted joints in the order of `JOINTS`; nan where there is none.
    camera_joints : ndarray, shape (f, 5, 3), m
        Whatever the camera stated, `inferred` included; nan where it stated nothing.
    point : ndarray, shape (f, 3), m
        The IMU's position at visible frames, the mean over joints of joint - R_K_A lever; nan elsewhere.
    point_sigma_m : float, m
        Noise of `point`, an axis.
    gaps : tuple of Gap
        The gaps inside.
    calibration : ArmCalibration
        Lever arms and measures.
    point_effective_sigma_m : float, m
        Deviation of a white noise with the long-run variance of the noise of `point`, which has a memory:
        what a filter of independent samples needs, an axis; nan where unknown.
    rows : slice
        Which of the recording's IMU samples these are.
    """

    imu: ImuStream
    R_K_A: FloatArray
    attitude_sigma_rad: float
    gravity: FloatArray
    acceleration: FloatArray
    frame_t: FloatArray
    joints: FloatArray
    camera_joints: FloatArray
    point: FloatArray
    point_sigma_m: float
    gaps: tuple[Gap, ...]
    calibration: ArmCalibration
    point_effective_sigma_m: float = float("nan")
    rows: slice = field(default_factory=lambda: slice(None))

    @property
    def t(self) -> FloatArray:
        """(n,) times of the IMU's samples, s."""
        return self.imu.t_s

    @property
    def visible(self) -> BoolArray:
        """(f,) frames in which the forearm is visible."""
        return np.asarray(np.isfinite(self.point).all(axis=1))

    @property
    def visible_points(self) -> tuple[FloatArray, FloatArray]:
        """Times (v,) s and the IMU's positions (v, 3) m at the visible frames."""
        return finite_rows(self.frame_t, self.point)

    @property
    def occluded(self) -> BoolArray:
        """(n,) samples inside a gap."""
        return occluded_at(self.t, self.gaps)

    @property
    def shoulder(self) -> FloatArray:
        """(n, 3) shoulder at the samples, m, linear between accepted frames (Jatesiktat and Ang, II-K.4).

        nan where it was never seen.
        """
        return between(self.frame_t, self.joints[:, JOINTS.index("shoulder")], self.t)


@dataclass(frozen=True)
class Path:
    """A baseline's answer at the scene's IMU times, in {K}; nan where it has none.

    Attributes
    ----------
    position : ndarray, shape (n, 3), m
        Of the IMU.
    velocity : ndarray, shape (n, 3), m/s, optional
        None where the method has none.
    covariance : ndarray, shape (n, 3, 3), m^2, optional
        Of the position; None where the method states none.
    R_K_A : ndarray, shape (n, 3, 3), optional
        Orientation; None where it is the scene's.
    attitude_covariance : ndarray, shape (n, 3, 3), rad^2, optional
        Of the orientation's error as a rotation vector in {K}.
    joints : dict of ndarray, shape (n, 3), m
        By joint, where the method gets them otherwise than by pose and lever arm.
    notes : tuple of str
        What a reader must know, one sentence each.
    """

    position: FloatArray
    velocity: FloatArray | None = None
    covariance: FloatArray | None = None
    R_K_A: FloatArray | None = None
    attitude_covariance: FloatArray | None = None
    joints: dict[str, FloatArray] = field(default_factory=dict)
    notes: tuple[str, ...] = ()


#: A method: one scene in, its answer out.
Baseline = Callable[[Scene], Path]


def no_answer(scene: Scene) -> Path:
    """The path of a scene in which the camera saw too little to begin with."""
    return Path(np.full((len(scene.t), 3), np.nan), notes=(TOO_LITTLE_SEEN,))


def finite_rows(t: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The times (f,) and values (f, 3) without the rows that have a nan."""
    finite = np.isfinite(values).all(axis=1)
    return t[finite], values[finite]


def between(t: FloatArray, values: FloatArray, at: FloatArray) -> FloatArray:
    """Linear interpolation (n, 3) between the finite rows of the values (f, 3), held beyond the ends.

    nan where no row is finite.
    """
    t, values = finite_rows(t, values)
    return interpolate(t, values, at) if len(t) else np.full((len(at), 3), np.nan)
