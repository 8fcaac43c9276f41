"""Self-calibration: unmeasured quantities, solved from the visible motion before the recovery.

The mounting starts in closed form (`mounting`). Then a few rounds on excerpts of the recordings: window
graphs with lever arms and upper arm as variables, their answers pooled, the camera's noise measured from
the residuals, and the clock offset moved along the slope of the loss (scoring). Recordings share the arm;
each has its own clock.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from ..array_types import FloatArray
from ..calibration import ArmCalibration, LeverArm
from ..config import Config
from ..errors import CalibrationError
from ..graph.columns import with_lens
from ..graph.solve import solve
from ..measurements.clock import OFFSET_SIGMA_S, Clock, constant_clock
from ..measurements.inertial import InertialSignal
from ..measurements.outliers import reject_by_direction
from ..measurements.segment import Segment
from ..recording import JOINTS
from ..runtime.pool import Pool
from ..window.cut import window_between
from ..window.prepare import PreparedSegment, prepare
from ..window.priors import (
    InitialValues,
    calibration_from,
    first_priors,
    initial_values,
    noise_of,
    upper_arm_length_sigma,
    upper_arm_seen,
)
from ..window.problem import Window
from ..window.solution import Solution
from ..window.trajectory import started_from
from .camera_noise import in_common, joint_noise, sigma_by_camera, sigma_by_joint
from .clock_fit import SYNTHETIC_SIGMA_S, clock_score, refined_clock
from .error_estimate import ConstantErrors, JointBias, PooledEvidence, well_seen_joints
from .excerpts import choose_excerpts
from .mounting import Mounting, find_mounting
from .self_calibration import SHORT_S, SelfCalibration


def solve_round(
    segments: dict[int, Segment],
    calibration: ArmCalibration,
    clocks: Sequence[Clock],
    joint_sigma_m: FloatArray,
    upper_arm_sigma_m: float,
    earlier: dict[int, Solution],
    config: Config,
    workers: Pool,
) -> tuple[dict[int, Window], dict[int, Solution], InitialValues]:
    """Solve each segment as one window, from the last round's answers where there are any."""
    margin_s = config.windows.margin_s
    prepared: dict[int, PreparedSegment] = {}
    alignments = []
    for number, segment in segments.items():
        ready = prepare(segment, calibration, clocks[segment.recording], joint_sigma_m, margin_s)
        if ready is not None:
            before = earlier.get(number)
            prepared[number] = ready[0] if before is None else started_from(ready[0], before, ready[0])
            alignments.append(ready[1])
    if not prepared:
        raise CalibrationError("the IMU and a visible forearm never overlap")
    initial = initial_values(list(prepared.values()), alignments, [segments[number] for number in prepared])
    prior = first_priors(initial, calibration, config)
    noise = noise_of(config, upper_arm_sigma_m)
    windows: dict[int, Window] = {}

    def cut_one_by_one() -> Iterator[Window]:
        for number, each in prepared.items():
            window = window_between(each, prior, noise, len(prepared))
            windows[number] = replace(window, loose_gaps=True)
            yield windows[number]

    # the first ones are solved while the next ones are cut
    solutions = workers.map(SOLVE_ONCE, cut_one_by_one())
    return windows, dict(zip(prepared, solutions, strict=True)), initial


ROUNDS = 4
#: A round ends when an iteration lowers the error by less than this share of it.
TOLERANCE = 1e-3
SOLVE_ONCE = partial(solve, with_covariance=False, with_offset=True, with_evidence=True, tolerance=TOLERANCE)
#: Rounds end when nothing moved more than this, m (a clock's s as m at a hand's pace, m/s), or more
#: than this share of its own sigma: the windows solve lever arms again.
SETTLED_M, SETTLED_SIGMAS = 0.001, 0.4
CLOCK_WEIGHT = 1.0
#: Fewer segments than this are no IMU that drops out again and again.
SHORT_SEGMENTS = 3
#: The closed form is done again when more than this share of the samples was rejected by it.
WORTH_AGAIN = 0.05


def self_calibrate(
    segments: list[Segment],
    given: ArmCalibration,
    config: Config,
    workers: Pool,
    clock_sigma_s: float = OFFSET_SIGMA_S,
    rounds: int = ROUNDS,
) -> SelfCalibration:
    """Find what the calibration lacks, and each recording's clock."""
    excerpts, mounting = _closed_form(choose_excerpts(segments), given, clock_sigma_s)
    synthetic = [
        any(segment.synthetic_stamps for segment in excerpts if segment.recording == number)
        for number in range(len(mounting.offset_s))
    ]
    start = _with_upper_arm(mounting.calibration, excerpts, config)
    estimate = prior = start
    clocks = tuple(constant_clock(offset, clock_sigma_s) for offset in mounting.offset_s)
    joint_sigma_m, upper_arm_sigma_m = (
        np.full(len(JOINTS), config.camera.joint_sigma_m),
        config.arm.upper_arm_flex_m,
    )
    cameras = max(1 if each.camera is None else int(each.camera.max(initial=0)) + 1 for each in excerpts)
    see_depth = max(_cameras_with_depth(each) for each in excerpts)
    errors = ConstantErrors()
    earlier: dict[int, Solution] = {}
    everything = list(range(len(excerpts)))
    # the first round, which starts farthest off, reads half
    numbers = _every_second(excerpts) if rounds > 1 else everything
    for _ in range(rounds):
        signals: dict[int, InertialSignal] = {}
        corrected = {number: errors.corrected(excerpts[number], signals) for number in numbers}
        try:
            windows, solutions, initial = solve_round(
                corrected, prior, clocks, joint_sigma_m, upper_arm_sigma_m, earlier, config, workers
            )
        except CalibrationError:
            if numbers == everything:
                raise
            numbers = everything  # what can be used is in the other half
            continue
        earlier |= solutions
        in_order, answers = list(windows.values()), list(solutions.values())
        used = in_order[0].priors
        place = "strap" not in used.layout.joints  # a tracked strap then represents the IMU
        recordings = np.array([excerpts[number].recording for number in windows])
        pooled = PooledEvidence.of(in_order, answers, used, recordings, errors)
        estimate = calibration_from(pooled.constants, used.layout, start, errors.joints.sigma_m)
        noise = joint_noise(in_order, answers)
        largest_m = max((each.sample_m for each in noise.values()), default=0.0)
        upper_arm_sigma_m = upper_arm_length_sigma(list(corrected.values()), config, largest_m)
        joint_sigma_m = (
            sigma_by_joint(noise, config.camera.joint_sigma_m)
            if cameras == 1
            else sigma_by_camera(noise, config.camera.joint_sigma_m, cameras)
        )
        before = prior, errors.joints, clocks
        errors = ConstantErrors.estimated(
            pooled,
            well_seen_joints(in_order, place),
            place,
            config.imu.scale_sigma,
            max(see_depth, 1),
            SYNTHETIC_SIGMA_S if any(synthetic) else 0.0,
            excerpts[0].focal_share if any(with_lens(window) for window in in_order) else 0.0,
        )
        clocks = tuple(
            refined_clock(
                clock,
                clock_score((windows[k], solutions[k]) for k in windows if excerpts[k].recording == number),
                synthetic[number],
            )
            for number, clock in enumerate(clocks)
        )
        prior = _recentred(estimate, start, given, see_depth > 0)
        if numbers == everything and _settled(before, (estimate, errors.joints, clocks)):
            break
        numbers = everything
    spread = mounting.direction_spread_rad if given.forearm_direction is None else float("nan")
    return SelfCalibration(
        estimate,
        prior,
        initial,
        clocks,
        noise,
        joint_sigma_m,
        errors,
        upper_arm_sigma_m,
        in_common(in_order, answers),
        spread,
        interrupted_s=_interrupted_s(excerpts) if given.forearm_direction is None else float("nan"),
    )


def _interrupted_s(excerpts: list[Segment]) -> float:
    """Median length of the segments that contain one recording's excerpts, where it is short; else nan."""
    if len(excerpts) < SHORT_SEGMENTS or any(excerpt.recording for excerpt in excerpts):
        return float("nan")
    length_s = float(np.median([excerpt.signal.end_s - excerpt.signal.start_s for excerpt in excerpts]))
    return length_s if length_s < SHORT_S else float("nan")


def _cameras_with_depth(excerpt: Segment) -> int:
    """How many of the cameras see depth."""
    origins = excerpt.frame_origins
    flat = np.zeros(len(excerpt.frame_t_camera), bool) if origins is None else np.isfinite(origins[:, 0])
    return len(np.unique(flat[~flat] if excerpt.camera is None else excerpt.camera[~flat]))


def _every_second(excerpts: list[Segment]) -> list[int]:
    """Numbers of every second excerpt of each recording, from the first on."""
    seen: Counter[int] = Counter()
    numbers = []
    for number, excerpt in enumerate(excerpts):
        if seen[excerpt.recording] % 2 == 0:
            numbers.append(number)
        seen[excerpt.recording] += 1
    return numbers


def _closed_form(
    excerpts: list[Segment], given: ArmCalibration, clock_sigma_s: float
) -> tuple[list[Segment], Mounting]:
    """The mounting, and the excerpts without the frames that contradict it."""
    mounting = find_mounting(excerpts, given, clock_sigma_s)
    inliers = [
        reject_by_direction(
            segment, mounting.calibration, constant_clock(mounting.offset_s[segment.recording])
        )[0]
        for segment in excerpts
    ]
    accepted = sum(int(segment.accepted.sum()) for segment in excerpts)
    rejected = sum(
        int((before.accepted & ~after.accepted).sum())
        for before, after in zip(excerpts, inliers, strict=True)
    )
    if rejected > WORTH_AGAIN * accepted:
        mounting = find_mounting(inliers, given, clock_sigma_s)
    return inliers, mounting


def _with_upper_arm(calibration: ArmCalibration, excerpts: list[Segment], config: Config) -> ArmCalibration:
    if "elbow" not in calibration.lever_arms or calibration.upper_arm is not None:
        return calibration
    return replace(calibration, upper_arm=upper_arm_seen(excerpts, config))


Settling = tuple[ArmCalibration, JointBias, tuple[Clock, ...]]


def _settled(before: Settling, after: Settling) -> bool:
    """Whether a round changed next to nothing: of lever arms, joint biases and clocks."""
    (arm, bias, clocks), (arm_after, bias_after, clocks_after) = before, after
    moves_m = [float(np.abs(bias_after.error_m - bias.error_m).max())]
    limits_m = [SETTLED_SIGMAS * bias_after.sigma_m]
    for joint, lever in arm_after.lever_arms.items():
        moves_m.append(float(np.linalg.norm(lever.position_m - arm.lever_arms[joint].position_m)))
        limits_m.append(SETTLED_SIGMAS * float(np.mean(lever.sigma_m)))
    for clock_after, clock in zip(clocks_after, clocks, strict=True):
        moves_m.append(CLOCK_WEIGHT * abs(clock_after.mean_s - clock.mean_s))
        limits_m.append(CLOCK_WEIGHT * SETTLED_SIGMAS * clock_after.sigma_s)
    return all(move < max(SETTLED_M, limit) for move, limit in zip(moves_m, limits_m, strict=True))


def _recentred(
    estimate: ArmCalibration, start: ArmCalibration, given: ArmCalibration, with_depth: bool
) -> ArmCalibration:
    """The next round's prior: the estimate, as uncertain as before; what was given stays."""
    levers = {
        joint: given.lever_arms[joint]
        if joint in given.lever_arms
        else LeverArm(lever.position_m, start.lever_arms[joint].sigma_m)
        for joint, lever in estimate.lever_arms.items()
    }
    upper_arm = given.upper_arm
    if upper_arm is None and estimate.upper_arm is not None and start.upper_arm is not None:
        value = estimate.upper_arm if with_depth else start.upper_arm
        upper_arm = replace(value, sigma_m=start.upper_arm.sigma_m)
    return replace(start, lever_arms=levers, upper_arm=upper_arm)
