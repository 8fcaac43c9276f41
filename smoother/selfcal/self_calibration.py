"""What self-calibration gives: the arm's geometry, clocks and noise that the recovery starts from."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ..array_types import FloatArray
from ..calibration import ArmCalibration
from ..measurements.clock import Clock
from ..measurements.outliers import JointNoise
from ..window.priors import InitialValues
from .error_estimate import ConstantErrors, JointBias

#: A forearm direction that may be farther off than this is not known, rad.
LARGEST_SPREAD_RAD = np.radians(40.0)
#: One that may be farther off than this is known with little margin, rad (closed form on sound arms: up to 13
#: degrees).
SMALL_MARGIN_RAD = np.radians(25.0)
#: An IMU that drops out again and again, so soon, s, leaves windows too short to find its own place on the
#: arm: simulated arms are 1 to 7 cm off at 1.0 s, as stated from 3 s on; the joints are right in all.
SHORT_S = 2.2
#: A lens that the motion contradicts by more than this many sigmas is another one's.
LENS_SIGMAS = 3.0


@dataclass(frozen=True)
class SelfCalibration:
    """What the recovery starts from."""

    estimate: ArmCalibration  # Lever arms and upper arm with their sigmas
    prior: ArmCalibration  # The same values as a prior for solving them again: as uncertain as before
    initial: InitialValues  # Start values of the shared quantities
    clocks: tuple[Clock, ...]  # Of each recording, t_imu = t_camera + offset
    joint_noise: dict[str, JointNoise]  # Of each forearm joint, by camera (`noise_key`)
    joint_sigma_m: FloatArray  # (5,) or (c, 5) m: effective noise per axis, in the order of `JOINTS`
    errors: ConstantErrors  # Of IMU and camera
    upper_arm_sigma_m: float  # How far from constant the upper arm's length is
    in_common: float = 1.0  # How much larger the camera's variance is, as its joints err together
    # How far the forearm's direction in the sensor may be from the estimate; nan where it was given
    direction_spread_rad: float = float("nan")
    # By segment with a further IMU t_own = t_camera + offset, mean, of the camera's stamps as `clocks` have
    # them
    further_clock_offset_s: dict[str, float] = field(default_factory=dict)
    interrupted_s: float = float("nan")  # Median time between two pauses of an IMU that pauses too often

    @property
    def clock(self) -> Clock:
        """Of the only recording."""
        return self.clocks[0]

    @property
    def joint_bias(self) -> JointBias:
        """The camera's constant errors."""
        return self.errors.joints

    @property
    def mounting_unknown(self) -> bool:
        """The visible motion did not show how the sensor sits on the forearm."""
        return self.direction_spread_rad > LARGEST_SPREAD_RAD

    @property
    def misfits(self) -> tuple[str, ...]:
        """What of the stated lens the motion contradicts, in words."""
        off, sigma = self.errors.lens
        if abs(off) <= LENS_SIGMAS * sigma:
            return ()
        longer = "longer" if off > 0 else "shorter"
        return (
            f"the motion fits a focal length about {100 * abs(off):.0f} % {longer}"
            " than the stated one: check that --intrinsics are this camera's, in the mode that was recorded",
        )

    @property
    def open_questions(self) -> tuple[str, ...]:
        """What the excerpts leave open of the mounting, in words."""
        questions = []
        if self.direction_spread_rad > SMALL_MARGIN_RAD:
            degrees = np.degrees(self.direction_spread_rad)
            questions.append(
                f"a mounting of the sensor that is {degrees:.0f} degrees off fits the visible motion nearly"
                " as well as the one taken: move the arm more in view, or give a calibration"
            )
        if self.interrupted_s < SHORT_S:
            questions.append(
                f"the IMU drops out every {self.interrupted_s:.1f} s: its own position on the arm is"
                " uncertain (the joints are not); move its receiver closer, or give a calibration"
            )
        return tuple(questions)
