"""A scene: a motion, what both sensors make of it, and how an answer is to be held against the truth.

The sensors of the second simulator: an IMU, and what skeleton trackers make of a body.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

from smoother.array_types import BoolArray, FloatArray
from smoother.linalg import unit
from smoother.recording import JOINTS, CameraFrame, ImuStream, JointState, JointTracks, Recording
from tools.reliability.body import Motion
from tools.reliability.motions import Gaps, perform

#: Lowest rate at which the motion is sampled, Hz.
FINE_HZ = 1000.0


def ideal_imu(motion: Motion, duration_s: float, rate_hz: float) -> ImuStream:
    """Error-free samples: means over each sample's interval, stamped at its centre."""
    fine = int(np.ceil(FINE_HZ / rate_hz))
    count = int(duration_s * rate_hz)
    h = 1.0 / (rate_hz * fine)
    edges = h * np.arange(count * fine + 1, dtype=np.float64)
    middles = edges[:-1] + 0.5 * h
    R_edges, _ = motion.imu_pose(edges)
    R_K_A, _ = motion.imu_pose(middles)
    turns = Rotation.from_matrix(R_edges)
    rate = (turns[:-1].inv() * turns[1:]).as_rotvec() / h
    before, here, after = (motion.imu_pose(middles + k * 0.5 * h)[1] for k in (-1, 0, 1))
    acceleration = (after - 2 * here + before) / (0.5 * h) ** 2
    force = np.einsum("nji,nj->ni", R_K_A, acceleration - motion.camera.gravity)
    acc, gyro = (values.reshape(count, fine, 3).mean(axis=1) for values in (force, rate))
    stamps = (np.arange(count, dtype=np.float64) + 0.5) / rate_hz
    return ImuStream("simulated wrist", stamps, acc, gyro)


@dataclass(frozen=True)
class ImuErrors:
    """How large a sensor's errors are: densities and sigmas, SI units."""

    acc_density: float = 0.002
    gyro_density: float = 2e-4
    acc_bias: float = 0.05  # m/s^2: per axis
    gyro_bias: float = 0.01  # m/s^2: per axis
    acc_walk: float = 5e-4  # Of the biases, per sqrt(s)
    gyro_walk: float = 5e-5  # Of the biases, per sqrt(s)
    scale: float = 0.002  # Per axis, as fractions and rad
    misalignment: float = 0.003  # Per axis, as fractions and rad
    acc_range: float = 16 * 9.81  # m/s^2: full scale, of 16 bits
    gyro_range: float = np.radians(2000.0)  # m/s^2: full scale, of 16 bits
    names: tuple[str, ...] = field(default=("acc", "gyro"), repr=False)


def measured(ideal: ImuStream, errors: ImuErrors, rng: np.random.Generator) -> ImuStream:
    """The samples with a sensor's errors."""
    rate_hz, samples = ideal.rate_hz, {}
    for name in errors.names:
        density, bias, walk, full = (
            getattr(errors, f"{name}_{of}") for of in ("density", "bias", "walk", "range")
        )
        true = getattr(ideal, name)
        matrix = np.eye(3) + np.diag(rng.normal(0, errors.scale, 3))
        matrix += np.tril(rng.normal(0, errors.misalignment, (3, 3)), -1)
        drift = rng.normal(0, bias, 3) + np.cumsum(rng.normal(0, walk / np.sqrt(rate_hz), true.shape), axis=0)
        values = true @ matrix.T + drift + rng.normal(0, density * np.sqrt(rate_hz), true.shape)
        step = full / 2**15
        samples[name] = np.clip(np.round(values / step) * step, -full, full)
    return replace(ideal, acc=samples["acc"], gyro=samples["gyro"])


#: Joints that the tracker knows, in the order of their columns; the strap's column stays empty.
TRACKED = JOINTS[:4]


@dataclass(frozen=True)
class Tracker:
    """How well a tracker sees."""

    white_m: float  # White noise, per axis
    slow_m: tuple[float, ...]  # Noise with a memory, 3D rms, by joint
    memory_s: float  # Of the slow noise
    offset_m: float  # Constant error of a joint, 3D, half of it fixed to the camera and half to the limb
    rate_hz: float = 30.0  # Frames per second
    dropped: float = 0.01  # Fraction of the frames that never arrive


#: Depth cameras and networks from good to poor.
TRACKERS = {
    "good": Tracker(0.003, (0.004, 0.005, 0.007, 0.010), 0.3, 0.006),
    "ordinary": Tracker(0.005, (0.008, 0.012, 0.018, 0.025), 0.5, 0.010),
    "poor": Tracker(0.006, (0.015, 0.022, 0.040, 0.050), 0.6, 0.015),
}


def plan_gaps(duration_s: float, rng: np.random.Generator, *, every_s: float = 5.0) -> Gaps:
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


@dataclass(frozen=True)
class Film:
    """Frames of a tracker before they are stamped."""

    t_s: FloatArray  # (F,) s: True times
    true: FloatArray  # (F, 5, 3) m: Where the joints are, in {K}
    error: FloatArray  # (F, 5, 3) m: what the tracker adds to any joint that it sees
    position: FloatArray  # (F, 5, 3) m: what it states; nan where nothing
    state: np.ndarray  # int (F, 5): `JointState` values
    hidden: BoolArray  # bool (F,): the arm is behind something, whatever the tracker states

    def tracks(self, offset_s: float, rng: np.random.Generator) -> JointTracks:
        """The frames on the camera's clock (t_imu = t_camera + offset), stamped 1 ms unevenly."""
        stamp = self.t_s - offset_s + np.clip(rng.normal(0, 0.001, len(self.t_s)), -0.004, 0.004)
        position = np.where(self.state[:, :, None] == JointState.NOT_TRACKED, np.nan, self.position)
        return JointTracks("skeleton", stamp, position, self.state.copy())

    def between(self, start_s: float, end_s: float) -> BoolArray:
        """(F,) frames between two true times."""
        return np.asarray((self.t_s >= start_s) & (self.t_s < end_s))


def in_columns(joints: dict[str, FloatArray]) -> FloatArray:
    """Joints by name (F, 3) as (F, 5, 3), nan where there is none."""
    columns = np.full((len(next(iter(joints.values()))), len(JOINTS), 3), np.nan)
    for name, place in joints.items():
        columns[:, JOINTS.index(name)] = place
    return columns


def film(motion: Motion, tracker: Tracker, duration_s: float, gaps: Gaps, rng: np.random.Generator) -> Film:
    """What a tracker makes of a person who is hidden now and then."""
    times_rng, noise_rng, state_rng = rng.spawn(3)
    t_s = np.arange(times_rng.uniform(0, 1) / tracker.rate_hz, duration_s, 1.0 / tracker.rate_hz)
    t_s = t_s[times_rng.uniform(size=len(t_s)) >= tracker.dropped]
    true = in_columns(motion.joints(t_s))
    error = tracker_error(motion, tracker, t_s, noise_rng)
    hidden = np.zeros(len(t_s), dtype=bool)
    state = np.zeros((len(t_s), len(JOINTS)), dtype=np.int8)
    state[:, : len(TRACKED)] = JointState.TRACKED
    for start_s, end_s in gaps:
        inside = (t_s >= start_s) & (t_s < end_s)
        hidden |= inside
        later = (t_s >= start_s + state_rng.uniform(0, 0.12)) & (t_s < end_s)
        state[inside, 2:4] = JointState.NOT_TRACKED
        state[later, 1] = JointState.NOT_TRACKED
    state[hidden & (state_rng.uniform(size=len(t_s)) < 0.05), 0] = JointState.NOT_TRACKED
    state[state_rng.uniform(size=len(t_s)) < 0.01, 3] = JointState.NOT_TRACKED  # hands are lost at any time
    return Film(t_s, true, error, true + error, state, hidden)


def tracker_error(motion: Motion, tracker: Tracker, t_s: FloatArray, rng: np.random.Generator) -> FloatArray:
    """(F, 5, 3) m: white and slow noise, constant errors of the camera and of the limbs."""
    frames = len(t_s)
    error = rng.normal(0, tracker.white_m, (frames, len(JOINTS), 3))
    memory = np.exp(-1.0 / (tracker.rate_hz * tracker.memory_s))
    drive = rng.normal(size=(frames, len(TRACKED), 3)) * np.sqrt(1 - memory**2)
    drive[0] /= np.sqrt(1 - memory**2)
    slow = lfilter([1.0], [1.0, -memory], drive, axis=0)
    error[:, : len(TRACKED)] += slow * (np.array(tracker.slow_m) / np.sqrt(3))[:, None]
    joints = motion.joints(t_s)
    along = unit(joints["wrist"] - joints["elbow"])
    for column in range(len(TRACKED)):
        error[:, column] += 0.6 * tracker.offset_m * unit(rng.normal(size=3))
        error[:, column] += 0.6 * tracker.offset_m * rng.normal() * along
    return np.asarray(error)


#: True time and places (N, 3) of the body to what the skeleton's coordinates call them.
View = Callable[[FloatArray, FloatArray], FloatArray]


def as_it_is(t_s: FloatArray, place: FloatArray) -> FloatArray:
    """The camera's coordinates as they are."""
    return place


@dataclass(frozen=True)
class Scene:
    """What is smoothed, and what is known of it."""

    exercise: str  # What the person does
    duration_s: float
    gaps: Gaps  # When the arm is hidden, true time
    rng: np.random.Generator  # Of the case's draws
    motion: Motion  # Whose skeleton it is
    film: Film  # What the tracker states
    imu: ImuStream  # On the true time
    offset_s: float  # t_imu = t_camera + offset; the IMU's clock is the true time
    view: View = as_it_is  # What the truth is called in the camera's coordinates
    clocks_unrelated: bool = False  # The files count from clocks that have nothing in common
    judged_joints: tuple[str, ...] = ("wrist",)  # Whose places are held against the truth, besides the IMU's

    def changed(self, **changes: Any) -> Scene:
        """The scene with other fields."""
        return replace(self, **changes)

    @property
    def tracks(self) -> JointTracks:
        """The skeleton on the camera's clock; the same jitter of the stamps whatever the case changed."""
        return self.film.tracks(self.offset_s, np.random.default_rng(len(self.film.t_s)))

    def recording(self) -> Recording:
        """What a user gives to `smooth`."""
        return Recording(
            imu=self.imu,
            arm=self.tracks,
            side="right",
            camera_frame=CameraFrame.KINECT,
            name=self.exercise,
            clocks_unrelated=self.clocks_unrelated,
        )


#: Sensors from good to ordinary, and rates, Hz.
IMU_RATES_HZ = (50.0, 60.0, 100.0, 120.0)


def draw_scene(
    exercise: str,
    duration_s: float,
    seed: list[int],
    *,
    every_s: float = 5.0,
) -> Scene:
    """A sound recording of an exercise."""
    plan_rng, motion_rng, camera_rng, imu_rng, case_rng = np.random.default_rng(seed).spawn(5)
    tracker = TRACKERS[str(plan_rng.choice(list(TRACKERS), p=[0.3, 0.5, 0.2]))]
    gaps = plan_gaps(duration_s, plan_rng, every_s=every_s)
    motion = perform(exercise, duration_s, motion_rng, gaps)
    imu_rate_hz = float(plan_rng.choice(IMU_RATES_HZ))
    return Scene(
        exercise=exercise,
        duration_s=duration_s,
        gaps=gaps,
        rng=case_rng,
        motion=motion,
        film=film(motion, tracker, duration_s, gaps, camera_rng),
        imu=worn_imu(motion, duration_s, imu_rate_hz, imu_rng),
        offset_s=float(plan_rng.uniform(-0.12, 0.12)),
    )


def worn_imu(motion: Motion, duration_s: float, rate_hz: float, rng: np.random.Generator) -> ImuStream:
    """An ordinary IMU on a wrist."""
    quality = rng.uniform(0.5, 1.5)
    errors = ImuErrors(acc_bias=0.05 * quality, gyro_bias=0.008 * quality, scale=0.002 * quality)
    return measured(ideal_imu(motion, duration_s, rate_hz), errors, rng)
