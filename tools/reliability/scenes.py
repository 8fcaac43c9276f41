"""Scenes of the second simulator: what sensors make of a motion, unusual set-ups, what an answer is worth.

Written apart from `smoother.simulation`; `python -m tools.accuracy oracle` counts them.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import numpy as np
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

from smoother.array_types import BoolArray, FloatArray
from smoother.evaluation.metrics import squared_sigmas
from smoother.linalg import interpolate, runs, unit
from smoother.recording import JOINTS, CameraFrame, ImuStream, JointState, JointTracks, Recording
from smoother.result import Recovery
from smoother.simulation import ArmSimulation, simulate_arm
from smoother.smoothing import smooth
from tools.accuracy.check import ONE_PROCESS, PRESETS, Run, ended
from tools.reliability.people import Gaps, Motion, perform, slow_noise

#: Lowest rate at which the motion is sampled, and rates of IMUs, Hz.
FINE_HZ, IMU_RATES_HZ = 1000.0, (50.0, 60.0, 100.0, 120.0)
#: Of an ordinary IMU: density of the white noise, bias per axis, its walk per sqrt(s), full scale of 16 bits.
SENSORS = {"acc": (0.002, 0.05, 5e-4, 16 * 9.81), "gyro": (2e-4, 0.008, 5e-5, np.radians(2000.0))}
#: Scale and misalignment per axis, as fractions and rad.
SCALE, MISALIGNMENT = 0.002, 0.003


def ideal_imu(motion: Motion, duration_s: float, rate_hz: float) -> ImuStream:
    """Error-free samples: means over each sample's interval, stamped at its centre."""
    fine, count = int(np.ceil(FINE_HZ / rate_hz)), int(duration_s * rate_hz)
    h = 1.0 / (rate_hz * fine)
    edges = h * np.arange(count * fine + 1, dtype=np.float64)
    middles = edges[:-1] + 0.5 * h
    turns, R_K_A = Rotation.from_matrix(motion.imu_pose(edges)[0]), motion.imu_pose(middles)[0]
    rate = (turns[:-1].inv() * turns[1:]).as_rotvec() / h
    before, here, after = (motion.imu_pose(middles + k * 0.5 * h)[1] for k in (-1, 0, 1))
    acceleration = (after - 2 * here + before) / (0.5 * h) ** 2
    force = np.einsum("nji,nj->ni", R_K_A, acceleration - motion.gravity)
    acc, gyro = (values.reshape(count, fine, 3).mean(axis=1) for values in (force, rate))
    return ImuStream("simulated wrist", (np.arange(count, dtype=np.float64) + 0.5) / rate_hz, acc, gyro)


def worn_imu(motion: Motion, duration_s: float, rate_hz: float, rng: np.random.Generator) -> ImuStream:
    """An ordinary IMU on a wrist, better or worse by half."""
    quality, samples = rng.uniform(0.5, 1.5), {}
    ideal = ideal_imu(motion, duration_s, rate_hz)
    for name, (density, bias, walk, full) in SENSORS.items():
        true = getattr(ideal, name)
        matrix = np.eye(3) + np.diag(rng.normal(0, SCALE * quality, 3))
        matrix += np.tril(rng.normal(0, MISALIGNMENT, (3, 3)), -1)
        drift = rng.normal(0, bias * quality, 3)
        drift = drift + np.cumsum(rng.normal(0, walk / np.sqrt(ideal.rate_hz), true.shape), axis=0)
        values = true @ matrix.T + drift + rng.normal(0, density * np.sqrt(ideal.rate_hz), true.shape)
        step = full / 2**15
        samples[name] = np.clip(np.round(values / step) * step, -full, full)
    return replace(ideal, **samples)


class Tracker(NamedTuple):
    """How well a skeleton tracker sees."""

    white_m: float  # White noise, per axis
    slow_m: tuple[float, ...]  # Noise with a memory, 3D rms, by joint
    memory_s: float  # Of the slow noise
    offset_m: float  # Constant error of a joint, 3D, half of it fixed to the camera and half to the limb


#: Depth cameras and networks from good to poor, with how often each is drawn.
TRACKERS = {
    "good": (0.3, Tracker(0.003, (0.004, 0.005, 0.007, 0.010), 0.3, 0.006)),
    "ordinary": (0.5, Tracker(0.005, (0.008, 0.012, 0.018, 0.025), 0.5, 0.010)),
    "poor": (0.2, Tracker(0.006, (0.015, 0.022, 0.040, 0.050), 0.6, 0.015)),
}
#: Frames per second, and the part of them that never arrives.
FRAMES_HZ, DROPPED = 30.0, 0.01
#: How many joints the tracker knows, the first of their columns; the strap's column stays empty.
TRACKED = 4


def plan_gaps(duration_s: float, rng: np.random.Generator, every_s: float) -> Gaps:
    """When the arm will be hidden: one or more gaps of 0.5 to 4 s, at least 1.5 s of sight between them."""
    gaps: list[tuple[float, float]] = []
    t_s = rng.uniform(3.0, 6.0)
    while True:
        length_s = float(rng.choice([0.5, 1.0, 1.5, 2.0, 3.0, 4.0]))
        if t_s + length_s > duration_s - 2.5:
            break
        gaps.append((t_s, t_s + length_s))
        t_s += length_s + 1.5 + rng.exponential(every_s - 1.5)
    # a short recording has one all the same
    return tuple(gaps) or ((0.5 * duration_s - 0.6, 0.5 * duration_s + 0.6),)


def film(
    motion: Motion, tracker: Tracker, duration_s: float, gaps: Gaps, rng: np.random.Generator
) -> JointTracks:
    """What a tracker makes of a person who is hidden now and then, stamped by the true time."""
    times_rng, noise_rng, state_rng = rng.spawn(3)
    t_s = np.arange(times_rng.uniform(0, 1) / FRAMES_HZ, duration_s, 1.0 / FRAMES_HZ)
    t_s = t_s[times_rng.uniform(size=len(t_s)) >= DROPPED]
    position = np.full((len(t_s), len(JOINTS), 3), np.nan)
    for name, place in motion.joints(t_s).items():
        position[:, JOINTS.index(name)] = place
    hidden = np.zeros(len(t_s), dtype=bool)
    state = np.zeros((len(t_s), len(JOINTS)), dtype=np.int8)
    state[:, :TRACKED] = JointState.TRACKED
    for start_s, end_s in gaps:
        inside = (t_s >= start_s) & (t_s < end_s)
        hidden |= inside
        later = (t_s >= start_s + state_rng.uniform(0, 0.12)) & (t_s < end_s)
        state[inside, 2:4] = JointState.NOT_TRACKED
        state[later, 1] = JointState.NOT_TRACKED
    state[hidden & (state_rng.uniform(size=len(t_s)) < 0.05), 0] = JointState.NOT_TRACKED
    state[state_rng.uniform(size=len(t_s)) < 0.01, 3] = JointState.NOT_TRACKED  # hands are lost at any time
    return JointTracks("skeleton", t_s, position + tracker_error(motion, tracker, t_s, noise_rng), state)


def tracker_error(motion: Motion, tracker: Tracker, t_s: FloatArray, rng: np.random.Generator) -> FloatArray:
    """(F, 5, 3) m: white and slow noise, constant errors of the camera and of the limbs."""
    error = rng.normal(0, tracker.white_m, (len(t_s), len(JOINTS), 3))
    memory = np.exp(-1.0 / (FRAMES_HZ * tracker.memory_s))
    drive = rng.normal(size=(len(t_s), TRACKED, 3)) * np.sqrt(1 - memory**2)
    drive[0] /= np.sqrt(1 - memory**2)
    slow = lfilter([1.0], [1.0, -memory], drive, axis=0)
    error[:, :TRACKED] += slow * (np.array(tracker.slow_m) / np.sqrt(3))[:, None]
    joints = motion.joints(t_s)
    along = unit(joints["wrist"] - joints["elbow"])
    for column in range(TRACKED):
        error[:, column] += 0.6 * tracker.offset_m * unit(rng.normal(size=3))
        error[:, column] += 0.6 * tracker.offset_m * rng.normal() * along
    return np.asarray(error)


@dataclass(frozen=True)
class Scene:
    """What is smoothed, and what is known of it."""

    exercise: str
    duration_s: float
    gaps: Gaps  # When the arm is hidden, true time
    rng: np.random.Generator  # Of the case's draws
    motion: Motion  # Whose skeleton it is
    arm: JointTracks  # What the tracker states, by the true time
    imu: ImuStream  # By the true time
    offset_s: float  # t_imu = t_camera + offset; the IMU's clock is the true time
    # True time and places (N, 3) of the body to what the skeleton's coordinates call them
    view: Callable[[FloatArray, FloatArray], FloatArray] = lambda t_s, place: place
    clocks_unrelated: bool = False  # The files count from clocks that have nothing in common
    judged_joints: tuple[str, ...] = ("wrist",)  # Whose places are held against the truth, besides the IMU's

    def trial(self) -> Trial:
        """What a user gives to `smooth`: stamped by the camera's clock, 1 ms unevenly; and the truth."""
        count, rng = len(self.arm), np.random.default_rng(len(self.arm))  # the same whatever the case changed
        stamps = self.arm.t_s - self.offset_s + np.clip(rng.normal(0, 0.001, count), -0.004, 0.004)
        unseen = self.arm.state[:, :, None] == JointState.NOT_TRACKED
        recording = Recording(
            imu=self.imu,
            arm=replace(self.arm, t_s=stamps, position=np.where(unseen, np.nan, self.arm.position)),
            side="right",
            camera_frame=CameraFrame.KINECT,
            name=self.exercise,
            clocks_unrelated=self.clocks_unrelated,
        )

        def truth_at(t_s: FloatArray) -> dict[str, FloatArray]:
            joints = self.motion.joints(t_s)
            truth = {name: joints[name] for name in self.judged_joints}
            truth["imu"] = self.motion.imu_pose(t_s)[1]
            return {name: self.view(t_s, place) for name, place in truth.items()}

        return Trial(recording, truth_at, self.gaps)


def draw_scene(exercise: str, duration_s: float, seed: list[int], every_s: float = 5.0) -> Scene:
    """A sound recording of an exercise."""
    plan_rng, motion_rng, camera_rng, imu_rng, case_rng = np.random.default_rng(seed).spawn(5)
    shares = [share for share, _ in TRACKERS.values()]
    _, tracker = TRACKERS[str(plan_rng.choice(list(TRACKERS), p=shares))]
    gaps = plan_gaps(duration_s, plan_rng, every_s)
    motion = perform(exercise, duration_s, motion_rng, gaps)
    rate_hz = float(plan_rng.choice(IMU_RATES_HZ))
    arm = film(motion, tracker, duration_s, gaps, camera_rng)
    imu, offset_s = worn_imu(motion, duration_s, rate_hz, imu_rng), float(plan_rng.uniform(-0.12, 0.12))
    return Scene(exercise, duration_s, gaps, case_rng, motion, arm, imu, offset_s)


# Unusual set-ups, each a function of a sound scene, and wrong pairs of the project's own presets


def trial_cut_by_hand(scene: Scene) -> Scene:
    """A trial of 8 to 10 s, camera and IMU cut from their recordings by eye, up to 3 s apart."""
    shift_s = float(scene.rng.choice([-1.0, 1.0]) * scene.rng.uniform(1.0, 3.0))
    return replace(scene, offset_s=shift_s, clocks_unrelated=True)


def shoulder_moves_fast(scene: Scene) -> Scene:
    """The trunk bends forward and back at 0.8 to 1.9 m/s, or walks; the shoulder is seen all the time."""
    state = scene.arm.state.copy()
    state[:, 0] = JointState.TRACKED
    return replace(scene, arm=replace(scene.arm, state=state), judged_joints=("wrist", "shoulder"))


def camera_sways(scene: Scene) -> Scene:
    """A camera that somebody holds: it turns by a degree or two to and fro."""
    fine_s = np.arange(0.0, scene.duration_s + 1.0, 0.02)
    turns = slow_noise(fine_s, 3, np.radians(1.5), 1.5, scene.rng)

    def view(t_s: FloatArray, place: FloatArray) -> FloatArray:
        return Rotation.from_rotvec(interpolate(fine_s, turns, t_s)).apply(place)

    position = scene.arm.position.copy()
    for column in range(TRACKED):
        position[:, column] = view(scene.arm.t_s, position[:, column])
    return replace(scene, arm=replace(scene.arm, position=position), view=view)


def mirrored_in_one_plane(scene: Scene) -> Scene:
    """A mirrored skeleton; what the camera sees stays in one upright plane, what it does not see does not."""
    mirror = np.array([-1.0, 1.0, 1.0])
    arm = replace(scene.arm, position=scene.arm.position * mirror)
    return replace(scene, arm=arm, view=lambda t_s, place: place * mirror)


#: Exercises in which the arm moves enough in all directions for most set-ups to matter.
LIVELY = (
    *("reaching out", "drinking", "combing", "behind the back"),
    *("wiping", "lifting", "wheelchair", "daily life"),
)
#: Set-ups: what is done to a sound scene, exercises, shortest and longest, s, from a gap to the next one, s.
UNUSUAL: tuple[tuple[Callable[[Scene], Scene], tuple[str, ...], tuple[float, float], float], ...] = (
    (trial_cut_by_hand, LIVELY, (8.0, 10.0), 3.0),
    (shoulder_moves_fast, ("bending forward", "walking about"), (26.0, 45.0), 5.0),
    (camera_sways, LIVELY, (26.0, 45.0), 5.0),
)


def unusual_jobs(count: int, rng: np.random.Generator) -> Iterator[Callable[[], Run]]:
    """As many set-ups to smooth and judge, the cases in turn; the first do not depend on how many follow."""
    for number in range(count):
        _, exercises, lengths_s, _ = UNUSUAL[number % len(UNUSUAL)]
        exercise, duration_s = str(rng.choice(exercises)), round(float(rng.uniform(*lengths_s)), 1)
        yield partial(unusual, number % len(UNUSUAL), exercise, duration_s, int(rng.integers(2**31)))


def unusual(case: int, exercise: str, duration_s: float, seed: int) -> Run:
    """Smooth and judge a set-up."""
    change, _, _, every_s = UNUSUAL[case]
    # the second number is of a family of seeds
    return run(change(draw_scene(exercise, duration_s, [seed, 0], every_s)).trial())


def wrong_pairs(count: int, rng: np.random.Generator) -> Iterator[Callable[[], Run]]:
    """Skeletons of simulated arms with the IMU of another one that does the same."""
    for number in range(count):
        seeds = int(rng.integers(2**30)), int(rng.integers(2**30, 2**31))
        protocol = ("behind", "random")[number % 2]
        yield partial(wrong_pair, PRESETS[number % len(PRESETS)], protocol, *seeds)


def wrong_pair(preset: str, protocol: str, skeleton_seed: int, imu_seed: int) -> Run:
    """Smooth and judge a wrong pair."""
    config = ArmSimulation.preset(preset, protocol=protocol, repetitions=3, duration_s=70.0)
    one, other = simulate_arm(config, skeleton_seed), simulate_arm(config, imu_seed)
    offset_s = float(one.parameters["clock_offset_s"])
    true_t = one.recording.arm.t_s + offset_s

    def truth_at(t_s: FloatArray) -> dict[str, FloatArray]:
        inside = np.clip(t_s, true_t[0], true_t[-1])
        return {"wrist": np.where((t_s == inside)[:, None], one.motion.joints(inside)["wrist"], np.nan)}

    spans = [gap for gap in runs(one.occluded) if gap.stop - gap.start > 3]
    hidden = tuple((float(true_t[gap.start]), float(true_t[gap.stop - 1])) for gap in spans)
    mixed = replace(one.recording, imu=other.recording.imu, truth=None)
    return run(Trial(mixed, truth_at, hidden, offset_s), wrong_pair=True)


# What an answer is worth against its truth

#: Wrong: farther off than this over all gaps or over a single one (rms), and than this many stated sigmas, m.
GAPS_M, ONE_GAP_M, SIGMAS = 0.10, 0.15, 3.0
#: An interval is treated as trusted where more of its samples than this are.
TRUSTED_SHARE = 0.5


@dataclass(frozen=True)
class Trial:
    """A recording with what is needed to judge its answer."""

    recording: Recording  # As a user gives it
    truth_at: Callable[[FloatArray], dict[str, FloatArray]]  # True times (N,) to places (N, 3) by name, m
    intervals: Gaps  # When the arm is hidden, on the true clock, s
    offset_s: float | None = None  # Where the IMU's time has nothing to do with the motion


class Rated(NamedTuple):
    """An interval of an answer."""

    length_s: float
    # Rms of the wrist's error or of the IMU's (or of another joint's), the larger one in sigmas, and what is
    # stated of it (3D); nan where there is no answer
    error_m: float
    sigma_m: float
    trusted: bool  # The answer calls more than half of the interval's samples trusted
    squared_sigmas: FloatArray  # (n,): of its samples, wrist and IMU


def wrong_and_trusted(rated: list[Rated]) -> int:
    """How many intervals are wrong and called trusted; one where they are wrong together."""
    gaps = [each for each in rated if each.trusted and np.isfinite(each.error_m)]
    single = sum(each.error_m > max(ONE_GAP_M, SIGMAS * each.sigma_m) for each in gaps)
    if single or not gaps:
        return single
    errors = np.array([(each.error_m, each.sigma_m) for each in gaps])
    error_m, sigma_m = np.sqrt(np.average(errors**2, axis=0, weights=[each.length_s for each in gaps]))
    return int(error_m > max(GAPS_M, SIGMAS * sigma_m))


def run(trial: Trial, wrong_pair: bool = False) -> Run:
    """Smooth a trial as a user would, and judge the answer; to a wrong pair it is wrong if trusted."""
    try:
        recovery = smooth(trial.recording, None, ONE_PROCESS)
    except Exception as error:
        return Run([], ended(error))
    intervals, trusted = list(rated(recovery, trial)), recovery.estimates.trusted is True
    counts = Counter(recordings=1, trusted=trusted, gaps=len(intervals))
    counts["gaps trusted"] = sum(each.trusted for each in intervals)
    counts["wrong"] = int(trusted) if wrong_pair else wrong_and_trusted(intervals)
    errors = []
    for each in () if wrong_pair else intervals:
        errors.append(np.full((len(each.squared_sigmas), 4), np.nan))
        errors[-1][:, 0], errors[-1][:, 1] = each.error_m, each.squared_sigmas
    return Run(errors, counts)


def rated(recovery: Recovery, trial: Trial) -> Iterator[Rated]:
    """Every interval of an answer."""
    t_s = recovery.t_s
    if trial.offset_s is not None:
        t_s = t_s - recovery.clock_offset_s + trial.offset_s
    truth, trusted = trial.truth_at(t_s), trusted_samples(recovery)
    answers = {name: (place, recovery.joint_covariance[name]) for name, place in recovery.joints.items()}
    answers["imu"] = (recovery.position, recovery.pose_covariance[:, :3, :3])
    for start_s, end_s in trial.intervals:
        rows = (t_s > start_s) & (t_s < end_s)
        if not rows.any():
            continue
        errors, squares = [], [np.empty(0)]
        for name in (name for name in truth if name in answers):
            answer, covariance = answers[name]
            error, covariance = answer[rows] - truth[name][rows], covariance[rows]
            known = np.isfinite(error).all(axis=1) & np.isfinite(covariance).all(axis=(1, 2))
            if known.any():
                error, covariance = error[known], covariance[known]
                variance = np.trace(covariance, axis1=1, axis2=2).mean()
                errors.append((float(np.sqrt((error**2).sum(axis=1).mean())), float(np.sqrt(variance))))
                squares.append(squared_sigmas(error, covariance))
        error_m, sigma_m = max(errors, key=lambda pair: pair[0] / pair[1], default=(np.nan, np.nan))
        believed = bool(trusted[rows].mean() > TRUSTED_SHARE) and bool(errors)
        yield Rated(end_s - start_s, error_m, sigma_m, believed, np.concatenate(squares))


def trusted_samples(recovery: Recovery) -> BoolArray:
    """(N,) what the answer calls trusted; nothing where the recording is not."""
    return np.asarray(recovery.trusted, dtype=bool) & (recovery.estimates.trusted is not False)
