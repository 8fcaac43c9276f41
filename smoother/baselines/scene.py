"""What every baseline gets, and what it gives back.

A baseline sees the graph's calibration, clock and accepted samples, so that a comparison is of methods and of
nothing else. `Scene` is one stretch of the recording without a pause of the IMU; a baseline is a function from a
scene to a `Path`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from ..calibration import ArmCalibration
from ..linalg import interpolate
from ..measurements.visibility import Gap, occluded_at
from ..recording import JOINTS, BoolArray, FloatArray, ImuStream


@dataclass(frozen=True)
class Scene:
    """One stretch as a baseline sees it; all times on the IMU's clock, all vectors in {K} unless said.

    Attributes
    ----------
    imu : (n,) samples in {A}, the calibration's biases taken off.
    R_K_A : (n, 3, 3) orientation at the samples by the chosen filter, aligned to the camera.
    attitude_sigma_rad : one standard deviation an axis of that orientation.
    gravity : (3,) m/s^2 in {K}.
    acceleration : (n, 3) of the sensor without gravity, m/s^2 in {K}, from that orientation.
    frame_t : (f,) camera frames, increasing, s.
    joints : (f, 5, 3) accepted joints in the order of `JOINTS`, m; nan where there is none.
    guessed : (f, 5, 3) whatever the camera stated, `inferred` included, m; nan where it stated nothing.
    point : (f, 3) the IMU's position at visible frames, the mean over joints of joint - R_K_A lever, m; nan
        elsewhere.
    point_sigma_m : noise of `point`, m an axis.
    gaps : the occluded stretches inside.
    calibration : lever arms and measures.
    point_effective_sigma_m : deviation of a white noise with the long-run variance of `point`'s, which
        remembers: what a filter of independent samples must be told, m an axis; nan where unknown.
    rows : which of the recording's IMU samples these are.
    """

    imu: ImuStream
    R_K_A: FloatArray
    attitude_sigma_rad: float
    gravity: FloatArray
    acceleration: FloatArray
    frame_t: FloatArray
    joints: FloatArray
    guessed: FloatArray
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
        """(f,) frames in which the forearm is seen."""
        return np.asarray(np.isfinite(self.point).all(axis=1))

    @property
    def occluded(self) -> BoolArray:
        """(n,) samples inside a gap."""
        return occluded_at(self.t, self.gaps)

    @property
    def shoulder(self) -> FloatArray:
        """(n, 3) shoulder at the samples, m, linear between accepted frames (Jatesiktat and Ang, II-K.4).

        nan where it was never seen.
        """
        place = self.joints[:, JOINTS.index("shoulder")]
        seen = np.isfinite(place).all(axis=1)
        if not seen.any():
            return np.full((len(self.t), 3), np.nan)
        return interpolate(self.frame_t[seen], place[seen], self.t)


@dataclass(frozen=True)
class Path:
    """A baseline's answer at the scene's IMU times, in {K}; nan where it has none.

    Attributes
    ----------
    position : (n, 3) of the IMU, m.
    velocity : (n, 3) m/s, or None where the method has none.
    covariance : (n, 3, 3) of the position, m^2, or None where the method states none.
    R_K_A : (n, 3, 3) orientation, or None where it is the scene's.
    attitude_covariance : (n, 3, 3) rad^2 in {K}, or None.
    joints : (n, 3) m by joint, where the method finds them otherwise than by pose and lever arm.
    notes : what a reader must know, one sentence each.
    """

    position: FloatArray
    velocity: FloatArray | None = None
    covariance: FloatArray | None = None
    R_K_A: FloatArray | None = None
    attitude_covariance: FloatArray | None = None
    joints: dict[str, FloatArray] = field(default_factory=dict)
    notes: tuple[str, ...] = ()


#: A method: one stretch in, its answer out.
Baseline = Callable[[Scene], Path]
