"""Self-calibration: what nobody measured, solved from the visible motion before the recovery.

The mounting starts in closed form (`mounting`). Then a few rounds on a choice of blocks of the
recordings: window graphs with the lever arms and the upper arm as variables, their answers combined,
the camera's noise measured from the residuals, and the clock offset moved along the slope of the loss
(secant steps). Recordings share the arm; each has its own clock offset.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from ..calibration import ArmCalibration, LeverArm
from ..config import Config
from ..errors import CalibrationError
from ..graph.solve import solve
from ..measurements.alignment import Alignment, align, pairs
from ..measurements.clock import Clock, constant_clock
from ..measurements.joint_noise import JointNoise
from ..measurements.outliers import reject_by_attitude
from ..measurements.segment import Segment
from ..recording import JOINTS, FloatArray
from ..runtime.pool import Pool
from ..units import GRAVITY
from ..window.cut import PreparedSegment, cut, cut_times
from ..window.pooling import pooled
from ..window.prepare import prepare
from ..window.priors import (
    InitialValues,
    calibration_from,
    first_priors,
    initial_values,
    noise_of,
    upper_arm_length_sigma,
    upper_arm_seen,
)
from ..window.problem import Solution, Window
from ..window.trajectory import Trajectory, at_times, merge_windows
from .camera_noise import joint_noise, sigma_by_joint
from .clock_fit import ClockFit
from .excerpts import choose_excerpts
from .joint_bias import JointBias
from .mounting import find_mounting

ROUNDS = 4
#: A round ends when an iteration lowers the error by less than this part of it.
TOLERANCE = 1e-3
#: A forearm direction that may be farther off than this is not known, rad.
LARGEST_SPREAD_RAD = np.radians(40.0)
#: Rounds end when nothing moved more than this, m; a clock's s count as m at a hand's pace, m/s.
SETTLED_M = 0.001
CLOCK_WEIGHT = 1.0
#: The closed form is done again when screening took more than this part of the samples.
WORTH_AGAIN = 0.05


@dataclass(frozen=True)
class SelfCalibration:
    """What the recovery starts from.

    Attributes
    ----------
    calibration : lever arms and upper arm with sigmas.
    start : the same values as a prior for solving them again: as uncertain as before.
    clocks : of each recording, t_imu = t_camera + offset.
    noise : of each forearm joint, by name.
    sigma_m : (5,) effective noise in the order of `JOINTS`, m an axis.
    direction_spread_rad : how far the forearm's direction in the sensor may be from the one found;
        nan where it was given or not looked for.
    upper_arm_sigma_m : how far from constant the upper arm's length is, m.
    bias : the camera's constant errors, joint by joint.
    begin : start values of the shared quantities.
    """

    calibration: ArmCalibration
    start: ArmCalibration
    clocks: tuple[Clock, ...]
    noise: dict[str, JointNoise]
    sigma_m: FloatArray
    upper_arm_sigma_m: float
    bias: JointBias
    begin: InitialValues
    direction_spread_rad: float = float("nan")

    @property
    def mounting_unknown(self) -> bool:
        """The visible motion did not tell how the sensor sits on the forearm."""
        return self.direction_spread_rad > LARGEST_SPREAD_RAD


def self_calibrate(
    segments: list[Segment], known: ArmCalibration, config: Config, pool: Pool
) -> SelfCalibration:
    """Find what the calibration lacks, and each recording's clock offset.

    Parameters
    ----------
    segments : of one or several recordings of one person and mounting.
    known : what is given; its sigmas are believed.
    """
    blocks = choose_excerpts(segments)
    mounting = find_mounting(blocks, known)
    screened = [
        reject_by_direction(b, mounting.calibration, constant_clock(mounting.offset_s[b.recording]))[0]
        for b in blocks
    ]
    lost = sum(int((old.accepted & ~new.accepted).sum()) for new, old in zip(screened, blocks, strict=True))
    if lost > WORTH_AGAIN * sum(int(block.accepted.sum()) for block in blocks):
        mounting = find_mounting(screened, known)
    blocks = screened
    calibration = mounting.calibration
    spread = mounting.direction_spread_rad if known.forearm_direction is None else float("nan")
    if "elbow" in calibration.lever_arms and calibration.upper_arm is None:
        calibration = replace(calibration, upper_arm=upper_arm_seen(blocks, config))
    given = calibration
    sigma_m, upper_arm_sigma_m = (
        np.full(len(JOINTS), config.camera.joint_sigma_m),
        config.arm.upper_arm_flex_m,
    )
    synthetic_stamps = {segment.recording: segment.synthetic_stamps for segment in blocks}
    clocks = ClockFit(
        [constant_clock(offset) for offset in mounting.offset_s],
        [synthetic_stamps.get(number, False) for number in range(len(mounting.offset_s))],
    )
    bias, seen = JointBias(), blocks
    motions: dict[int, Trajectory] = {}
    margin_s = config.windows.margin_s
    for _ in range(ROUNDS):
        ready = [
            (segment, each)
            for segment in blocks
            if (each := prepare(segment, calibration, clocks.clocks[segment.recording], sigma_m, margin_s))
            is not None
        ]
        if not ready:
            raise CalibrationError("at no time do the IMU and a visible forearm come together")
        prepared_segments = [
            with_initial_values(each[0], motions.get(k)) for k, (_, each) in enumerate(ready)
        ]
        begin = initial_values(
            prepared_segments, [each[1] for _, each in ready], [segment for segment, _ in ready]
        )
        prior = first_priors(begin, calibration, config)
        windows: list[Window] = []
        owner: list[int] = []
        borders = [cut_times(prepared, config.windows.length_s) for prepared in prepared_segments]
        sharing = sum(len(border) - 1 for border in borders)
        for (segment, _), prepared, border in zip(ready, prepared_segments, borders, strict=True):
            windows += cut(
                prepared,
                [prior] * (len(border) - 1),
                noise_of(config, upper_arm_sigma_m),
                border,
                margin_s,
                GRAVITY,
                sharing,
            )
            owner += [segment.recording] * (len(border) - 1)
        answers = list(
            pool.map(partial(solve, with_covariance=False, with_offset=True, tolerance=TOLERANCE), windows)
        )
        motions = _motions(prepared_segments, borders, windows, answers)
        found = calibration_from(
            pooled([a.message for a in answers], prior), prior.layout, given, bias.sigma_m
        )
        noise = joint_noise(windows, answers)
        upper_arm_sigma_m = upper_arm_length_sigma(
            blocks, config, max((each.sample_m for each in noise.values()), default=0.0)
        )
        sigma_m = sigma_by_joint(noise, config.camera.joint_sigma_m)
        times, errors = list(clocks.clocks), bias.found_m.copy()
        bias.step(windows, answers)
        blocks = bias.corrected(seen)
        clocks.step(windows, answers, np.array(owner))
        moved = max(
            _lever_change(calibration, found),
            float(np.abs(bias.found_m - errors).max()),
            CLOCK_WEIGHT * max(abs(a.mean_s - b.mean_s) for a, b in zip(clocks.clocks, times, strict=True)),
        )
        calibration = _recentred(found, given, known)
        if moved < SETTLED_M:
            break
    return SelfCalibration(
        found, calibration, tuple(clocks.clocks), noise, sigma_m, upper_arm_sigma_m, bias, begin, spread
    )


def reject_by_direction(
    segment: Segment, calibration: ArmCalibration, clock: Clock
) -> tuple[Segment, Alignment | None]:
    """The piece without the frames whose forearm does not point where the inertial attitude says.

    Returns
    -------
    The piece, and the alignment that it was judged by where that is still good: nothing was set aside.
    """
    along_A = calibration.forearm_direction
    if along_A is None:
        return segment, None
    frame_t = segment.frame_t_imu(clock)
    alignment = align(
        pairs(segment, frame_t, segment.accepted, calibration), segment.start_s, segment.end_s, segment.down
    )
    screened = reject_by_attitude(segment, frame_t, alignment, along_A)
    return screened, alignment if screened is segment else None


def with_initial_values(prepared: PreparedSegment, motion: Trajectory | None) -> PreparedSegment:
    """The stretch with an earlier solution's motion as start values."""
    if motion is None:
        return prepared
    inside = np.clip(prepared.t, motion.t[0], motion.t[-1])
    return replace(prepared, start=at_times(motion, prepared.signal, inside))


def _motions(
    prepared_segments: list[PreparedSegment],
    borders: list[list[float]],
    windows: list[Window],
    answers: list[Solution],
) -> dict[int, Trajectory]:
    """The joined motion of each stretch, by its number."""
    found, first = {}, 0
    for k, (prepared, border) in enumerate(zip(prepared_segments, borders, strict=True)):
        last = first + len(border) - 1
        found[k] = merge_windows(prepared.t, windows[first:last], answers[first:last])
        first = last
    return found


def _lever_change(before: ArmCalibration, after: ArmCalibration) -> float:
    """Longest way that a lever arm moved, m."""
    return max(
        (
            float(np.linalg.norm(lever.position_m - before.lever_arms[joint].position_m))
            for joint, lever in after.lever_arms.items()
        ),
        default=0.0,
    )


def _recentred(found: ArmCalibration, start: ArmCalibration, known: ArmCalibration) -> ArmCalibration:
    """The next round's prior: what was found, as uncertain as before; what was given stays."""
    levers = {
        joint: known.lever_arms[joint]
        if joint in known.lever_arms
        else LeverArm(lever.position_m, start.lever_arms[joint].sigma_m)
        for joint, lever in found.lever_arms.items()
    }
    upper_arm = known.upper_arm
    if upper_arm is None and found.upper_arm is not None and start.upper_arm is not None:
        upper_arm = replace(found.upper_arm, sigma_m=start.upper_arm.sigma_m)
    return replace(start, lever_arms=levers, upper_arm=upper_arm)
