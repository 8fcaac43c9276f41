"""Self-calibration: unmeasured quantities, solved from the visible motion before the recovery.

The mounting starts in closed form (`mounting`). Then a few rounds on excerpts of the recordings: window
graphs with lever arms and upper arm as variables, their answers pooled, the camera's noise measured from
the residuals, and the clock offset moved along the slope of the loss (scoring). Recordings share the arm;
each has its own clock.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from ..array_types import FloatArray, IntArray
from ..calibration import ArmCalibration, LeverArm
from ..config import Config
from ..errors import CalibrationError
from ..graph.error_columns import with_lens
from ..graph.solve import solve
from ..measurements.clock import OFFSET_SIGMA_S, Clock, constant_clock
from ..measurements.inertial import InertialSignal
from ..measurements.outliers import reject_by_direction
from ..measurements.segment import Segment
from ..recording import JOINTS
from ..runtime.pool import Pool
from ..units import GRAVITY
from ..window.cut import cut, cut_times
from ..window.pooling import pooled
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
from ..window.problem import Priors, Window
from ..window.solution import Solution
from ..window.trajectory import Trajectory, at_times, merge_windows
from .camera_noise import joint_noise, sigma_by_camera, sigma_by_joint
from .clock_fit import SYNTHETIC_SIGMA_S, refined_clocks
from .error_estimate import ConstantErrors, JointBias
from .excerpts import choose_excerpts
from .mounting import Mounting, find_mounting
from .self_calibration import SHORT_S, SelfCalibration


@dataclass(frozen=True)
class SolvedRound:
    """The windows of a round, segment after segment, and their answers."""

    prepared: dict[int, PreparedSegment]
    borders: list[list[float]]
    windows: list[Window]
    solutions: list[Solution]
    recording_of_window: IntArray
    initial: InitialValues
    prior: Priors

    def trajectories(self) -> dict[int, Trajectory]:
        """The joined trajectory of each segment, by its number."""
        merged, first = {}, 0
        for (number, prepared), border in zip(self.prepared.items(), self.borders, strict=True):
            last = first + len(border) - 1
            merged[number] = merge_windows(prepared.t, self.windows[first:last], self.solutions[first:last])
            first = last
        return merged


def solve_round(
    segments: dict[int, Segment],
    calibration: ArmCalibration,
    clocks: Sequence[Clock],
    joint_sigma_m: FloatArray,
    upper_arm_sigma_m: float,
    trajectories: dict[int, Trajectory],
    config: Config,
    workers: Pool,
) -> SolvedRound:
    """Prepare, cut and solve all segments, from the last round's trajectories where there are any."""
    margin_s = config.windows.margin_s
    ready = [
        (number, segment, *answer)
        for number, segment in segments.items()
        if (answer := prepare(segment, calibration, clocks[segment.recording], joint_sigma_m, margin_s))
    ]
    if not ready:
        raise CalibrationError("the IMU and a visible forearm never overlap")
    prepared = {number: with_initial_values(each, trajectories.get(number)) for number, _, each, _ in ready}
    initial = initial_values(
        list(prepared.values()),
        [alignment for *_, alignment in ready],
        [segment for _, segment, *_ in ready],
    )
    prior = first_priors(initial, calibration, config)
    noise = noise_of(config, upper_arm_sigma_m)
    borders = [cut_times(each, config.windows.length_s) for each in prepared.values()]
    counts = [len(border) - 1 for border in borders]
    windows: list[Window] = []

    def cut_one_by_one() -> Iterator[Window]:
        for each, border, count in zip(prepared.values(), borders, counts, strict=True):
            for window in cut(each, [prior] * count, noise, border, margin_s, GRAVITY, sum(counts)):
                windows.append(window)
                yield window

    # the first ones are solved while the next ones are cut
    solutions = list(workers.map(SOLVE_ONCE, cut_one_by_one()))
    recording = np.repeat([segment.recording for _, segment, *_ in ready], counts)
    return SolvedRound(prepared, borders, windows, solutions, recording, initial, prior)


def with_initial_values(prepared: PreparedSegment, trajectory: Trajectory | None) -> PreparedSegment:
    """The segment with an earlier solution's trajectory as start values; as it is without one."""
    if trajectory is None:
        return prepared
    inside = np.clip(prepared.t, trajectory.t[0], trajectory.t[-1])
    return prepared.with_start(at_times(trajectory.forearm, prepared.forearm.signal, inside))


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
    with_depth = any((origin := each.frame_origins) is None or np.isnan(origin).any() for each in excerpts)
    errors = ConstantErrors()
    trajectories: dict[int, Trajectory] = {}
    everything = list(range(len(excerpts)))
    # the first round, which starts farthest off, reads half
    numbers = _every_second(excerpts) if rounds > 1 else everything
    for _ in range(rounds):
        signals: dict[int, InertialSignal] = {}
        corrected = {number: errors.corrected(excerpts[number], signals) for number in numbers}
        try:
            current = solve_round(
                corrected, prior, clocks, joint_sigma_m, upper_arm_sigma_m, trajectories, config, workers
            )
        except CalibrationError:
            if numbers == everything:
                raise
            numbers = everything  # what can be used is in the other half
            continue
        windows, solutions, trajectories = current.windows, current.solutions, current.trajectories()
        shared = pooled([solution.message for solution in solutions], current.prior)
        estimate = calibration_from(shared, current.prior.layout, start, errors.joints.sigma_m)
        noise = joint_noise(windows, solutions)
        largest_m = max((each.sample_m for each in noise.values()), default=0.0)
        upper_arm_sigma_m = upper_arm_length_sigma(list(corrected.values()), config, largest_m)
        joint_sigma_m = (
            sigma_by_joint(noise, config.camera.joint_sigma_m)
            if cameras == 1
            else sigma_by_camera(noise, config.camera.joint_sigma_m, cameras)
        )
        before = prior, errors.joints, clocks
        errors = errors.updated(
            windows,
            solutions,
            current.prior,
            current.recording_of_window,
            config.imu.scale_sigma,
            SYNTHETIC_SIGMA_S if any(synthetic) else 0.0,
            excerpts[0].focal_share if any(with_lens(window) for window in windows) else 0.0,
        )
        clocks = refined_clocks(clocks, synthetic, windows, solutions, current.recording_of_window)
        prior = _recentred(estimate, start, given, with_depth)
        if numbers == everything and _settled(before, (estimate, errors.joints, clocks)):
            break
        numbers = everything
    spread = mounting.direction_spread_rad if given.forearm_direction is None else float("nan")
    return SelfCalibration(
        estimate,
        prior,
        current.initial,
        clocks,
        noise,
        joint_sigma_m,
        errors,
        upper_arm_sigma_m,
        spread,
        interrupted_s=_interrupted_s(excerpts) if given.forearm_direction is None else float("nan"),
    )


def _interrupted_s(excerpts: list[Segment]) -> float:
    """Median length of the segments that contain one recording's excerpts, where it is short; else nan."""
    if len(excerpts) < SHORT_SEGMENTS or any(excerpt.recording for excerpt in excerpts):
        return float("nan")
    length_s = float(np.median([excerpt.signal.end_s - excerpt.signal.start_s for excerpt in excerpts]))
    return length_s if length_s < SHORT_S else float("nan")


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
